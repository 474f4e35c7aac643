"""Names and labels in exports: one person stays one, and no label can be read in two ways."""

from __future__ import annotations

import csv
import errno
import json
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner import _exports, bids, errors
from meissner._labels import Labels, exact


def stimulus(play: int = 1, labels: dict[str, str] | None = None) -> dict[str, Any]:
    """A row of the session record."""
    return {
        "play": play,
        "item": None,
        "items_planned": None,
        "pattern": "pin",
        "pattern_sha256": None,
        "trial": None,
        "labels": labels or {},
        "scale": 1.0,
        "state": "done",
        "played_ms": 100.0,
        "reached_um": 40.0,
        "late_strokes": 0,
        "trigger": None,
        "onset_tick": 85_000 * play,
        "onset_monotonic_ns": 10**9 * play,
        "onset_uncertainty_ns": 10_000,
        **dict.fromkeys(("mapped_from", "first_pulse_tick", "start_edge", "stop_edge", "live", "answer")),
        "array": "tula35-6x4",
        "tick_hz": 85_000,
    }


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


@pytest.mark.parametrize(("first", "second"), [("1-12", "11-2"), ("11-2", "1-12"), ("a-B", "Ab")])
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


@pytest.mark.parametrize(
    ("first", "second"), [("edge detection", "edge-detection"), ("Edges", "edges"), ("tactile", None)]
)
def test_two_tasks_are_never_one(tmp_path: Path, first: str, second: str | None) -> None:
    export(tmp_path, recorded("P01", "1", first))
    if second is None:
        export(tmp_path, recorded("P02", "2", None))
        return
    with pytest.raises(errors.BidsConflict, match=f"is the task `{first}`, not `{second}`: give another `task`"):
        export(tmp_path, recorded("P02", "2", second))
    export(tmp_path, recorded("P02", "2", second), task="another one")


@pytest.mark.parametrize("kind", ["subject", "session", "run"])
@pytest.mark.parametrize("value", ["", "P-07", "sub-07", "7 ", "ö", "a/b", 1.5, True, -1])
def test_names_that_are_no_labels_are_refused(tmp_path: Path, kind: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"`{kind}` is "):
        export(tmp_path, recorded(), **{kind: value})
    assert contents(tmp_path) == {}


def test_what_is_in_the_dataset_already_counts(tmp_path: Path) -> None:
    (tmp_path / "participants.tsv").write_text("participant_id\tage\nsub-P07\t30\nsub-P08\t31\nsub-p10\t32\n")
    export(tmp_path, recorded("P07", "1"))
    with pytest.raises(errors.BidsConflict, match="does not say of which participant"):
        export(tmp_path, recorded("P-08", "2"))
    export(tmp_path, recorded("P-08", "2"), subject="P08")  # The caller knows.
    with pytest.raises(errors.BidsConflict, match="is the participant `P-08`, not `P08`"):
        export(tmp_path, recorded("P08", "3"))
    (tmp_path / "sub-P09").mkdir()
    with pytest.raises(errors.BidsConflict, match="does not say of which participant"):
        export(tmp_path, recorded("P_09", "4"))
    for name in ("P10", "p07"):
        with pytest.raises(errors.BidsConflict, match="differs in case alone"):
            export(tmp_path, recorded(name, "5"))
    rows = table(tmp_path / "participants.tsv")
    assert [(row["age"], row["meissner_participant"]) for row in rows] == [("30", "P07"), ("31", "P-08"), ("32", "n/a")]
    assert set(json.loads((tmp_path / "participants.json").read_text())) == {"meissner_participant"}
    # A file that names no session is not this session's.
    sidecar = next(tmp_path.rglob("sub-P07*_events.json"))
    about = json.loads(sidecar.read_text())
    for key in ("MeissnerSession", "MeissnerParticipant"):
        del about[key]
    sidecar.write_text(json.dumps(about))
    with pytest.raises(errors.BidsConflict, match="not from an export of this session"):
        export(tmp_path, recorded("P07", "1"))
    export(tmp_path, recorded("P07", "1"), overwrite=True)
    assert json.loads(sidecar.read_text())["MeissnerSession"] == "1"
    sidecar.write_text("{")
    with pytest.raises(errors.BidsConflict, match="cannot be read"):
        export(tmp_path, recorded("P07", "1"))


