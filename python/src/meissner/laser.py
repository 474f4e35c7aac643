"""Calibration of one motor by a laser: gains from a displacement sensor's recording of its pin, for boards without telemetry.

`meissner calibrate --plan` plays bursts and writes each with its tick. `fit` finds them in a recording that was made meanwhile, by any
clock, and `Client.store_calibration` gives the result to the daemon. It needs NumPy.

1. A search: the recording's steps, in bins, are correlated with the plan's bursts at every lag and at several clock errors. Offsets and
   slow drift have no steps.
2. The area under each step tells when it happened, whatever its shape. A line through these times is the sensor's clock. A reversed
   sign with a lag half a stroke longer fits almost as well, so both are measured and the better one is taken.
3. Least squares fit a level and a travel, with the motor model's step, to the samples around each burst.
4. A line through travel against pulses is the gain. Travels scatter by a share of themselves, so each weighs 1/pulses².

A recording that does not follow the plan's bursts raises a `ValueError` and gives no gains.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

_BIN_S = 0.01
_SIDE = 5
"""Bins on either side of a step of the search. Bursts are 125 ms apart."""
_SEARCH_PPM = (-1200, -900, -600, -300, 0, 300, 600, 900, 1200)
"""Neighbours differ by 22 ms at the ends of the longest plan; a step of the search is 100 ms wide."""
_WINDOWS = ((0.060, 0.030), (0.040, 0.012), (0.040, 0.012))
"""Half the length about a burst's middle, and half the part where no level is measured, s. The first allows for the search's error."""
_REST_S, _END_S = 0.25, 2.0
"""Rest that counts beside a burst; for the drift, before the first and after the last one, s at most."""
_MOST_PPM, _LEAST_CORRELATION, _MOST_SCATTER, _MOST_SLOPE_SE = 1000, 0.9, 0.35, 0.05
_PLAN_FORMAT, _CALIBRATION_FORMAT = 1, 1


@dataclass(frozen=True)
class Line:
    """Travel of a motor in one direction: offset + slope times pulses. The keys of a calibration file."""

    gain: float
    slope_um_per_pulse: float
    slope_se_um_per_pulse: float
    offset_um: float
    relative_sd: float
    """Standard deviation of a burst's travel, as a share of it, without the sensor's noise."""
    blocks: int
    points: list[tuple[int, float, float, int]] = field(repr=False)
    """By length: pulses, mean travel, its standard deviation, µm, and bursts."""


@dataclass(frozen=True)
class Fit:
    """What a recording says about a motor and about the sensor."""

    motor: int
    up: Line
    down: Line
    drift_um_per_s: float
    noise_um: float
    reversed: bool
    """Whether the sensor counts downwards; the fit turned it round."""
    clock_error_ppm: float
    first_burst_s: float
    """When the first burst began, by the sensor's clock."""
    bursts: int
    """How many of the plan's the recording covers."""
    trace: Any = field(repr=False)
    """Rows of time since the first burst, s, measured and fitted displacement, µm: for a plot. Drift is taken out."""
    toml: str = field(repr=False)
    """The calibration file, for `Client.store_calibration`."""


@dataclass(frozen=True)
class _Clock:
    """The sensor's clock against the plan's: `sensor = at_s + rate (plan - middle_s)`."""

    middle_s: float
    at_s: float
    rate: float

    def sensor(self, plan_s: Any) -> Any:
        return self.at_s + self.rate * (plan_s - self.middle_s)

    def plan(self, sensor_s: Any) -> Any:
        return self.middle_s + (sensor_s - self.at_s) / self.rate


def fit(time_s: Any, displacement_um: Any, plan: Mapping[str, Any]) -> Fit:
    """Fit the motor of a plan that was played to a recording of its pin.

    Samples without a displacement are NaN. `plan` is the document of `meissner calibrate --plan`.
    """
    if plan.get("format") != _PLAN_FORMAT:
        raise ValueError(f"`plan` has format {plan.get('format')!r}: must be what `meissner calibrate --plan` writes")
    seconds, um = _checked(time_s, displacement_um)
    bursts = _Bursts(plan)
    clock, sign = _aligned(bursts, seconds, um)
    measured = _measured(bursts, clock.plan(seconds), sign * um)
    planned = len(bursts.um)
    if 2 * len(measured.index) < planned:
        raise ValueError(
            f"the recording covers {len(measured.index)} of {planned} bursts: record from before the first burst until after the last"
        )
    up, down = (_line(bursts, measured, sign) for sign in (1, -1))
    return Fit(
        motor=bursts.motor,
        up=up,
        down=down,
        drift_um_per_s=measured.drift,
        noise_um=measured.noise,
        reversed=sign < 0,
        clock_error_ppm=(clock.rate - 1) * 1e6,
        first_burst_s=float(clock.sensor(0.0)),
        bursts=len(measured.index),
        trace=measured.trace,
        toml=_toml(plan, up, down),
    )


