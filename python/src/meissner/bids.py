"""BIDS: writes a recorded session as `events.tsv` with its sidecar, the stimuli, and what a dataset needs around them.

`Client.export_bids` uses it. The files follow BIDS 1.10 for behavioural data (`beh`): onsets in seconds, sorted, and every
column described. What a dataset has already stays: the participant is added. `_bids_names.py` names the files.

Invariants: an export writes the same files for the same session, so that it may be repeated. All files are written beside their
places before the first one takes its place. No file of others is replaced unless the caller says so.
"""

from __future__ import annotations

import contextlib
import json
import platform
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ._bids_names import SESSION_SOURCE, SOURCE, Names, source, with_participant
from ._bids_names import label as label
from ._labels import Labels
from ._rows import stimuli as stimuli_of
from ._text_file import replacing
from .errors import BidsConflict, MeissnerError
from .motions import pattern_toml

VERSION = "1.10.0"
_MOST_LEVELS = 40
"""The most different responses that the sidecar lists."""
COLUMNS: dict[str, dict[str, Any]] = {
    "onset": {"Description": "Onset of the stimulus, from the session's first onset or as asked for", "Units": "s"},
    "duration": {"Description": "From the onset to the end of the last pulse", "Units": "s"},
    "trial_type": {"Description": "Name of the vibration pattern"},
    "stim_file": {"Description": "The pattern, below /stimuli; n/a if its text as played is not kept"},
    "trial": {"Description": "Number of the trial, as the experiment gave it"},
    "scale": {"Description": "Factor of the amplitudes"},
    "reached_um": {
        "Description": "Largest amplitude that a pin reaches, peak to peak, by the motor model: predicted, not measured",
        "Units": "um",
    },
    "first_pulse": {
        "Description": "First pulse of a pin, on the time line of the onsets; n/a: none, or not recorded",
        "Units": "s",
    },
    "state": {
        "Description": "What became of the stimulus",
        "Levels": {
            "done": "played to its end",
            "stopped": "stopped",
            "aborted": "ended because strokes were late",
            "unknown": "its end is missing from the record",
            "played": "an item of a sequence, with every stroke",
            "incomplete": "an item of a sequence, strokes of which were late or refused",
            "cut": "an item of a sequence that ended within it",
        },
    },
    "late_strokes": {"Description": "Number of strokes that came late and were left out"},
    "trigger_code": {"Description": "Code of the trigger output; n/a: one pulse, or nothing"},
    "onset_tick": {"Description": "Onset on the device's clock, ticks"},
    "onset_uncertainty": {"Description": "Uncertainty of the onset against the recording PC's clock", "Units": "s"},
    "play": {"Description": "Number of the play in the session record"},
    "item": {"Description": "Number of the item in its sequence, from 0; n/a: a play of one pattern"},
    "array": {"Description": "Name of the array of pins"},
    "tick_hz": {"Description": "Ticks of the device's clock a second", "Units": "Hz"},
    "start_edge": {
        "Description": "Number of the edge of the trigger input after which the play began; n/a: it waited for none"
    },
    "start_edge_tick": {"Description": "When that edge came on the device's clock, ticks"},
    "stop_edge": {"Description": "Number of the edge of the trigger input that stopped the play; n/a: none did"},
    "stop_edge_tick": {"Description": "When that edge came on the device's clock, ticks"},
    "response": {"Description": "What the participant answered; n/a: no answer was recorded"},
    "correct": {
        "Description": "Whether the answer is right",
        "Levels": {"true": "right", "false": "wrong"},
    },
    "response_time": {
        "Description": "Response time, as the experiment measured it; of keys and button boxes from the onset of the play",
        "Units": "s",
    },
    "level": {"Description": "Level of the stimulus, as the experiment gave it with the answer"},
}


@dataclass(frozen=True)
class Export:
    """What an export has written."""

    events: Path
    """The file of events."""
    stimuli: dict[str, str]
    """The patterns by SHA-256, and their files below `stimuli`."""
    left_out: tuple[str, ...]
    """What could not be exported, one line each."""
    plays_missing: int = 0
    """How many plays of the session the record lacks, or has without their end."""


