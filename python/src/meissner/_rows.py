"""The rows of recorded plays in tables: one for each stimulus. BIDS and NWB are made from them.

A row has the columns of `meissner session export` that these tables use, and what they make columns from: `labels`, `factors`, `live`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ._labels import exact
from .results import reached_um


def of_play(play: Mapping[str, Any]) -> dict[str, Any]:
    """What the rows of a recorded play have in common; None: not known. The response time is in seconds."""
    receipt, answer = play["receipt"], play["answer"] or {}
    correct, rt_ms = answer.get("correct"), answer.get("rt_ms")
    return {
        "play": receipt["id"],
        "trial": receipt["order"].get("trial"),
        "labels": receipt["order"].get("labels") or {},
        "live": receipt["live"],
        **{key: receipt["device"][key] for key in ("array", "tick_hz")},
        **{f"{which}_edge": (edge or {}).get("number") for which, edge in receipt["edges"].items()},
        **{f"{which}_edge_tick": (edge or {}).get("tick") for which, edge in receipt["edges"].items()},
        "response": exact(answer["response"]) if answer else None,
        "correct": None if correct is None else str(correct).lower(),
        "response_time": None if rt_ms is None else rt_ms / 1000,
        "level": answer.get("level"),
        "factors": answer.get("factors") or {},
    }


def rows(play: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The rows of a recorded play: one for each of its items in the record. A single one ends as the play does, and has no number."""
    receipt, items = play["receipt"], play["receipt"]["items"] or []
    if receipt["order"]["items"] == 1 and items:
        onset = receipt["onset"] and {**receipt["onset"], "tick": receipt["onset"]["actual_tick"]}
        own = {"item": None, "onset": items[0]["onset"] or onset, **{key: receipt[key] for key in ("state", "offset")}}
        items = [{**items[0], **own}]
    return [{**of_play(play), **_stimulus(item, receipt["device"]["tick_hz"])} for item in items]


def _stimulus(item: Mapping[str, Any], tick_hz: int) -> dict[str, Any]:
    onset, offset, trigger = (item[key] or {} for key in ("onset", "offset", "trigger"))
    start, end, pulse = onset.get("tick"), offset.get("tick"), item["first_pulse_tick"]
    later = None if None in (start, pulse) else onset["monotonic_ns"] + round((pulse - start) * 1e9 / tick_hz)
    return {
        **{key: item[key] for key in ("item", "pattern", "pattern_sha256", "scale", "state", "late_strokes")},
        "reached_um": reached_um(item),
        "onset_tick": start,
        **{f"onset_{key}": onset.get(key) for key in ("monotonic_ns", "uncertainty_ns")},
        "played_ms": None if start is None or end is None else (end - start) * 1000 / tick_hz,
        "first_pulse_ns": later,
        "trigger_code": trigger.get("code"),
    }


def stimuli(plays: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows of what began, sorted by onset."""
    began = [row for play in plays for row in rows(play) if row["onset_tick"] is not None]
    return sorted(began, key=lambda row: int(row["onset_monotonic_ns"]))
