"""Server-sent events without input or output: bytes in, events out."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Event:
    """One event of the daemon. The API reference lists the names and their keys."""

    name: str
    """`state`, `queued`, `began`, `ended`, ...; `reconnected` after a gap in which events may be missing."""
    data: dict[str, Any]

    def __getitem__(self, key: str) -> Any:
        return self.data[key]


class EventParser:
    """Takes bytes as they come and returns the events that are complete."""

    def __init__(self) -> None:
        self._rest = b""
        self._name, self._data = "", ""

    def feed(self, data: bytes) -> list[Event]:
        """The events that these bytes complete."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        events = []
        for line in lines:
            text = line.rstrip(b"\r").decode()
            key, _, value = text.partition(":")
            if not text and self._data:
                document = json.loads(self._data)
                events.append(Event(self._name or str(document.get("event", "")), document))
            if not text:
                self._name, self._data = "", ""
            elif key == "event":
                self._name = value.strip()
            elif key == "data":
                self._data += value.strip()
        return events
