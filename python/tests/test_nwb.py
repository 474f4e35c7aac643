"""A recorded session as an NWB file."""

from __future__ import annotations

import datetime
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner import errors
from test_bids import forget, record

pynwb = pytest.importorskip("pynwb", reason="pynwb is not installed")


def problems(file: Path) -> list[str]:
    """What the official validators find, but for suggestions."""
    from nwbinspector import Importance, inspect_nwbfile

    found = [str(error) for error in pynwb.validate(path=str(file))]
    for message in inspect_nwbfile(nwbfile_path=str(file)):
        if message.importance.value > Importance.BEST_PRACTICE_SUGGESTION.value:
            found.append(f"{message.importance.name}: {message.check_function_name}: {message.message}")
    return found


def test_a_session_becomes_a_file_without_errors(m: meissner.Client, tmp_path: Path) -> None:
    session, play, pair = record(m)
    forget(m)
    file = tmp_path / "P07.nwb"
    file.write_text("of others")
    (tmp_path / "folder.nwb").mkdir()
    refused = [
        (file, False, "is there already.*overwrite=True"),
        (tmp_path / "folder.nwb", True, "cannot be written: name a file"),
        (tmp_path / "none" / "P07.nwb", False, "cannot be written: name a file"),
    ]
    for place, overwrite, why in refused:
        with pytest.raises(errors.MeissnerError, match=why):
            m.export_nwb(session, place, overwrite=overwrite)
    assert file.read_text() == "of others"
    (tmp_path / "folder.nwb").rmdir()
    about: dict[str, Any] = {"subject": {"age": "P30Y", "sex": "F"}, "metadata": {"keywords": ["touch"]}}
    export = m.export_nwb(session, file, overwrite=True, **about)
    m.remove_pattern("mine")
    assert export.file == file
    assert [line for line in export.left_out if "late strokes" not in line] == [
        "the text of mine as played is not kept"
    ]
    assert list(tmp_path.iterdir()) == [file]
    assert problems(file) == []
    with pynwb.NWBHDF5IO(str(file), "r") as io:
        check(io.read(), play, pair)


def check(nwb: Any, play: meissner.Play, pair: meissner.Play) -> None:
    """The table of stimuli has the true times, and the samples are where the stimuli are."""
    assert (nwb.subject.subject_id, nwb.subject.sex, list(nwb.keywords)) == ("P-07", "F", ["touch"])
    assert "simulated motors" in nwb.devices["tactile_display"].description
    assert "frequency_hz = 60.0" in nwb.stimulus_notes
    table = nwb.get_events_table("stimuli")
    assert list(table["pattern"][:3]) == ["pin-60", "mine", "pin-60"]
    assert (table["timestamp"].resolution, table["duration"].resolution) == (1 / 85_000, 1 / 85_000)
    first = list(table.colnames).index("array")
    assert list(table.colnames)[first : first + 2] == ["array", "tick_hz"]
    assert (table["array"][0], table["tick_hz"][0]) == ("tula35-6x4", 85_000)
    times, ticks = table["timestamp"][:], table["onset_tick"][:]
    assert [int(tick) for tick in ticks[:3]] == [
        instant.tick for instant in (play.onset, *(item.onset for item in pair.items)) if instant
    ]
    assert ticks[2] - ticks[1] == 17_000
    # Both times are estimates.
    uncertainty = sum(item.onset.monotonic_uncertainty for item in pair.items if item.onset)
    assert times[2] - times[1] == pytest.approx(0.2, abs=uncertainty + 1e-4)
    onset = nwb.session_start_time + datetime.timedelta(seconds=float(times[0]))
    assert onset.timestamp() == pytest.approx(play.onset.wall, abs=0.1)
    assert table["duration"][0] == pytest.approx((play.offset.tick - play.onset.tick) / 85_000, abs=1e-6)
    assert (table["trial"][0], table["label_block"][0], table["trigger_code"][0]) == (1, "a b", 5)
    assert list(table["label_k_"][:3]) == ["", "v=", "v="]
    assert set(table["session_label_note"]) == {"a;b"}
    check_trials(nwb, play, pair)


def check_trials(nwb: Any, play: meissner.Play, pair: meissner.Play) -> None:
    """A row per play with its answer: a sequence is one trial."""
    trials = nwb.trials.to_dataframe()
    assert list(trials["play"])[:2] == [play.id, pair.id]
    first = trials.iloc[0]
    assert (first["response"], first["correct"], first["response_time"]) == ("left", "true", 0.5125)
    assert (first["level"], first["factor_block"], first["trial"], first["label_block"]) == (0.4, "2", 1, "a b")
    assert trials.iloc[1]["response"] == ""
    length_s = (pair.offset.tick - pair.onset.tick) / 85_000
    assert trials.iloc[1]["stop_time"] - trials.iloc[1]["start_time"] == pytest.approx(
        length_s, abs=pair.onset.monotonic_uncertainty + pair.offset.monotonic_uncertainty + 1e-4
    )


def test_what_is_missing_is_told(m: meissner.Client, tmp_path: Path) -> None:
    about = {"age": "P30Y", "sex": "F"}
    with m.session("P07") as session:
        # In blank items no pin moves.
        m.sequence([None, None], seconds=0.05).wait()
    export = m.export_nwb(session.id, tmp_path / "blanks.nwb")
    assert export.left_out == ("the participant's age, which archives ask for: export with subject={'age': 'P30Y'}",)
    export = m.export_nwb(session.id, tmp_path / "known.nwb", subject=about)
    assert (export.left_out, problems(export.file)) == ((), [])
    assert m.export_bids(session.id, tmp_path).left_out == ()
    with m.session("P07") as session:
        pass
    with pytest.raises(meissner.MeissnerError, match="no stimuli"):
        m.export_nwb(session.id, tmp_path / "empty.nwb")


def test_without_pynwb_the_remedy_is_told() -> None:
    code = "import sys; sys.modules['pynwb'] = None; from meissner import nwb; nwb.needs_pynwb()"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "pip install 'pynwb>=4'" in ended.stderr


def test_a_live_play_is_said_to_have_no_moves_in_the_record(m: meissner.Client, tmp_path: Path) -> None:
    """The participant felt it, so it is a stimulus; what moved is not known, and that is said of each play."""
    with m.session("P07", experiment="live") as session:
        with m.live(drives=[{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 40.0}], trial=1) as live:
            live.set(10, frequency_hz=60.0, amplitude_um=20.0).wait()
        live.answer("felt", correct=True)
        play = m.play("pin-60", 0.05, trial=2)
        play.wait()
    recorded = m.session_plays(session.id)["plays"]
    assert [each["receipt"]["live"] and each["receipt"]["live"]["updates"] for each in recorded] == [1, None]
    said = f"play {live.id} was live: the record has the number of its updates (1), not its moves"
    export = m.export_nwb(session.id, tmp_path / "live.nwb", subject={"age": "P30Y", "sex": "F"})
    assert [line for line in export.left_out if "late strokes" not in line] == [said]
    bids = m.export_bids(session.id, tmp_path / "data")
    assert bids.left_out == (f"{said}: its stim_file is n/a",)
    assert [line.split("\t")[2] for line in bids.events.read_text().splitlines()[1:]] == ["live", "pin-60"]
