"""Names in a BIDS dataset: the labels of subject, session and task, the run, and which source each label stands for.

A label has letters and digits alone, so `P-07` and `P 07` both become `P07`. The dataset keeps the source: of a subject in a column
of `participants.tsv`, of a session and a task in the sidecars of events. `Names.check` refuses a label that has another source.

Invariant: `check` writes nothing.
"""

from __future__ import annotations

import json
import numbers
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ._labels import exact
from .errors import BidsConflict, MeissnerError

SOURCE = "meissner_participant"
"""The column of `participants.tsv`."""
SESSION_SOURCE = "MeissnerSession"
"""The key of a sidecar of events. Those of other programs lack it."""


def label(text: str) -> str:
    """A BIDS label: letters and digits alone."""
    made = re.sub(r"[^A-Za-z0-9]", "", text)
    if not made:
        raise MeissnerError(
            f"`{text}` has no letter or digit: BIDS needs one, so name a `participant` or `task` that has"
        )
    return made


def _stated(kind: str, text: str) -> str:
    """A label that the caller gives."""
    if not isinstance(text, str) or not re.fullmatch("[A-Za-z0-9]+", text):
        raise ValueError(f"`{kind}` is {text!r}: a BIDS label has letters and digits alone, such as '07'")
    return text


def _index(run: int | str) -> str:
    is_number = isinstance(run, numbers.Integral) and not isinstance(run, bool) and run >= 0
    if not is_number and not (isinstance(run, str) and re.fullmatch("[0-9]+", run)):
        raise ValueError(f"`run` is {run!r}: BIDS takes a number, such as 1 or '01'")
    return str(run)


@dataclass(frozen=True)
class Names:
    """What an export is called in its dataset, and the sources of that."""

    participant: str
    session_id: str
    task_name: str
    subject: str
    session: str
    task: str
    run: str | None
    states_subject: bool
    """Whether the caller has given `subject`."""
    states_session: bool

    @staticmethod
    def of(
        recorded: Mapping[str, Any], task: str | None, subject: str | None, session: str | None, run: int | str | None
    ) -> Names:
        """The names of a recorded session. What the caller does not give comes from the record."""
        task_name = task or recorded["experiment"] or "tactile"
        return Names(
            participant=recorded["participant"],
            session_id=recorded["id"],
            task_name=task_name,
            subject=label(recorded["participant"]) if subject is None else _stated("subject", subject),
            session=label(recorded["id"]) if session is None else _stated("session", session),
            task=label(task_name),
            run=None if run is None else _index(run),
            states_subject=subject is not None,
            states_session=session is not None,
        )

    @property
    def folder(self) -> Path:
        """The session's folder in the dataset."""
        return Path(f"sub-{self.subject}", f"ses-{self.session}")

    @property
    def file(self) -> str:
        """The name of the file of events."""
        run = "" if self.run is None else f"_run-{self.run}"
        return f"sub-{self.subject}_ses-{self.session}_task-{self.task}{run}_events.tsv"

    def check(self, root: Path) -> None:
        """Raises `BidsConflict` if a name stands for something else in this dataset."""
        self._check_subject(root)
        self._check_case(root.glob("sub-*"), f"sub-{self.subject}", "subject")
        self._check_case((root / f"sub-{self.subject}").glob("ses-*"), f"ses-{self.session}", "session")
        for sidecar, about in _sidecars(root):
            self._check_task(sidecar, about)
            if sidecar.parent.parent == root / self.folder:
                self._check_session(sidecar, about)

    def _check_subject(self, root: Path) -> None:
        name, source = f"sub-{self.subject}", exact(self.participant)
        header, rows = participants(root)
        known = {row[0]: dict(zip(header, row, strict=False)).get(SOURCE, "n/a") for row in rows}
        self._check_case((Path(each) for each in known), name, "subject")
        if name not in known and not (root / name).exists():
            return
        known_source = known.get(name, "n/a")
        if known_source == "n/a":
            if self.participant != self.subject and not self.states_subject:
                raise BidsConflict(
                    f"{name} is in {root}, which does not say of which participant: it may not be `{self.participant}`. If it "
                    f"is, give subject={self.subject!r}; else another `subject`"
                )
        elif known_source != source:
            raise BidsConflict(
                f"{name} in {root} is the participant `{known_source}`, not `{self.participant}`: give another `subject`"
            )

    def _check_case(self, there: Iterator[Path], name: str, kind: str) -> None:
        for each in there:
            if each.name != name and each.name.casefold() == name.casefold():
                raise BidsConflict(
                    f"{each.name} is in the dataset, and {name} differs in case alone: give another `{kind}`"
                )

    def _check_task(self, sidecar: Path, about: Mapping[str, Any]) -> None:
        found = re.search("_task-([A-Za-z0-9]+)_", sidecar.name)
        if found is None or found[1].casefold() != self.task.casefold() or SESSION_SOURCE not in about:
            return
        if (found[1], about.get("TaskName")) != (self.task, self.task_name):
            raise BidsConflict(
                f"task-{found[1]} in {sidecar.parent} is the task `{about.get('TaskName')}`, not `{self.task_name}`: give another `task`"
            )

    def _check_session(self, sidecar: Path, about: Mapping[str, Any]) -> None:
        known = about.get(SESSION_SOURCE)
        is_same_file = sidecar.name == Path(self.file).with_suffix(".json").name
        if known is None or known == self.session_id or (self.states_session and not is_same_file):
            return
        raise BidsConflict(
            f"ses-{self.session} of sub-{self.subject} has the session `{known}`, not `{self.session_id}`: give another "
            + ("`session`, `run` or `task`" if is_same_file else "`session`")
        )


