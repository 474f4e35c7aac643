"""A recorded session as a BIDS dataset."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner import bids, errors

PATTERN = 'format = 1\nname = "{}"\nduration_s = 0.1\n[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = {}\nphase = 0.25\n'


def record(m: meissner.Client) -> tuple[str, meissner.Play, meissner.Play]:
    """A session with a play, a sequence, a play that was stopped, and a pattern that changes afterwards."""
    # The session record keeps a text once: `forget` removes this one, and no test has it again.
    m.store_pattern("mine", PATTERN.format("mine", 40.0) + f"# {time.time_ns()}\n", replace=True)
    with m.session("P-07", experiment="edge detection", labels={"note": "a;b"}) as session:
        play = m.play("pin-60", 0.1, trial=1, labels={"block": "a b"}, trigger=5)
        play.wait()
        play.answer("left", correct=True, rt_ms=512.5, level=0.4, factors={"block": 2})
        pair = m.sequence(
            ["mine", {"pattern": "pin-60", "scale": 0.5}], seconds=0.05, soa=0.2, trial=2, labels={"k;": "v="}
        )
        pair.wait()
        m.play("pin-60", endless=True)
        m.stop()
    m.store_pattern("mine", PATTERN.format("mine", 50.0), replace=True)
    return session.id, play, pair


def forget(m: meissner.Client) -> None:
    """As if the record had no text of the pattern `mine`, such as of one of more than 16 MiB."""
    for file in (Path(m.core.endpoint.name).parent / "record" / "sessions").glob("*.jsonl"):
        lines = file.read_text().splitlines(keepends=True)
        is_of = ['"event":"pattern"' in line and 'name = \\"mine\\"' in line for line in lines]
        made = [
            re.sub('"sha256":"[0-9a-f]+"', f'"sha256":"{0:064}"', line) if its else line
            for line, its in zip(lines, is_of, strict=True)
        ]
        file.write_text("".join(made))


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
    assert (rows[0]["trial"], rows[0]["label_block"], rows[0]["trigger_code"], rows[0]["item"]) == (
        "1",
        "a b",
        "5",
        "n/a",
    )
    answer = ("response", "correct", "response_time", "level", "factor_block")
    assert [rows[0][name] for name in answer] == ["left", "true", "0.5125", "0.4", "2"]
    # The drives of the pattern begin with a stroke, some ticks after the onset at most.
    assert 0 <= float(rows[0]["first_pulse"]) - float(rows[0]["onset"]) < 0.001
    assert [rows[1][name] for name in answer] == ["n/a"] * 5
    with pytest.raises(errors.MeissnerError, match="is not of a session that runs"):
        play.answer("again")
    assert [row["item"] for row in rows[1:3]] == ["0", "1"]
    assert [row["label_k_"] for row in rows[:3]] == ["n/a", "v=", "v="]
    assert {row["session_label_note"] for row in rows} == {"a;b"}
    # The pattern has changed since; the file has what was played.
    assert "amplitude_um = 40.0" in (tmp_path / "stimuli" / rows[1]["stim_file"]).read_text()
    assert [line for line in export.left_out if "late strokes" not in line] == []
    forget(m)
    export = m.export_bids(session, tmp_path / "lost")
    lost = read(export.events)
    assert lost[1]["stim_file"] == "n/a"
    assert [line for line in export.left_out if "late strokes" not in line] == [
        "the text of mine as played is not kept: its stim_file is n/a",
    ]
    shutil.rmtree(tmp_path / "lost")
    export = m.export_bids(session, tmp_path)
    stimulus = tmp_path / "stimuli" / rows[0]["stim_file"]
    sidecar = json.loads(export.events.with_suffix(".json").read_text())
    assert set(rows[0]) <= set(sidecar)
    assert sidecar["StimulusPresentation"]["SoftwareName"] == "meissner"
    assert sidecar["response"]["Levels"] == {"left": "the answer left"}
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


def test_losses_are_told(tmp_path: Path) -> None:
    session: dict[str, Any] = {"participant": "P", "id": "1", "experiment": None, "labels": {}}
    losses = {
        "complete": False,
        "missing": ["3 entries"],
        "plays_missing": 1,
        "lost": 3,
        "left_out": 2,
        "unreadable": 1,
    }
    recorded = {"session": session, "plays": [], "problems": ["a line"], **losses}
    export = bids.write(tmp_path, recorded, {})
    bounded = "2 entries of the record about commands and the device, because of its bound"
    assert export.left_out == ("a line", "3 entries", bounded)
    assert bids._cell("a\tb\n") == "a b "
    with pytest.raises(meissner.MeissnerError, match="BIDS needs one"):
        bids.label("--")


def validated(root: Path) -> None:
    """Fails if the official validator finds an error."""
    command = ["bids-validator-deno", "--json", str(root)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    report = json.loads(ended.stdout)
    found = [issue for issue in report["issues"]["issues"] if issue["severity"] == "error"]
    assert found == [], json.dumps(found, indent=1)
    assert ended.returncode == 0


NEEDS_VALIDATOR = pytest.mark.skipif(
    shutil.which("bids-validator-deno") is None, reason="bids-validator-deno is not installed"
)


@NEEDS_VALIDATOR
def test_the_official_validator_finds_no_error(m: meissner.Client, tmp_path: Path) -> None:
    session, _, _ = record(m)
    m.export_bids(session, tmp_path)
    m.export_bids(session, tmp_path, subject="other", session="01", run=2)
    m.remove_pattern("mine")
    validated(tmp_path)


@NEEDS_VALIDATOR
@pytest.mark.parametrize("readme", ["README", "README.rst"])
def test_a_valid_dataset_of_others_stays_valid(m: meissner.Client, tmp_path: Path, readme: str) -> None:
    (tmp_path / readme).write_text("A dataset of another lab, described at some length. " * 5)
    (tmp_path / "CHANGES").write_text("1.0.0 2026-01-01\n - Began.\n")
    description = '{"Name": "Ours", "BIDSVersion": "1.8.0", "License": "CC0", "Authors": ["A. Lab"]}'
    (tmp_path / "dataset_description.json").write_text(description)
    (tmp_path / "participants.tsv").write_bytes(b"participant_id\tage\nsub-01\t30\n")
    (tmp_path / "participants.json").write_text('{"age": {"Description": "Age", "Units": "year"}}')
    events = tmp_path / "sub-01" / "beh" / "sub-01_task-rest_events.tsv"
    events.parent.mkdir(parents=True)
    events.write_text("onset\tduration\n0\t1\n")
    events.with_suffix(".json").write_text('{"TaskName": "rest"}')
    validated(tmp_path)
    with m.session("P07") as session:
        play = m.play("pin-60", 0.05, trial=1)
        play.wait()
        play.answer("a\tb\n", correct=True)
    m.export_bids(session.id, tmp_path)
    validated(tmp_path)


@NEEDS_VALIDATOR
def test_odd_sessions_are_valid_datasets(m: meissner.Client, tmp_path: Path) -> None:
    """Odd names and answers, a session without plays, one over midnight, and two of one person."""
    with m.session("Zoë #7 (left)", experiment="bords & coins", labels={"étude": "1/2", "a b": "x;y"}) as odd:
        play = m.play("pin-60", 0.05, labels={"é": '=;"', "n/a": "n/a"})
        play.wait()
        play.answer('"gauche", peut-être', correct=False, factors={"côté": "n/a"})
        m.play("pin-60", 0.05).wait()
    with m.session("Zoë #7 (left)", experiment="bords & coins") as second:
        m.play("pin-60", 0.05).wait()
    with m.session("empty") as empty:
        pass
    for each in (odd, second, empty):
        m.export_bids(each.id, tmp_path)
    recorded = m.session_plays(second.id)
    session = {**recorded["session"], "id": "20261231T225959Z-a1b2c3", "participant": "midnight"}
    session |= {"started": "2026-12-31T23:59:59.5+01:00", "ended": "2027-01-01T00:00:02+01:00"}
    bids.write(tmp_path, {**recorded, "session": session}, {})
    validated(tmp_path)
    (empty_events,) = tmp_path.glob("sub-empty/*/beh/*_events.tsv")
    assert read(empty_events) == []
    assert len(list(tmp_path.glob("sub-Zo7left/ses-*"))) == 2
