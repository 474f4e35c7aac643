"""Labels of trials and sessions, and factors of answers, as columns of a table: one for each key.

Invariant: columns have different names, also without regard to case, whatever the keys are.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

Source = Literal["trial", "session", "answer"]
ABOUT = "A text that a cell cannot hold as it is stands in quotes, as JSON"


def exact(text: str) -> str:
    """A text as the cell of a table, such that different texts make different cells."""
    is_plain = text == text.strip() and text not in ("", "n/a") and not re.search(r'^"|[\x00-\x1f\x7f]|[^\S ]', text)
    return text if is_plain else json.dumps(text)


@dataclass(frozen=True)
class Column:
    """The column of a label or factor."""

    name: str
    key: str
    source: Source

    @property
    def description(self) -> str:
        """What it holds."""
        kind = "Factor" if self.source == "answer" else "Label"
        return f"{kind} {json.dumps(self.key)} of the {self.source}, as the experiment gave it. {ABOUT}"


class Labels:
    """The columns of a session's labels and factors."""

    def __init__(self, session: Mapping[str, Any], rows: list[dict[str, Any]]) -> None:
        self._session: Mapping[str, str] = session["labels"]
        taken: set[str] = set()
        self.columns: list[Column] = []

        def add(prefix: str, source: Source, keys: Iterable[str]) -> None:
            self.columns += [Column(_name(f"{prefix}_{key}", taken), key, source) for key in sorted(set(keys))]

        add("label", "trial", (key for row in rows for key in row["labels"]))
        add("session_label", "session", self._session)
        add("factor", "answer", (key for row in rows for key in row["factors"]))

    def cells(self, row: Mapping[str, Any]) -> dict[str, str | None]:
        """The cells of the columns; None: the trial has no such label or factor."""
        made: dict[str, str | None] = {}
        sources = {"trial": row["labels"], "session": self._session, "answer": row["factors"]}
        for column in self.columns:
            text = sources[column.source].get(column.key)
            made[column.name] = None if text is None else exact(text)
        return made


def _name(text: str, taken: set[str]) -> str:
    """A name like this that no other column has."""
    name = base = re.sub(r"\W+", "_", text)
    number = 1
    while name.casefold() in taken:
        number += 1
        name = f"{base}_{number}"
    taken.add(name.casefold())
    return name