def _checked(time_s: Any, displacement_um: Any) -> tuple[Any, Any]:
    """The samples that have a displacement."""
    seconds, um = np.asarray(time_s, dtype=float), np.asarray(displacement_um, dtype=float)
    if seconds.ndim != 1 or seconds.shape != um.shape:
        raise ValueError(f"times and displacements have the shapes {seconds.shape} and {um.shape}: must be as long")
    if not (np.isfinite(seconds).all() and (np.diff(seconds) > 0).all()):
        raise ValueError("`time_s` must increase from sample to sample: if times are rounded, count samples instead")
    there = np.isfinite(um)
    seconds, um = seconds[there], um[there]
    if len(um) < 100:
        raise ValueError(f"the recording has {len(um)} samples: must be at least 100")
    if seconds[-1] - seconds[0] > 1800:
        raise ValueError(
            f"the recording lasts {seconds[-1] - seconds[0]:.0f} s: must be at most 1800 s; check the unit of the time, or cut it"
        )
    step = float(np.median(np.diff(seconds)))
    if step > 0.005:
        raise ValueError(f"one sample each {step * 1e3:.1f} ms is too slow to see a burst: record 200 a second or more")
    same = um[1:] == um[:-1]
    # Without noise, equal samples say nothing.
    for end in (um.min(), um.max()) if 2 * same.sum() <= len(um) else ():
        edges = np.flatnonzero(np.diff(np.concatenate(([0], um == end, [0]))))
        runs = int((edges[1::2] - edges[::2] >= 5).sum())
        if runs >= 5:
            raise ValueError(
                f"the sensor is clipped at {end:.2f} um, in {runs} places: set its range so that the whole travel fits, and record again"
            )
    return seconds, um


def _between(seconds: Any, from_s: float, to_s: float) -> slice:
    return slice(int(np.searchsorted(seconds, from_s)), int(np.searchsorted(seconds, to_s)))


class _Bursts:
    """The plan's bursts, in plan time: seconds since the first."""

    def __init__(self, plan: Mapping[str, Any]) -> None:
        bursts = plan["bursts"]
        ticks = np.array([burst["tick"] for burst in bursts], dtype=np.int64)
        self.motor = int(plan["motor"])
        self.pulses = np.array([burst["pulses"] for burst in bursts], dtype=float)
        self.sign = np.array([1.0 if burst["direction"] == "up" else -1.0 for burst in bursts])
        self.warm_up = np.array([burst["warm_up"] for burst in bursts], dtype=bool)
        self.um_per_pulse = float(plan["um_per_pulse"])
        self.um = self.sign * self.pulses * self.um_per_pulse
        """Travel by the model, upwards positive."""
        self.hz = plan["tick_hz"]
        self.window = plan["window_ticks"]
        self.start_s = (ticks - ticks[0]) / self.hz
        self.rests_s = (ticks - ticks[0] + self.pulses + np.ceil(self.window)) / self.hz
        self.middle_s = self.start_s + (self.pulses + self.window) / 2 / self.hz

    def share(self, index: int, plan_s: Any) -> Any:
        """The share of a burst's travel that the motor model shows: a ramp, averaged over the window."""
        ticks, pulses = np.round((plan_s - self.start_s[index]).clip(0) * 2 * self.hz) / 2, self.pulses[index]

        def area(after: Any) -> Any:
            inside = after.clip(0, pulses)
            return inside * inside / (2 * pulses) + (after - pulses).clip(0)

        return (area(ticks) - area(ticks - self.window)) / self.window


