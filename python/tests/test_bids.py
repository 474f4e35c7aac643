"""A recorded session as a BIDS dataset."""

from __future__ import annotations

import csv
import gzip
import json
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner import bids, errors, traces

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
    """Removes the text of `mine` as it was played from the session record."""
    for file in (Path(m.core.endpoint.name).parent / "record" / "patterns").glob("*.toml"):
        if 'name = "mine"' in file.read_text():
            file.unlink()


def read(file: Path) -> list[dict[str, str]]:
    with file.open(newline="", encoding="utf-8") as opened:
        return list(csv.DictReader(opened, delimiter="\t", quoting=csv.QUOTE_NONE))


def samples(export: bids.Export) -> tuple[dict[str, Any], list[list[str]]]:
    """The sidecar and the rows of the pins' displacement."""
    assert export.displacement is not None
    sidecar = json.loads(
        export.displacement.with_name(export.displacement.name.replace(".tsv.gz", ".json")).read_text()
    )
    text = gzip.decompress(export.displacement.read_bytes()).decode()
    return sidecar, [line.split("\t") for line in text.splitlines()]


def check_displacement(export: bids.Export, events: list[dict[str, str]]) -> None:
    """Pin 9 moves during the stimuli, as far as the motor model says, and nothing moves else."""
    sidecar, table = samples(export)
    assert (sidecar["SamplingFrequency"], sidecar["StartTime"]) == (1000.0, 0.0)
    assert sidecar["Columns"] == [f"pin_{pin}" for pin in range(24)]
    assert {len(row) for row in table} == {24}
    plain = meissner.displacement("pin-60", 0.1)
    assert plain.motors == (9,)
    # The first stroke, from rest, is larger than the amplitude of a vibration that goes on.
    settled = [row[0] for row in meissner.displacement("pin-60", 0.1, rate_hz=20_000.0).um][600:1800]
    assert max(settled) - min(settled) == pytest.approx(float(events[0]["reached_um"]), rel=0.01)
    mine = meissner.displacement(PATTERN.format("mine", 40.0), 0.05)
    reached = {name: max(row[0] for row in of.um) for name, of in [("pin-60", plain), ("mine", mine)]}
    # The first onset is a sample. The daemon knows the device's rate as well as it knows the device's clock.
    assert [float(row[9]) for row in table[: len(plain.um)]] == pytest.approx([row[0] for row in plain.um], abs=0.5)
    assert all(set(row[:9] + row[10:]) <= {"0", "n/a"} for row in table)
    still = [True] * len(table)
    for event in events:
        first, last = (round(1000 * (float(event["onset"]) + part)) for part in (0.0, float(event["duration"])))
        # The motor's moving average is 4.3 ms long.
        still[max(0, first - 1) : last + 6] = [False] * len(still[max(0, first - 1) : last + 6])
        during = [row[9] for row in table[first + 1 : last - 1]]
        if event["stim_file"] == "n/a":
            assert set(during) == {"n/a"}
        elif float(event["duration"]) > 0.04:
            scale = float(event["scale"])
            assert max(map(float, during)) == pytest.approx(scale * reached[event["trial_type"]], rel=0.1)
    assert {row[9] for row, at_rest in zip(table, still, strict=True) if at_rest} == {"0"}


def test_a_session_becomes_a_dataset(m: meissner.Client, tmp_path: Path) -> None:
    session, play, pair = record(m)
    export = m.export_bids(session, tmp_path)
    name = f"sub-P07_ses-{bids.label(session)}_task-edgedetection_events.tsv"
    assert export.events == tmp_path / "sub-P07" / f"ses-{bids.label(session)}" / "beh" / name
    rows = read(export.events)
    assert [row["trial_type"] for row in rows][:3] == ["pin-60", "mine", "pin-60"]
    assert rows[0]["onset"] == "0.000000000"
    check_displacement(export, rows)
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
        f"play {pair.id}, item 0: its pattern as played is not kept, so its displacement is n/a",
    ]
    check_displacement(export, lost)
    shutil.rmtree(tmp_path / "lost")
    export = m.export_bids(session, tmp_path)
    stimulus = tmp_path / "stimuli" / rows[0]["stim_file"]
    sidecar = json.loads(export.events.with_suffix(".json").read_text())
    assert set(rows[0]) <= set(sidecar)
    assert sidecar["StimulusPresentation"]["SoftwareName"] == "meissner"
    assert sidecar["response"]["HED"] == {"left": "(Agent-action, Participant-response, Label/left)"}
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


