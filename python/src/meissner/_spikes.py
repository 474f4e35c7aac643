"""Predicted spikes of a session's stimuli: the program `meissner simulate` computes those of each stimulus by itself, from rest.

The afferents are those of one simulated fingertip, the same for all stimuli. `nwb.py` writes them as units.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .clocks import NS
from .errors import ProgramError
from .program import simulate_pattern
from .traces import ArrayName, as_played, is_blank, unknown


@dataclass(frozen=True)
class Predicted:
    """The spikes of each afferent."""

    afferents: list[tuple[float, float]]
    """Their places, mm; empty: nothing could be predicted."""
    spikes_ns: list[list[int]]
    """The times of each one's spikes, on the recording PC's clock, sorted."""
    problems: list[str]
    """What could not be predicted, one line each."""


def predict(rows: list[dict[str, Any]], texts: Mapping[str, str], array: ArrayName | None) -> Predicted:
    """Predicts the spikes of stimuli. `texts` holds the patterns by SHA-256; `array` is as of `displacement`."""
    afferents: list[tuple[float, float]] = []
    spikes: list[list[int]] = []
    found: dict[tuple[Any, ...], list[list[float]]] = {}
    problems: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "pattern.toml")
        for row in rows:
            if is_blank(row):
                continue
            why, ordered = unknown(row, texts), as_played(row)
            if why is not None or ordered is None:
                problems.append(f"{why}, so it has no predicted spikes")
                continue
            key = (row["pattern_sha256"], row["scale"], *ordered)
            try:
                if key not in found:
                    file.write_text(texts[row["pattern_sha256"]], encoding="utf-8")
                    raw = simulate_pattern(file, row["scale"], *ordered, array)
                    found[key] = raw["spikes_s"]
                    afferents = [(each["x_mm"], each["y_mm"]) for each in raw["afferents"]]
                    spikes = spikes or [[] for _ in afferents]
            except ProgramError as error:
                return Predicted([], [], [*problems, f"no predicted spikes: {error}"])
            for own, times in zip(spikes, found[key], strict=True):
                own += [row["onset_monotonic_ns"] + round(time * NS) for time in times]
    return Predicted(afferents, [sorted(own) for own in spikes], problems)