def _sidecars(root: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    """The sidecars of events for behavioural data."""
    for sidecar in sorted(root.glob("sub-*/ses-*/beh/*_events.json")):
        try:
            about = json.loads(sidecar.read_text(encoding="utf-8-sig"))
        except OSError:
            # A link of git-annex without its file.
            continue
        except ValueError as error:
            raise BidsConflict(f"{sidecar} cannot be read: {error}") from error
        yield sidecar, about if isinstance(about, dict) else {}


_LINE = re.compile(r"([^\r\n]*)(\r\n?|\n|$)")


def _people(root: Path) -> tuple[str, list[tuple[list[str], str]]]:
    """The byte order mark of `participants.tsv`, and its lines: the cells, and the line's end."""
    people = root / "participants.tsv"
    try:
        text = people.read_bytes().decode() if people.exists() else ""
    except UnicodeDecodeError as error:
        raise BidsConflict(f"{people} is no text in UTF-8: save it as UTF-8") from error
    except OSError as error:
        raise BidsConflict(f"{people} cannot be read ({error.strerror}): correct it") from error
    mark = "\ufeff" if text.startswith("\ufeff") else ""
    if not text.removeprefix(mark).strip():
        return mark, [(["participant_id"], "\n")]
    return mark, [(found[1].split("\t"), found[2]) for found in _LINE.finditer(text, len(mark)) if found[0]]


def participants(root: Path) -> tuple[list[str], list[list[str]]]:
    """The columns and the rows of `participants.tsv`, which begin with the participant."""
    people = root / "participants.tsv"
    header, *rows = [cells for cells, _ in _people(root)[1] if "".join(cells).strip()]
    if header[0] != "participant_id":
        raise BidsConflict(f"{people}: its first column is `{header[0]}`, not `participant_id`: correct it")
    long = next((row for row in rows if len(row) > len(header)), None)
    if long is not None:
        raise BidsConflict(
            f"{people}: the row of {long[0]} has {len(long)} cells, the header has {len(header)}: correct it"
        )
    return header, rows


def with_participant(root: Path, names: Names) -> bytes:
    """`participants.tsv` with the subject and its source. What others wrote there stays as it is, to the byte."""
    name, source = f"sub-{names.subject}", exact(names.participant)
    width = len(participants(root)[0])
    mark, lines = _people(root)
    filled = [number for number, (cells, _) in enumerate(lines) if "".join(cells).strip()]
    header, end = lines[filled[0]]
    rows = [lines[number][0] for number in filled[1:]]
    if SOURCE not in header:
        header.append(SOURCE)
        for cells in rows:
            cells += ["n/a"] * (width + 1 - len(cells))
    place = header.index(SOURCE)
    row = next((cells for cells in rows if cells[0] == name), None)
    if row is None:
        row, last = [name], filled[-1]
        lines[last] = (lines[last][0], lines[last][1] or end or "\n")
        lines.insert(last + 1, (row, end or "\n"))
    row += ["n/a"] * (len(header) - len(row))
    row[place] = source
    return (mark + "".join("\t".join(cells) + end for cells, end in lines)).encode()
