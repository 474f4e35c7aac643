"""Labels of trials and sessions, and factors of answers, as columns of a table, so that nothing is ambiguous.

The column `labels` joins a trial's labels as `key=value;key=value`. A label whose key or value would make that ambiguous gets a
column of its own, in all rows. The labels of the session and the factors of the answers have a column each.

Invariant: columns have different names, also without regard to case, whatever the keys are.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

_NOT_JOINED = re.compile(r'[;="\x00-\x1f\x7f]|[^\S ]')
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
    source: Literal["trial", "session", "answer"]

    @property
    def description(self) -> str:
        """What it holds."""
        kind = "Factor" if self.source == "answer" else "Label"
        return f"{kind} {json.dumps(self.key)} of the {self.source}, as the experiment gave it. {ABOUT}"


class Labels:
    """Which labels of a session's rows have columns of their own."""

    def __init__(self, session: Mapping[str, Any], rows: list[dict[str, Any]]) -> None:
        self._session: Mapping[str, str] = session.get("labels") or {}
        texts: dict[str, list[str]] = {}
        for row in rows:
            for key, value in row["labels"].items():
                texts.setdefault(key, [key]).append(value)
        own = [key for key, found in sorted(texts.items()) if any(_NOT_JOINED.search(text) for text in found)]
        self._own = frozenset(own)
        taken: set[str] = set()
        factors = sorted({key for row in rows for key in _factors(row)})
        self.columns = [Column(_name(f"label_{key}", taken), key, "trial") for key in own]
        self.columns += [Column(_name(f"session_label_{key}", taken), key, "session") for key in sorted(self._session)]
        self.columns += [Column(_name(f"factor_{key}", taken), key, "answer") for key in factors]

    def joined(self, row: Mapping[str, Any]) -> str:
        """The cell of the column `labels`."""
        return ";".join(f"{key}={value}" for key, value in sorted(row["labels"].items()) if key not in self._own)

    def cells(self, row: Mapping[str, Any]) -> dict[str, str | None]:
        """The cells of the other columns; None: the trial has no such label or factor."""
        made: dict[str, str | None] = {}
        sources = {"trial": row["labels"], "session": self._session, "answer": _factors(row)}
        for column in self.columns:
            text = sources[column.source].get(column.key)
            made[column.name] = None if text is None else exact(text)
        return made


def _factors(row: Mapping[str, Any]) -> Mapping[str, str]:
    # An older daemon has no answers.
    factors: Mapping[str, str] = (row.get("answer") or {}).get("factors") or {}
    return factors


def _name(text: str, taken: set[str]) -> str:
    """A name like this that no other column has."""
    name = base = re.sub(r"\W+", "_", text)
    number = 1
    while name.casefold() in taken:
        number += 1
        name = f"{base}_{number}"
    taken.add(name.casefold())
    return name