@pytest.mark.parametrize("mark", ["", "\ufeff"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("last", ["", "\n", "\n\n"])
def test_what_others_wrote_of_participants_is_kept_to_the_byte(tmp_path: Path, mark: str, end: str, last: str) -> None:
    text = mark + "participant_id\tname \tnote\n\nsub-P01\t José\t\nsub-P03" + last
    (tmp_path / "participants.tsv").write_bytes(text.replace("\n", end).encode())
    export(tmp_path, recorded("P02", "1"))
    expected = (
        mark
        + "participant_id\tname \tnote\tmeissner_participant\n\nsub-P01\t José\t\tn/a\nsub-P03\tn/a\tn/a\tn/a\n"
        + "sub-P02\tn/a\tn/a\tP02\n"
        + last[1:]
    )
    assert (tmp_path / "participants.tsv").read_bytes() == expected.replace("\n", end).encode()
    before = contents(tmp_path)
    export(tmp_path, recorded("P02", "1"))
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            b"participant_id\tage\nsub-P01\t30\t\nsub-P02\t31\tleft\n",
            "the row of sub-P01 has 3 cells, the header has 2",
        ),
        (b"participant_id\nsub-\xff\n", "is no text in UTF-8"),
        ("participant_id\nsub-P01\n".encode("utf-16"), "is no text in UTF-8"),
        (b"age\tparticipant_id\n30\tsub-P01\n", "its first column is `age`"),
    ],
)
def test_a_list_of_participants_that_cannot_be_read_stays_as_it_is(tmp_path: Path, text: bytes, says: str) -> None:
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


def test_entries_beyond_the_records_bound_are_told(tmp_path: Path) -> None:
    made = export(tmp_path, recorded(complete=True, missing=[], left_out=4))
    assert made.left_out[0] == "4 entries of the record about commands and the device, because of its bound"
    assert "Incomplete" not in json.loads(made.events.with_suffix(".json").read_text())


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


def state(root: Path) -> dict[str, Any]:
    """Everything below a folder: links, folders and files with their bytes and inodes."""
    return {
        str(each.relative_to(root)): (
            each.lstat().st_ino, each.readlink() if each.is_symlink() else each.is_dir() or each.read_bytes()
        )
        for each in root.rglob("*")
    }  # fmt: skip


DESCRIPTION = b'{\r\n\t"Name": "Ours", "BIDSVersion": "1.8.0",\r\n\t"Authors": ["A. Lab"]\r\n}\r\n'


@pytest.mark.parametrize("readme", ["README", "README.md", "README.txt", "README.rst", "readme.TXT", "Readme"])
def test_a_dataset_of_others_keeps_its_files(tmp_path: Path, readme: str) -> None:
    (tmp_path / readme).write_bytes(b"kept")
    (tmp_path / "dataset_description.json").write_bytes(DESCRIPTION)
    (tmp_path / "participants.json").write_bytes(b'\xef\xbb\xbf{"age": {"Units": "year"}}')
    (tmp_path / "participants.tsv").write_bytes(b"participant_id\tage\r\nsub-P01\t30")
    (tmp_path / "participants.tsv").chmod(0o640)
    export(tmp_path, recorded("P02", "1"))
    names = [each.name for each in tmp_path.iterdir()]
    assert [name for name in names if name.casefold().startswith("readme")] == [readme]
    assert [name for name in names if name.startswith(".")] == []
    assert (tmp_path / readme).read_bytes() == b"kept"
    merged = (tmp_path / "dataset_description.json").read_bytes()
    assert merged == DESCRIPTION[:-5] + b',\n  "HEDVersion": "8.3.0"\n}\r\n'
    assert json.loads(merged) == {**json.loads(DESCRIPTION), "HEDVersion": "8.3.0"}
    columns = (tmp_path / "participants.json").read_bytes()
    assert columns.startswith(b'\xef\xbb\xbf{"age": {"Units": "year"},\n  "meissner_participant": ')
    assert set(json.loads(columns.decode("utf-8-sig"))) == {"age", "meissner_participant"}
    assert (tmp_path / "participants.tsv").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    ("version", "has_hed"),
    [("8.0.0", True), (["8.3.0", "sc:score_2.0.0"], True), ("7.2.0", False), ("", False), (None, False)],
)
def test_hed_tags_fit_the_datasets_version(tmp_path: Path, version: Any, has_hed: bool) -> None:
    description = json.dumps({"Name": "Ours", "BIDSVersion": "1.8.0", "HEDVersion": version}).encode()
    (tmp_path / "dataset_description.json").write_bytes(description)
    made = export(tmp_path, recorded())
    assert (tmp_path / "dataset_description.json").read_bytes() == description
    sidecar = made.events.with_suffix(".json").read_text()
    told = any("HEDVersion is not 8" in line for line in made.left_out)
    assert ('"HED"' in sidecar, told) == (has_hed, not has_hed)


