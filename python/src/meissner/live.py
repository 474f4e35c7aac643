"""Live plays of the client: `with m.live(...) as live`, over a WebSocket of the package websockets.

A thread reads the daemon's answers. The caller's thread writes; it waits for the daemon only while two dozen messages have no answer.
`_live.py` has the messages and their answers.

Invariant: `Updates` is used, and messages are sent, under one lock. So numbers go out in order.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any

from . import _live
from . import _operations as ops
from ._arguments import hints, number, whole
from ._http import Answer
from ._live import END_TIMEOUT, Drives, Pose, Started, Update, Updates
from ._operations import Core
from ._plays import KnownPlay, quietly
from ._transport import tls
from .errors import ConnectionLost, MeissnerError, UnexpectedAnswer, Unreachable
from .results import LiveResult, Receipt

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection


_CONNECT_TIMEOUT = 10.0
_CLOSE_TIMEOUT = 1.0
_BUFFER = 1 << 20
"""What the connection may hold that the daemon has not read, bytes: more than a window of messages for all motors."""


@hints
class Live(KnownPlay):
    """A live play. As a context manager it ends with its block; `receipt` and `wait()` then say what became of it."""

    def __init__(self, core: Core, started: Started) -> None:
        """`Client.live()` makes them."""
        super().__init__(core, started.accepted)
        self._lock = threading.Condition(threading.Lock())
        self._updates = Updates(self.id, started.array, self._wait_for)
        self._is_over = threading.Event()
        self._connection = _open(core, started.path)
        threading.Thread(target=self._read, name="meissner-live", daemon=True).start()

    def send(self, *, drives: Drives | None = None, pose: Pose | None = None, scale: float | None = None) -> Update:
        """Send several changes as one message, without waiting for the answer.

        An update that was refused, and that nobody waits for, raises its error at the next call, whose own message is not
        sent then. Raises `PlayStopped` once the daemon has ended the play, and `ConnectionLost` if the connection has ended.

        While two dozen messages have no answer, this waits for one.
        """
        with self._lock:
            if not self._lock.wait_for(lambda: not self._updates.is_full, END_TIMEOUT):
                raise ConnectionLost(f"the daemon has not answered live play {self.id} within {END_TIMEOUT:.0f} s")
            update, message = self._updates.message(drives, pose, scale)
            self._write(message)
        return update

    def pose(
        self, x_mm: float = 0.0, y_mm: float = 0.0, angle_deg: float = 0.0, depth_um: float | None = None
    ) -> Update:
        """Move the object: it turns anticlockwise about the array's middle, then shifts. As `send`.

        `depth_um`: how far the object's highest point is below the skin at rest, 0 to 2000; without it the depth of the object's press.
        """
        depth = {} if depth_um is None else {"depth_um": depth_um}
        return self.send(pose={"x_mm": x_mm, "y_mm": y_mm, "angle_deg": angle_deg, **depth})

    def drives(self, drives: Drives) -> Update:
        """Change these motors; the others stay as they are. As `send`."""
        return self.send(drives=drives)

    def set(self, motor: int, *, frequency_hz: float, amplitude_um: float, phase: float = 0.0) -> Update:
        """Change one motor. As `send`."""
        numbers = {"frequency_hz": frequency_hz, "amplitude_um": amplitude_um, "phase": phase}
        drive = {"motor": whole("motor", motor, -1), **{name: number(name, value) for name, value in numbers.items()}}
        return self.send(drives=[drive])

    def scale(self, scale: float) -> Update:
        """Multiply all amplitudes, 0 to 1. As `send`."""
        return self.send(scale=number("scale", scale))

    def keep(self) -> Update:
        """Show that the program is alive, and change nothing. As `send`."""
        return self.send()

    def _write(self, message: str) -> None:
        """Sends this. If the connection has ended, the thread finds out why."""
        from websockets.exceptions import ConnectionClosed

        with contextlib.suppress(ConnectionClosed):
            self._connection.send(message)

    def _hang_up(self) -> None:
        """Ends the connection at once: the daemon must not hear calls that nobody has answers for."""
        with contextlib.suppress(OSError):
            self._connection.socket.shutdown(socket.SHUT_RDWR)

    def _read(self) -> None:
        """The thread: reads answers until the play is over."""
        from websockets.exceptions import ConnectionClosed

        lost: MeissnerError | None = None
        try:
            try:
                while self._updates.cause is None:
                    answer = self._connection.recv()
                    with self._lock:
                        self._updates.take(answer)
                        self._lock.notify_all()
            except (ConnectionClosed, MeissnerError) as error:
                lost = self._updates.lost(error)
                self._hang_up()
            receipt, failure = _live.outcome(self._core, self._updates, lost)
        except Exception as error:  # A client that was closed meanwhile, or a mistake in this package.
            receipt, failure = None, self._updates.lost(repr(error))
        with self._lock:
            self._receipt = receipt or self._receipt
            self._updates.over(failure)
            self._lock.notify_all()
        self._connection.close()
        self._is_over.set()

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
        return _live.result(self._core, raw)

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
            self._hang_up()
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
            self._receipt = ops.wait(self._core, self._accepted, left)
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


def _open(core: Core, path: str) -> ClientConnection:
    """Opens the play's connection."""
    from websockets.exceptions import InvalidStatus, WebSocketException
    from websockets.sync.client import connect, unix_connect

    name, uri = core.endpoint.name, _live.address(core.endpoint, path)
    options: dict[str, Any] = {
        "additional_headers": core.headers,
        "compression": None,
        "open_timeout": _CONNECT_TIMEOUT,
        "close_timeout": _CLOSE_TIMEOUT,
        # The daemon watches over silence itself.
        "ping_interval": None,
    }
    opened: ClientConnection
    try:
        if core.endpoint.socket is not None:
            opened = unix_connect(core.endpoint.socket, uri, **options)
        else:
            opened = connect(uri, ssl=tls() if core.endpoint.is_secure else None, proxy=None, **options)
    except InvalidStatus as error:
        Answer(error.response.status_code, bytes(error.response.body or b"")).json()
        raise UnexpectedAnswer(
            f"HTTP status {error.response.status_code} instead of a WebSocket: does a proxy between here and the daemon allow it?"
        ) from error
    except TimeoutError as error:
        raise ConnectionLost(f"{name} has not taken the live play's connection ({error})") from error
    except OSError as error:
        raise Unreachable(f"no daemon answers at {name} ({error}): start one with `meissner daemon`") from error
    except WebSocketException as error:
        if isinstance(error.__cause__, EOFError):
            raise ConnectionLost(f"{name} has closed the connection of the live play before it began") from error
        raise UnexpectedAnswer(
            f"the answer to the upgrade is no WebSocket's ({error}): is this a meissner daemon?"
        ) from error
    opened.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
    # The thread closes it.
    opened.__enter__()
    return opened
