"""NWB: writes a recorded session as a file with a table of stimuli, the trials, and the device.

`Client.export_nwb` uses it; it needs `pynwb`: `pip install 'pynwb>=4'`. Times count from the session's start on the
recording PC's clock.

Invariant: a file that is there is replaced only if the caller says so: whole, and once everything was written.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from ._labels import Labels
from ._rows import of_play, stimuli
from ._rows import rows as rows_of
from ._text_file import replacing
from .bids import COLUMNS, losses, not_kept
from .clocks import NS
from .errors import MeissnerError
from .motions import pattern_toml
from .results import Status


def _meaning(about: Mapping[str, Any]) -> str:
    what, mark, none = about["Description"].replace("n/a", "NaN or empty").partition(";")
    return f"{what}{', ' if 'Units' in about else ''}{about.get('Units', '')}{mark}{none}"


_COLUMNS = {
    "pattern": "Name of the vibration pattern",
    "pattern_sha256": "SHA-256 of the pattern's file; empty: not known",
    **{
        name: _meaning(about)
        for name, about in COLUMNS.items()
        if name not in ("onset", "duration", "trial_type", "stim_file")
    },
}


@dataclass(frozen=True)
class Export:
    """What an export has written."""

    file: Path
    left_out: tuple[str, ...]
    """What could not be exported, one line each."""
    plays_missing: int = 0
    """How many plays of the session the record lacks, or has without their end."""


def needs_pynwb() -> Any:
    """The package pynwb."""
    try:
        import pynwb
    except ImportError as error:
        raise ImportError(f"NWB needs the package pynwb: pip install 'pynwb>=4' ({error})") from error
    return pynwb


def check_place(file: Path, overwrite: bool) -> None:
    """Raises `MeissnerError` if a file cannot be written here, or is there and may not be replaced."""
    if not file.parent.is_dir() or (file.exists() and not file.is_file()):
        raise MeissnerError(f"{file} cannot be written: name a file in a folder that is there")
    if file.exists() and not overwrite:
        raise MeissnerError(f"{file} is there already: name another file, or replace it by overwrite=True")


def write(
    file: Path,
    recorded: Mapping[str, Any],
    patterns: Mapping[str, dict[str, Any]],
    *,
    status: Status,
    subject: Mapping[str, Any] | None = None,
    metadata: Mapping[str, Any] | None = None,
    overwrite: bool = False,
) -> Export:
    """Writes a session. `recorded` is as of `session_plays`, `patterns` holds the patterns' keys by SHA-256."""
    pynwb = needs_pynwb()
    check_place(file, overwrite)
    session, rows = recorded["session"], stimuli(recorded["plays"])
    if not rows:
        raise MeissnerError(f"session {session['id']} has no stimuli: there is nothing to export")
    texts = {sha256: pattern_toml(keys) for sha256, keys in patterns.items()}
    left_out = [*losses(recorded), *not_kept(rows, patterns)]
    started = datetime.fromisoformat(session["started"])
    plays = [play for play in recorded["plays"] if play["receipt"]["onset"] is not None]
    plays.sort(key=lambda play: int(play["receipt"]["onset"]["monotonic_ns"]))
    zero_ns = _zero_ns(plays[0], started)
    about = {
        "session_description": f"Tactile stimulation in the experiment {session['experiment'] or 'without a name'}",
        "identifier": session["id"],
        "session_id": session["id"],
        "session_start_time": started,
        "stimulus_notes": "Vibration patterns by SHA-256, frequencies in Hz, amplitudes in um peak to peak.\n\n"
        + "\n".join(f"# {sha256}\n{text}" for sha256, text in texts.items()),
        "was_generated_by": [["meissner", status.raw["daemon"]["version"]]],
        **({} if recorded["complete"] else {"notes": "Incomplete: " + "; ".join(left_out)}),
        **(metadata or {}),
    }
    nwb = pynwb.NWBFile(**about)
    person = {"subject_id": session["participant"], "species": "Homo sapiens", "sex": "U", **(subject or {})}
    nwb.subject = pynwb.file.Subject(**person)
    nwb.add_device(_device(pynwb, rows, status))
    nwb.add_events_table(_table(pynwb, rows, Labels(session, rows), zero_ns))
    _add_trials(nwb, plays, session, zero_ns)
    if "age" not in person and "date_of_birth" not in person:
        left_out.append("the participant's age, which archives ask for: export with subject={'age': 'P30Y'}")
    with replacing(file) as beside, pynwb.NWBHDF5IO(str(beside), "w") as io:
        io.write(nwb)
    return Export(file, tuple(left_out), recorded["plays_missing"])