def _aligned(bursts: _Bursts, seconds: Any, um: Any) -> tuple[_Clock, float]:
    """The sensor's clock, and -1 if it counts downwards."""
    found, problems = [], []
    for clock, sign in _search(bursts, seconds, um):
        try:
            explained, refined = _refined(bursts, seconds, um, clock, sign)
            found.append((explained, refined, sign))
        except ValueError as problem:
            problems.append(problem)
    if not found:
        raise problems[0]
    _, clock, sign = max(found, key=lambda one: one[0])
    ppm = (clock.rate - 1) * 1e6
    if abs(ppm) > _MOST_PPM:
        raise ValueError(
            f"the sensor's clock differs by {ppm:.0f} ppm from the device's, which is more than {_MOST_PPM}: check the unit of the time"
            " and the sampling rate"
        )
    return clock, sign


def _search(bursts: _Bursts, seconds: Any, um: Any) -> list[tuple[_Clock, float]]:
    """The clocks at which the recording's steps follow the plan best, upwards and turned round; the better one first."""
    first = seconds[0]
    count = int((seconds[-1] - first) / _BIN_S) + 1
    bins = ((seconds - first) / _BIN_S).astype(int).clip(0, count - 1)
    samples = np.bincount(bins, minlength=count)
    full = samples > 0
    means = np.bincount(bins, um, count) / samples.clip(1)
    sums, fulls = (np.concatenate(([0], np.cumsum(each))) for each in (means, full))
    at = np.arange(_SIDE, count - _SIDE + 1)
    counts = [fulls[at + _SIDE] - fulls[at], fulls[at] - fulls[at - _SIDE]]
    levels = [(sums[at + _SIDE] - sums[at]) / counts[0].clip(1), (sums[at] - sums[at - _SIDE]) / counts[1].clip(1)]
    steps = np.zeros(count)
    steps[at[at < count]] = np.where(np.minimum(*counts) * 2 > _SIDE, levels[0] - levels[1], 0.0)[at < count]

    length = bursts.middle_s[-1]
    before = int(length / _BIN_S) + 2 * _SIDE
    best = {1.0: (0.0, _Clock(length / 2, first, 1.0)), -1.0: (0.0, _Clock(length / 2, first, 1.0))}
    for ppm in _SEARCH_PPM:
        rate = 1 + ppm / 1e6
        products, squares = np.zeros(count + 2 * before), np.zeros(count + 2 * before)
        for bin, travel in zip(
            np.rint((bursts.middle_s - length / 2) * rate / _BIN_S).astype(int), bursts.um, strict=True
        ):
            # Index `before` is a plan whose middle lies at the recording's beginning.
            lags = slice(before - bin, before - bin + count)
            products[lags] += travel * steps
            squares[lags] += travel * travel
        # What the plan explains with the best common gain: a lag with longer bursts is no better for that.
        scores = products**2 / squares.clip(1e-300)
        for sign in best:
            of_sign = np.where(products * sign >= 0, scores, 0.0)
            index = int(of_sign.argmax())
            if of_sign[index] > best[sign][0]:
                best[sign] = of_sign[index], _Clock(length / 2, first + (index - before) * _BIN_S, rate)
    ordered = sorted(best.items(), key=lambda item: -item[1][0])
    return [(clock, sign) for sign, (_, clock) in ordered]


def _refined(bursts: _Bursts, seconds: Any, um: Any, clock: _Clock, sign: float) -> tuple[float, _Clock]:
    """How much of the recording's steps the plan explains, µm², and the clock."""
    explained = 0.0
    for half_s, blind_s in _WINDOWS:
        middles, expected, steps, at_s = _steps(bursts, seconds, um, clock, half_s, blind_s)
        count = len(steps)
        if count < 20:
            raise ValueError(
                f"the recording covers {count} of {len(bursts.um)} bursts: record from before the first burst until after the last"
            )
        step_um, expected_um = np.sqrt((steps**2).mean()), np.sqrt((expected**2).mean())
        if step_um < 0.1 * expected_um:
            raise ValueError(
                f"the pin moves by {step_um:.3f} um where the bursts would move it by {expected_um:.1f} um: check that the sensor points"
                f" at motor {bursts.motor}'s pin, and the unit of the displacement"
            )
        product = sign * float(steps @ expected)
        correlation = product / count / step_um / expected_um
        explained = product**2 / count / expected_um**2
        if not correlation >= _LEAST_CORRELATION:
            raise ValueError(
                f"the recording does not follow the plan's bursts (correlation {correlation:.2f}, {_LEAST_CORRELATION} is needed): check"
                f" that it was made during this plan, of motor {bursts.motor}'s pin, and the unit of the time"
            )
        # A step that noise has swallowed has no middle.
        clear = (np.abs(steps) > 0.1 * np.abs(expected)) & np.isfinite(at_s)
        clock = _clock(middles[clear], at_s[clear], expected[clear] ** 2)
    return explained, clock


