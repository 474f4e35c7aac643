"""`check`: whether a plan would stop at the drift limit on a board."""

from __future__ import annotations

from collections.abc import Iterable

from . import _http
from . import _operations as ops
from ._bodies import SequenceItem
from ._operations import Core
from .results import PlanCheck


def check(
    core: Core,
    items: Iterable[SequenceItem],
    *,
    isi: float | None = None,
    soa: float | None = None,
    seconds: float | None = None,
    scale: float | None = None,
) -> PlanCheck:
    """Ask before the first trial whether a study would stop at the drift limit on a board. Nothing is played.

    The arguments are those of `sequence`: give all plays of the study as one list, at most 4096. The daemon follows its estimate of the
    drift of pins without telemetry, from level pins on, also if its own device has telemetry.
    """
    body = {"items": ops.items_of(core, items, isi, soa, seconds, scale)}
    # Compiling long motions takes a while.
    answer = ops.send(core, _http.post("/v1/sequence/check", body, timeout=60.0))
    return PlanCheck.of(core.read(answer))
