"""The client for asyncio: `AsyncClient`, its plays and its sessions. The same methods as `client.py`, with `await`.

async with await meissner.connect_async() as m:
    play = await m.play("edge-45", seconds=0.3)
    await play.wait()
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncGenerator, Awaitable, Callable, Generator, Iterable
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, TypeVar

from . import _ending, _exports, _kept, _live, _plan, _sessions, bids, nwb, program
from . import _operations as ops
from ._aio_live import AsyncLive
from ._alive import Alive
from ._answers import AsyncAnswerable
from ._arguments import hinted, hints
from ._bodies import Labels, Verdict
from ._http import Answer, Op, Pause, Step
from ._operations import Accepted, Core
from ._plays import answered, played_in, quietly, trial_answer, unanswered
from ._sse import Event, EventParser
from ._transport import AsyncTransport
from .arrays import Array
from .clocks import NS
from .errors import ConnectionLost, MeissnerError, Unreachable
from .experiment.trials import Trial
from .results import Receipt

P = ParamSpec("P")
T = TypeVar("T")


def _awaiting(
    operation: Callable[Concatenate[Core, P], Op[T]],
) -> Callable[Concatenate[AsyncClient, P], Awaitable[T]]:
    """A method that runs this operation."""
    operation = hinted(operation)

    async def method(client: AsyncClient, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await client.run(operation(client.core, *args, **kwargs))

    return ops.named_after(operation, method)


def _arming(operation: Callable[Concatenate[Core, P], Op[T]]) -> Callable[Concatenate[AsyncClient, P], Awaitable[T]]:
    """A method that arms, and shows signs of life from then on."""
    operation = hinted(operation)

    async def method(client: AsyncClient, /, *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return await client.run(operation(client.core, *args, **kwargs))
        finally:
            # The motors may be on although the answer was lost.
            client.alive.begin()

    return ops.named_after(operation, method)


def _playing(
    operation: Callable[Concatenate[Core, P], Op[Accepted]],
) -> Callable[Concatenate[AsyncClient, P], Awaitable[AsyncPlay]]:
    """A method that orders a play and returns it."""
    operation = hinted(operation)

    async def method(client: AsyncClient, /, *args: P.args, **kwargs: P.kwargs) -> AsyncPlay:
        play = AsyncPlay(client, await client.run(operation(client.core, *args, **kwargs)))
        client.trials[kwargs.get("trial")] = play
        return play

    return ops.named_after(operation, method)


def _living(
    operation: Callable[Concatenate[Core, P], Op[_live.Started]],
) -> Callable[Concatenate[AsyncClient, P], AsyncLive]:
    """A method that returns a live play, which starts with `async with` or `await`."""
    operation = hinted(operation)

    def method(client: AsyncClient, /, *args: P.args, **kwargs: P.kwargs) -> AsyncLive:
        return AsyncLive(client, operation(client.core, *args, **kwargs), kwargs.get("trial"))

    return ops.named_after(operation, method)


def _opening(
    operation: Callable[Concatenate[Core, P], Op[dict[str, Any]]],
) -> Callable[Concatenate[AsyncClient, P], AsyncSession]:
    """A method that returns a session, which starts with `async with` or `await`."""
    operation = hinted(operation)

    def method(client: AsyncClient, /, *args: P.args, **kwargs: P.kwargs) -> AsyncSession:
        return AsyncSession(client, operation(client.core, *args, **kwargs))

    return ops.named_after(operation, method)


@hints
class AsyncPlay(AsyncAnswerable):
    """A play that the daemon has taken."""

    def __init__(self, client: AsyncClient, accepted: Accepted) -> None:
        super().__init__(accepted)
        self._client = client

    async def wait(self, timeout: float | None = None, *, check: bool = True) -> Receipt:
        """Wait until the play has ended. As `Play.wait`."""
        result = await self._client.run(ops.wait(self._client.core, self._accepted, timeout))
        self._receipt = result
        return ops.checked(result) if check else result

    async def withdraw(self) -> Receipt:
        """Take the play out of the queue. As `Play.withdraw`."""
        self._receipt = await self._client.run(ops.withdraw(self._client.core, self.id))
        return self._receipt


@hints
class AsyncSession:
    """A session that this client owns: it starts with `async with` or `await`, and ends with its block or `end()`."""

    def __init__(self, client: AsyncClient, start: Op[dict[str, Any]]) -> None:
        self._client, self._start = client, start
        self.id = ""
        self.record_problem: str | None = None
        self.resumed = False
        """Whether it was running, and its program had ended."""

    async def plays(self) -> list[dict[str, Any]]:
        """What was played and answered so far. As `Session.plays`."""
        rows: list[dict[str, Any]] = (await self._client.session_plays(self.id))["plays"]
        return rows

    async def answers(self, **factors: object) -> list[tuple[float, bool]]:
        """The level and the correctness of each answer so far. As `Session.answers`."""
        return answered(await self.plays(), factors)

    async def remaining(self, trials: Iterable[Trial]) -> list[Trial]:
        """The trials that have no answer yet."""
        return unanswered(await self.plays(), trials)

    async def answer(
        self,
        trial: Trial | int,
        response: object,
        *,
        correct: Verdict = None,
        rt_ms: float | None = None,
        level: float | None = None,
        factors: Labels = None,
    ) -> None:
        """Record the answer in a trial. As `Session.answer`."""
        number, level, own = trial_answer(trial, level, factors)
        with _kept.answer(trial=number, response=response, correct=correct, rt_ms=rt_ms, level=level, factors=own):
            play = played_in(self._client.trials, number)
        await play.answer(response, correct=correct, rt_ms=rt_ms, level=level, factors=own)

    @property
    def heartbeat_problem(self) -> MeissnerError | None:
        """Why the last sign of life did not reach the daemon; None if it did."""
        return self._client.alive.problem

    async def _begin(self) -> AsyncSession:
        started = await self._client.run(self._start)
        self.id, self.record_problem, self.resumed = started["id"], started["record_problem"], started["resumed"]
        self._client.trials.clear()
        self._client.alive.begin()
        return self

    async def export_bids(self, root: str | os.PathLike[str], **options: Any) -> bids.Export:
        """Write the session, which is over, into a BIDS dataset. `Client.export_bids` has the options."""
        return await self._client.export_bids(self.id, root, **options)

    async def export_nwb(self, file: str | os.PathLike[str], **options: Any) -> nwb.Export:
        """Write the session, which is over, as an NWB file. `Client.export_nwb` has the options."""
        return await self._client.export_nwb(self.id, file, **options)

    async def end(self) -> None:
        """End the session. As `Session.end`."""
        await self._leave(failed=False)

    async def _leave(self, failed: bool) -> None:
        owned = self._client.core.session
        if owned is not None and owned.id == self.id:
            incomplete = await self._client.run(_sessions.session_leave(self._client.core, self.id, failed))
            self._client.alive.end()
            if incomplete is not None:
                raise incomplete

    def __await__(self) -> Generator[Any, None, AsyncSession]:
        return self._begin().__await__()

    async def __aenter__(self) -> AsyncSession:
        return self if self.id else await self._begin()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with quietly("at the end of the session", kind is not None):
            try:
                await self._leave(failed=kind is not None)
            except (KeyboardInterrupt, SystemExit, asyncio.CancelledError):
                # The program ends while this waits for the last play.
                await self._leave(failed=True)
                raise


@hints
class AsyncClient:
    """A connection to a daemon. As a context manager it disarms, if it has armed, and closes."""

    def __init__(self, core: Core) -> None:
        """`connect_async()` makes clients."""
        self.core = core
        self.trials: dict[Any, AsyncPlay | AsyncLive] = {}
        """The newest play of each trial."""
        self._transport = AsyncTransport(core.endpoint, lambda: core.headers, core.clock.now_ns)
        self.alive = Alive(core)
        self._is_closed = False
        _ending.opened(self)

    async def run(self, operation: Op[T]) -> T:
        """Runs an operation of `_operations.py`."""
        try:
            step = next(operation)
            while True:
                try:
                    answer = await self._perform(step)
                except MeissnerError as error:
                    step = operation.throw(error)
                else:
                    step = operation.send(answer)
        except StopIteration as end:
            result: T = end.value
            return result

    async def _perform(self, step: Step) -> Answer:
        if isinstance(step, Pause):
            await self._transport.pause(step.seconds)
            return Answer(0, b"")
        return await self._transport.perform(step)

    def now(self) -> float:
        """This process's `time.monotonic()`, s: the clock of `at` and of `onset.monotonic`."""
        return self.core.clock.now_ns() / NS

    @property
    def array(self) -> Awaitable[Array]:
        """The array that the daemon drives: `await m.array`. It is read once."""
        return self.run(ops.array(self.core))

    status = _awaiting(ops.status)
    synchronise = _awaiting(ops.synchronise)
    arm = _arming(ops.arm)
    disarm = _awaiting(ops.disarm)
    stop = _awaiting(ops.stop)
    estop = _awaiting(ops.estop)
    reset = _awaiting(ops.reset)
    home = _awaiting(ops.home)
    edge = _awaiting(ops.edge)
    play = _playing(ops.play)
    sequence = _playing(ops.sequence)
    check = _awaiting(_plan.check)
    live = _living(_live.start)
    session = _opening(_sessions.session)
    receipt = _awaiting(ops.receipt)
    wait_until_idle = _awaiting(ops.wait_until_idle)
    doctor = _awaiting(ops.doctor)
    patterns = _awaiting(ops.patterns)
    pattern = _awaiting(ops.pattern)
    store_pattern = _awaiting(ops.store_pattern)
    remove_pattern = _awaiting(ops.remove_pattern)
    sessions = _awaiting(_sessions.sessions)
    session_plays = _awaiting(_sessions.session_plays)
    export_bids = _awaiting(_exports.export_bids)
    export_nwb = _awaiting(_exports.export_nwb)

    async def events(self, *, reconnect: bool = True) -> AsyncGenerator[Event]:
        """The daemon's events, from now on and without end. After a gap the event `reconnected` comes first."""
        while True:
            try:
                async with self._transport.stream("/v1/events") as chunks:
                    parser = EventParser()
                    async for chunk in chunks:
                        for event in parser.feed(chunk):
                            yield event
                raise ConnectionLost("the daemon has ended the stream of events")
            except (Unreachable, ConnectionLost):
                if not reconnect:
                    raise
            await self.status()
            yield Event("reconnected", {})

    async def simulate(self, scene: program.Scene, **options: Any) -> program.Simulation:
        """Predict the spikes of afferents, in a thread. As `meissner.simulate`."""
        return await asyncio.to_thread(program.simulate, scene, **options)

    async def design(self, target: str, **options: Any) -> program.Design:
        """Find a pattern of the daemon's array for a target shape, in a thread, and store it in the daemon. As `meissner.design`."""
        found = await asyncio.to_thread(program.design_for, await self.array, target, options)
        await self.store_pattern(found.name, found.toml, replace=True)
        return found

    async def render(self, object: program.Object, **options: Any) -> program.Rendering:
        """Render an object's touch for the daemon's array, in a thread, and store it in the daemon. As `meissner.render`."""
        found = await asyncio.to_thread(program.render_for, await self.array, object, options)
        await self.store_pattern(found.name, found.toml, replace=True)
        return found

    async def close(self) -> None:
        """Disarm, if this client has armed, and close all connections."""
        if self._is_closed:
            return
        self._is_closed = True
        try:
            await self.run(ops.leave(self.core))
        except (KeyboardInterrupt, SystemExit, asyncio.CancelledError):
            # The end of Python tries it again.
            self._is_closed = False
            raise
        finally:
            if self._is_closed:
                _ending.closed(self)
                self.core.has_armed, self.core.session = False, None
                self.alive.end()
                await self._transport.close()

    def end(self) -> None:
        """Disarm as Python ends, if this client was not closed."""
        self.alive.release()

    def release(self, last: bool) -> None:
        """Disarm, by another thread."""
        self.alive.release()

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with quietly("the motors may be armed still", kind is not None):
            await self.close()
