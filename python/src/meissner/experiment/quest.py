"""QUEST+ (Watson, 2017) by the package `questplus`: `pip install questplus 'setuptools<81'`.

quest = QuestPlus(levels, guess=0.5, max_trials=40)
while not quest.done:
    quest.answer(present(quest.level))
print(quest.threshold, quest.standard_error, quest.problem)
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from typing import Any

from .._arguments import hints, listed, number, whole
from .answers import decided
from .staircase import Bound, pairs

_SURE = 0.99
"""So probable the lowest or the highest threshold ends the procedure."""
_LIKELY = 0.25
"""So probable it holds the estimate. Of 500 simulated guessing participants it holds that of 499."""


@hints
class QuestPlus:
    """Chooses the level that tells most about the threshold of a Weibull function.

    At the threshold the share of correct answers is 1 - (1 - guess) / e without lapses: 0.82 for 2AFC.
    """

    def __init__(
        self,
        levels: Sequence[float],
        *,
        thresholds: Sequence[float] | None = None,
        slopes: Sequence[float] = (1.0, 1.5, 2.0, 3.0, 4.0),
        guess: float = 0.5,
        lapses: Sequence[float] = (0.02,),
        max_trials: int = 200,
    ) -> None:
        """`levels`: what can be presented, above 0. `thresholds`: where the threshold may lie; without it, at any level.

        `max_trials` answers end it, and so does a threshold that almost surely lies at an end of `thresholds` or beyond.
        """
        levels = _above_zero("levels", levels)
        between = levels if thresholds is None else _above_zero("thresholds", thresholds)
        if not 0 <= number("guess", guess) < 1:
            raise ValueError(f"`guess` is {guess}: must be from 0 to below 1, such as 0.5 for 2AFC")
        whole("max_trials", max_trials, 1)
        try:
            from questplus import QuestPlusWeibull
        except ImportError as error:
            raise ImportError(
                f"QUEST+ needs the package questplus: pip install questplus 'setuptools<81' ({error})"
            ) from error
        self._levels = {math.log10(level): level for level in levels}
        self._max_trials, self._ends = max_trials, (between[0], between[-1])
        self._thresholds = [math.log10(level) for level in between]
        self._quest: Any = QuestPlusWeibull(
            intensities=list(self._levels),
            thresholds=self._thresholds,
            slopes=_above_zero("slopes", slopes, 1),
            lower_asymptotes=[guess],
            lapse_rates=[number("lapses", lapse) for lapse in listed("lapses", lapses, "[0.02]")],
            responses=["correct", "wrong"],
            stim_scale="log10",
        )
        self.answers: list[tuple[float, bool]] = []
        """Each level that was presented, and whether the answer was correct."""

    @property
    def level(self) -> float:
        """The level to present next."""
        return self._levels[self._nearest(float(self._quest.next_intensity))]

    @property
    def done(self) -> bool:
        """Whether it has ended: by `max_trials`, or at an end of `thresholds`."""
        return len(self.answers) >= self._max_trials or max(self._at_ends) >= _SURE

    def _nearest(self, intensity: float) -> float:
        """The logarithm of the level that lies nearest: `questplus` takes only the values that it was given."""
        return min(self._levels, key=lambda log: abs(log - intensity))

    def answer(self, correct: bool, *, level: float | None = None) -> None:
        """Takes the answer to a level: the one that was proposed, if none is given."""
        correct = decided(correct)
        presented = self.level if level is None else number("level", level)
        if presented <= 0:
            raise ValueError(f"`level` is {level}: must be above 0")
        self.answers.append((presented, correct))
        intensity = self._nearest(math.log10(presented))
        self._quest.update(intensity=intensity, response="correct" if correct else "wrong")

    def resume(self, answers: Iterable[tuple[float, bool]]) -> None:
        """Takes the answers of an earlier run, such as `session.answers()`."""
        for level, correct in pairs(answers):
            self.answer(correct, level=level)

    @property
    def _posterior(self) -> list[float]:
        """How probable each of the thresholds is."""
        return [float(share) for share in self._quest.marginal_posterior["threshold"]]

    @property
    def _at_ends(self) -> tuple[float, float]:
        """How probable the lowest and the highest threshold are; 0 before the first answer."""
        shares = self._posterior
        return (shares[0], shares[-1]) if self.answers else (0.0, 0.0)

    @property
    def at_bound(self) -> Bound | None:
        """The end of `thresholds` that holds the estimate: it may lie beyond."""
        low, high = self._at_ends
        if max(low, high) < _LIKELY:
            return None
        return "minimum" if low > high else "maximum"

    @property
    def problem(self) -> str | None:
        """Why `threshold` may be wrong; None: nothing was found."""
        bound = self.at_bound
        if bound is None:
            return None
        if bound == "minimum":
            return f"the threshold may lie below {self._ends[0]:g}, the lowest of `thresholds`"
        return f"the threshold may lie above {self._ends[1]:g}, the highest of `thresholds`, or the participant has guessed"

    @property
    def threshold(self) -> float:
        """The mean of the threshold's posterior distribution. Warns of its `problem`."""
        if problem := self.problem:
            warnings.warn(problem, stacklevel=2)
        return 10 ** float(self._quest.param_estimate["threshold"])

    @property
    def standard_error(self) -> float:
        """Standard error of `threshold`: the standard deviation of the posterior distribution of its logarithm, times the threshold."""
        shares = self._posterior
        mean = sum(share * log for share, log in zip(shares, self._thresholds, strict=True))
        variance = sum(share * (log - mean) ** 2 for share, log in zip(shares, self._thresholds, strict=True))
        return math.sqrt(variance) * math.log(10) * 10**mean


def _above_zero(name: str, given: Sequence[float], least: int = 2) -> list[float]:
    """Values, sorted, each once."""
    found = sorted({number(name, value) for value in listed(name, given, "[0.1, 0.2, 0.4]")})
    if len(found) < least or found[0] <= 0:
        raise ValueError(f"`{name}` is {found}: must be {least} or more, all above 0")
    return found
