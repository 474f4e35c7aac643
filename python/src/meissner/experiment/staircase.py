"""An adaptive staircase: the level falls after correct answers and rises after wrong ones (Levitt, 1971).

    stairs = Staircase(start=0.8, ratio=1.26, down=2, minimum=0.01, maximum=1.0)
    while not stairs.done:
        stairs.answer(present(stairs.level))
    print(stairs.threshold, stairs.standard_error, stairs.problem)

`down` correct answers in a row lower the level, one wrong answer raises it. So the staircase settles where the share of
correct answers is 0.5 ** (1 / down): 0.707 for 2, 0.794 for 3.

`threshold` warns of what `problem` says: of an estimate that a bound holds, or that had not settled.

`Interleaved` presents several staircases, or `QuestPlus`, in a random order.
"""

from __future__ import annotations

import math
import random
import statistics
import warnings
from collections.abc import Iterable, Mapping
from typing import Literal, Protocol

from .._arguments import hints, listed, number, table, whole
from .answers import decided

Bound = Literal["minimum", "maximum"]

_PUSHES = 6
"""So many steps in a row that a bound does not allow end a staircase."""
_DRIFT = 3
"""By so many steps the mean of the later reversals may differ from that of the earlier ones: with 8 of them, 1 to 6 of 100 staircases
that have settled are further off, and two thirds of those of guessing participants."""


