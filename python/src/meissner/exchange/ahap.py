"""Apple Haptic Audio Patterns: `from_ahap` makes a pattern of an AHAP file, which phones play.

An AHAP file has taps (`HapticTransient`) and vibrations (`HapticContinuous`) of an intensity and a sharpness, 0 to 1, and parameters
that change them over time. Sharpness becomes frequency; intensity becomes amplitude.
"""

from __future__ import annotations

import bisect
import os
from collections.abc import Iterable, Mapping
from typing import Any

from ..arrays import Array
from .imported import Imported, Motors, Pins, Points, Vibration, number, read_json, time_of, value_at

_DEFAULT = 0.5
_STEP_S = 0.001
"""How long a parameter takes for a step."""
_KNOWN = {"HapticIntensity", "HapticSharpness"}


def from_ahap(
    path: str | os.PathLike[str],
    *,
    motors: Motors = None,
    array: Array | None = None,
    amplitude_um: float = 40.0,
    frequency_hz: tuple[float, float] = (40.0, 120.0),
) -> Imported:
    """A pattern of an AHAP file.

    `motors` play it together: all of the array unless given. `array` is `m.array`; without it the paper's. `amplitude_um` is the
    amplitude of intensity 1, µm peak to peak, and `frequency_hz` the frequencies of sharpness 0 and 1, with equal ratios between: pins
    reach lower ones than a phone. Raises `ValueError` for a file that is no AHAP, and if nothing of it can be played.
    """
    low, high = frequency_hz
    if not 1 <= low <= high <= 300:
        raise ValueError(f"`frequency_hz` is {low:g} to {high:g}: must be from 1 to 300, the lower one first")
    pins = Pins(array, amplitude_um)
    chosen = pins.motors(motors, 0)
    document = read_json(path, "AHAP")
    entries = document.get("Pattern") if isinstance(document, Mapping) else None
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise ValueError(f"{os.fspath(path)} is no AHAP file: it has no list `Pattern`")
    try:
        intensity, sharpness = (
            _controls(entries, "HapticIntensityControl"),
            _controls(entries, "HapticSharpnessControl"),
        )
        played = [
            vibration
            for entry in entries
            if "Event" in entry
            and (vibration := _vibration(entry["Event"], intensity, sharpness, low, high, pins)) is not None
        ]
        pins.add(played, chosen)
    except (TypeError, AttributeError) as error:
        raise ValueError(f"{os.fspath(path)} is no AHAP file: {error}") from error
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)}: {error}") from error
    for entry in entries:
        for name in ("ParameterCurve", "Parameter"):
            control = entry[name].get("ParameterID") if name in entry else None
            if control not in (None, "HapticIntensityControl", "HapticSharpnessControl"):
                pins.lose(f"the parameter {control}")
    if any("Event" in entry for entry in entries):
        pins.lose(f"the phone's frequencies: sharpness 0 to 1 is played at {low:g} to {high:g} Hz")
    return pins.pattern(path)


def _controls(entries: Iterable[Mapping[str, Any]], name: str) -> list[tuple[float, float]]:
    """The values of a dynamic parameter over time: before the first one it changes nothing, and each holds until the next one."""
    controls = [
        (number(control.get("Time"), f"`Time` of a {kind}"), control)
        for entry in entries
        for kind in ("Parameter", "ParameterCurve")
        if (control := entry.get(kind, {})).get("ParameterID") == name
    ]
    points: list[tuple[float, float]] = []
    for start_s, control in sorted(controls, key=lambda each: each[0]):
        given = control.get(
            "ParameterCurveControlPoints", [{"Time": 0.0, "ParameterValue": control.get("ParameterValue")}]
        )
        before = value_at(points, start_s - _STEP_S) if points else 1.0 if "Intensity" in name else 0.0
        added = [(start_s - _STEP_S, before)]
        added += [
            (
                start_s + number(point.get("Time"), "`Time` of a control point"),
                number(point.get("ParameterValue"), "`ParameterValue`"),
            )
            for point in given
        ]
        for point in added:
            bisect.insort(points, point, key=time_of)
    return points


def _vibration(
    event: Mapping[str, Any], intensity: Points, sharpness: Points, low: float, high: float, pins: Pins
) -> Vibration | None:
    """What an event plays."""
    kind = event.get("EventType")
    if kind not in ("HapticTransient", "HapticContinuous"):
        pins.lose(f"events of the type {kind}" + (", which are sounds" if str(kind).startswith("Audio") else ""))
        return None
    start_s = number(event.get("Time"), f"`Time` of a {kind}")
    given: dict[str, float] = {}
    for each in event.get("EventParameters", ()):
        name = each.get("ParameterID")
        if not isinstance(name, str):
            raise ValueError(f"`ParameterID` of a {kind} is {name!r:.40}: must be a name")
        given[name] = number(each.get("ParameterValue"), f"`ParameterValue` of `{name}`")
    for name in sorted(given.keys() - _KNOWN):
        pins.lose(f"`{name}` of events: the ends of vibrations take 20 ms")

    def amplitude_at(at_s: float) -> float:
        share = given.get("HapticIntensity", _DEFAULT) * (value_at(intensity, at_s) if intensity else 1.0)
        return min(max(share, 0.0), 1.0)

    def hertz_at(at_s: float) -> float:
        share = given.get("HapticSharpness", _DEFAULT) + (value_at(sharpness, at_s) if sharpness else 0.0)
        return float(low * (high / low) ** min(max(share, 0.0), 1.0))

    if kind == "HapticTransient":
        hz = hertz_at(start_s)
        return Vibration(start_s, 2 / hz, [(0.0, amplitude_at(start_s))], [(0.0, hz)], is_tap=True)
    duration_s = number(event.get("EventDuration"), "`EventDuration`")
    if duration_s < 0.001:
        pins.lose("vibrations shorter than 1 ms")
        return None

    def over(points: Points, value: Any) -> Points:
        first = bisect.bisect_right(points, start_s, key=time_of)
        times = [at_s for at_s, _ in points[first : bisect.bisect_left(points, start_s + duration_s, key=time_of)]]
        return [(at_s - start_s, value(at_s)) for at_s in (start_s, *times, start_s + duration_s)]

    return Vibration(start_s, duration_s, over(intensity, amplitude_at), over(sharpness, hertz_at))
