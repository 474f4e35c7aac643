"""What plays and sessions have in common: the receipt that is known so far, what answers are, and ends that
hide no error.
"""

from __future__ import annotations

import contextlib
import numbers
import warnings
from collections.abc import Generator
from typing import TYPE_CHECKING, Any, TypeVar

from . import _kept, _sessions
from . import _operations as ops
from ._arguments import hints, listed, table
from ._bodies import Labels, Verdict
from ._operations import Accepted, Core
from ._presses import Press
from .clocks import Instant
from .errors import MeissnerError, NotKnownYet
from .results import Item, Receipt

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from .experiment.trials import Trial

P = TypeVar("P")


@hints
class KnownPlay:
    """A play or live play that the daemon has taken, and what is known of it. It takes an answer."""

    def __init__(self, core: Core, accepted: Accepted) -> None:
        self._core, self._accepted = core, accepted
        self._receipt: Receipt | None = None

    @property
    def id(self) -> int:
        """The play's number since the daemon's start."""
        return self._accepted.id

    @property
    def pattern(self) -> str:
        """The pattern's name, or the sequence's."""
        return self._accepted.pattern

    @property
    def ordered_s(self) -> float | None:
        """Duration as ordered, s; None: without end."""
        return self._accepted.ordered_s

    @property
    def motions(self) -> tuple[dict[str, Any], ...]:
        """How each motor follows its motions, computed before they are played: `error_um`, `error_share`, `too_slow_from_s` and more."""
        return self._accepted.motions

    @property
    def receipt(self) -> Receipt:
        """The newest receipt."""
        if self._receipt is None:
            raise NotKnownYet(f"play {self.id} has no receipt yet: call `wait()` or `refresh()` first")
        return self._receipt

    @property
    def onset(self) -> Instant:
        """When it began, on every clock."""
        if self.receipt.onset is None:
            raise NotKnownYet(f"play {self.id} had not begun ({self.receipt.state}): call `wait()` first")
        return self.receipt.onset

    @property
    def offset(self) -> Instant:
        """When its last pulse was over, on every clock."""
        if self.receipt.offset is None:
            raise NotKnownYet(f"play {self.id} has no end yet ({self.receipt.state}): call `wait()` first")
        return self.receipt.offset

    @property
    def items(self) -> tuple[Item, ...]:
        """What it has played, each pattern with its times."""
        return self.receipt.items

    def refresh(self) -> Receipt:
        """Ask for the receipt as it is now."""
        self._receipt = ops.receipt(self._core, self.id)
        return self._receipt

    def answer(
        self,
        response: object,
        *,
        correct: Verdict = None,
        rt_ms: float | None = None,
        level: float | None = None,
        factors: Labels = None,
    ) -> None:
        """Record what the participant answered: the text of `response`, whether it is right, the response time in ms.

        The play belongs to the running session and has begun; it takes one answer. `level` is that of the stimulus, such as a
        staircase's; `factors` are texts by name. Every export has them in the row of the play. A `Press` has its response time, from
        the onset of the play, and becomes the factors `response_tick` and `response_uncertainty_s`, too. What the daemon does not take
        is kept in a file of the user, which the error names.
        """
        session = self._core.session
        given = {"correct": correct, "rt_ms": rt_ms, "level": level, "factors": factors}
        with _kept.answer(session=session and session.id, play=self.id, response=response, **given):
            if isinstance(response, Press) and (self._receipt is None or self._receipt.onset is None):
                self.refresh()
            onset = self.onset if isinstance(response, Press) else None
            _sessions.answer(self._core, self.id, onset, response, given)

    def __repr__(self) -> str:
        state = self._receipt.state if self._receipt else "accepted"
        return f"<play {self.id}: {self.pattern}, {state}>"


def trial_answer(trial: Trial | int, level: float | None, factors: Labels) -> tuple[int, float | None, dict[str, Any]]:
    """A trial's number, and the level and factors of an answer in it: its own `level` is the level, its other factors are factors."""
    if isinstance(trial, (int, numbers.Integral)):
        return int(trial), level, {} if factors is None else table("factors", factors, "{'block': 2}")
    check_trial("trial", trial)
    own = {**trial.factors, **({} if factors is None else table("factors", factors, "{'block': 2}"))}
    if level is None and isinstance(own.get("level"), numbers.Real) and not isinstance(own["level"], bool):
        level = own.pop("level")
    return trial.number, level, own


def played_in(trials: Mapping[Any, P], number: int) -> P:
    """The newest play of a trial. `MeissnerError`: this program has played nothing in it."""
    try:
        return trials[number]
    except KeyError:
        raise MeissnerError(
            f"this program has played nothing in trial {number}: play with `trial={number}` first"
        ) from None


def answered(plays: Iterable[Mapping[str, Any]], factors: Mapping[str, Any]) -> list[tuple[float, bool]]:
    """Of recorded plays the level and the correctness of each answer that has both, and these factors."""
    wanted = {key: str(value) for key, value in factors.items()}.items()
    found = []
    for play in plays:
        # An answer without a level lacks the key.
        answer = play["answer"] or {}
        known = (answer.get("level"), answer.get("correct"))
        if None not in known and wanted <= (answer.get("factors") or {}).items():
            found.append((float(answer["level"]), bool(answer["correct"])))
    return found


def unanswered(plays: Iterable[Mapping[str, Any]], trials: Iterable[Trial]) -> list[Trial]:
    """The trials that have no answer in the recorded plays."""
    finished = {play["receipt"]["order"].get("trial") for play in plays if play["answer"]}
    wanted = listed("trials", trials, "that of `two_afc(...)`")
    for place, trial in enumerate(wanted):
        check_trial(f"trials[{place}]", trial)
    return [trial for trial in wanted if trial.number not in finished]


def check_trial(name: str, trial: object) -> None:
    if not hasattr(trial, "factors"):
        raise TypeError(f"`{name}` is {trial!r}: must be a `Trial`, as of `two_afc(...)`, or its number")


@contextlib.contextmanager
def quietly(what: str, failed: bool) -> Generator[None]:
    """Turns an error into a warning if another error is on its way, so that it does not hide that one."""
    try:
        yield
    except MeissnerError as error:
        if not failed:
            raise
        warnings.warn(f"{what}: {error}", stacklevel=4)