@hints
class Staircase:
    """A staircase with `down` down, 1 up. Steps are a `ratio` or a difference (`step`)."""

    def __init__(
        self,
        start: float,
        *,
        ratio: float | None = None,
        step: float | None = None,
        down: int = 2,
        minimum: float | None = None,
        maximum: float | None = None,
        reversals: int = 12,
        coarse: int = 4,
        max_trials: int = 200,
    ) -> None:
        """`reversals`: how many end the staircase. Steps are twice as large until `coarse` of them, and those do not count.

        `max_trials` answers end it, too, and so do 6 steps in a row that a bound does not allow.
        """
        if (ratio is None) == (step is None):
            raise ValueError("give either `ratio` (above 1) or `step` (above 0)")
        start = number("start", start)
        minimum = None if minimum is None else number("minimum", minimum)
        maximum = None if maximum is None else number("maximum", maximum)
        if ratio is not None:
            if number("ratio", ratio) <= 1:
                raise ValueError(f"`ratio` is {ratio}: must be above 1")
            for name, level in (("start", start), ("minimum", minimum), ("maximum", maximum)):
                if level is not None and level <= 0:
                    raise ValueError(f"`{name}` is {level}: must be above 0 with a `ratio`; or give `step`")
        if step is not None and number("step", step) <= 0:
            raise ValueError(f"`step` is {step}: must be above 0")
        if not (minimum is None or minimum <= start) or not (maximum is None or start <= maximum):
            bounds = [f"`{name}` {of}" for name, of in (("minimum", minimum), ("maximum", maximum)) if of is not None]
            raise ValueError(f"`start` is {start}: must lie within {' and '.join(bounds)}")
        if minimum is not None and minimum == maximum:
            raise ValueError(f"`minimum` and `maximum` are both {minimum}: must differ")
        for name, count, least in (("down", down, 1), ("coarse", coarse, 0), ("max_trials", max_trials, 1)):
            whole(name, count, least)
        if whole("reversals", reversals, 1) <= coarse:
            raise ValueError(f"`reversals` is {reversals}: must be above `coarse`, {coarse}")
        self._is_log = ratio is not None
        self._step = math.log(ratio) if ratio is not None else step or 0.0
        self._down, self._reversals, self._coarse, self._max_trials = down, reversals, coarse, max_trials
        self._low = -math.inf if minimum is None else self._inner(minimum)
        self._high = math.inf if maximum is None else self._inner(maximum)
        self._at = self._inner(start)
        self._in_a_row = 0
        self._direction = 0
        self._pushes = 0
        self._turns: list[float] = []
        self._settled: list[float] = []
        """Where each step since the coarse reversals began."""
        self.answers: list[tuple[float, bool]] = []
        """Each level that was presented, and whether the answer was correct."""

    def _inner(self, level: float) -> float:
        return math.log(level) if self._is_log else level

    def _outer(self, at: float) -> float:
        return math.exp(at) if self._is_log else at

    @property
    def level(self) -> float:
        """The level to present next."""
        return self._outer(self._at)

    @property
    def done(self) -> bool:
        """Whether the staircase has ended: by its reversals, at a bound, or by `max_trials`."""
        enough = len(self._turns) >= self._reversals or len(self.answers) >= self._max_trials
        return enough or self._pushes >= _PUSHES

    @property
    def reversals(self) -> list[float]:
        """The levels at which the staircase turned."""
        return [self._outer(turn) for turn in self._turns]

    def answer(self, correct: bool) -> None:
        """Takes the answer to the present level."""
        correct = decided(correct)
        self.answers.append((self.level, correct))
        if correct:
            self._in_a_row += 1
            if self._in_a_row < self._down:
                return
        self._in_a_row = 0
        direction = -1 if correct else 1
        if self._direction not in (0, direction):
            self._turns.append(self._at)
        self._direction = direction
        if len(self._turns) >= self._coarse:
            self._settled.append(self._at)
        step = self._step * (2 if len(self._turns) < self._coarse else 1)
        before, self._at = self._at, min(max(self._at + direction * step, self._low), self._high)
        self._pushes = self._pushes + 1 if self._at == before else 0

    def resume(self, answers: Iterable[tuple[float, bool]]) -> None:
        """Takes the answers of an earlier run, in their order, such as `session.answers()`: then `level` is the next one.

        Raises `ValueError` if a level is not the one that this staircase presents then: it has other settings, or other answers.
        """
        for place, (level, correct) in enumerate(pairs(answers), 1):
            if not math.isclose(level, self.level, rel_tol=1e-9, abs_tol=1e-12):
                raise ValueError(
                    f"answer {place} is to level {level}, but the staircase presents {self.level} then: give it the settings and the "
                    "answers of the earlier run"
                )
            self.answer(correct)

    @property
    def _counted(self) -> list[float]:
        """The last reversals after the coarse ones, an even number of them."""
        fine = self._turns[self._coarse :]
        return fine[len(fine) % 2 :]

    @property
    def _estimate(self) -> float:
        if self._pushes >= _PUSHES:
            return self._at
        if not self._counted:
            raise ValueError(f"the staircase has {len(self._turns)} reversals: it needs at least {self._coarse + 2}")
        return statistics.fmean(self._counted)

    @property
    def at_bound(self) -> Bound | None:
        """The bound that holds the estimate: the staircase has ended there or turned there, or the estimate is within a step of it."""
        if self._pushes < _PUSHES and not self._counted:
            return None
        lowest, highest = min([self._estimate, *self._counted]), max([self._estimate, *self._counted])
        if highest >= self._high or self._estimate > self._high - self._step:
            return "maximum"
        return "minimum" if lowest <= self._low or self._estimate < self._low + self._step else None

    @property
    def problem(self) -> str | None:
        """Why `threshold` may be wrong, or is not known; None: nothing was found. It finds most guessing participants, not all."""
        if bound := self.at_bound:
            side, edge = (
                ("above it, or the participant has guessed", self._high)
                if bound == "maximum"
                else ("below it", self._low)
            )
            return f"the staircase has reached its `{bound}` {self._outer(edge):g}: the threshold may lie {side}"
        counted = self._counted
        if not counted:
            return f"the staircase has {len(self._turns)} reversals: it needs at least {self._coarse + 2}"
        half = len(counted) // 2
        drift = statistics.fmean(counted[half:]) - statistics.fmean(counted[:half])
        if half > 1 and abs(drift) > _DRIFT * self._step:
            return (
                f"the reversals drift {'up' if drift > 0 else 'down'} by {abs(drift) / self._step:.1f} steps: the staircase has not "
                "settled; give it more `reversals`, or `coarse` ones, or the participant has guessed"
            )
        if self.done and len(self._turns) < self._reversals:
            return (
                f"the staircase ended after {len(self.answers)} trials with {len(self._turns)} of {self._reversals} reversals: give "
                "more `max_trials`"
            )
        return None

    @property
    def threshold(self) -> float:
        """The mean of the last reversals, an even number of them; of their logarithms if steps are ratios.

        Of a staircase that ended at a bound it is the bound. Warns of its `problem`.
        """
        found = self._outer(self._estimate)
        if problem := self.problem:
            warnings.warn(problem, stacklevel=2)
        return found

    @property
    def standard_error(self) -> float:
        """Standard error of `threshold`; NaN: not known.

        It comes from how far the levels wander around the estimate. Levels follow each other, so that the spread of the
        reversals alone says half as much: the error is `2 v / (step sqrt(n))`, where `v` is the variance of the levels of the last `n` steps.
        """
        settled = self._settled
        if self._pushes >= _PUSHES or len(self._counted) < 2 or len(settled) < 3:
            return math.nan
        wander = 2 * statistics.variance(settled) / (self._step * math.sqrt(len(settled)))
        error = max(wander, statistics.stdev(self._counted) / math.sqrt(len(self._counted)))
        return error * self._outer(self._estimate) if self._is_log else error


