"""The methods of the client that export a session: to BIDS, and to NWB. Written as `_operations.py` explains."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import bids, nwb
from ._http import Op
from ._operations import Core, pattern, session_plays, status
from .clocks import NS, Instant
from .errors import BadPattern, NotFound


def _stimuli(core: Core, session_id: str) -> Op[tuple[dict[str, Any], dict[str, dict[str, Any]]]]:
    """The rows of a session, and the patterns as they were played, by SHA-256: without those whose text is not kept."""
    recorded = yield from session_plays(core, session_id)
    rows = bids.stimulus_rows(recorded["plays"])
    found = {}
    for name, sha256 in sorted({(row["pattern"], row["pattern_sha256"]) for row in rows if row["pattern_sha256"]}):
        try:
            stored = yield from pattern(core, name, sha256=sha256)
        except (NotFound, BadPattern):
            continue
        # An older daemon knows today's text only.
        if stored["sha256"] == sha256:
            found[sha256] = stored["pattern"]
    return recorded, found


def export_bids(
    core: Core,
    session_id: str,
    root: str | os.PathLike[str],
    *,
    task: str | None = None,
    zero: float | Instant | None = None,
    displacement_hz: float | None = 1000.0,
) -> Op[bids.Export]:
    """Write a recorded session into a BIDS dataset: events, the patterns as stimuli, the displacement of the pins.

    `task` names the task, else the session's experiment does. `zero` is the instant from which onsets count, such as the
    start of an EEG recording: of this process's `time.monotonic()`, or an `Instant`. Without it the first onset counts.
    `displacement_hz`: samples of the pins' displacement a second, computed by the program `meissner` on this machine; None: none.
    """
    recorded, found = yield from _stimuli(core, session_id)
    if isinstance(zero, Instant):
        zero_host_ns: int | None = zero.host_ns
    else:
        zero_host_ns = None if zero is None else core.clock.to_host(round(zero * NS))[0]
    return bids.write(
        Path(root),
        recorded,
        found,
        task=task,
        zero_host_ns=zero_host_ns,
        software=core.daemon,
        displacement_hz=displacement_hz,
    )


def export_nwb(
    core: Core,
    session_id: str,
    file: str | os.PathLike[str],
    *,
    subject: Mapping[str, Any] | None = None,
    metadata: Mapping[str, Any] | None = None,
    displacement_hz: float | None = 1000.0,
) -> Op[nwb.Export]:
    """Write a recorded session as an NWB file: a table of stimuli, the displacement of the pins, the device.

    It needs the package `pynwb`. `subject` has keys of `pynwb.file.Subject`, such as `age="P30Y"` and `sex="F"`, `metadata` those of
    `pynwb.NWBFile`, such as `experimenter`, `institution` and `keywords`. `displacement_hz`: as in `export_bids`.
    """
    nwb.needs_pynwb()
    recorded, found = yield from _stimuli(core, session_id)
    return nwb.write(
        Path(file),
        recorded,
        found,
        status=(yield from status(core)),
        subject=subject,
        metadata=metadata,
        displacement_hz=displacement_hz,
    )
