"""Live plays of the blocking client: `with m.live(...) as live`.

A thread reads the daemon's answers on the play's own connection. The caller's thread writes: it never waits for the daemon,
and what the connection does not take at once the thread sends. `_live.py` has the messages and their answers.

Invariant: the connection and `Updates` are used under one lock. So TLS is safe, too, and numbers go out in order.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from . import _live
from . import _operations as ops
from ._answers import Answerable
from ._arguments import hints, number
from ._endpoint import Endpoint
from ._live import END_TIMEOUT, Drives, KnownUpdate, LivePlay, Pose, Started, Updates
from ._operations import Core
from ._plays import quietly
from ._transport import tls
from .errors import ConnectionLost, MeissnerError, Unreachable
from .results import LiveResult, Receipt

if TYPE_CHECKING:
    from .client import Client

_CONNECT_TIMEOUT = 10.0


@hints
class Update(KnownUpdate):
    """A message of a live play."""

    def __init__(self, live: Live, seq: int) -> None:
        self._answered = threading.Event()
        super().__init__(seq, self._answered)
        self._live = live

    def wait(self, timeout: float | None = None) -> LiveResult:
        """Wait for the daemon's answer. Raises the refusal, or `TimeoutError` after `timeout` s.

        Waiting is no sign of life: if it takes longer than the play's `timeout`, the daemon ends the play.
        """
        return self._live._wait_for(self, None if timeout is None else number("timeout", timeout, " of seconds"))


@hints
class Live(LivePlay[Update], Answerable):
    """A live play. As a context manager it ends with its block; `receipt` and `wait()` then say what became of it."""

    def __init__(self, client: Client, started: Started) -> None:
        """`Client.live()` makes them."""
        super().__init__(started.accepted)
        self._client = client
        self._lock = threading.Lock()
        self._updates = Updates(self.id, lambda seq: Update(self, seq))
        self._updates.array = started.array
        self._is_over = threading.Event()
        self._socket, received = _open(client.core, started.path)
        self._outgoing = self._updates.take(received)
        threading.Thread(target=self._read, name="meissner-live", daemon=True).start()

    def _send(self, drives: Drives | None, pose: Pose | None, scale: float | None) -> Update:
        with self._lock:
            update, line = self._updates.message(drives, pose, scale)
            self._write(line)
        return update

    def _write(self, line: bytes = b"") -> None:
        """Sends what the connection takes. If it has ended, the thread finds out why."""
        self._outgoing += line
        with contextlib.suppress(OSError):
            while self._outgoing:
                self._outgoing = self._outgoing[self._socket.send(self._outgoing) :]

    def _read(self) -> None:
        """The thread: reads answers until the play is over."""
        lost: MeissnerError | None = None
        try:
            try:
                self._until_ended()
            except (OSError, MeissnerError) as error:
                lost = self._updates.lost(error)
                # The daemon must not hear calls that this thread has no answers for.
                with self._lock:
                    self._socket.close()
            receipt, failure = self._client.run(_live.outcome(self._client.core, self._updates, lost))
        except Exception as error:  # A client that was closed meanwhile, or a mistake in this package.
            receipt, failure = None, self._updates.lost(repr(error))
        with self._lock:
            self._receipt = receipt or self._receipt
            self._updates.over(failure)
            self._socket.close()
        self._is_over.set()

    def _until_ended(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._socket, selectors.EVENT_READ)
            while True:
                with self._lock:
                    self._write()
                    self._take()
                    wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if self._outgoing else 0)
                if self._updates.cause is not None:
                    break
                selector.modify(self._socket, wanted)
                # Answers and the end wake it. What the caller's thread could not send meanwhile waits 1 s at most.
                selector.select(1.0)

    def _take(self) -> None:
        """Reads what is there."""
        while self._updates.cause is None:
            try:
                data = self._socket.recv(65536)
            except (BlockingIOError, InterruptedError):
                return
            except OSError as error:
                if _wants_more(error):
                    return
                raise
            if not data:
                raise ConnectionLost("closed by the other side")
            self._write(self._updates.take(data))

    def _wait_for(self, update: Update, timeout: float | None) -> LiveResult:
        with self._lock:
            self._updates.wait_begins(update)
        try:
            update._answered.wait(timeout)
        except BaseException:
            with self._lock:
                self._updates.wait_ends(update)
            raise
        # One section: a refusal that came in between would be raised here and at the next call.
        with self._lock:
            self._updates.wait_ends(update)
            raw = self._updates.answer(update)
        return self._client.run(_live.result(self._client.core, raw))

    def end(self) -> None:
        """End the play, and wait until the daemon has ended it. The pins return.

        Raises `PlayStopped` if the daemon had ended it before, and the newest refusal that nobody has waited for.
        """
        self._finish()
        with self._lock:
            self._updates.raise_failure()
            self._updates.raise_problem()

    def _finish(self) -> None:
        """Ends the play, if it is not over."""
        with self._lock:
            if not self._updates.is_ending and not self._updates.is_over:
                self._write(self._updates.end())
        if not self._is_over.wait(END_TIMEOUT):
            with self._lock, contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            raise ConnectionLost(f"the daemon has not ended live play {self.id} within {END_TIMEOUT:.0f} s")

    def wait(self, timeout: float | None = None, *, check: bool = True) -> Receipt:
        """Wait until the play is over, and return its receipt. After the block it is over.

        Raises `PlayStopped` if the daemon has ended it, unless `check` is False, and `TimeoutError` after `timeout` s.
        """
        begun = time.monotonic()
        if not self._is_over.wait(timeout):
            raise TimeoutError(f"live play {self.id} runs after {timeout} s: wait longer, or call `end()`")
        if self._receipt is None or not self._receipt.is_over:
            left = None if timeout is None else max(0.0, timeout - (time.monotonic() - begun))
            self._receipt = self._client.run(ops.wait(self._client.core, self._accepted, left))
        return ops.checked(self._receipt) if check and not self._updates.ended_as_asked else self._receipt

    def __enter__(self) -> Live:
        with self._lock:
            self._updates.check_open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.end()
        else:
            with quietly("the live play could not be ended", True):
                self._finish()


def _open(core: Core, path: str) -> tuple[socket.socket, bytes]:
    """Opens the play's connection. Returns it with what has been received beyond the head."""
    opened = _connect(core.endpoint)
    try:
        opened.sendall(_live.upgrade(core, path))
        received, rest = b"", None
        while rest is None:
            data = opened.recv(65536)
            if not data:
                raise ConnectionLost(f"{core.endpoint.name} has closed the connection of the live play before it began")
            received += data
            rest = _live.upgraded(received)
        opened.setblocking(False)
        return opened, rest
    except OSError as error:
        opened.close()
        raise ConnectionLost(f"the connection of the live play ended before it began ({error})") from error
    except BaseException:
        opened.close()
        raise


def _connect(endpoint: Endpoint) -> socket.socket:
    address = urlsplit(endpoint.url)
    try:
        if endpoint.socket is not None:
            opened = socket.socket(socket.AF_UNIX)
            try:
                opened.settimeout(_CONNECT_TIMEOUT)
                opened.connect(endpoint.socket)
            except BaseException:
                opened.close()
                raise
            return opened
        place = (address.hostname or "", address.port or (443 if endpoint.is_secure else 80))
        opened = socket.create_connection(place, _CONNECT_TIMEOUT)
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # It closes the socket if the handshake fails.
        return tls().wrap_socket(opened, server_hostname=address.hostname) if endpoint.is_secure else opened
    except OSError as error:
        raise Unreachable(
            f"no daemon answers at {endpoint.name} ({error}): start one with `meissner daemon`"
        ) from error


def _wants_more(error: OSError) -> bool:
    """Whether TLS has to wait for the connection."""
    import ssl

    return isinstance(error, (ssl.SSLWantReadError, ssl.SSLWantWriteError))