def pairs(answers: Iterable[tuple[float, bool]]) -> list[tuple[float, bool]]:
    """The answers of an earlier run."""
    found = listed("answers", answers, "`session.answers()`")
    for place, pair in enumerate(found):
        if not isinstance(pair, (tuple, list)) or len(pair) != 2:
            raise TypeError(f"`answers[{place}]` is {pair!r}: must be a level and whether the answer to it was correct")
        number(f"answers[{place}]", pair[0])
    return found


class Procedure(Protocol):
    """What `Interleaved` needs of a procedure."""

    @property
    def level(self) -> float:
        """The level to present next."""

    @property
    def done(self) -> bool:
        """Whether it has ended."""

    def answer(self, correct: bool) -> None:
        """Takes the answer to that level."""

    def resume(self, answers: Iterable[tuple[float, bool]]) -> None:
        """Takes the answers of an earlier run."""


@hints
class Interleaved:
    """Several procedures at once: each trial is of one of them, at random among those that have not ended.

    both = Interleaved({"low": Staircase(0.1, ratio=1.26), "high": Staircase(0.9, ratio=1.26)}, seed=7)
    while not both.done:
        name, level = both.name, both.level
        ...
        session.answer(trial, said, correct=correct, level=level, factors={"staircase": name})
        both.answer(correct)
    """

    def __init__(self, procedures: Mapping[str, Procedure], *, seed: int) -> None:
        """`procedures`: by name. The same seed and the same answers give the same order."""
        if not table("procedures", procedures, "{'low': Staircase(...)}"):
            raise ValueError("`procedures` is empty: give at least one staircase, by name")
        self.procedures = dict(procedures)
        self._seed, self._trials = seed, 0

    @property
    def done(self) -> bool:
        """Whether all have ended."""
        return all(each.done for each in self.procedures.values())

    @property
    def name(self) -> str:
        """The procedure of the next trial."""
        left = [name for name, each in self.procedures.items() if not each.done]
        if not left:
            raise ValueError("all procedures have ended: ask `done` before each trial")
        return random.Random(f"{self._seed}/{self._trials}").choice(left)

    @property
    def level(self) -> float:
        """The level to present next."""
        return self.procedures[self.name].level

    def answer(self, correct: bool) -> None:
        """Takes the answer to the present level."""
        self.procedures[self.name].answer(correct)
        self._trials += 1

    def resume(self, answers: Mapping[str, Iterable[tuple[float, bool]]]) -> None:
        """Takes the answers of an earlier run by name: `{name: session.answers(staircase=name) for name in both.procedures}`."""
        unknown = [name for name in answers if name not in self.procedures]
        if unknown:
            raise ValueError(f"`{unknown[0]}` is no procedure: there are {', '.join(self.procedures)}")
        for name, of in answers.items():
            taken = pairs(of)
            self.procedures[name].resume(taken)
            self._trials += len(taken)