def _steps(bursts: _Bursts, seconds: Any, um: Any, clock: _Clock, half_s: float, blind_s: float) -> Any:
    """Of the bursts that are covered without a gap: middle in plan time, travel by the model, step, middle by the sensor's clock."""
    most_s = 5 * np.median(np.diff(seconds))
    around = []
    products = squares = 0.0
    for index, at in enumerate(clock.sensor(bursts.middle_s)):
        part = _between(seconds, at - half_s, at + half_s)
        time, level = seconds[part], um[part]
        if len(time) == 0 or max(time[0] - at + half_s, at + half_s - time[-1], np.diff(time).max(initial=0)) > most_s:
            continue
        sides = time < at - blind_s, time > at + blind_s
        for side in sides:
            if side.any():
                off = time[side] - time[side].mean()
                products, squares = products + off @ level[side], squares + off @ off
        around.append((index, time, level, sides))
    # The sensor's drift is the common slope of the levels.
    drift = products / squares if squares > 0 else 0.0
    rows = []
    for index, time, level, (before, after) in around:
        if before.any() and after.any():
            still = level - drift * time
            low, high = still[before].mean(), still[after].mean()
            area: float = np.sum(np.diff(time) * (still[1:] + still[:-1] - 2 * low) / 2)
            at_s = time[-1] - area / (high - low) if high != low else np.nan
            rows.append((bursts.middle_s[index], bursts.um[index], high - low, at_s))
    return np.array(rows).reshape(-1, 4).T


def _clock(plan_s: Any, sensor_s: Any, weight: Any) -> _Clock:
    """The line through the middles, without outliers. A middle's error is the noise over the step, so it weighs as the step's square."""
    clock = _Clock(0.0, 0.0, 1.0)
    for _ in range(3):
        middle_s, at_s = np.average(plan_s, weights=weight), np.average(sensor_s, weights=weight)
        rate = (weight * (plan_s - middle_s)) @ (sensor_s - at_s) / (weight @ (plan_s - middle_s) ** 2)
        clock = _Clock(float(middle_s), float(at_s), float(rate))
        off = weight * (sensor_s - clock.sensor(plan_s)) ** 2
        near = off <= 16 * off.sum() / max(len(off) - 2, 1)
        if near.sum() < 20:
            break
        plan_s, sensor_s, weight = plan_s[near], sensor_s[near], weight[near]
    return clock


@dataclass
class _Measured:
    """Travels of the bursts that have enough rest on either side."""

    index: Any
    travels: Any
    """µm, in the direction of the burst."""
    variances: Any
    """What the sensor's noise gives each, µm²."""
    drift: float
    noise: float
    trace: Any


def _measured(bursts: _Bursts, seconds: Any, um: Any) -> _Measured:
    """Each burst's travel, in plan time. It has a level of its own, so a step of the sensor elsewhere does not matter."""
    starts, rests = bursts.start_s, bursts.rests_s
    tt = ty = yy = 0.0
    free = -1
    for begin, end in np.column_stack(
        (np.append(starts[0] - _END_S, rests), np.append(starts, rests[-1] + _END_S))
    ).tolist():
        part = _between(seconds, begin, end)
        if len(seconds[part]) >= 2:
            t, y = seconds[part] - seconds[part].mean(), um[part] - um[part].mean()
            tt, ty, yy, free = tt + t @ t, ty + t @ y, yy + y @ y, free + len(t) - 1
    drift = float(ty / tt) if tt > 0 else 0.0
    noise = float(np.sqrt(max(yy - drift * ty, 0.0) / max(free, 1)))

    rows: list[tuple[int, float, float]] = []
    trace = []
    from_s: Any = np.maximum(np.append(-np.inf, rests[:-1]), starts - _REST_S)
    to_s: Any = np.minimum(np.append(starts[1:], np.inf), rests + _REST_S)
    for index in range(len(starts)):
        part = _between(seconds, from_s[index], to_s[index])
        time, level = seconds[part], um[part] - drift * seconds[part]
        if (time < starts[index]).sum() < 10 or (time > rests[index]).sum() < 10:
            continue
        share = bursts.share(index, time)
        off = share - share.mean()
        travel = off @ (level - level.mean()) / (off @ off)
        rows.append((index, bursts.sign[index] * travel, noise**2 / (off @ off)))
        own = time >= starts[index]
        trace.append(np.column_stack((time, level, level.mean() + travel * off))[own])
    found = np.array(rows).reshape(-1, 3)
    joined = np.concatenate(trace) if trace else np.zeros((0, 3))
    joined[:, 1:] -= joined[:1, 1]
    return _Measured(found[:, 0].astype(int), found[:, 1], found[:, 2], drift, noise, joined)


