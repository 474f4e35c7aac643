"""TouchSim (Saal, Delhaye, Rayhaun and Bensmaia 2017): stimuli and responses, to and from this project's.

TouchSim is not needed to read its objects, nor to make the arguments of its `Stimulus`: only attributes that it documents are used,
`trace`, `location`, `fs` and `pin_radius` of a stimulus, `aff` and `spikes` of a response. Both sides measure places in mm, and times
in seconds. TouchSim's traces are indentations in mm, this project's are displacements in µm.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

from ..arrays import Array
from ..motions import RATE
from ..program import Simulation, as_array
from ..traces import Displacement


@dataclass(frozen=True)
class Traces:
    """A stimulus of TouchSim for an array's pins."""

    samples: dict[int, Any] = field(repr=False)
    """Displacement above rest of each motor, µm: `m.play(samples=traces.samples, rate=traces.rate)`."""
    rate: float
    """Hz."""
    lost: tuple[str, ...]
    """What the pins cannot do of the stimulus, one sentence each."""


@dataclass(frozen=True)
class Spikes:
    """Spikes of a population of afferents, in its order."""

    classes: tuple[str, ...]
    """`SA1`, `RA` or `PC`."""
    positions_mm: tuple[tuple[float, float], ...]
    spikes_s: list[Any] = field(repr=False)
    """The spike times of each afferent, s: arrays with NumPy, else lists."""


def to_touchsim(
    displacement: Displacement, array: Array | None = None, *, center_mm: tuple[float, float] = (0.0, 0.0)
) -> dict[str, Any]:
    """The arguments of TouchSim's `Stimulus` for what pins do: `touchsim.Stimulus(**to_touchsim(...))`.

    `displacement` is `meissner.displacement(...)`; pins that rest are in it, because they hold the skin down. `array` is `m.array`; without
    it the paper's. `center_mm` is where the array's middle lies on TouchSim's surface. Needs NumPy.
    """
    import numpy

    pins = Array.paper() if array is None else array
    trace = numpy.zeros((pins.motors, len(displacement.um)))
    for column, motor in enumerate(displacement.motors):
        trace[motor] = [row[column] / 1000 for row in displacement.um]
    return {
        "trace": trace,
        "location": numpy.array(pins.positions_mm) + numpy.array(center_mm),
        "fs": float(displacement.rate_hz),
        "pin_radius": float(pins.raw.get("pin_radius_mm", 0.5)),
    }


def from_touchsim(stimulus: Any, array: Array | None = None, *, center_mm: tuple[float, float] = (0.0, 0.0)) -> Traces:
    """The samples of a TouchSim `Stimulus` for an array's pins: each pin of it moves the nearest pin, at most half a pitch away.

    Raises `ValueError` if its rate or indentations are beyond the pins, if no pin is near enough, or if two share one.
    """
    pins = Array.paper() if array is None else array
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
    radius_mm, own_mm = float(stimulus.pin_radius), float(pins.raw.get("pin_radius_mm", 0.5))
    if abs(radius_mm - own_mm) > 0.001:
        lost.append(f"the pins' radius of {radius_mm:g} mm: those of {pins.name} have {own_mm:g} mm")
    return Traces(samples, rate, tuple(lost))


def from_touchsim_response(response: Any) -> Spikes:
    """The spikes of a TouchSim `Response`; those of several stimuli follow each other, as there."""
    return Spikes(
        tuple(str(each) for each in response.aff.affclass),
        tuple((float(place[0]), float(place[1])) for place in response.aff.location),
        [as_array([float(time) for time in times]) for times in response.spikes],
    )


def to_touchsim_response(simulation: Simulation, stimulus: Any) -> Any:
    """A TouchSim `Response` with this project's predicted spikes, for TouchSim's plots and measures. Needs TouchSim.

    `simulation` is `meissner.simulate(..., model="afferents")`, and `stimulus` the `touchsim.Stimulus` that it is the response to.
    """
    try:
        from touchsim.classes import Afferent, AfferentPopulation, Response
    except ImportError as error:
        raise ImportError(
            f"a TouchSim response needs the package touchsim, which its authors publish as source ({error})"
        ) from error
    import numpy

    afferents = simulation.raw.get("afferents") or []
    if (
        not simulation.spikes_s
        or len(afferents) != len(simulation.spikes_s)
        or any("class" not in each for each in afferents)
    ):
        raise ValueError(
            "the simulation has no spikes of SA1, RA and PC afferents: simulate with model='afferents', and not rates_only"
        )
    population = AfferentPopulation(
        *(Afferent(each["class"], location=[each["x_mm"], each["y_mm"]], idx=0) for each in afferents)
    )
    return Response(population, [stimulus], [[numpy.asarray(times, dtype=float) for times in simulation.spikes_s]])
