"""The bodies of requests for plays: what the client's arguments become.

Times are seconds in Python and milliseconds in the API.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal, SupportsInt, Union

from ._arguments import listed, meant, number, plain, table
from .clocks import Instant

At = Union[float, Instant, None]
Trigger = Union[Mapping[str, Any], bool, int, None]
Labels = Union[Mapping[str, Any], None]
Verdict = Union[SupportsInt, None]
"""Whether an answer is right: a `bool`, or a kind of NumPy."""
Late = Literal["drop", "abort", None]
Fit = Literal["whole", "cover", None]
ITEM_KEYS = ("pattern", "seconds", "scale", "gap", "start", "trigger", "samples", "rate", "drives", "pattern_sha256")
SequenceItem = Union[str, Mapping[str, Any], None]


def milliseconds(name: str, seconds: Any) -> Any:
    """An argument in seconds as the API has it; None stays None. Raises `TypeError` for what is no number, `ValueError` for NaN and infinity."""
    return None if seconds is None else number(name, seconds, " of seconds, such as 0.1") * 1000


def verdict(correct: Any) -> bool | None:
    """Whether an answer is right. Raises `TypeError` for a text, as `"False"`, which Python takes as true."""
    correct = plain(correct)
    if correct is None or correct in (0, 1):
        return None if correct is None else bool(correct)
    raise TypeError(f"`correct` is {correct!r}: must be True, False or None")


def trial_number(trial: Any) -> Any:
    """The number of a trial; None stays None."""
    if hasattr(trial, "factors"):
        raise TypeError(f"`trial` is {trial!r}: must be its number, `trial.number`")
    return trial


def trigger_of(trigger: Trigger) -> Any:
    """A number is short for a code."""
    trigger = plain(trigger)
    if isinstance(trigger, bool) or trigger is None:
        return trigger
    return (
        {"code": trigger} if isinstance(trigger, int) else table("trigger", trigger, "{'code': 7}; or a code, or False")
    )


def texts(labels: Labels, name: str = "labels") -> dict[str, str] | None:
    if labels is None:
        return None
    return {whole(str(key)): whole(str(value)) for key, value in table(name, labels, "{'block': 2}").items()}


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
    isi_ms, soa_ms = milliseconds("isi", isi), milliseconds("soa", soa)
    for place, item in enumerate(listed("items", items, "['pin-60', 'edge-45']")):
        if not (item is None or isinstance(item, (str, Mapping))):
            raise TypeError(f"`items[{place}]` is {item!r}: must be a pattern's name, a dict with `pattern`, or None")
        own = {"pattern": item} if item is None or isinstance(item, str) else dict(item)
        for key in own:
            if key not in ITEM_KEYS and (right := meant(str(key).removesuffix("_ms"), ITEM_KEYS)):
                raise ValueError(f"`items[{place}]` has no key `{key}`: did you mean `{right}`?")
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
                entry["start_ms"] = place * soa_ms
            elif isi is not None and place > 0:
                entry["gap_ms"] = isi_ms
        made.append({key: value for key, value in entry.items() if value is not None or key == "pattern"})
    return made
