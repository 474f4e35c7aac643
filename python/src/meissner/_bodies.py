"""The bodies of requests for plays: what the client's arguments become.

Times are seconds in Python and milliseconds in the API.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal, SupportsInt, Union

from ._http import plain
from .clocks import Instant

At = Union[float, Instant, None]
Trigger = Union[Mapping[str, Any], bool, int, None]
Labels = Union[Mapping[str, Any], None]
Verdict = Union[SupportsInt, None]
"""Whether an answer is right: a `bool`, or a kind of NumPy."""
Late = Literal["drop", "abort", None]
Fit = Literal["whole", "cover", None]
Map = Literal["nearest", None]
SequenceItem = Union[str, Mapping[str, Any], None]


def milliseconds(name: str, seconds: Any) -> Any:
    """An argument in seconds as the API has it; None stays None. Raises `TypeError` for what is no number, `ValueError` for NaN and infinity."""
    if seconds is None:
        return None
    seconds = plain(seconds) if hasattr(seconds, "tolist") else seconds
    if isinstance(seconds, bool) or not isinstance(seconds, numbers.Real):
        raise TypeError(f"`{name}` is {seconds!r}: must be a number of seconds, such as 0.1")
    if not math.isfinite(seconds):
        raise ValueError(f"`{name}` is {seconds} s: must be a finite number of seconds, such as 0.1")
    return float(seconds) * 1000


def verdict(correct: Any) -> bool | None:
    """Whether an answer is right. Raises `TypeError` for a text, as `"False"`, which Python takes as true."""
    correct = plain(correct) if hasattr(correct, "tolist") else correct
    if correct is None or correct in (0, 1):
        return None if correct is None else bool(correct)
    raise TypeError(f"`correct` is {correct!r}: must be True, False or None")


def trigger_of(trigger: Trigger) -> Any:
    """A number is short for a code."""
    trigger = plain(trigger) if hasattr(trigger, "tolist") else trigger
    if isinstance(trigger, bool) or trigger is None:
        return trigger
    return {"code": trigger} if isinstance(trigger, int) else dict(trigger)


def texts(labels: Labels) -> dict[str, str] | None:
    return None if labels is None else {whole(str(key)): whole(str(value)) for key, value in labels.items()}


def whole(text: str) -> str:
    """A text in which bytes that a terminal could not read are escaped: JSON and UTF-8 cannot hold them."""
    return text.encode("utf-8", "backslashreplace").decode()


def sequence_items(
    items: Iterable[SequenceItem],
    isi: float | None,
    soa: float | None,
    defaults: dict[str, Any],
    inline: Callable[[dict[str, Any]], dict[str, Any]],
) -> list[dict[str, Any]]:
    """The items as the daemon takes them: times in ms, from the item before or from the sequence's onset.

    `inline` makes a pattern of an item's samples.
    """
    if isi is not None and soa is not None:
        raise ValueError("give `isi` (pause from an item's end) or `soa` (distance of onsets), not both")
    made = []
    for number, item in enumerate(items):
        own = {"pattern": item} if item is None or isinstance(item, str) else dict(item)
        entry = {**defaults, **inline(own)}
        if entry.get("pattern", "") is None:
            # A blank item has no amplitudes.
            entry.pop("scale", None)
        for key in ("gap", "start"):
            if (seconds := entry.pop(key, None)) is not None:
                entry[f"{key}_ms"] = milliseconds(key, seconds)
        if "trigger" in entry:
            entry["trigger"] = trigger_of(entry["trigger"])
        if "gap_ms" not in entry and "start_ms" not in entry:
            if soa is not None:
                entry["start_ms"] = number * milliseconds("soa", soa)
            elif isi is not None and number > 0:
                entry["gap_ms"] = milliseconds("isi", isi)
        made.append({key: value for key, value in entry.items() if value is not None or key == "pattern"})
    return made
