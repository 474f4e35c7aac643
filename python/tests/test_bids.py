"""A recorded session as a BIDS dataset."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner import bids

PATTERN = 'format = 1\nname = "{}"\nduration_s = 0.1\n[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = {}\nphase = 0.25\n'


def record(m: meissner.Client) -> tuple[str, meissner.Play, meissner.Play]:
    """A session with a play, a sequence, a play that was stopped, and a pattern that changes afterwards."""
    m.store_pattern("mine", PATTERN.format("mine", 40.0), replace=True)
    with m.session("P-07", experiment="edge detection") as session:
        play = m.play("pin-60", 0.1, trial=1, labels={"block": "a b"}, trigger=5)
        play.wait()
        pair = m.sequence(["mine", {"pattern": "pin-60", "scale": 0.5}], seconds=0.05, soa=0.2, trial=2)
        pair.wait()
        m.play("pin-60", endless=True)
        m.stop()
    m.store_pattern("mine", PATTERN.format("mine", 50.0), replace=True)
    return session.id, play, pair


def read(file: Path) -> list[dict[str, str]]:
    with file.open(newline="", encoding="utf-8") as opened:
        return list(csv.DictReader(opened, delimiter="\t", quoting=csv.QUOTE_NONE))


def test_a_session_becomes_a_dataset(m: meissner.Client, tmp_path: Path) -> None:
    session, play, pair = record(m)
    export = m.export_bids(session, tmp_path)
    name = f"sub-P07_ses-{bids.label(session)}_task-edgedetection_events.tsv"
    assert export.events == tmp_path / "sub-P07" / f"ses-{bids.label(session)}" / "beh" / name
    rows = read(export.events)
    assert [row["trial_type"] for row in rows][:3] == ["pin-60", "mine", "pin-60"]
    assert rows[0]["onset"] == "0.000000000"
    assert float(rows[1]["onset"]) == pytest.approx((pair.onset.host_ns - play.onset.host_ns) / 1e9, abs=1e-4)
    assert int(rows[2]["onset_tick"]) - int(rows[1]["onset_tick"]) == 17_000
    assert float(rows[0]["duration"]) == pytest.approx((play.offset.tick - play.onset.tick) / 85_000, abs=1e-6)
    assert (rows[0]["trial"], rows[0]["labels"], rows[0]["trigger_code"], rows[0]["item"]) == (
        "1",
        "block=a b",
        "5",
        "n/a",
    )
    assert [row["item"] for row in rows[1:3]] == ["0", "1"]
    # The pattern that has changed is not passed off as the one that was played.
    assert rows[1]["stim_file"] == "n/a"
    assert export.left_out == ("the pattern mine has changed since: its stim_file is n/a",)
    stimulus = tmp_path / "stimuli" / rows[0]["stim_file"]
    sidecar = json.loads(export.events.with_suffix(".json").read_text())
    assert set(rows[0]) <= set(sidecar)
    assert sidecar["StimulusPresentation"]["SoftwareName"] == "meissner"
    text = stimulus.read_text().replace('"pin-60"', '"copied"')
    m.store_pattern("copied", text, replace=True)
    assert m.pattern("copied")["pattern"]["drive"] == m.pattern("pin-60")["pattern"]["drive"]
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    m.export_bids(session, tmp_path, zero=None)
    assert before == {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    for zero in (play.onset.later(-2.0), play.onset.monotonic - 2.0):
        m.export_bids(session, tmp_path, task="other", zero=zero)
        moved = read(export.events.with_name(name.replace("edgedetection", "other")))
        assert float(moved[0]["onset"]) == pytest.approx(2.0, abs=1e-3)
    for each in ("mine", "copied"):
        m.remove_pattern(each)


def test_a_dataset_that_is_there_keeps_its_files(m: meissner.Client, tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("kept")
    (tmp_path / "participants.tsv").write_text("participant_id\tage\nsub-P01\t30\n")
    with m.session("P02") as session:
        m.play("pin-60", 0.05).wait()
    m.export_bids(session.id, tmp_path)
    assert (tmp_path / "README.md").read_text() == "kept"
    assert (tmp_path / "participants.tsv").read_text() == "participant_id\tage\nsub-P01\t30\nsub-P02\tn/a\n"
    assert next(tmp_path.rglob("*_events.tsv")).name.endswith("_task-tactile_events.tsv")


def test_losses_are_told(tmp_path: Path) -> None:
    session: dict[str, Any] = {"participant": "P", "id": "1", "experiment": None}
    recorded = {"session": session, "plays": [], "problems": ["a line"], "lost": 3, "unreadable": 1}
    export = bids.write(tmp_path, recorded, {}, task=None, zero_host_ns=None, software=None)
    assert export.left_out == ("a line", "the session record lost 3 entries during the session")
    assert bids._cell("a\tb\n") == "a b "
    with pytest.raises(meissner.MeissnerError, match="BIDS needs one"):
        bids.label("--")


@pytest.mark.skipif(shutil.which("bids-validator-deno") is None, reason="bids-validator-deno is not installed")
def test_the_official_validator_finds_no_error(m: meissner.Client, tmp_path: Path) -> None:
    session, _, _ = record(m)
    m.export_bids(session, tmp_path)
    m.remove_pattern("mine")
    command = ["bids-validator-deno", "--json", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    report = json.loads(ended.stdout)
    found = [issue for issue in report["issues"]["issues"] if issue["severity"] == "error"]
    assert found == [], json.dumps(found, indent=1)
    assert ended.returncode == 0
