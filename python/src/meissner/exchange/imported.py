"""A haptic file as a pattern: vibrations and curves of other formats become what pins can do.

`from_ahap` and `from_hjif` read their files into `Vibration` and `Curve`, and `Pins` makes motions of them. A vibration of one amplitude
and frequency is a `[[tone]]`. One that changes, and a curve, are samples of a `[[wave]]`.

Invariant: no motion asks for more than the motor's speed. What it takes away is told in `lost`.
"""

from __future__ import annotations

import bisect
import itertools
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Union

from .. import motions
from .._text_file import text_of
from ..arrays import Array

Points = Sequence[tuple[float, float]]
"""Times, s, with values; linear between them, and as the nearest one outside."""
Motors = Union[Sequence[int], Mapping[int, Sequence[int]], None]

# How long the ends of a vibration rise and fall. It swings about half of its amplitude, and a jump to there would be felt as a tap.
_EDGE_S = 0.02
_RATE = 4000.0
_MOST_TONES = 4096
_LARGEST = 1e15
_LONGEST_S = 1000.0
_SLOWEST_HZ = 0.1


@dataclass(frozen=True)
class Imported:
    """A pattern, and what of the file it does not have."""

    pattern: dict[str, Any] = field(repr=False)
    """The keys of a pattern file: `m.play(imported.pattern)`. Its name is the file's."""
    lost: tuple[str, ...]
    """What the pins cannot do of the file, one sentence each."""

    @property
    def toml(self) -> str:
        """The pattern file: `m.store_pattern(imported.pattern["name"], imported.toml)`."""
        return motions.pattern_toml(self.pattern)


@dataclass(frozen=True)
class Vibration:
    """A vibration, from `start_s` on; times of its points count from there."""

    start_s: float
    duration_s: float
    amplitude: Points
    """Shares of the amplitude that the user chooses, 0 to 1."""
    frequency: Points
    """Hz."""
    signal: str = "Sine"
    is_tap: bool = False
    """Whether it is so short that whole periods stand for its ends."""

    @property
    def begin_s(self) -> float:
        """When it begins."""
        return self.start_s

    @property
    def end_s(self) -> float:
        """When it ends."""
        return self.start_s + self.duration_s

    @property
    def edge_s(self) -> float:
        """How long its ends last."""
        return min(_EDGE_S, self.duration_s / 2)

    @property
    def is_steady(self) -> bool:
        """Whether a tone can play it."""
        return self.signal == "Sine" and len({share for _, share in self.amplitude}) == 1 == len(
            {hz for _, hz in self.frequency}
        )


@dataclass(frozen=True)
class Curve:
    """A displacement, from `start_s` on; times of its points count from there, and it is 0 before and after them."""

    start_s: float
    points: Points
    """Displacements, µm; below 0 the pin would go down."""
    is_smooth: bool = False
    """Whether it goes from point to point without corners."""

    @property
    def begin_s(self) -> float:
        """When it begins."""
        return self.start_s + self.points[0][0]

    @property
    def end_s(self) -> float:
        """When it ends."""
        return self.start_s + self.points[-1][0]


def value_at(points: Points, at_s: float) -> float:
    """The value of points at a time."""
    after = bisect.bisect_right(points, at_s, key=time_of)
    if after == 0:
        return points[0][1]
    if after == len(points):
        return points[-1][1]
    (t0, v0), (t1, v1) = points[after - 1 : after + 1]
    return v0 + (v1 - v0) * (at_s - t0) / (t1 - t0)


def time_of(point: tuple[float, float]) -> float:
    """When a point is, by which points are searched."""
    return point[0]