LINKS = [
    "participants.tsv",
    "dataset_description.json",
    "participants.json",
    "sub-P07",
    "sub-P07/ses-1",
    "sub-P07/ses-1/beh",
    "sub-P07/ses-1/beh/sub-P07_ses-1_task-tactile_events.tsv",
    "sub-P07/ses-1/beh/sub-P07_ses-1_task-tactile_events.json",
]


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("target", ["there", "missing"])
@pytest.mark.parametrize("link", LINKS)
def test_no_link_is_written_through(tmp_path: Path, link: str, target: str, overwrite: bool) -> None:
    root, annex = tmp_path / "dataset", tmp_path / "annex"
    (root / link).parent.mkdir(parents=True)
    annex.mkdir()
    aim = annex / "object"
    if target == "there":
        aim.write_bytes(b"{}") if link.endswith(".json") else None
        aim.write_bytes(b"participant_id\n") if link.endswith(".tsv") else None
        aim.mkdir() if not link.endswith(("json", "tsv")) else None
    (root / link).symlink_to(aim)
    before = state(tmp_path)
    with pytest.raises(errors.BidsConflict, match=r"is a symbolic link.*(unlock|copy)"):
        export(root, recorded(), overwrite=overwrite)
    assert state(tmp_path) == before


def test_a_link_that_needs_no_change_is_left(tmp_path: Path) -> None:
    """As of a dataset whose files git-annex has locked since the last export."""
    root, annex = tmp_path / "dataset", tmp_path / "annex"
    export(root, recorded())
    annex.mkdir()
    for number, file in enumerate([each for each in root.rglob("*") if each.is_file()]):
        file.rename(annex / str(number))
        file.symlink_to(annex / str(number))
    before = state(tmp_path)
    export(root, recorded())
    assert state(tmp_path) == before
    with pytest.raises(errors.BidsConflict, match="is a symbolic link"):
        export(root, recorded("P08", "2"))
    assert state(tmp_path) == before


EVENTS = "sub-P07/ses-1/beh/sub-P07_ses-1_task-tactile_events"


@pytest.mark.parametrize("name", [EVENTS + ".tsv", EVENTS + ".json"])
@pytest.mark.parametrize("by_session", [None, "1"])
def test_no_file_of_others_is_replaced_unasked(tmp_path: Path, name: str, by_session: str | None) -> None:
    file = tmp_path / name
    file.parent.mkdir(parents=True)
    file.write_text("{}")
    if by_session is not None and name.endswith(".tsv"):
        file.with_suffix(".json").write_text('{"MeissnerSession": "another", "TaskName": "tactile"}')
    before = state(tmp_path)
    with pytest.raises(errors.BidsConflict, match=r"overwrite=True|has the session `another`"):
        export(tmp_path, recorded())
    assert state(tmp_path) == before
    if by_session is None:
        export(tmp_path, recorded(), overwrite=True)
        assert len(table(tmp_path / (EVENTS + ".tsv"))) == 1


