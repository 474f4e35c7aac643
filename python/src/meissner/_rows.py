"""The rows of recorded plays in tables: one for each stimulus. BIDS and NWB are made from them.

A row has the columns of `meissner session export` that these tables use, and what they make columns from: `labels`, `factors`, `live`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ._labels import exact
from .results import reached_um


def rows(play: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The rows of a recorded play: one for each of several items that the record has, else one for the play."""
    receipt = play["receipt"]
    order, items = receipt["order"], receipt["items"] or []
    same = {
        "play": receipt["id"],
        "trial": order.get("trial"),
        "labels": order.get("labels") or {},
        "live": receipt["live"],
        "array": receipt["device"]["array"],
        "tick_hz": receipt["device"]["tick_hz"],
        **_edge_cells(receipt["edges"]),
        **_answer_cells(play["answer"] or {}),
    }
    if order["items"] > 1 and items:
        return [{**same, **_stimulus(item, same["tick_hz"])} for item in items]
    onset, lateness = receipt["onset"], receipt["counts"]["lateness"]
    whole = {
        "pattern": receipt["name"],
        "pattern_sha256": receipt["sha256"],
        "onset": onset and {**onset, "tick": onset["actual_tick"]},
        **dict.fromkeys(("scale", "ordered_um", "reached_um", "first_pulse_tick", "trigger")),
        **{key: known for key, known in (items[0] if items else {}).items() if known is not None},
        "item": None,
        "state": receipt["state"],
        "offset": receipt["offset"],
        "late_strokes": sum(lateness[where] for where in ("host", "link", "device")),
    }
    return [{**same, **_stimulus(whole, same["tick_hz"])}]


def stimuli(plays: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows of what began, sorted by onset; without a play of several items of which the record has none."""
    found = [
        row
        for play in plays
        for row in rows(play)
        if row["onset_tick"] is not None and (row["item"] is not None or play["receipt"]["order"]["items"] == 1)
    ]
    return sorted(found, key=lambda row: int(row["onset_monotonic_ns"]))


def _stimulus(item: Mapping[str, Any], tick_hz: int) -> dict[str, Any]:
    """The cells of an item."""
    onset, offset, trigger = item["onset"] or {}, item["offset"] or {}, item["trigger"] or {}
    start, end, pulse = onset.get("tick"), offset.get("tick"), item["first_pulse_tick"]
    return {
        **{key: item[key] for key in ("item", "pattern", "pattern_sha256", "scale", "state", "late_strokes")},
        "reached_um": reached_um(item),
        "onset_tick": start,
        "onset_monotonic_ns": onset.get("monotonic_ns"),
        "onset_uncertainty_ns": onset.get("uncertainty_ns"),
        "played_ms": None if start is None or end is None else (end - start) * 1000 / tick_hz,
        "first_pulse_ns": None
        if start is None or pulse is None
        else onset["monotonic_ns"] + round((pulse - start) * 1e9 / tick_hz),
        "trigger_code": trigger.get("code"),
    }


def _edge_cells(edges: Mapping[str, Any]) -> dict[str, int | None]:
    """The edges of the trigger input that started and stopped the play."""
    keys = {"": "number", "_tick": "tick"}
    return {
        f"{which}_edge{end}": (edges[which] or {}).get(key) for which in ("start", "stop") for end, key in keys.items()
    }


def _answer_cells(answer: Mapping[str, Any]) -> dict[str, Any]:
    """What the participant answered; None: not known. The response time is in seconds."""
    correct, rt_ms = answer.get("correct"), answer.get("rt_ms")
    return {
        "response": exact(answer["response"]) if answer else None,
        "correct": None if correct is None else str(correct).lower(),
        "response_time": None if rt_ms is None else rt_ms / 1000,
        "level": answer.get("level"),
        "factors": answer.get("factors") or {},
    }