def write(
    root: Path,
    recorded: Mapping[str, Any],
    patterns: Mapping[str, dict[str, Any]],
    *,
    zero_host_ns: int | None = None,
    software: tuple[int, str] | None = None,
    overwrite: bool = False,
    **named: Any,
) -> Export:
    """Writes a session. `recorded` is as of `session_plays`, `patterns` holds the patterns' keys by SHA-256, and
    `named` is as of `Names.of`.

    Raises `BidsConflict`, and writes nothing, if a name of it stands for something else in the dataset, or if a file is in the way.
    """
    rows = stimuli_of(recorded["plays"])
    labels = Labels(recorded["session"], rows)
    names = Names.of(recorded["session"], **named)
    names.check(root)
    texts = {sha256: pattern_toml(keys) for sha256, keys in patterns.items()}
    stimuli = {sha256: f"{keys['name']}_{sha256[:8]}.toml" for sha256, keys in patterns.items()}
    zero = zero_host_ns if zero_host_ns is not None else (rows[0]["onset_monotonic_ns"] if rows else 0)
    left_out = losses(recorded) + [f"{line}: its stim_file is n/a" for line in not_kept(rows, patterns)]
    merged = _dataset(root, names)
    events = root / names.folder / "beh" / names.file
    columns = [*COLUMNS, *(column.name for column in labels.columns)]
    sources = {"MeissnerParticipant": names.participant, SESSION_SOURCE: names.session_id}
    about = {"TaskName": names.task_name, **sources, **_incomplete(recorded)}
    made: dict[Path, bytes] = {root / "stimuli" / stimuli[sha256]: text.encode() for sha256, text in texts.items()}
    sidecar = {**about, **_sidecar(rows, labels, software)}
    made[events.with_suffix(".json")] = _json(sidecar)
    made[events] = _tsv(columns, [{**_event(row, zero, stimuli), **labels.cells(row)} for row in rows])
    files = {**merged, **made}
    changed = {file: data for file, data in files.items() if not _holds(file, data)}
    if not overwrite:
        is_own = source(events.with_suffix(".json")) == names.session_id
        of_others = [file for file in changed if file not in merged and not (is_own and file.parent == events.parent)]
        _check_foreign(of_others)
    writers: dict[Path, Callable[[Path], object]] = {
        file: lambda beside, data=data: beside.write_bytes(data)  # type: ignore[misc]
        for file, data in changed.items()
    }
    _write_all(root, writers)
    return Export(events, stimuli, tuple(left_out), recorded["plays_missing"])


def _holds(file: Path, data: bytes) -> bool:
    """Whether a file has this content already."""
    try:
        return file.read_bytes() == data
    except OSError:
        return False


def _check_foreign(files: list[Path]) -> None:
    """Raises `BidsConflict` if one of these files is there."""
    there = [str(file) for file in files if file.exists()]
    if there:
        raise BidsConflict(
            f"{', '.join(there)}: not from an export of this session, or changed since: give another `session`, `run` or `task`, "
            "or overwrite=True to replace it; nothing was written"
        )


def _write_all(root: Path, writers: Mapping[Path, Callable[[Path], object]]) -> None:
    """Writes files: all of them beside their places first."""
    try:
        with contextlib.ExitStack() as stack:
            for file, write in reversed(list(writers.items())):
                file.parent.mkdir(parents=True, exist_ok=True)
                write(stack.enter_context(replacing(file)))
    except OSError as error:
        raise MeissnerError(
            f"{root} cannot be written ({error.strerror}: {error.filename or root}): export again; what was there is whole"
        ) from error


def losses(recorded: Mapping[str, Any]) -> list[str]:
    """What the session record itself lacks, one line each."""
    bounded = recorded["left_out"]
    left_out = (
        [f"{bounded} entries of the record about commands and the device, because of its bound"] if bounded else []
    )
    return [*recorded["problems"], *recorded["missing"], *left_out]


