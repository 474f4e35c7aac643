"""QUEST+ (Watson, 2017) by the package `questplus`: `pip install 'meissner[quest]'`.

quest = QuestPlus(levels, guess=0.5)
for _ in range(40):
    quest.answer(present(quest.level))
print(quest.threshold)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any


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
    ) -> None:
        """`levels`: what can be presented, above 0. `thresholds`: where the threshold may lie; without it, at any level."""
        if min(levels) <= 0:
            raise ValueError(f"the lowest level is {min(levels)}: all must be above 0")
        try:
            from questplus import QuestPlusWeibull
        except ImportError as error:
            raise ImportError(f"QUEST+ needs the package questplus: pip install 'meissner[quest]' ({error})") from error
        self._levels = {math.log10(level): level for level in levels}
        self._quest: Any = QuestPlusWeibull(
            intensities=list(self._levels),
            thresholds=[math.log10(level) for level in (thresholds or levels)],
            slopes=list(slopes),
            lower_asymptotes=[guess],
            lapse_rates=list(lapses),
            responses=["correct", "wrong"],
            stim_scale="log10",
        )
        self.answers: list[tuple[float, bool]] = []
        """Each level that was presented, and whether the answer was correct."""

    @property
    def level(self) -> float:
        """The level to present next."""
        return self._levels[self._nearest(float(self._quest.next_intensity))]

    def _nearest(self, intensity: float) -> float:
        """The logarithm of the level that lies nearest: `questplus` takes only the values that it was given."""
        return min(self._levels, key=lambda log: abs(log - intensity))

    def answer(self, correct: bool, *, level: float | None = None) -> None:
        """Takes the answer to a level: the one that was proposed, if none is given."""
        presented = self.level if level is None else level
        self.answers.append((presented, bool(correct)))
        intensity = self._nearest(math.log10(presented))
        self._quest.update(intensity=intensity, response="correct" if correct else "wrong")

    def resume(self, answers: Iterable[tuple[float, bool]]) -> None:
        """Takes the answers of an earlier run, such as `session.answers()`."""
        for level, correct in answers:
            self.answer(correct, level=level)

    @property
    def threshold(self) -> float:
        """The mean of the threshold's posterior distribution."""
        return 10 ** float(self._quest.param_estimate["threshold"])
