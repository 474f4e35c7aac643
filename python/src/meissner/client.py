"""The blocking client: `Client`, its plays and its sessions.

`meissner.connect()` makes one. `_operations.py` has what each method does.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Generator, Iterable
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, TypeVar

from . import _ending, _estop, _exports, _kept, _live, _sessions, bids, nwb, program
from . import _operations as ops
from ._alive import Alive
from ._arguments import hinted, hints
from ._bodies import Labels, Verdict
from ._operations import Accepted, Core
from ._plays import KnownPlay, answered, played_in, quietly, trial_answer, unanswered
from ._sse import Event, EventParser
from ._transport import BlockingTransport
from .arrays import Array
from .clocks import NS
from .errors import ConnectionLost, MeissnerError, Unreachable
from .experiment.trials import Trial
from .live import Live
from .results import Receipt

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def _method(
    operation: Callable[Concatenate[Core, P], T], then: Callable[[Client, T, object], R]
) -> Callable[Concatenate[Client, P], R]:
    """A method that runs this operation and waits for its end. `then` makes its result, of the trial that it belongs to, too."""
    operation = hinted(operation)

    def method(client: Client, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return then(client, operation(client.core, *args, **kwargs), kwargs.get("trial"))

    return functools.update_wrapper(method, operation)


def _blocking(operation: Callable[Concatenate[Core, P], T]) -> Callable[Concatenate[Client, P], T]:
    return _method(operation, lambda client, result, trial: result)


def _arming(operation: Callable[Concatenate[Core, P], T]) -> Callable[Concatenate[Client, P], T]:
    """A method that arms, and shows signs of life from then on."""
    arm = _blocking(operation)

    def method(client: Client, /, *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return arm(client, *args, **kwargs)
        finally:
            # The motors may be on although the answer was lost.
            client.alive.begin()

    return functools.update_wrapper(method, arm)


def _played(client: Client, accepted: Accepted, trial: object) -> Play:
    play = client.trials[trial] = Play(client.core, accepted)
    return play


def _lives(client: Client, started: _live.Started, trial: object) -> Live:
    play = client.trials[trial] = Live(client.core, started)
    return play


def _opened(client: Client, started: dict[str, Any], trial: object) -> Session:
    client.trials.clear()
    client.alive.begin()
    return Session(client, started)


@hints
class Play(KnownPlay):
    """A play that the daemon has taken."""

    def wait(self, timeout: float | None = None, *, check: bool = True) -> Receipt:
        """Wait until the play has ended, and return its receipt.

        Raises `PlayStopped` if it was stopped or aborted, unless `check` is False, and `TimeoutError` after `timeout` s.
        """
        result = ops.wait(self._core, self._accepted, timeout)
        self._receipt = result
        return ops.checked(result) if check else result

    def withdraw(self) -> Receipt:
        """Take the play out of the queue, and return its receipt. Raises `Playing` once it runs."""
        self._receipt = ops.withdraw(self._core, self.id)
        return self._receipt


@hints
class Session:
    """A running session that this client owns. As a context manager it ends with its block."""

    def __init__(self, client: Client, started: dict[str, Any]) -> None:
        self._client = client
        self.id: str = started["id"]
        self.record_problem: str | None = started["record_problem"]
        self.resumed: bool = started["resumed"]
        """Whether it was running, and its program had ended."""

    @property
    def plays(self) -> list[dict[str, Any]]:
        """What was played and answered so far, with the keys of the API reference: also before the session was resumed."""
        plays: list[dict[str, Any]] = self._client.session_plays(self.id)["plays"]
        return plays

    def answers(self, **factors: object) -> list[tuple[float, bool]]:
        """The level and the correctness of each answer so far that has these factors: what `Staircase.resume` takes."""
        return answered(self.plays, factors)

    def remaining(self, trials: Iterable[Trial]) -> list[Trial]:
        """The trials that have no answer yet."""
        return unanswered(self.plays, trials)

    def answer(
        self,
        trial: Trial | int,
        response: object,
        *,
        correct: Verdict = None,
        rt_ms: float | None = None,
        level: float | None = None,
        factors: Labels = None,
    ) -> None:
        """Record the answer in a trial, to its newest play. As `Play.answer`; the factors of a `Trial` are those of the answer, too."""
        number, level, own = trial_answer(trial, level, factors)
        with _kept.answer(
            session=self.id, trial=number, response=response, correct=correct, rt_ms=rt_ms, level=level, factors=own
        ):
            play = played_in(self._client.trials, number)
        play.answer(response, correct=correct, rt_ms=rt_ms, level=level, factors=own)

    @property
    def heartbeat_problem(self) -> MeissnerError | None:
        """Why the last sign of life did not reach the daemon; None if it did."""
        return self._client.alive.problem

    def export_bids(self, root: str | os.PathLike[str], **options: Any) -> bids.Export:
        """Write the session, which is over, into a BIDS dataset. `Client.export_bids` has the options."""
        return self._client.export_bids(self.id, root, **options)

    def export_nwb(self, file: str | os.PathLike[str], **options: Any) -> nwb.Export:
        """Write the session, which is over, as an NWB file. `Client.export_nwb` has the options."""
        return self._client.export_nwb(self.id, file, **options)

    def end(self) -> None:
        """End the session, after its plays have ended. A session that is over already is left.

        Raises `IncompleteSession` if the record has lost something of it.
        """
        self._leave(failed=False)

    def _leave(self, failed: bool) -> None:
        owned = self._client.core.session
        if owned is not None and owned.id == self.id:
            incomplete = _sessions.session_leave(self._client.core, self.id, failed)
            self._client.alive.end()
            if incomplete is not None:
                raise incomplete

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with quietly("at the end of the session", kind is not None):
            try:
                self._leave(failed=kind is not None)
            except (KeyboardInterrupt, SystemExit):
                # The program ends while this waits for the last play.
                self._leave(failed=True)
                raise


@hints
class Client:
    """A connection to a daemon. As a context manager it takes back what it has armed, and closes.

    Threads may share a client.
    """

    def __init__(self, core: Core) -> None:
        """`connect()` and `demo()` make clients."""
        self.core = core
        self.alive = Alive(core)
        self.trials: dict[Any, Play | Live] = {}
        """The newest play of each trial."""
        self._daemon: program.Daemon | None = None
        self._transport = core.link = BlockingTransport(core.endpoint, lambda: core.headers, core.clock.now_ns)
        self._is_closed = False
        _ending.opened(self)

    def adopt(self, daemon: program.Daemon) -> None:
        """Ends this daemon when the client is closed."""
        self._daemon = daemon

    def now(self) -> float:
        """This process's `time.monotonic()`, s: the clock of `at` and of `onset.monotonic`."""
        return self.core.clock.now_ns() / NS

    @property
    def array(self) -> Array:
        """The array that the daemon drives. It is read once."""
        return ops.array(self.core)

    status = _blocking(ops.status)
    synchronise = _blocking(ops.synchronise)
    arm = _arming(ops.arm)
    disarm = _blocking(ops.disarm)
    stop = _blocking(ops.stop)
    estop = _blocking(_estop.estop)
    reset = _blocking(ops.reset)
    home = _blocking(ops.home)
    edge = _blocking(ops.edge)
    play = _method(ops.play, _played)
    sequence = _method(ops.sequence, _played)
    check = _blocking(ops.check)
    live = _method(_live.start, _lives)
    session = _method(_sessions.session, _opened)
    receipt = _blocking(ops.receipt)
    wait_until_idle = _blocking(ops.wait_until_idle)
    doctor = _blocking(ops.doctor)
    patterns = _blocking(ops.patterns)
    pattern = _blocking(ops.pattern)
    store_pattern = _blocking(ops.store_pattern)
    remove_pattern = _blocking(ops.remove_pattern)
    store_calibration = _blocking(ops.store_calibration)
    sessions = _blocking(_sessions.sessions)
    session_plays = _blocking(_sessions.session_plays)
    export_bids = _blocking(_exports.export_bids)
    export_nwb = _blocking(_exports.export_nwb)

    def events(self, *, reconnect: bool = True) -> Generator[Event]:
        """The daemon's events, from now on and without end. After a gap the event `reconnected` comes first."""
        while True:
            try:
                with self._transport.stream("/v1/events") as chunks:
                    parser = EventParser()
                    for chunk in chunks:
                        yield from parser.feed(chunk)
                raise ConnectionLost("the daemon has ended the stream of events")
            except (Unreachable, ConnectionLost):
                if not reconnect:
                    raise
            self.status()
            yield Event("reconnected", {})

    simulate = staticmethod(program.simulate)

    def design(self, target: str, **options: Any) -> program.Design:
        """Find a pattern of the daemon's array for a target shape, and store it in the daemon. `meissner.design` has the options."""
        with program.described(self.array, options) as named:
            found = program.design(target, **named)
        self.store_pattern(found.name, found.toml, replace=True)
        return found

    def render(self, object: program.Object, **options: Any) -> program.Rendering:
        """Render an object's touch for the daemon's array, and store it in the daemon. `meissner.render` has the options."""
        with program.described(self.array, options) as named:
            found = program.render(object, **named)
        self.store_pattern(found.name, found.toml, replace=True)
        return found

    def close(self) -> None:
        """Disarm, if this client has armed and no other one, and close all connections."""
        if self._is_closed:
            return
        self._is_closed = True
        try:
            if self._daemon is None or self._daemon.runs:
                ops.leave(self.core)
        except (KeyboardInterrupt, SystemExit):
            # The end of Python tries it again.
            self._is_closed = False
            raise
        finally:
            if self._is_closed:
                self._discard()

    def _discard(self) -> None:
        _ending.closed(self)
        self.core.has_armed, self.core.session = False, None
        self.alive.end()
        self._transport.close()
        if self._daemon is not None:
            self._daemon.close()

    def end(self) -> None:
        """As `close`, as Python ends."""
        self.close()

    def release(self, last: bool) -> None:
        """Disarm, by another thread."""
        self.alive.release()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with quietly("the motors may be armed still", kind is not None):
            self.close()
