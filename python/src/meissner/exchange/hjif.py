"""MPEG haptics (ISO/IEC 23090-31): `from_hjif` makes a pattern of an interchange file, which is JSON.

A file has perceptions, such as vibration or pressure; each has channels, one for each actuator; each has bands, whose effects add up.
A band's effects are vibrations (`VectorialWave`), taps (`Transient`), curves (`Curve`) or wavelets.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from typing import Any

from ..arrays import Array
from .imported import Curve, Imported, Motors, Pins, Points, Vibration, number, read_json

_VIBRATIONS = {"Vibrotactile", "Vibration", "Vibrotactile Texture", "Texture"}
_PRESSES = {"Pressure", "Force", "Kinesthetic", "Position"}
_SIGNALS = {"Sine", "Triangle", "Square", "SawToothUp", "SawToothDown"}
# The reference software plays a tap as two cycles in 22 ms, whatever frequency it names.
_TAP_S, _TAP_CYCLES = 0.022, 2


def from_hjif(
    path: str | os.PathLike[str],
    *,
    motors: Motors = None,
    array: Array | None = None,
    amplitude_um: float = 40.0,
    press_um: float = 200.0,
    highest_hz: float = 120.0,
) -> Imported:
    """A pattern of an `.hjif` file.

    `motors` play all channels together: all of the array unless given. A dict names the motors of each channel, by its place in the
    file from 0. `array` is `m.array`; without it the paper's. `amplitude_um` is the amplitude of 1 in a vibration, µm peak to peak;
    `press_um` the displacement of 1 in a pressure, force or position, µm. Vibrations above `highest_hz` are played at it, because pins
    hardly follow higher ones. Raises `ValueError` for a file that is no `.hjif`, and if nothing of it can be played.
    """
    if not 1 <= highest_hz <= 300:
        raise ValueError(f"`highest_hz` is {highest_hz:g}: must be 1 to 300")
    pins = Pins(array, amplitude_um)
    document = read_json(path, "hjif")
    perceptions = document.get("perceptions") if isinstance(document, Mapping) else None
    if not isinstance(perceptions, list):
        raise ValueError(f"{os.fspath(path)} is no hjif file: it has no list `perceptions`")
    try:
        ticks = number(document.get("timescale", 1000), "`timescale`")
        if ticks <= 0:
            raise ValueError(f"`timescale` is {ticks:g}: must be above 0")
        channel_number = 0
        for perception in perceptions:
            kind = str(perception.get("perception_modality"))
            for channel in perception.get("channels", ()):
                if kind in _VIBRATIONS | _PRESSES:
                    unit_um = amplitude_um / 2 if kind in _VIBRATIONS else press_um
                    reader = _Reader(pins, ticks, number(channel.get("gain", 1.0), "`gain`"), unit_um, highest_hz)
                    library = {effect.get("id"): effect for effect in perception.get("effect_library", ())}
                    parts = [part for band in channel.get("bands", ()) for part in reader.band(band, library)]
                    pins.add(parts, pins.motors(motors, channel_number))
                else:
                    pins.lose(f"perceptions of the kind {kind}")
                channel_number += 1
    except (TypeError, AttributeError, KeyError) as error:
        raise ValueError(f"{os.fspath(path)} is no hjif file: {type(error).__name__}: {error}") from error
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)}: {error}") from error
    if channel_number > 1 and not isinstance(motors, Mapping):
        pins.lose(
            f"the places of {channel_number} channels: the same pins play all; a dict `motors` gives each its own"
        )
    return pins.pattern(path)


class _Reader:
    """Reads the bands of a channel."""

    def __init__(self, pins: Pins, ticks: float, gain: float, unit_um: float, highest_hz: float) -> None:
        self._pins, self._ticks, self._gain, self._unit_um, self._highest_hz = (
            pins,
            ticks,
            abs(gain),
            unit_um,
            highest_hz,
        )

    def band(self, band: Mapping[str, Any], library: Mapping[Any, Mapping[str, Any]]) -> Iterator[Vibration | Curve]:
        """What a band's effects play."""
        kind = band.get("band_type")
        for given in band.get("effects", ()):
            effect = given
            if given.get("effect_type") == "Reference":
                effect = {**library[given["id"]], "position": given.get("position", 0)}
            elif given.get("effect_type", "Basis") != "Basis":
                self._pins.lose(f"effects of the type {given['effect_type']}")
                continue
            start_s = number(effect.get("position", 0), "`position`") / self._ticks
            keyframes = effect.get("keyframes", ())
            if kind == "Transient":
                yield from self._taps(start_s, keyframes)
            elif kind == "VectorialWave":
                yield from self._vibration(start_s, keyframes, str(effect.get("base_signal", "Sine")))
            elif kind == "Curve":
                yield from self._curve(start_s, keyframes, str(band.get("curve_type", "Linear")))
            else:
                self._pins.lose(f"bands of the type {kind}")

    def _points(self, keyframes: Any, key: str) -> Points:
        """The values of keyframes that have one: times, s, which grow."""
        points = [
            (self._after_s(keyframe), number(keyframe[key], f"`{key}`"))
            for keyframe in keyframes
            if keyframe.get(key) is not None
        ]
        return sorted(points, key=lambda point: point[0])

    def _after_s(self, keyframe: Mapping[str, Any]) -> float:
        """The time of a keyframe from its effect's beginning on, s."""
        position = number(keyframe.get("relative_position", 0), "`relative_position`")
        if position < 0:
            raise ValueError(f"`relative_position` is {position:g}: must be 0 or more")
        return position / self._ticks

    def _share(self, amplitude: float) -> float:
        share = self._gain * abs(amplitude)
        if share > 1:
            self._pins.lose("amplitudes above 1 by their gain: they are played as 1")
        return min(share, 1.0)

    def _taps(self, start_s: float, keyframes: Any) -> Iterator[Vibration]:
        for after_s, amplitude in self._points(keyframes, "amplitude_modulation"):
            hz = _TAP_CYCLES / _TAP_S
            yield Vibration(start_s + after_s, _TAP_S, [(0.0, self._share(amplitude))], [(0.0, hz)], is_tap=True)

    def _vibration(self, start_s: float, keyframes: Any, signal: str) -> Iterator[Vibration]:
        frequency = [(at_s, hz) for at_s, hz in self._points(keyframes, "frequency_modulation") if hz > 0]
        amplitude = self._points(keyframes, "amplitude_modulation") or [(0.0, 1.0)]
        last_s = max(map(self._after_s, keyframes), default=0.0)
        if not frequency or last_s < 0.001:
            self._pins.lose("vibrations without a frequency or a duration")
            return
        if signal not in _SIGNALS:
            self._pins.lose(f"the signal {signal}: a sine is played")
            signal = "Sine"
        if max(hz for _, hz in frequency) > self._highest_hz:
            self._pins.lose(
                f"frequencies of up to {max(hz for _, hz in frequency):g} Hz: above {self._highest_hz:g} Hz that is played"
            )
        yield Vibration(
            start_s,
            last_s,
            [(at_s, self._share(value)) for at_s, value in amplitude],
            [(at_s, min(hz, self._highest_hz)) for at_s, hz in frequency],
            signal,
        )

    def _curve(self, start_s: float, keyframes: Any, curve: str) -> Iterator[Curve]:
        points = [
            (at_s, self._gain * value * self._unit_um)
            for at_s, value in self._points(keyframes, "amplitude_modulation")
        ]
        if len(points) < 2:
            self._pins.lose("curves of fewer than two keyframes")
            return
        if curve not in ("Linear", "Cubic"):
            self._pins.lose(f"the form of {curve} curves: they are straight between keyframes")
        yield Curve(start_s, points, is_smooth=curve == "Cubic")
