"""`align` finds which pulses are the same in two recordings, and the map between their clocks."""

from __future__ import annotations

import random

import pytest

from meissner import align

TICK_HZ = 85_000


def recorded(
    seed: int, count: int = 400, *, lost: float = 0.1, more: float = 0.1
) -> tuple[list[int], list[float], float]:
    """Ticks of pulses at uneven intervals, and what a recorder has: 80 ppm fast, with jitter, and the rate of its clock."""
    rng = random.Random(seed)
    ticks, at = [], 4_292_000_000
    for _ in range(count):
        at += round(TICK_HZ * rng.uniform(0.8, 3.0))
        ticks.append(at)
    rate = 1 + rng.uniform(-80e-6, 80e-6)
    exact = [1234.5 + rate * (tick - ticks[0]) / TICK_HZ for tick in ticks]
    times = [time + rng.uniform(-2e-4, 2e-4) for time in exact if rng.random() >= lost]
    times += [rng.uniform(exact[0] - 60, exact[-1] + 60) for _ in range(int(more * count))]
    return [tick for tick in ticks if rng.random() >= lost], sorted(times), rate


@pytest.mark.parametrize("seed", range(20))
def test_pulses_that_either_lacks_are_left_out(seed: int) -> None:
    ticks, times, rate = recorded(seed)
    found = align(ticks, times, tick_hz=TICK_HZ)
    assert found.per_tick * TICK_HZ == pytest.approx(rate, abs=2e-6)
    assert len(found.pairs) > 300
    assert found.residual < 3e-4
    for at, place in found.pairs:
        assert found.seconds(ticks[at]) == pytest.approx(times[place], abs=3e-4)


@pytest.mark.parametrize("part", [(150, 300), (45, 79), (0, 20), (390, 400)])
def test_a_recording_that_began_late_and_ended_early_is_aligned(part: tuple[int, int]) -> None:
    ticks, times, _ = recorded(1, lost=0.0, more=0.0)
    first, last = part
    found = align(ticks, times[first:last], tick_hz=TICK_HZ)
    assert found.pairs == tuple((first + place, place) for place in range(last - first))
    found = align(ticks[first:last], times, tick_hz=TICK_HZ)
    assert found.pairs == tuple((place, first + place) for place in range(last - first))
    assert found.seconds(ticks[first]) == pytest.approx(times[first], abs=1e-3)


def test_equal_intervals_may_be_shifted_so_they_are_refused() -> None:
    ticks = [10 * TICK_HZ + 2 * TICK_HZ * volume for volume in range(100)]
    times = [3.0 + 2.0 * volume for volume in range(100)]
    for given in ((ticks, times), (ticks, times[:-1]), (ticks[1:], times[:-1])):
        with pytest.raises(ValueError, match="fit in more than one way"):
            align(*given, tick_hz=TICK_HZ)


def test_what_cannot_be_aligned_is_told() -> None:
    ticks, times, _ = recorded(2)
    for given, said in (
        ((ticks[:2], times), "`ticks` has 2 pulses"),
        ((ticks, [*times, float("nan")]), "`times` must be finite and in order"),
        ((ticks[::-1], times), "`ticks` must be finite and in order"),
        ((ticks, [*times, float("inf")]), "`times` must be finite and in order"),
        ((ticks, [1000 * time for time in times]), "are both lists of one recording"),
        ((ticks, recorded(7)[1]), "are both lists of one recording"),
    ):
        with pytest.raises(ValueError, match=said):
            align(*given, tick_hz=TICK_HZ)
    # The recorder's clock was set forward.
    ticks, times, _ = recorded(3, lost=0.0, more=0.0)
    with pytest.raises(ValueError, match="no line fits the pulses"):
        align(ticks, [time + (0.005 if place > 200 else 0.0) for place, time in enumerate(times)], tick_hz=TICK_HZ)
