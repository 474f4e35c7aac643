"""Live plays of the client for asyncio: `async with m.live(...) as live`.

Messages are sent by plain methods: `live.pose(1.0)` needs no `await`. A task reads the daemon's answers whenever the program
awaits something. `_live.py` has the messages and their answers.

Bound: what the daemon does not read waits in memory, `WINDOW` messages at most. Newer ones merge.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Coroutine, Generator
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urlsplit

from . import _live
from . import _operations as ops
from ._answers import AsyncAnswerable
from ._arguments import hints, number
from ._endpoint import Endpoint
from ._http import Op
from ._live import END_TIMEOUT, Drives, KnownUpdate, LivePlay, Pose, Started, Updates
from ._operations import Accepted
from ._plays import quietly
from ._transport import tls
from .errors import ConnectionLost, MeissnerError, Unreachable
from .results import LiveResult, Receipt

if TYPE_CHECKING:
    from .aio import AsyncClient

T = TypeVar("T")
_CONNECT_TIMEOUT = 10.0


@hints
class AsyncUpdate(KnownUpdate):
    """A message of a live play."""

    def __init__(self, live: AsyncLive, seq: int) -> None:
        self._answered = asyncio.Event()
        super().__init__(seq, self._answered)
        self._live = live

    async def wait(self, timeout: float | None = None) -> LiveResult:
        """Wait for the daemon's answer. As `Update.wait`."""
        return await self._live._wait_for(self, None if timeout is None else number("timeout", timeout, " of seconds"))


