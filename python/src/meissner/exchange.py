"""TouchSim (Saal, Delhaye, Rayhaun and Bensmaia 2017): its stimuli on this project's pins, and the other way.

    from meissner import exchange

    traces = exchange.from_touchsim(stimulus, m.array)
    m.play(samples=traces.samples, rate=traces.rate)

TouchSim is not needed: only attributes of a `Stimulus` that it documents are used, `trace`, `location`, `fs` and `pin_radius`. Both
sides measure places in mm. TouchSim's traces are indentations in mm, this project's are displacements in µm.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

from ._arguments import hinted
from .arrays import Array
from .motions import RATE
from .program import Displacement, as_array, find_array

_PAPERS = "tula35-6x4"


@dataclass(frozen=True)
class Traces:
    """A stimulus of TouchSim for an array's pins."""

    samples: dict[int, Any] = field(repr=False)
    """Displacement above rest of each motor, µm: `m.play(samples=traces.samples, rate=traces.rate)`."""
    rate: float
    """Hz."""
    lost: tuple[str, ...]
    """What the pins cannot do of the stimulus, one sentence each."""


@hinted
def to_touchsim(
    displacement: Displacement, array: Array | None = None, *, center_mm: tuple[float, float] = (0.0, 0.0)
) -> dict[str, Any]:
    """The arguments of TouchSim's `Stimulus` for what pins do: `touchsim.Stimulus(**to_touchsim(...))`.

    `displacement` is `meissner.displacement(...)`; pins that rest are in it, because they hold the skin down. `array` is `m.array`; without
    it the paper's. `center_mm` is where the array's middle lies on TouchSim's surface. Needs NumPy.
    """
    import numpy

    pins = find_array(_PAPERS) if array is None else array
    trace = numpy.zeros((pins.motors, len(displacement.um)))
    for column, motor in enumerate(displacement.motors):
        trace[motor] = [row[column] / 1000 for row in displacement.um]
    return {
        "trace": trace,
        "location": numpy.array(pins.positions_mm) + numpy.array(center_mm),
        "fs": float(displacement.rate_hz),
        "pin_radius": float(pins.raw["pin_radius_mm"]),
    }


@hinted
def from_touchsim(stimulus: Any, array: Array | None = None, *, center_mm: tuple[float, float] = (0.0, 0.0)) -> Traces:
    """The samples of a TouchSim `Stimulus` for an array's pins: each pin of it moves the nearest pin, at most half a pitch away.

    Raises `ValueError` if its rate or indentations are beyond the pins, if no pin is near enough, or if two share one.
    """
    pins = find_array(_PAPERS) if array is None else array
    rate = float(stimulus.fs)
    if not RATE[0] <= rate <= RATE[1]:
        raise ValueError(f"the stimulus has {rate:g} samples a second: must be {RATE[0]:g} to {RATE[1]:g}")
    travel_um, speed_um_s = pins.motor["travel_um"], 1000 * pins.motor["speed_mm_s"]
    samples: dict[int, Any] = {}
    lost, furthest_mm, fastest_um_s = [], 0.0, 0.0
    for place, trace in zip(stimulus.location, stimulus.trace, strict=True):
        x, y = float(place[0]) - center_mm[0], float(place[1]) - center_mm[1]
        motor = min(range(pins.motors), key=lambda each: math.dist(pins.positions_mm[each], (x, y)))
        away_mm = math.dist(pins.positions_mm[motor], (x, y))
        # NaN is near to nothing.
        if not away_mm <= pins.pitch_mm / 2:
            raise ValueError(
                f"no pin of {pins.name} is within half a pitch of ({x:g}, {y:g}) mm: the nearest is {away_mm:.3g} mm away"
            )
        if motor in samples:
            raise ValueError(
                f"two pins of the stimulus are nearest to motor {motor}: the array {pins.name} is coarser than the stimulus"
            )
        um = [1000 * float(mm) for mm in trace]
        if not all(map(math.isfinite, um)):
            raise ValueError(
                f"the pin at ({x:g}, {y:g}) mm has samples that are no finite numbers: must be 0 to {travel_um:g} um"
            )
        if min(um) < -0.001 or max(um) > travel_um + 0.001:
            raise ValueError(
                f"the pin at ({x:g}, {y:g}) mm goes from {min(um):.4g} to {max(um):.4g} um: must be 0 to {travel_um:g}, its motor's travel"
            )
        samples[motor] = as_array([min(max(value, 0.0), travel_um) for value in um])
        furthest_mm = max(furthest_mm, away_mm)
        fastest_um_s = max(
            [fastest_um_s, um[0] * rate, um[-1] * rate, *(abs(b - a) * rate for a, b in itertools.pairwise(um))]
        )
    if furthest_mm > 0.001:
        lost.append(f"the exact places: pins are up to {furthest_mm:.3g} mm away")
    if fastest_um_s > 1.01 * speed_um_s:
        lost.append(
            f"speeds of up to {fastest_um_s / 1000:.3g} mm/s: the motor moves at {speed_um_s / 1000:.3g} mm/s, and the pin lags"
        )
    radius_mm, own_mm = float(stimulus.pin_radius), float(pins.raw["pin_radius_mm"])
    if abs(radius_mm - own_mm) > 0.001:
        lost.append(f"the pins' radius of {radius_mm:g} mm: those of {pins.name} have {own_mm:g} mm")
    return Traces(samples, rate, tuple(lost))
