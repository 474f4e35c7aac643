"""Who answers: a person at the keyboard, or a simulated observer for tests and power calculations."""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Sequence

from .._arguments import hinted, hints, number
from .._bodies import verdict


@hinted
def ask(question: str, choices: Sequence[str] = ("1", "2")) -> str:
    """Asks at the terminal until one of the choices is typed. What was typed before the question is no answer."""
    forget_typed()
    while True:
        answer = input(f"{question} [{'/'.join(choices)}] ").strip()
        if answer in choices:
            return answer


def forget_typed() -> None:
    """Drops what was typed at the terminal and not read."""
    if sys.stdin is not None and sys.stdin.isatty():
        try:
            import termios
        except ImportError:  # Windows
            import msvcrt

            while msvcrt.kbhit():  # type: ignore[attr-defined]
                msvcrt.getwch()  # type: ignore[attr-defined]
        else:
            termios.tcflush(sys.stdin, termios.TCIFLUSH)


def decided(correct: object) -> bool:
    """The answer that a procedure takes. Raises `TypeError` for a text, which Python takes as true, and for no answer."""
    answer = verdict(correct)
    if answer is None:
        raise TypeError(
            "`correct` is None: must be True or False; present the level again after a trial without an answer"
        )
    return answer


@hints
class SimulatedObserver:
    """An observer with a Weibull psychometric function. Without lapses it detects 1 - 1/e of stimuli at `threshold`."""

    def __init__(
        self, threshold: float, *, slope: float = 2.0, guess: float = 0.5, lapse: float = 0.02, seed: int = 0
    ) -> None:
        """`guess`: share of correct answers without a stimulus; `lapse`: share of wrong answers to a strong stimulus."""
        for name, value in (("threshold", threshold), ("slope", slope)):
            if number(name, value) <= 0:
                raise ValueError(f"`{name}` is {value}: must be above 0")
        if min(number("guess", guess), number("lapse", lapse)) < 0 or guess + lapse >= 1:
            raise ValueError(f"`guess` is {guess} and `lapse` {lapse}: must be 0 or more, and below 1 together")
        self.threshold, self.slope, self.guess, self.lapse = threshold, slope, guess, lapse
        self._chance = random.Random(seed)

    def p_correct(self, level: float) -> float:
        """The probability of a correct answer."""
        return self.guess + (1 - self.guess - self.lapse) * -math.expm1(
            -((max(0.0, number("level", level)) / self.threshold) ** self.slope)
        )

    def is_correct(self, level: float) -> bool:
        """One answer."""
        return self._chance.random() < self.p_correct(level)

    def level_of(self, p_correct: float) -> float:
        """The level at which the share of correct answers is `p_correct`: what a procedure should find."""
        if not self.guess < number("p_correct", p_correct) < 1 - self.lapse:
            raise ValueError(
                f"`p_correct` is {p_correct}: must be above `guess` {self.guess} and below {1 - self.lapse:g}"
            )
        share = (p_correct - self.guess) / (1 - self.guess - self.lapse)
        return self.threshold * math.pow(-math.log1p(-share), 1 / self.slope)