def row(play: int, onset_s: float, **keys: Any) -> dict[str, Any]:
    """A row of the session record: `pin` for 0.1 s."""
    made: dict[str, Any] = {
        "play": play,
        "item": None,
        "items_planned": None,
        "pattern": "pin",
        "pattern_sha256": "0" * 64,
        "seconds": 0.1,
        "scale": 1.0,
        "fit": "whole",
        "state": "done",
        "played_ms": 100.0,
        "cut_after_ms": None,
        "late_strokes": 0,
        "onset_tick": round(onset_s * 85_000),
        "offset_tick": round(onset_s * 85_000) + 8_500,
        "onset_monotonic_ns": round(onset_s * 1e9),
        "offset_monotonic_ns": round((onset_s + 0.1) * 1e9),
        "array": "tula35-6x4",
        "tick_hz": 85_000,
        "mapped_from": None,
        "live": None,
    }
    return {**made, **keys}


TEXTS = {"0" * 64: PATTERN.format("pin", 40.0)}


def moves(rows: list[dict[str, Any]], rate_hz: float = 1000.0) -> tuple[dict[int, float | None], list[str]]:
    grid = traces.Grid(bids.stimulus_rows(rows), TEXTS, zero_ns=0, rate_hz=rate_hz)
    found = list(grid)
    assert [index for index, _ in found] == sorted({index for index, _ in found})
    return {index: None if pins is None else pins[9] for index, pins in found}, grid.problems


def test_displacement_follows_the_clock_of_the_pc_and_adds_up() -> None:
    plain = [um for (um,) in meissner.displacement(TEXTS["0" * 64], 0.1).um]
    found, problems = moves([row(1, 1.0), row(2, 2.0005), row(3, 2.1005)])
    assert problems == []
    assert [found[1000 + index] for index in range(len(plain))] == plain
    # Half a sample later.
    fine = [um for (um,) in meissner.displacement(TEXTS["0" * 64], 0.1, rate_hz=2000.0).um]
    assert [found[2001 + index] for index in range(99)] == pytest.approx([fine[1 + 2 * index] for index in range(99)])
    # The end of a stimulus and the begin of the next one overlap.
    assert found[2102] == pytest.approx((fine[203] if len(fine) > 203 else 0.0) + fine[3], abs=2e-3)
    # A device whose clock is 1 % fast plays in less time.
    fast = row(1, 1.0, offset_monotonic_ns=round(1e9 + 0.1e9 / 1.01))
    assert len(moves([fast], 10_000.0)[0]) == pytest.approx(len(moves([row(1, 1.0)], 10_000.0)[0]) / 1.01, abs=2)


def test_displacement_of_stimuli_that_were_cut_lost_or_late() -> None:
    cut, problems = moves([row(1, 1.0, state="stopped", seconds=None, cut_after_ms=50.0, late_strokes=3)])
    whole, _ = moves([row(1, 1.0)])
    assert 0 < len(cut) <= 55 < len(whole)
    assert problems == ["1 stimuli had late strokes, which were not played: the displacement has them"]
    item, _ = moves([row(1, 1.0, item=0, state="cut", played_ms=50.0)])
    assert item == cut
    killed = row(2, 2.0, state="unknown", played_ms=None, offset_monotonic_ns=None, offset_tick=None)
    unknown, problems = moves([killed, row(3, 3.0, pattern_sha256=None)])
    assert unknown == {2000: None} | {3000 + index: None for index in range(100)}
    assert problems == [
        "play 2: its end is missing from the record, so its displacement is n/a",
        "play 3: its pattern as played is not kept, so its displacement is n/a",
    ]
    # In a blank item no pin moves, and that is known.
    blank = row(4, 4.0, pattern_sha256="", offset_monotonic_ns=None, offset_tick=None)
    assert moves([blank]) == ({4000: 0.0}, [])
    with pytest.raises(errors.ProgramError, match=r"displacement` failed: .*has no end"):
        meissner.displacement(
            'format = 1\nname = "x"\n[[drive]]\nmotor = 1\nfrequency_hz = 60.0\namplitude_um = 40.0\n'
        )


def test_without_the_program_there_is_no_displacement(
    m: meissner.Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with m.session("P03") as session:
        m.play("pin-60", 0.05).wait()
    assert m.export_bids(session.id, tmp_path / "none", displacement_hz=None).displacement is None
    monkeypatch.setenv("MEISSNER_PROGRAM", str(tmp_path / "missing"))
    export = m.export_bids(session.id, tmp_path)
    assert export.displacement is None
    assert "no displacement of the pins: MEISSNER_PROGRAM is" in export.left_out[-1]
    assert list(tmp_path.rglob("*_stim*")) == []


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
    export = bids.write(tmp_path, recorded, {}, task=None, zero_host_ns=None, software=None)
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
    bids.write(
        tmp_path,
        {**recorded, "session": session},
        {},
        task=None,
        zero_host_ns=None,
        software=None,
        displacement_hz=None,
    )
    validated(tmp_path)
    (empty_events,) = tmp_path.glob("sub-empty/*/beh/*_events.tsv")
    assert read(empty_events) == []
    assert len(list(tmp_path.glob("sub-Zo7left/ses-*"))) == 2
