"""Trial lists: every combination equally often, in a random order that a seed repeats.

Lists come from Python's `random.Random`, so the same seed gives the same list on every machine.
"""

from __future__ import annotations

import itertools
import numbers
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from .._arguments import hinted, listed, whole

T = TypeVar("T")


@dataclass(frozen=True)
class Trial:
    """One trial: its number, from 1, and the value of each factor."""

    number: int
    factors: Mapping[str, Any]

    def __getitem__(self, factor: str) -> Any:
        if factor not in self.factors:
            there = ", ".join(f"`{name}`" for name in self.factors) or "none"
            raise KeyError(f"trial {self.number} has no factor `{factor}`: it has {there}")
        return self.factors[factor]

    def intervals(self, target: T, other: T) -> list[T]:
        """Of a 2AFC trial: what each of its two intervals holds. The factor `interval` says where the target is."""
        return [target, other] if self["interval"] == 1 else [other, target]


@hinted
def trials(*, repeats: int = 1, seed: int, **factors: Iterable[Any]) -> list[Trial]:
    """Every combination of the factors, `repeats` times.

    The list consists of `repeats` blocks. Each block holds every combination once, in an order of its own.
    """
    whole("repeats", repeats, 1)
    if not isinstance(seed, (int, str, numbers.Integral)):
        raise TypeError(f"`seed` is {seed!r}: must be a whole number, such as 7")
    names, values = list(factors), [listed(name, levels, "[0.2, 0.4]") for name, levels in factors.items()]
    for name, levels in zip(names, values, strict=True):
        if not levels:
            raise ValueError(f"the factor `{name}` has no values: give at least one")
    combinations = [dict(zip(names, combination, strict=True)) for combination in itertools.product(*values)]
    chance = random.Random(seed)
    made = []
    for _ in range(repeats):
        made += chance.sample(combinations, len(combinations))
    return [Trial(number, factors) for number, factors in enumerate(made, 1)]


@hinted
def constant_stimuli(levels: Iterable[Any], *, repeats: int, seed: int, **factors: Iterable[Any]) -> list[Trial]:
    """The method of constant stimuli: each of the `levels` (factor `level`) equally often."""
    return trials(repeats=repeats, seed=seed, **_beside(factors, level=levels))


@hinted
def two_afc(levels: Iterable[Any], *, repeats: int, seed: int, **factors: Iterable[Any]) -> list[Trial]:
    """Two-alternative forced choice: each level `repeats` times, the target as often in interval 1 as in 2.

    `repeats` must be even. The factor `interval` is 1 or 2.
    """
    if whole("repeats", repeats, 1) % 2:
        raise ValueError(f"`repeats` is {repeats}: must be even, so that each interval has the target equally often")
    return trials(repeats=repeats // 2, seed=seed, **_beside(factors, level=levels, interval=(1, 2)))


def _beside(factors: Mapping[str, Iterable[Any]], **own: Iterable[Any]) -> dict[str, Iterable[Any]]:
    for name in own:
        if name in factors:
            raise ValueError(f"the factor `{name}` is this list's own: give yours another name")
    return {**own, **factors}


@hinted
def counterbalanced(conditions: Sequence[T], participant: int) -> list[T]:
    """The order of the conditions for this participant (from 0), by a balanced Latin square (Williams design).

    Over `len(conditions)` participants (twice as many if that is odd) each condition stands at each place equally often,
    and follows each other condition equally often.
    """
    conditions, participant = (
        listed("conditions", conditions, "['left', 'right']"),
        whole("participant", participant, 0),
    )
    if not conditions:
        raise ValueError("`conditions` is empty: give at least one")
    count = len(conditions)
    row = [(place + 1) // 2 if place % 2 else (count - place // 2) % count for place in range(count)]
    order = [conditions[(index + participant) % count] for index in row]
    is_reversed = count % 2 == 1 and (participant // count) % 2 == 1
    return order[::-1] if is_reversed else order