def _zero_ns(first: Mapping[str, Any], started: datetime) -> int:
    """The session's start on the recording PC's `CLOCK_MONOTONIC`, ns: by the wall clock at the onset of the first play."""
    after_s: float = first["onset_wall_ns"] / NS - started.timestamp()
    onset_ns: int = first["receipt"]["onset"]["monotonic_ns"]
    return onset_ns - round(after_s * NS)


def _device(pynwb: Any, rows: list[dict[str, Any]], status: Status) -> Any:
    names = ", ".join(sorted({row["array"] for row in rows}))
    raw, about = status.raw["device"], f"Piezo pin array {names} for a fingertip"
    if raw is not None:
        kind = "simulated motors" if raw["simulated"] else raw["kind"]
        about += f"; at the export {kind}, firmware {raw['firmware']}, build {raw['build']}"
    return pynwb.device.Device(name="tactile_display", description=about)


def _cell(value: Any, is_number: bool) -> Any:
    if is_number:
        return math.nan if value is None else float(value)
    return "" if value is None else value


def _table(pynwb: Any, rows: list[dict[str, Any]], labels: Labels, zero_ns: int) -> Any:
    """A row per stimulus."""
    always = ("onset_tick", "play", "tick_hz")
    texts = ("pattern", "pattern_sha256", "state", "array", "response", "correct")
    numbers = {"timestamp", "duration", *_COLUMNS} - {*always, *texts}
    meanings = {**_COLUMNS, **{column.name: f"{column.description}; empty: none" for column in labels.columns}}
    columns: dict[str, list[Any]] = {name: [] for name in ("timestamp", "duration", *meanings)}
    for row in rows:
        pulse_ns = row["first_pulse_ns"]
        cells = {
            **{name: row.get(name) for name in _COLUMNS},
            "timestamp": (row["onset_monotonic_ns"] - zero_ns) / NS,
            "duration": math.nan if row["played_ms"] is None else row["played_ms"] / 1000,
            **labels.cells(row),
            "first_pulse": None if pulse_ns is None else (pulse_ns - zero_ns) / NS,
            "onset_uncertainty": row["onset_uncertainty_ns"] / NS,
        }
        for name, cell in cells.items():
            columns[name].append(_cell(cell, name in numbers))
    event, tick_s = pynwb.event, 1 / min(row["tick_hz"] for row in rows)
    times = {
        "timestamp": (event.TimestampVectorData, "Onset, by the recording PC's clock"),
        "duration": (event.DurationVectorData, "From the onset to the end of the last pulse; NaN: not known"),
    }
    made = [
        kind(name=name, description=about, data=columns[name], resolution=tick_s)
        for name, (kind, about) in times.items()
    ]
    made += [
        pynwb.core.VectorData(name=name, description=about, data=columns[name]) for name, about in meanings.items()
    ]
    return event.EventsTable(
        name="stimuli",
        description="Vibration stimuli. The device schedules onsets by its ticks; the daemon maps them to the PC's clock.",
        source_description="Session record of the daemon meissner",
        columns=made,
        colnames=list(columns),
    )


def _add_trials(nwb: Any, plays: list[dict[str, Any]], session: Mapping[str, Any], zero_ns: int) -> None:
    """A row per play, with its answer."""
    plays = [play for play in plays if play["receipt"]["offset"] is not None]
    if not plays:
        return
    labels = Labels(session, list(map(of_play, plays)))
    numbers = ("trial", "response_time", "level", "reached_um")
    about = {
        name: _COLUMNS[name]
        for name in ("play", "trial", "response", "correct", "response_time", "level", "reached_um")
    }
    about |= {column.name: f"{column.description}; empty: none" for column in labels.columns}
    for name, meaning in about.items():
        nwb.add_trial_column(name=name, description=meaning)
    for play in plays:
        receipt, known = play["receipt"], of_play(play)
        reached = [row["reached_um"] for row in rows_of(play) if row["reached_um"] is not None]
        cells = {**known, **labels.cells(known), "reached_um": max(reached, default=None)}
        nwb.add_trial(
            start_time=(receipt["onset"]["monotonic_ns"] - zero_ns) / NS,
            stop_time=(receipt["offset"]["monotonic_ns"] - zero_ns) / NS,
            **{name: _cell(cells[name], name in numbers) for name in about},
        )