@hints
class AsyncLive(LivePlay[AsyncUpdate], AsyncAnswerable):
    """A live play: it starts with `async with` or `await`, and ends with its block or `end()`."""

    def __init__(self, client: AsyncClient, start: Op[Started], trial: object = None) -> None:
        """`AsyncClient.live()` makes them."""
        super().__init__(Accepted(0, "live", None, None))
        self._client, self._start, self._trial = client, start, trial
        self._updates = Updates(0, lambda seq: AsyncUpdate(self, seq))
        self._writer: asyncio.StreamWriter | None = None
        self._is_over = asyncio.Event()

    async def _begin(self) -> AsyncLive:
        started = await self._client.run(self._start)
        self._accepted, self._updates.play_id = started.accepted, started.accepted.id
        self._updates.array = started.array
        endpoint = self._client.core.endpoint
        try:
            reader, received = await _within(self._open(endpoint, started.path), _CONNECT_TIMEOUT)
            self._task = asyncio.create_task(self._read(reader, self._opened, received))
        except (OSError, asyncio.TimeoutError) as error:
            self._close()
            raise Unreachable(f"no live play begins at {endpoint.name} ({error!r}): is a daemon there?") from error
        except BaseException:
            self._close()
            raise
        self._client.trials[self._trial] = self
        return self

    async def _open(self, endpoint: Endpoint, path: str) -> tuple[asyncio.StreamReader, bytes]:
        """Opens the play's connection. Returns also what has been received beyond the head."""
        reader, self._writer = await _connect(endpoint)
        self._writer.write(_live.upgrade(self._client.core, path))
        received, rest = b"", None
        while rest is None:
            data = await reader.read(65536)
            if not data:
                raise ConnectionLost(f"{endpoint.name} has closed the connection of the live play before it began")
            received += data
            rest = _live.upgraded(received)
        return reader, rest

    @property
    def _opened(self) -> asyncio.StreamWriter:
        if self._writer is None:
            raise ValueError("the live play has not begun: use `async with m.live(...) as live`")
        return self._writer

    def _close(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _send(self, drives: Drives | None, pose: Pose | None, scale: float | None) -> AsyncUpdate:
        writer = self._opened
        update, line = self._updates.message(drives, pose, scale)
        self._write(writer, line)
        return update

    def _write(self, writer: asyncio.StreamWriter, line: bytes) -> None:
        # If the connection has ended, the task finds out why.
        if line and not writer.is_closing():
            writer.write(line)

    async def _read(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, received: bytes) -> None:
        """The task: reads answers until the play is over."""
        failure: MeissnerError | None = self._updates.lost("the program ends")
        lost: MeissnerError | None = None
        try:
            try:
                await self._until_ended(reader, writer, received)
            except (OSError, MeissnerError) as error:
                lost = self._updates.lost(error)
            receipt, failure = await self._client.run(_live.outcome(self._client.core, self._updates, lost))
            self._receipt = receipt or self._receipt
        except Exception as error:  # A client that was closed meanwhile, or a mistake in this package.
            failure = self._updates.lost(repr(error))
        finally:
            self._updates.over(failure)
            self._is_over.set()
            writer.close()

    async def _until_ended(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, received: bytes) -> None:
        self._write(writer, self._updates.take(received))
        while self._updates.cause is None:
            data = await reader.read(65536)
            if not data:
                raise ConnectionLost("closed by the other side")
            self._write(writer, self._updates.take(data))

    async def _wait_for(self, update: AsyncUpdate, timeout: float | None) -> LiveResult:
        self._updates.wait_begins(update)
        try:
            with contextlib.suppress(asyncio.TimeoutError):
                await _within(update._answered.wait(), timeout)
        finally:
            self._updates.wait_ends(update)
        return await self._client.run(_live.result(self._client.core, self._updates.answer(update)))

    async def end(self) -> None:
        """End the play, and wait until the daemon has ended it. As `Live.end`."""
        await self._finish()
        self._updates.raise_failure()
        self._updates.raise_problem()

    async def _finish(self) -> None:
        """Ends the play, if it is not over."""
        if self._writer is None:
            return
        if not self._updates.is_ending and not self._updates.is_over:
            self._write(self._writer, self._updates.end())
        try:
            await _within(self._is_over.wait(), END_TIMEOUT)
        except asyncio.TimeoutError:
            self._task.cancel()
            raise ConnectionLost(f"the daemon has not ended live play {self.id} within {END_TIMEOUT:.0f} s") from None

    async def wait(self, timeout: float | None = None, *, check: bool = True) -> Receipt:
        """Wait until the play is over, and return its receipt. As `Live.wait`."""
        begun = time.monotonic()
        try:
            await _within(self._is_over.wait(), timeout)
        except asyncio.TimeoutError:
            raise TimeoutError(f"live play {self.id} runs after {timeout} s: wait longer, or call `end()`") from None
        if self._receipt is None or not self._receipt.is_over:
            left = None if timeout is None else max(0.0, timeout - (time.monotonic() - begun))
            self._receipt = await self._client.run(ops.wait(self._client.core, self._accepted, left))
        return ops.checked(self._receipt) if check and not self._updates.ended_as_asked else self._receipt

    def __await__(self) -> Generator[Any, None, AsyncLive]:
        return self._begin().__await__()

    async def __aenter__(self) -> AsyncLive:
        if self._writer is None:
            return await self._begin()
        self._updates.check_open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            await self.end()
        else:
            with quietly("the live play could not be ended", True):
                await self._finish()


async def _connect(endpoint: Endpoint) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    if endpoint.socket is not None:
        return await asyncio.open_unix_connection(endpoint.socket)
    address = urlsplit(endpoint.url)
    port = address.port or (443 if endpoint.is_secure else 80)
    return await asyncio.open_connection(address.hostname, port, ssl=tls() if endpoint.is_secure else None)


async def _within(work: Coroutine[Any, Any, T], timeout: float | None) -> T:
    """As `asyncio.wait_for`, which in Python 3.10 and 3.11 loses a cancellation that comes as the work ends."""
    task = asyncio.create_task(work)
    try:
        done, _ = await asyncio.wait({task}, timeout=timeout)
        if not done:
            raise asyncio.TimeoutError
        return task.result()
    finally:
        task.cancel()
