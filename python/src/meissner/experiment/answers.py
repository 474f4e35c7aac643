"""Who answers: a person at the keyboard, or a simulated observer for tests and power calculations."""

from __future__ import annotations

import math
import numbers
import random
import sys
from collections.abc import Sequence

from .._bodies import verdict
from .._http import plain


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


def number(name: str, value: object) -> float:
    """A finite number. Raises `TypeError` for what is none, `ValueError` for NaN and infinity."""
    value = plain(value) if hasattr(value, "tolist") else value
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise TypeError(f"`{name}` is {value!r}: must be a number")
    if not math.isfinite(value):
        raise ValueError(f"`{name}` is {value}: must be a finite number")
    return float(value)


class SimulatedObserver:
    """An observer with a Weibull psychometric function. Without lapses it detects 1 - 1/e of stimuli at `threshold`."""

    def __init__(
        self, threshold: float, *, slope: float = 2.0, guess: float = 0.5, lapse: float = 0.02, seed: int = 0
    ) -> None:
        """`guess`: share of correct answers without a stimulus; `lapse`: share of wrong answers to a strong stimulus."""
        self.threshold, self.slope, self.guess, self.lapse = threshold, slope, guess, lapse
        self._chance = random.Random(seed)

    def p_correct(self, level: float) -> float:
        """The probability of a correct answer."""
        return self.guess + (1 - self.guess - self.lapse) * -math.expm1(-((level / self.threshold) ** self.slope))

    def is_correct(self, level: float) -> bool:
        """One answer."""
        return self._chance.random() < self.p_correct(level)

    def level_of(self, p_correct: float) -> float:
        """The level at which the share of correct answers is `p_correct`: what a procedure should find."""
        share = (p_correct - self.guess) / (1 - self.guess - self.lapse)
        return self.threshold * math.pow(-math.log1p(-share), 1 / self.slope)