def number(value: Any, what: str) -> float:
    """A number of a file. Raises `ValueError` for NaN and for those so large that sums and products of them would overflow."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not -_LARGEST <= value <= _LARGEST:
        raise ValueError(f"{what} is {value!r:.40}: must be a number from {-_LARGEST:g} to {_LARGEST:g}")
    return float(value)


class Pins:
    """Makes motions for an array's pins, and collects what they lose."""

    def __init__(self, array: Array | None, amplitude_um: float) -> None:
        self.array = Array.paper() if array is None else array
        motor = self.array.motor
        self.speed_um_s, self.window_s = 1000 * motor["speed_mm_s"], motor["window_ms"] / 1000
        self.travel_um = motor["travel_um"]
        if not 0 < amplitude_um <= self.travel_um:
            raise ValueError(
                f"`amplitude_um` is {amplitude_um:g}: must be above 0, at most the pins' travel of {self.travel_um:g}"
            )
        self.amplitude_um = amplitude_um
        self.lost: list[str] = []
        self._tones: list[dict[str, Any]] = []
        self._waves: list[dict[str, Any]] = []
        self._parts: dict[int, list[Vibration | Curve]] = {}
        # By signal: the lowest and the highest frequency whose amplitude is less than asked for, and what the highest has, µm.
        self._weak: dict[str, tuple[float, float, float]] = {}

    def lose(self, sentence: str) -> None:
        """Tells what is lost, once."""
        if sentence not in self.lost:
            self.lost.append(sentence)

    def motors(self, motors: Motors, channel: int) -> list[int]:
        """The motors that play a channel: of a dict those it names, else the same for all."""
        chosen = (
            motors.get(channel, ())
            if isinstance(motors, Mapping)
            else range(self.array.motors)
            if motors is None
            else motors
        )
        self.array.check_motors({"motor": motor} for motor in chosen)
        if isinstance(motors, Mapping) and not chosen:
            self.lose(f"channel {channel}: `motors` names no motor for it")
        return list(chosen)

    def add(self, parts: Iterable[Vibration | Curve], motors: Sequence[int]) -> None:
        """Adds what motors do together. Raises `ValueError` for times and frequencies that no pattern has."""
        parts = list(parts)
        for part in parts:
            # NaN is within nothing.
            if not (part.begin_s >= 0.0 and part.end_s <= _LONGEST_S):
                raise ValueError(
                    f"something lasts from {part.begin_s:g} to {part.end_s:g} s: must be within 0 and {_LONGEST_S:g} s"
                )
            lowest_hz = (
                min((hz for _, hz in part.frequency), default=0.0) if isinstance(part, Vibration) else _SLOWEST_HZ
            )
            if lowest_hz < _SLOWEST_HZ:
                raise ValueError(
                    f"a vibration at {part.begin_s:g} s has {lowest_hz:g} Hz: must be at least {_SLOWEST_HZ:g}"
                )
        felt = [part for part in parts if isinstance(part, Curve) or max(share for _, share in part.amplitude) > 0]
        for motor in motors:
            self._parts.setdefault(motor, []).extend(felt)

    def _move(self, parts: Sequence[Vibration | Curve], motors: Sequence[int]) -> None:
        """Makes the motions of motors that do the same."""
        parts = sorted(parts, key=lambda part: part.start_s)
        # What overlaps is sampled together, because the motor's speed limits the sum.
        sampled, steady, end_s = list[Vibration | Curve](), list[Vibration](), -math.inf
        for part, after in itertools.zip_longest(parts, parts[1:]):
            is_alone = part.start_s >= end_s and (after is None or after.start_s >= part.end_s)
            end_s = max(end_s, part.end_s)
            if is_alone and isinstance(part, Vibration) and part.is_steady:
                steady.append(part)
            else:
                sampled.append(part)
        if len(self._tones) + len(steady) * len(motors) > _MOST_TONES:
            sampled, steady = parts, []
        for motor in motors:
            self._tones += [{"motor": motor, **self._tone(part)} for part in steady]
        if sampled:
            self._sample(sampled, motors)

    def _amplitude(self, part: Vibration, hz: float) -> float:
        """The amplitude of 1 at a frequency, µm peak to peak. A sine is steepest in its middle, and the ends add to it."""
        per_s = hz * (math.pi if part.signal == "Sine" else 2) + (0.0 if part.is_tap else 1 / part.edge_s)
        most_um = self.speed_um_s / per_s
        if most_um < self.amplitude_um:
            low, high, least_um = self._weak.get(part.signal, (hz, hz, most_um))
            self._weak[part.signal] = (min(low, hz), max(high, hz), min(least_um, most_um))
        return min(self.amplitude_um, most_um)

    def _tone(self, part: Vibration) -> dict[str, Any]:
        hz, share = part.frequency[0][1], part.amplitude[0][1]
        return {
            "start_s": part.start_s,
            "duration_s": part.duration_s,
            "frequency_hz": hz,
            "amplitude_um": share * self._amplitude(part, hz),
            # It begins at its lowest point, at rest.
            "phase": 0.75,
            **({} if part.is_tap else {"envelope": {"attack_s": part.edge_s, "release_s": part.edge_s}}),
        }

    def _sample(self, parts: Sequence[Vibration | Curve], motors: Sequence[int]) -> None:
        first_s = min(part.start_s for part in parts)
        last_s = max(part.end_s for part in parts)
        um = [0.0] * (math.ceil((last_s - first_s) * _RATE) + 2)
        for part in parts:
            begin = round((part.start_s - first_s) * _RATE)
            for place, value in enumerate(
                self._vibrate(part) if isinstance(part, Vibration) else self._follow(part), begin
            ):
                um[place] += value
        um = self._at_speed(um, first_s)
        made = motions.pattern(
            dict.fromkeys(motors, um), _RATE, start=first_s, motors=self.array.motors, most_um=self.travel_um
        )
        self._waves += made["wave"]

    def _vibrate(self, part: Vibration) -> Iterable[float]:
        """Samples of a vibration: from rest up and back, times its amplitude."""
        cycles = 0.0
        amplitude, frequency = _Reader(part.amplitude), _Reader(part.frequency)
        for place in range(round(part.duration_s * _RATE) + 1):
            at_s = place / _RATE
            hz = frequency(at_s)
            left_s = max(0.0, part.duration_s - at_s)
            edge = 1.0 if part.is_tap else min(1.0, at_s / part.edge_s, left_s / part.edge_s)
            um = amplitude(at_s) * self._amplitude(part, hz)
            yield edge * um * (1 + _SIGNALS[part.signal](cycles % 1)) / 2
            cycles += hz / _RATE

    def _follow(self, part: Curve) -> Iterable[float]:
        """Samples of a curve. Its lowest point is at rest if it goes below 0."""
        lowest = min(0.0, min(um for _, um in part.points))
        if lowest < 0:
            self.lose(f"curves that go below 0: a pin only goes up, so it is raised by {-lowest:.3g} um for them")
        read = _Reader(part.points, part.is_smooth)
        first = round(part.points[0][0] * _RATE)
        for place in range(round(part.points[-1][0] * _RATE) + 1):
            yield read(place / _RATE) - lowest if place >= first else 0.0

    def _at_speed(self, um: list[float], first_s: float) -> list[float]:
        """The samples as a motor follows them at its speed. The last one is at rest."""
        most = self.speed_um_s / _RATE
        # Samples beyond the travel are refused, so that no pin has farther to go.
        um += [0.0] * math.ceil(min(max(um), self.travel_um) / most)
        at, furthest, since = 0.0, 0.0, 0.0
        for place, wanted in enumerate(um):
            at = min(max(wanted, at - most), at + most)
            if abs(wanted - at) > furthest:
                since, furthest = since if furthest > 1 else first_s + place / _RATE, abs(wanted - at)
            um[place] = at
        if furthest > 1:
            self.lose(
                f"motion faster than the motor's {self.speed_um_s / 1000:.3g} mm/s, from {since:.3g} s on: the pins are up to "
                f"{furthest:.3g} um behind it"
            )
        return um

    def pattern(self, path: str | os.PathLike[str]) -> Imported:
        """The pattern of all that was added."""
        together: dict[tuple[int, ...], list[int]] = {}
        for motor, parts in self._parts.items():
            together.setdefault(tuple(map(id, parts)), []).append(motor)
        try:
            for motors in together.values():
                self._move(self._parts[motors[0]], motors)
        except ValueError as error:
            raise ValueError(f"{os.fspath(path)}: {error}") from error
        if not self._tones and not self._waves:
            raise ValueError(
                f"{os.fspath(path)}: nothing in it that a pin can do" + "".join(f"; {line}" for line in self.lost)
            )
        for signal, (low, hz, um) in self._weak.items():
            mean = abs(math.sin(math.pi * hz * self.window_s) / (math.pi * hz * self.window_s))
            self.lose(
                f"the amplitude of {'vibrations' if signal == 'Sine' else signal + ' vibrations'} of {low:.3g} to {hz:.3g} "
                f"Hz: at {hz:.3g} Hz a motor of {self.speed_um_s / 1000:.3g} mm/s moves by {um:.3g} of {self.amplitude_um:.3g} um, and its "
                f"mean over {1000 * self.window_s:.3g} ms leaves {100 * mean:.0f} % of that"
            )
        made = {"tone": self._tones, "wave": self._waves}
        name = re.sub(r"[^a-z0-9-]+", "-", Path(path).stem.lower()).strip("-")[:64] or "imported"
        keys = {"name": name, **({} if not self.array.raw else {"array": self.array.name})}
        return Imported({**keys, **{key: tables for key, tables in made.items() if tables}}, tuple(self.lost))