@pytest.mark.parametrize("suffix", [".tsv", ".json"])
def test_a_column_that_a_person_has_added_is_not_replaced_unasked(tmp_path: Path, suffix: str) -> None:
    export(tmp_path, recorded())
    file = tmp_path / (EVENTS + suffix)
    text = file.read_text()
    head = (
        text.replace("{", '{\n  "remark": {"Description": "By hand"},', 1) if suffix == ".json" else "remark\t" + text
    )
    file.write_text(head)
    before = state(tmp_path)
    with pytest.raises(errors.BidsConflict, match="overwrite=True"):
        export(tmp_path, recorded())
    assert state(tmp_path) == before
    export(tmp_path, recorded(), overwrite=True)
    assert file.read_text() == text


def test_a_stimulus_that_was_changed_is_not_replaced_unasked(tmp_path: Path) -> None:
    keys = {"format": 1, "name": "pin", "duration_s": 0.1, "drive": []}
    session = recorded(plays=[{**stimulus(), "pattern_sha256": "a" * 64}])

    def write(**more: Any) -> bids.Export:
        return bids.write(tmp_path, session, {"a" * 64: keys}, task=None, zero_host_ns=None, software=None, **more)

    write()
    stimulus_file = tmp_path / "stimuli" / "pin_aaaaaaaa.toml"
    stimulus_file.write_text("mine")
    before = state(tmp_path)
    with pytest.raises(errors.BidsConflict, match="overwrite=True"):
        write()
    assert state(tmp_path) == before
    write(overwrite=True)
    assert 'name = "pin"' in stimulus_file.read_text()


TOP = ["participants.tsv", "dataset_description.json", "participants.json"]
IN_THE_WAY: list[tuple[str, bytes | None, int, str]] = [
    *((name, None, 0o755, "") for name in [*TOP, EVENTS + ".tsv", EVENTS + ".json"]),
    *((name, b"", 0o644, "") for name in ("sub-P07", "sub-P07/ses-1/beh")),
    ("participants.tsv", b"participant_id\n", 0o444, "is read-only"),
    ("dataset_description.json", b"{}", 0o444, "is read-only"),
    *(
        (name, bad, 0o644, ".*correct it")
        for name in TOP[1:]
        for bad in (b"{", b"[]", '{"Name": "é"}'.encode("latin-1"))
    ),
]
"""Names, the content of a file (None: a folder), its mode, and what is said."""


@pytest.mark.parametrize(("name", "content", "mode", "said"), IN_THE_WAY)
def test_what_is_in_the_way_is_told_before_anything_is_written(
    tmp_path: Path, name: str, content: bytes | None, mode: int, said: str
) -> None:
    place = tmp_path / name
    place.parent.mkdir(parents=True, exist_ok=True)
    if content is None:
        place.mkdir()
    else:
        place.write_bytes(content)
    place.chmod(mode)
    before = state(tmp_path)
    with pytest.raises(errors.MeissnerError, match=f"{name.split('/')[-1]} ?{said}"):
        export(tmp_path, recorded(), overwrite=mode == 0o444)
    assert state(tmp_path) == before


@pytest.mark.parametrize("room", range(12))
def test_a_full_disk_leaves_the_dataset_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    """The disk takes so many files, then half of one."""
    root = tmp_path / "dataset"
    export(root, recorded("P01", "1"))
    before, whole, count = state(tmp_path), Path.write_bytes, 0

    def write(path: Path, data: bytes) -> int:
        nonlocal count
        count += 1
        if count > room:
            whole(path, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return whole(path, data)

    monkeypatch.setattr(Path, "write_bytes", write)
    if room >= 3:  # participants.tsv, and the two files of events.
        export(root, recorded("P02", "2"))
        return
    with pytest.raises(errors.MeissnerError, match=r"No space left on device.*nothing was written"):
        export(root, recorded("P02", "2"))
    assert state(tmp_path) == before
    with pytest.raises(errors.MeissnerError, match="nothing was written"):
        export(tmp_path / "new" / "one", recorded("P02", "2"))
    assert state(tmp_path) == before


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for root in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/none")):
        with pytest.raises(errors.MeissnerError, match="nothing was written") as caught:
            export(root, recorded())
        assert "\n" not in str(caught.value)
    assert (tmp_path / "file").read_text() == ""
