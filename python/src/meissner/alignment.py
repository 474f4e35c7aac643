"""Alignment with another recording: `align` maps ticks of the device to a recorder's clock by pulses that both have.

How it works: a few pulses, spread over the shorter list, are tried with every pulse of the longer one. The best of these trials are
followed to both ends, from pulse to pulse, and the one that explains most pulses is taken. A line through its pairs is the map; pairs that
are not on it are left out.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from ._arguments import hinted, number
from ._arguments import listed as given
from .clocks import MAX_SKEW

_TRIED = 10
"""How many pulses are tried, and how many pulses from each on say whether a trial is followed."""
_FOLLOWED = 20
"""Of the trials, so many are followed to both ends."""
_LEAST = 3
_RIVAL = 0.8
"""Another pairing with such a share of the pairs may be the true one."""
_ON_LINE = 0.8
"""The least share of the pairs that lies on the line."""


@dataclass(frozen=True)
class Aligned:
    """The map from ticks to the recorder's clock."""

    first_tick: int
    """The tick at which `offset` holds."""
    offset: float
    """The recorder's time at `first_tick`, s."""
    per_tick: float
    """Seconds of the recorder in a tick."""
    pairs: tuple[tuple[int, int], ...]
    """The places of each pulse in both lists: in `ticks` and in `times`."""
    residual: float
    """The largest difference of a pair from the map, s."""

    def seconds(self, tick: float) -> float:
        """The recorder's time at a tick, s."""
        return self.offset + (tick - self.first_tick) * self.per_tick


@hinted
def align(ticks: Sequence[int], times: Sequence[float], *, tick_hz: int, within: float = 0.001) -> Aligned:
    """Map the device's ticks to the clock of another recorder by pulses that both have.

    `ticks` are of one boot: of onsets whose trigger the recorder has, `receipt.onset.tick`, or of edges of the trigger input. `times` are
    those of the recorder's pulses, s. Both are in order; either may lack pulses, and have others. `tick_hz` is `receipt.onset.tick_hz`, or BIDS's column.
    `within` is how exactly the recorder tells the time between two pulses, s. The clocks may differ in rate by 0.04 %.

    Raises `ValueError` if the lists have too little in common, if they fit in two ways, as pulses at equal intervals do, or if no line fits
    them, because a clock was set.
    """
    if not (number("within", within) > 0 and number("tick_hz", tick_hz) > 0):
        raise ValueError(f"`within` is {within} and `tick_hz` is {tick_hz}: both must be above 0")
    device = [(float(tick) - float(ticks[0])) / tick_hz for tick in given("ticks", ticks, "[850000, 935000]")]
    recorder = [float(time) for time in given("times", times, "[10.0, 11.0]")]
    for name, listed in (("ticks", device), ("times", recorder)):
        if len(listed) < _LEAST:
            raise ValueError(f"`{name}` has {len(listed)} pulses: at least {_LEAST} are needed")
        if not all(earlier < later < math.inf for earlier, later in itertools.pairwise(listed)):
            raise ValueError(f"`{name}` must be finite and in order, each once")
    is_turned = len(recorder) < len(device)
    shorter, longer = (recorder, device) if is_turned else (device, recorder)
    trials = [
        (len(_follow(shorter, longer, (at, place), within, range(at + 1, min(at + _TRIED, len(shorter))))), at, place)
        for at in range(0, len(shorter), max(1, len(shorter) // _TRIED))
        for place in range(len(longer))
    ]
    trials.sort(reverse=True)
    # Trials of one pairing give the same pairs.
    best, *others = sorted(
        {_both_ways(shorter, longer, (at, place), within) for _, at, place in trials[:_FOLLOWED]}, key=len, reverse=True
    )
    if len(best) < max(_LEAST, len(shorter) / 4):
        raise ValueError(
            f"only {len(best)} of {len(shorter)} pulses fit: are both lists of one recording, `times` in seconds, and the clocks' rates "
            "within 0.04 %?"
        )
    rivals = [other for other in others if len(set(best) & set(other)) < len(other) / 2]
    # Two pulses may fit by chance. Equal intervals fit as well shifted by one, but for the last.
    if any(len(rival) >= max(2, min(_RIVAL * len(best), len(best) - 2)) for rival in rivals):
        raise ValueError(
            "the pulses fit in more than one way, as those at equal intervals do: give pulses at uneven intervals"
        )
    pairs = [(b, a) for a, b in best] if is_turned else list(best)
    # A pulse that the other list has by chance, near to where one is expected, is not on the line.
    near = [pair for pair, off in zip(pairs, _line(device, recorder, pairs)[2], strict=True) if off <= within]
    if len(near) < max(_LEAST, _ON_LINE * len(pairs)):
        raise ValueError("no line fits the pulses: was a clock set meanwhile, or is `within` too small?")
    offset, slope, off = _line(device, recorder, near)
    return Aligned(int(ticks[0]), offset, slope / tick_hz, tuple(near), max(off))


def _both_ways(
    shorter: Sequence[float], longer: Sequence[float], first: tuple[int, int], within: float
) -> tuple[tuple[int, int], ...]:
    """All pairs that follow from one."""
    back = _follow(shorter, longer, first, within, range(first[0] - 1, -1, -1))
    return (*reversed(back), *_follow(shorter, longer, first, within, range(first[0] + 1, len(shorter)))[1:])


def _follow(
    shorter: Sequence[float], longer: Sequence[float], first: tuple[int, int], within: float, ahead: range
) -> list[tuple[int, int]]:
    """The pairs from one on, forwards or backwards. Each is near to where the pair before it lets expect it."""
    pairs = [first]
    for at in ahead:
        last, last_place = pairs[-1]
        distance = shorter[at] - shorter[last]
        expected = longer[last_place] + distance
        after = bisect.bisect(longer, expected)
        near = [
            index for index in (after - 1, after) if 0 <= index < len(longer) and (index - last_place) * ahead.step > 0
        ]
        best = min(near, key=lambda index: abs(longer[index] - expected), default=None)
        if best is not None and abs(longer[best] - expected) <= within + 2 * MAX_SKEW * abs(distance):
            pairs.append((at, best))
    return pairs


def _line(
    device: Sequence[float], recorder: Sequence[float], pairs: Sequence[tuple[int, int]]
) -> tuple[float, float, list[float]]:
    """The line of least squares: its value at 0, its slope, and how far each pair is from it."""
    x, y = [device[at] for at, _ in pairs], [recorder[place] for _, place in pairs]
    mean_x, mean_y = math.fsum(x) / len(x), math.fsum(y) / len(y)
    slope = math.fsum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True)) / math.fsum(
        (a - mean_x) ** 2 for a in x
    )
    off = [abs(b - mean_y - slope * (a - mean_x)) for a, b in zip(x, y, strict=True)]
    return mean_y - slope * mean_x, slope, off
