"""An adaptive staircase: the level falls after correct answers and rises after wrong ones (Levitt, 1971).

    stairs = Staircase(start=0.8, ratio=1.26, down=2)
    while not stairs.done:
        stairs.answer(present(stairs.level))
    print(stairs.threshold)

`down` correct answers in a row lower the level, one wrong answer raises it. So the staircase settles where the share of
correct answers is 0.5 ** (1 / down): 0.707 for 2, 0.794 for 3.
"""

from __future__ import annotations

import math
from collections.abc import Iterable


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
    ) -> None:
        """`reversals`: how many end the staircase. Steps are twice as large until `coarse` of them, and those do not count."""
        if (ratio is None) == (step is None):
            raise ValueError("give either `ratio` (above 1) or `step` (above 0)")
        if ratio is not None and (ratio <= 1 or start <= 0):
            raise ValueError(f"`ratio` is {ratio} and `start` {start}: must be above 1 and above 0")
        if step is not None and step <= 0:
            raise ValueError(f"`step` is {step}: must be above 0")
        if down < 1 or not 0 <= coarse < reversals:
            raise ValueError(
                f"`down` is {down}, `coarse` {coarse}, `reversals` {reversals}: need 1 <= `down`, 0 <= `coarse` < `reversals`"
            )
        self._is_log = ratio is not None
        self._step = math.log(ratio) if ratio is not None else step or 0.0
        self._down, self._reversals, self._coarse = down, reversals, coarse
        self._low = -math.inf if minimum is None else self._inner(minimum)
        self._high = math.inf if maximum is None else self._inner(maximum)
        self._at = min(max(self._inner(start), self._low), self._high)
        self._in_a_row = 0
        self._direction = 0
        self._turns: list[float] = []
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
        """Whether there were enough reversals."""
        return len(self._turns) >= self._reversals

    @property
    def reversals(self) -> list[float]:
        """The levels at which the staircase turned."""
        return [self._outer(turn) for turn in self._turns]

    def answer(self, correct: bool) -> None:
        """Takes the answer to the present level."""
        self.answers.append((self.level, bool(correct)))
        if correct:
            self._in_a_row += 1
            if self._in_a_row < self._down:
                return
        self._in_a_row = 0
        direction = -1 if correct else 1
        if self._direction not in (0, direction):
            self._turns.append(self._at)
        self._direction = direction
        step = self._step * (2 if len(self._turns) < self._coarse else 1)
        self._at = min(max(self._at + direction * step, self._low), self._high)

    def resume(self, answers: Iterable[tuple[float, bool]]) -> None:
        """Takes the answers of an earlier run, in their order, such as `session.answers()`: then `level` is the next one.

        Raises `ValueError` if a level is not the one that this staircase presents then: it has other settings, or other answers.
        """
        for number, (level, correct) in enumerate(answers, 1):
            if not math.isclose(level, self.level, rel_tol=1e-9, abs_tol=1e-12):
                raise ValueError(
                    f"answer {number} is to level {level}, but the staircase presents {self.level} then: give it the settings and the "
                    "answers of the earlier run"
                )
            self.answer(correct)

    @property
    def threshold(self) -> float:
        """The mean of the last reversals, an even number of them; of their logarithms if steps are ratios."""
        fine = self._turns[self._coarse :]
        fine = fine[len(fine) % 2 :]
        if not fine:
            raise ValueError(f"the staircase has {len(self._turns)} reversals: it needs at least {self._coarse + 2}")
        return self._outer(sum(fine) / len(fine))