class _Reader:
    """Reads points at times that grow, without a search."""

    def __init__(self, points: Points, is_smooth: bool = False) -> None:
        self._points, self._is_smooth, self._next = points, is_smooth, 0

    def __call__(self, at_s: float) -> float:
        points = self._points
        while self._next < len(points) and points[self._next][0] <= at_s:
            self._next += 1
        if self._next == 0:
            return points[0][1]
        if self._next == len(points):
            return points[-1][1]
        (t0, v0), (t1, v1) = points[self._next - 1 : self._next + 1]
        share = (at_s - t0) / (t1 - t0)
        return v0 + (v1 - v0) * (share * share * (3 - 2 * share) if self._is_smooth else share)


# From -1 to 1, over a cycle that begins at the lowest point; jumps are the motor's, at its speed.
_SIGNALS: dict[str, Callable[[float], float]] = {
    "Sine": lambda cycle: -math.cos(2 * math.pi * cycle),
    "Triangle": lambda cycle: 1 - 4 * abs(cycle - 0.5),
    "Square": lambda cycle: -1.0 if cycle < 0.5 else 1.0,
    "SawToothUp": lambda cycle: 2 * cycle - 1,
    "SawToothDown": lambda cycle: 1 - 2 * cycle,
}


def read_json(path: str | os.PathLike[str], kind: str) -> Any:
    """The document in a file. Commas before a closing bracket are left out: Apple's own files have them."""
    text = text_of(path)
    try:
        return json.loads(re.sub(r",(\s*[\]}])", r"\1", text))
    except RecursionError as error:
        raise ValueError(f"{os.fspath(path)} is no {kind} file: its brackets are nested too deeply") from error
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)} is no {kind} file: {error}") from error
