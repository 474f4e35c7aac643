"""Names in a BIDS dataset: the labels of subject, session and task, the run, and which source each label stands for.

A label has letters and digits alone, so `P-07` and `P 07` both become `P07`. The dataset keeps the source: of a subject in a column
of `participants.tsv`, of a session in the sidecars of events. `Names.check` refuses a label that has another source.

Invariant: `check` writes nothing.
"""

from __future__ import annotations

import json
import numbers
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ._labels import exact
from ._text_file import text_of
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
        recorded: Mapping[str, Any],
        task: str | None = None,
        subject: str | None = None,
        session: str | None = None,
        run: int | str | None = None,
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
        for sidecar in sorted((root / self.folder / "beh").glob("*_events.json")):
            known = source(sidecar)
            is_same_file = sidecar.name == Path(self.file).with_suffix(".json").name
            if known is None or known == self.session_id or (self.states_session and not is_same_file):
                continue
            raise BidsConflict(
                f"ses-{self.session} of sub-{self.subject} has the session `{known}`, not `{self.session_id}`: give another "
                + ("`session`, `run` or `task`" if is_same_file else "`session`")
            )

    def _check_subject(self, root: Path) -> None:
        name, own = f"sub-{self.subject}", exact(self.participant)
        known = {row["participant_id"]: row.get(SOURCE) or "n/a" for row in participants(root)[1]}
        if name not in known and not (root / name).exists():
            return
        found = known.get(name, "n/a")
        if found == "n/a":
            if self.participant != self.subject and not self.states_subject:
                raise BidsConflict(
                    f"{name} is in {root}, which does not say of which participant: it may not be `{self.participant}`. If it "
                    f"is, give subject={self.subject!r}; else another `subject`"
                )
        elif found != own:
            raise BidsConflict(
                f"{name} in {root} is the participant `{found}`, not `{self.participant}`: give another `subject`"
            )


def source(sidecar: Path) -> str | None:
    """The session that a sidecar of events is from; None: another program's, or no sidecar that can be read."""
    try:
        about = json.loads(text_of(sidecar))
    except (OSError, ValueError):
        return None
    return about.get(SESSION_SOURCE) if isinstance(about, dict) else None


def participants(root: Path) -> tuple[list[str], list[dict[str, str]]]:
    """The columns and the rows of `participants.tsv`."""
    people = root / "participants.tsv"
    try:
        text = text_of(people) if people.exists() else "participant_id\n"
    except (OSError, ValueError) as error:
        raise BidsConflict(f"{people} cannot be read: {error}") from error
    header, *rows = [line.split("\t") for line in text.splitlines() if line.strip()] or [["participant_id"]]
    if header[0] != "participant_id" or any(len(row) > len(header) for row in rows):
        raise BidsConflict(
            f"{people}: its first column must be `participant_id`, and no row longer than the header: correct it"
        )
    return header, [dict(zip(header, row, strict=False)) for row in rows]


def with_participant(root: Path, names: Names) -> bytes:
    """`participants.tsv` with the subject and its source."""
    header, rows = participants(root)
    if SOURCE not in header:
        header.append(SOURCE)
    name = f"sub-{names.subject}"
    row = next((row for row in rows if row["participant_id"] == name), None)
    if row is None:
        rows.append(row := {"participant_id": name})
    row[SOURCE] = exact(names.participant)
    lines = [header, *([row.get(key) or "n/a" for key in header] for row in rows)]
    return "".join("\t".join(cells) + "\n" for cells in lines).encode()
