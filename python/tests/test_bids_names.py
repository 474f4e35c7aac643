"""Names and labels in exports: one person stays one, and no label can be read in two ways."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner import _exports, bids, errors
from meissner._labels import Labels, exact

SHA256 = 64 * "0"


def stimulus(play: int = 1, labels: dict[str, str] | None = None) -> dict[str, Any]:
    """A play of the session record."""
    instant = {"tick": 85_000 * play, "monotonic_ns": 10**9 * play, "uncertainty_ns": 10_000}
    item = {"item": 0, "pattern": "pin", "pattern_sha256": SHA256, "scale": 1.0, "state": "played", "late_strokes": 0}
    item |= {"ordered_um": 50.0, "reached_um": 40.0, "onset": instant, "offset": instant}
    receipt = {
        "id": play,
        "name": "pin",
        "sha256": SHA256,
        "order": {"items": 1, "labels": labels or {}},
        "state": "done",
        "edges": {"start": None, "stop": None},
        "onset": {**instant, "actual_tick": instant["tick"]},
        "offset": {**instant, "tick": instant["tick"] + 8500},
        "items": [{**item, "trigger": None, "first_pulse_tick": None}],
        "counts": {"lateness": {"host": 0, "link": 0, "device": 0}},
        "device": {"array": "tula35-6x4", "tick_hz": 85_000},
        **dict.fromkeys(("live", "pins")),
    }
    return {"receipt": receipt, "answer": None}


def recorded(
    participant: str = "P07", session: str = "1", experiment: str | None = None, **keys: Any
) -> dict[str, Any]:
    about: dict[str, Any] = {
        "participant": participant,
        "id": session,
        "experiment": experiment,
        "reason": "request",
        "labels": {},
    }
    whole = {"complete": True, "missing": [], "plays_missing": 0, "left_out": 0, "lost": 0}
    return {"session": about, "plays": [stimulus()], "problems": [], "unreadable": 0, **whole, **keys}


def export(root: Path, what: dict[str, Any], task: str | None = None, **names: Any) -> bids.Export:
    return bids.write(root, what, {}, task=task, zero_host_ns=None, software=None, **names)


def table(file: Path) -> list[dict[str, str]]:
    with file.open(newline="", encoding="utf-8") as opened:
        return list(csv.DictReader(opened, delimiter="\t", quoting=csv.QUOTE_NONE))


def contents(root: Path) -> dict[str, bytes]:
    return {str(file.relative_to(root)): file.read_bytes() for file in root.rglob("*") if file.is_file()}


FOUR = ["P07", "P_07", "P-07", "P 07"]


@pytest.mark.parametrize("first", FOUR)
@pytest.mark.parametrize("second", FOUR)
def test_four_participants_are_never_one(tmp_path: Path, first: str, second: str) -> None:
    export(tmp_path, recorded(first, "1"))
    assert table(tmp_path / "participants.tsv") == [{"participant_id": "sub-P07", "meissner_participant": first}]
    before = contents(tmp_path)
    if first == second:
        export(tmp_path, recorded(second, "2"))
        export(tmp_path, recorded(second, "1"))
        assert {name: data for name, data in contents(tmp_path).items() if name in before} == before
        return
    stated: list[dict[str, Any]] = [{}, {"subject": "P07"}, {"subject": "P07", "session": "9", "run": 9}]
    for names in stated:
        with pytest.raises(
            errors.BidsConflict, match=f"is the participant `{first}`, not `{second}`: give another `subject`"
        ):
            export(tmp_path, recorded(second, "2"), **names)
    assert contents(tmp_path) == before
    export(tmp_path, recorded(second, "2"), subject="P07b")
    assert [row["meissner_participant"] for row in table(tmp_path / "participants.tsv")] == [first, second]


@pytest.mark.parametrize(("first", "second"), [("1-12", "11-2"), ("11-2", "1-12")])
def test_two_sessions_are_never_one(tmp_path: Path, first: str, second: str) -> None:
    export(tmp_path, recorded(session=first, experiment="one"))
    before = contents(tmp_path)
    for experiment in ("one", "another"):
        with pytest.raises(errors.BidsConflict, match="give another `session`"):
            export(tmp_path, recorded(session=second, experiment=experiment))
    assert contents(tmp_path) == before
    # Of another participant it is another session.
    export(tmp_path, recorded("P08", second, "one"))
    export(tmp_path, recorded(session=second, experiment="one"), session="second")


def test_sessions_of_one_visit_are_runs(tmp_path: Path) -> None:
    first = export(tmp_path, recorded(session="1"), session="01", run=1)
    assert first.events.name == "sub-P07_ses-01_task-tactile_run-1_events.tsv"
    export(tmp_path, recorded(session="2"), session="01", run="02")
    before = contents(tmp_path)
    for run in (1, "02"):
        with pytest.raises(
            errors.BidsConflict, match=r"has the session `[12]`, not `3`: give another `session`, `run` or `task`"
        ):
            export(tmp_path, recorded(session="3"), session="01", run=run)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("kind", ["subject", "session", "run"])
@pytest.mark.parametrize("value", ["", "P-07", "sub-07", "7 ", "ö", "a/b", 1.5, True, -1])
def test_names_that_are_no_labels_are_refused(tmp_path: Path, kind: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"`{kind}` is "):
        export(tmp_path, recorded(), **{kind: value})
    assert contents(tmp_path) == {}


def test_what_is_in_the_dataset_already_counts(tmp_path: Path) -> None:
    (tmp_path / "participants.tsv").write_text("participant_id\tage\nsub-P07\t30\nsub-P08\t31\n")
    export(tmp_path, recorded("P07", "1"))
    with pytest.raises(errors.BidsConflict, match="does not say of which participant"):
        export(tmp_path, recorded("P-08", "2"))
    export(tmp_path, recorded("P-08", "2"), subject="P08")  # The caller knows.
    with pytest.raises(errors.BidsConflict, match="is the participant `P-08`, not `P08`"):
        export(tmp_path, recorded("P08", "3"))
    (tmp_path / "sub-P09").mkdir()
    with pytest.raises(errors.BidsConflict, match="does not say of which participant"):
        export(tmp_path, recorded("P_09", "4"))
    rows = table(tmp_path / "participants.tsv")
    assert [(row["age"], row["meissner_participant"]) for row in rows] == [("30", "P07"), ("31", "P-08")]
    # A file that names no session is not this session's.
    sidecar = next(tmp_path.rglob("sub-P07*_events.json"))
    sidecar.write_text("{")
    with pytest.raises(errors.BidsConflict, match="not from an export of this session"):
        export(tmp_path, recorded("P07", "1"))
    export(tmp_path, recorded("P07", "1"), overwrite=True)
    assert json.loads(sidecar.read_text())["MeissnerSession"] == "1"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"participant_id\tage\nsub-P01\t30\tleft\n", "no row longer than the header"),
        (b"participant_id\nsub-\xff\n", "is no text in UTF-8"),
        (b"age\tparticipant_id\n30\tsub-P01\n", "must be `participant_id`"),
    ],
)
def test_a_dataset_that_cannot_be_read_stays_as_it_is(tmp_path: Path, text: bytes, says: str) -> None:
    (tmp_path / "participants.tsv").write_bytes(text)
    with pytest.raises(errors.BidsConflict, match=says):
        export(tmp_path, recorded("P02", "1"))
    assert contents(tmp_path) == {"participants.tsv": text}


def test_every_label_has_a_column(tmp_path: Path) -> None:
    trials: list[dict[str, str]] = [
        {"a": "1;b=2"},
        {"a": "1", "b": "2"},
        {"a;b": "x", "a=b": "y", "A b": "=", "plain": "z"},
        {"a": "", "b": "n/a"},
        {"onset": "1=1", "labels": ";", "tab": "a\tb"},
        {"tab": "a b"},
        {"a": '"1;b=2"'},
        {},
    ]
    session = recorded(plays=[stimulus(number, labels) for number, labels in enumerate(trials, 1)])
    session["session"]["labels"] = {"block": "2", "note": "a;b=c", "onset": "x"}
    events = export(tmp_path, session).events
    header = events.read_text().splitlines()[0].split("\t")
    assert len(header) == len({name.casefold() for name in header})
    rows, sidecar = table(events), json.loads(events.with_suffix(".json").read_text())
    assert rows[0]["onset"] == "0.000000000"
    keys = {name: about["LongName"] for name, about in sidecar.items() if name.startswith("label_")}

    def read(row: dict[str, str]) -> dict[str, str]:
        """The labels, from the table and its sidecar alone."""
        found = {}
        for name, key in keys.items():
            if row[name] != "n/a":
                found[key] = json.loads(row[name]) if row[name].startswith('"') else row[name]
        return found

    assert [read(row) for row in rows] == trials
    assert (rows[1]["label_b"], rows[0]["label_b"]) == ("2", "n/a")
    assert {name: rows[-1][name] for name in header if name.startswith("session_label_")} == {
        "session_label_block": "2",
        "session_label_note": "a;b=c",
        "session_label_onset": "x",
    }
    assert set(header) <= set(sidecar)


def test_different_texts_have_different_cells() -> None:
    texts = ["", "n/a", '""', '"n/a"', "a b", "a\tb", "a\nb", "a\u2028b", " a", "a", "a ", '"a"', "ä", "\\t", "\x1b"]
    assert len({exact(text) for text in texts}) == len(texts)
    assert not [text for text in texts if set("\t\n\x1b\u2028") & set(exact(text))]
    assert Labels({"labels": {}}, []).columns == []


MISSING = ["29 of 40 plays are not recorded", "the record lost 31 entries of the session"]


def test_an_incomplete_session_is_exported_on_request_alone(tmp_path: Path) -> None:
    session = recorded(complete=False, missing=MISSING, plays_missing=29, lost=31)
    said = f"session 1 is incomplete: {'; '.join(MISSING)}.*incomplete=True"
    with pytest.raises(errors.IncompleteSession, match=said):
        _exports._complete(session)
    _exports._complete(recorded())
    made = export(tmp_path, session)
    assert made.plays_missing == 29
    assert [line for line in MISSING if line not in made.left_out] == []
    sidecar = json.loads(made.events.with_suffix(".json").read_text())
    assert sidecar["Incomplete"] == {"Missing": MISSING, "PlaysMissing": 29, "EntriesLost": 31}


def test_a_session_that_runs_is_not_exported(m: meissner.Client, tmp_path: Path) -> None:
    with m.session("P07") as session:
        m.play("pin-60", 0.05).wait()
        for write in (m.export_bids, m.export_nwb):
            with pytest.raises(errors.IncompleteSession, match=f"session {session.id} is incomplete"):
                write(session.id, tmp_path / "never")
        assert list(tmp_path.iterdir()) == []
        made = m.export_bids(session.id, tmp_path, subject="07", session="1", run=1, incomplete=True)
    assert made.events.name == "sub-07_ses-1_task-tactile_run-1_events.tsv"
    m.export_bids(session.id, tmp_path, subject="07", session="1", run=1)


@pytest.mark.parametrize("readme", ["README", "readme.TXT"])
def test_a_dataset_of_others_keeps_its_files(tmp_path: Path, readme: str) -> None:
    description = b'{"Name": "Ours", "BIDSVersion": "1.8.0"}'
    kept = {readme: b"kept", "dataset_description.json": description, "participants.json": b"{}"}
    for name, data in kept.items():
        (tmp_path / name).write_bytes(data)
    (tmp_path / "participants.tsv").write_bytes(b"\xef\xbb\xbfparticipant_id\tage\r\nsub-P01\t30")
    export(tmp_path, recorded("P02", "1"))
    after = contents(tmp_path)
    assert {name: data for name, data in after.items() if name in kept} == kept
    assert not [name for name in after if name.casefold().startswith("readme") and name != readme]
    rows = table(tmp_path / "participants.tsv")
    assert [(row["participant_id"], row["age"], row["meissner_participant"]) for row in rows] == [
        ("sub-P01", "30", "n/a"),
        ("sub-P02", "n/a", "P02"),
    ]


EVENTS = "sub-P07/ses-1/beh/sub-P07_ses-1_task-tactile_events"


@pytest.mark.parametrize("name", [EVENTS + ".tsv", EVENTS + ".json"])
@pytest.mark.parametrize("by_session", [None, "1"])
def test_no_file_of_others_is_replaced_unasked(tmp_path: Path, name: str, by_session: str | None) -> None:
    file = tmp_path / name
    file.parent.mkdir(parents=True)
    file.write_text("{}")
    if by_session is not None and name.endswith(".tsv"):
        file.with_suffix(".json").write_text('{"MeissnerSession": "another", "TaskName": "tactile"}')
    before = contents(tmp_path)
    with pytest.raises(errors.BidsConflict, match=r"overwrite=True|has the session `another`"):
        export(tmp_path, recorded())
    assert contents(tmp_path) == before
    if by_session is None:
        export(tmp_path, recorded(), overwrite=True)
        assert len(table(tmp_path / (EVENTS + ".tsv"))) == 1