def _incomplete(recorded: Mapping[str, Any]) -> dict[str, Any]:
    """What the sidecar says of a session that is not recorded completely."""
    if recorded["complete"]:
        return {}
    told = {"PlaysMissing": recorded["plays_missing"], "EntriesLost": recorded["lost"]}
    return {"Incomplete": {"Missing": losses(recorded), **told}}


def not_kept(rows: list[dict[str, Any]], patterns: Mapping[str, Any]) -> list[str]:
    """Of which stimuli the pattern as it was played is not kept, one line each. A blank item, as in a catch trial, has none."""
    lines = (
        f"play {row['play']} was live: the record has the number of its updates ({row['live']['updates']}), not its moves"
        if row["live"]
        else f"the text of {row['pattern']} as played is not kept"
        for row in rows
        if row["pattern_sha256"] not in ("", *patterns)
    )
    return list(dict.fromkeys(lines))


def _event(row: Mapping[str, Any], zero: int, stimuli: Mapping[str, str]) -> dict[str, Any]:
    played, pulse_ns = row["played_ms"], row["first_pulse_ns"]
    return {
        **row,
        "onset": f"{(row['onset_monotonic_ns'] - zero) / 1e9:.9f}",
        "duration": None if played is None else f"{played / 1000:.6f}",
        "trial_type": row["pattern"],
        "stim_file": stimuli.get(row["pattern_sha256"]),
        "first_pulse": None if pulse_ns is None else f"{(pulse_ns - zero) / 1e9:.9f}",
        "onset_uncertainty": f"{row['onset_uncertainty_ns'] / 1e9:.9f}",
    }


def _sidecar(rows: list[dict[str, Any]], labels: Labels, software: tuple[int, str] | None) -> dict[str, Any]:
    columns = {name: dict(meaning) for name, meaning in COLUMNS.items()}
    for column in labels.columns:
        columns[column.name] = {"LongName": column.key, "Description": column.description}
    kinds = sorted({row["pattern"] for row in rows})
    columns["trial_type"]["Levels"] = {kind: f"the pattern {kind}" for kind in kinds}
    said = {str(row["response"]) for row in rows if row["response"] is not None}
    if 0 < len(said) <= _MOST_LEVELS:
        columns["response"]["Levels"] = {each: f"the answer {each}" for each in sorted(said)}
    presentation = {
        "OperatingSystem": platform.platform(),
        "SoftwareName": "meissner",
        "SoftwareVersion": software[1] if software else "n/a",
        "Code": "n/a",
    }
    return {**columns, "StimulusPresentation": presentation}


def _dataset(root: Path, names: Names) -> dict[Path, bytes]:
    """What a dataset needs at its top and lacks, and the participants."""
    about = {
        "Name": "Tactile stimulation by meissner",
        "BIDSVersion": VERSION,
        "DatasetType": "raw",
        "Authors": ["n/a"],
        "License": "n/a",
    }
    meaning = "The participant's pseudonym in the session record of meissner, from which the label comes"
    readme = (
        b"# Tactile stimulation\n\nVibration patterns played under a fingertip by meissner. Each `events.tsv` has a row per stimulus, and its\n"
        b"sidecar describes the columns. `stimuli/` holds the patterns, as text files. Describe the experiment here.\n"
    )
    tops = {
        "dataset_description.json": _json(about),
        "participants.json": _json({SOURCE: {"Description": meaning}}),
        **({} if any(root.glob("[Rr][Ee][Aa][Dd][Mm][Ee]*")) else {"README.md": readme}),
    }
    made = {root / name: data for name, data in tops.items() if not (root / name).exists()}
    made[root / "participants.tsv"] = with_participant(root, names)
    return made


def _json(document: Mapping[str, Any]) -> bytes:
    return (json.dumps(document, indent=2) + "\n").encode()


def _tsv(columns: list[str], rows: list[dict[str, Any]]) -> bytes:
    lines = ["\t".join(columns), *("\t".join(_cell(row[name]) for name in columns) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


def _cell(value: Any) -> str:
    """A value as BIDS has it: no tabs or line ends, `n/a` if it is not known."""
    return "n/a" if value is None or value == "" else re.sub(r"\s", " ", str(value))