def _line(bursts: _Bursts, measured: _Measured, sign: int) -> Line:
    """The line through the travels of one direction. Warm-up strokes do not count."""
    counts = (bursts.sign[measured.index] == sign) & ~bursts.warm_up[measured.index]
    pulses, travels = bursts.pulses[measured.index[counts]], measured.travels[counts]
    where = f"motor {bursts.motor}, {'upwards' if sign > 0 else 'downwards'}"
    if len(travels) < 10:
        raise ValueError(f"{where}: {len(travels)} bursts were measured, but 10 are needed: record the whole plan")
    lengths = np.unique(pulses)
    if len(lengths) < 2:
        raise ValueError(
            f"{where}: all bursts have the same number of pulses, which gives no slope: play two numbers or more"
        )
    x, y = 1 / pulses, travels / pulses
    off = x - x.mean()
    offset = off @ (y - y.mean()) / (off @ off)
    slope = y.mean() - offset * x.mean()
    gain = slope / bursts.um_per_pulse
    if not 0.5 <= gain <= 1.5:
        raise ValueError(
            f"{where}: a pulse moves the pin by {slope:.4f} um, {gain:.4f} times the model's value, which must be 0.5 to 1.5: check that the"
            " pin moves freely, and that the sensor measures this motor"
        )
    sd = np.sqrt(((y - slope - offset * x) ** 2).sum() / (len(y) - 2))
    error = sd * np.sqrt(1 / len(y) + x.mean() ** 2 / (off @ off))
    noise = (measured.variances[counts] / (pulses * bursts.um_per_pulse) ** 2).mean()
    scatter = float(np.sqrt(max((sd / slope) ** 2 - noise, 0.0)))
    if error > _MOST_SLOPE_SE * slope:
        raise ValueError(
            f"{where}: the slope is only known to {error / slope:.0%}, from bursts that scatter by {sd / slope:.0%}: measure more bursts,"
            " or numbers of pulses further apart"
        )
    if scatter > _MOST_SCATTER:
        raise ValueError(
            f"{where}: bursts scatter by {scatter:.0%}, which no motor does (at most {_MOST_SCATTER:.0%}): check that nothing touches the"
            " pin or the sensor, and record again"
        )
    points = []
    for length in lengths:
        of = travels[pulses == length]
        spread = float(of.std(ddof=1)) if len(of) > 1 else 0.0
        points.append((int(length), round(float(of.mean()), 3), round(spread, 3), len(of)))
    return Line(float(gain), float(slope), float(error), float(offset), scatter, len(travels), points)


def _toml(plan: Mapping[str, Any], up: Line, down: Line) -> str:
    """The calibration file of this motor."""
    provenance = {
        **{key: plan[key] for key in ("device", "firmware", "identity")},
        "telemetry": "laser",
        **{key: plan[key] for key in ("pulses", "repetitions")},
        "groups": len(plan["pulses"]) * plan["repetitions"],
        "um_per_pulse": plan["um_per_pulse"],
        "date": plan["date"],
    }
    head = {"format": _CALIBRATION_FORMAT, "array": plan["array"], "array_hash": plan["array_hash"]}
    lines = [*_keys(head), "\n[[motor]]", f"motor = {plan['motor']}"]
    for name, line in (("up", up), ("down", down)):
        lines += [f"\n[motor.{name}]", *_keys(vars(line))]
    return "\n".join([*lines, "\n[provenance]", *_keys(provenance)]) + "\n"


def _keys(table: Mapping[str, Any]) -> Sequence[str]:
    """Lines of TOML. Strings, numbers and lists of them are written as in JSON."""
    return [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items()]
