"""Predicted spikes of a session's stimuli: the program `meissner simulate` computes those of each stimulus by itself, from rest.

The afferents stand on a grid, so that a file tells their places. `nwb.py` writes them as units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .clocks import NS
from .errors import ProgramError
from .motions import MOTIONS
from .program import simulate
from .traces import is_blank

PLACES = [(float(x), float(y)) for y in range(-10, 11) for x in range(-7, 8)]
"""The places of the afferents, mm from the array's middle: 1 mm apart, beyond the pins by a receptive field."""
_AFTER_S = 0.1
"""How long a stimulus is observed after its end, s."""
_KEYS = {"motor", "frequency_hz", "amplitude_um", "phase", "start_s", "stop_s"}


@dataclass(frozen=True)
class Predicted:
    """The spikes of each afferent."""

    afferents: list[tuple[float, float]]
    """Their places, mm; empty: nothing could be predicted."""
    spikes_ns: list[list[int]]
    """The times of each one's spikes, on the recording PC's clock, sorted."""
    problems: list[str]
    """What could not be predicted, one line each."""


def predict(rows: list[dict[str, Any]], patterns: Mapping[str, Mapping[str, Any]]) -> Predicted:
    """Predicts the spikes of stimuli. `patterns` holds the patterns' keys by SHA-256."""
    spikes: list[list[int]] = [[] for _ in PLACES]
    found: dict[tuple[Any, ...], list[list[float]]] = {}
    problems: list[str] = []
    for row in rows:
        if is_blank(row):
            continue
        pattern, played_ms = patterns.get(row["pattern_sha256"] or ""), row["played_ms"]
        which = f"play {row['play']}" + ("" if row["item"] is None else f", item {row['item']}")
        if pattern is None or played_ms is None or row["mapped_from"] is not None:
            problems.append(f"{which}: its pattern as played, or its end, is not known, so it has no predicted spikes")
            continue
        if any(pattern.get(kind) for kind in MOTIONS) or any(set(drive) - _KEYS for drive in _set_drives(pattern)):
            problems.append(f"{which}: its pattern has motions, which have no predicted spikes")
            continue
        key = (row["pattern_sha256"], row["scale"], round(played_ms, 3))
        try:
            if key not in found:
                found[key] = _spikes(pattern, row["scale"], played_ms / 1000, row["array"])
        except ProgramError as error:
            return Predicted([], [], [*problems, f"no predicted spikes: {error}"])
        for own, times in zip(spikes, found[key], strict=True):
            own += [row["onset_monotonic_ns"] + round(time * NS) for time in times]
    return Predicted(PLACES, [sorted(own) for own in spikes], problems)


def _set_drives(pattern: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The drives with the keys that are given."""
    return [{key: value for key, value in drive.items() if value is not None} for drive in pattern.get("drive", ())]


def _spikes(pattern: Mapping[str, Any], scale: float, seconds: float, array: str) -> list[list[float]]:
    drives = [
        {
            **drive,
            "amplitude_um": drive["amplitude_um"] * scale,
            "stop_s": min(drive.get("stop_s", seconds), seconds),
        }
        for drive in _set_drives(pattern)
        if drive.get("start_s", 0.0) < seconds
    ]
    afferents = [{"x_mm": x_mm, "y_mm": y_mm} for x_mm, y_mm in PLACES]
    scene = {"array": array, "duration_s": seconds + _AFTER_S, "afferents": afferents, "drives": drives}
    return [list(map(float, times)) for times in simulate(scene).spikes_s]
