"""The methods of the client that export a session: to BIDS, and to NWB."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import bids, nwb
from ._arguments import number, table
from ._operations import Core, pattern, status
from ._rows import stimuli
from ._sessions import session_plays, warn_of_gaps
from .clocks import NS, Instant
from .errors import BadPattern, IncompleteSession, NotFound


def _complete(recorded: Mapping[str, Any]) -> None:
    """Raises `IncompleteSession` if the record lacks something of the session."""
    if not recorded["complete"]:
        missing = recorded["missing"] or bids.losses(recorded)
        raise IncompleteSession(
            f"the record of session {recorded['session']['id']} is incomplete: {'; '.join(missing)}: nothing was written; pass "
            "incomplete=True to export what there is"
        )


def _stimuli(core: Core, session_id: str, incomplete: bool) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """The plays of a session, and the patterns as they were played, by SHA-256: without those whose text is not kept."""
    recorded = session_plays(core, session_id)
    warn_of_gaps(recorded)
    if not incomplete:
        _complete(recorded)
    found = {}
    played = {(row["pattern"], row["pattern_sha256"]) for row in stimuli(recorded["plays"]) if row["pattern_sha256"]}
    for name, sha256 in sorted(played):
        try:
            stored = pattern(core, name, sha256=sha256)
        except (NotFound, BadPattern):
            continue
        found[sha256] = stored["pattern"]
    return recorded, found


def export_bids(
    core: Core,
    session_id: str,
    root: str | os.PathLike[str],
    *,
    task: str | None = None,
    subject: str | None = None,
    session: str | None = None,
    run: int | str | None = None,
    zero: float | Instant | None = None,
    incomplete: bool = False,
    overwrite: bool = False,
) -> bids.Export:
    """Write a recorded session into a BIDS dataset: events, and the patterns as stimuli.

    `task` names the task, else the session's experiment does. `subject` and `session` are labels of letters and digits, by
    default what remains of the participant's pseudonym and of the session's id; `run` is a number. Raises `BidsConflict` if one of
    them stands for something else in the dataset, such as a participant `P-07` for `P07`, and if a file is in the way that no export of
    this session wrote: `overwrite` replaces it.

    `zero` is the instant from which onsets count, such as the
    start of an EEG recording: of this process's `time.monotonic()`, or an `Instant`. Without it the first onset counts.

    Raises `IncompleteSession` if the record lacks something of the session, unless `incomplete`; `left_out` then says what.
    """
    recorded, found = _stimuli(core, session_id, incomplete)
    if isinstance(zero, Instant):
        zero_host_ns: int | None = zero.host_ns
    else:
        seconds = None if zero is None else number("zero", zero, " of seconds, such as `m.now()`, or an instant")
        zero_host_ns = None if seconds is None else core.clock.to_host(round(seconds * NS))[0]
    named: dict[str, Any] = {"task": task, "subject": subject, "session": session, "run": run}
    named |= {"zero_host_ns": zero_host_ns, "software": core.daemon, "overwrite": overwrite}
    return bids.write(Path(root), recorded, found, **named)


def export_nwb(
    core: Core,
    session_id: str,
    file: str | os.PathLike[str],
    *,
    subject: Mapping[str, Any] | None = None,
    metadata: Mapping[str, Any] | None = None,
    incomplete: bool = False,
    overwrite: bool = False,
) -> nwb.Export:
    """Write a recorded session as an NWB file: a table of stimuli, and the trials with their answers.

    It needs the package `pynwb`. `subject` has keys of `pynwb.file.Subject`, such as `age="P30Y"` and `sex="F"`, `metadata` those of
    `pynwb.NWBFile`, such as `experimenter`, `institution` and `keywords`.
    `incomplete`: as in `export_bids`. A file that is there is left as it is, unless `overwrite`.
    """
    nwb.needs_pynwb()
    nwb.check_place(Path(file), overwrite)
    about = {
        name: None if given is None else table(name, given, such_as)
        for name, given, such_as in (
            ("subject", subject, "{'age': 'P30Y', 'sex': 'F'}"),
            ("metadata", metadata, "{'institution': 'a lab'}"),
        )
    }
    recorded, found = _stimuli(core, session_id, incomplete)
    return nwb.write(Path(file), recorded, found, status=status(core), **about, overwrite=overwrite)
