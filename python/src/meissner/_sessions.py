"""The methods of the client about sessions: start, resume and leave them, answers, what was played."""

from __future__ import annotations

import contextlib
import warnings
from typing import Any, Literal
from urllib.parse import quote

from . import _http, _kept
from ._arguments import number, table, text
from ._bodies import Labels, texts, verdict, whole
from ._operations import Core, Owned, document, send, status, stop, wait_until_idle
from ._presses import Press
from .clocks import Instant
from .errors import ApiError, Exists, IncompleteSession, NotFound, SessionExclusive, SessionOver, SessionRunning


def session(
    core: Core,
    participant: str,
    *,
    exclusive: bool = False,
    experiment: str | None = None,
    seed: int | None = None,
    labels: Labels = None,
    resume: bool = False,
    record: Literal["required", "optional"] = "required",
) -> dict[str, Any]:
    """Start a session that this client owns. `exclusive`: others may change nothing but stop.

    Every play of this client belongs to it from now on. If the session ends without this client, as by a restart of the daemon,
    plays raise `SessionOver` until the client has left it by its end, or starts another one.

    `resume`: go on with the running session of this participant, if a program of this user on this machine has started it and has
    ended without its end. Plays of that program are stopped. `SessionRunning` if that program still runs, or if the session is of
    another participant. After an error in its block the session goes on, for the next run of the program.

    While the daemon cannot record the session, its plays and answers raise `StoreError`; with `record="optional"` plays go on.
    """
    if resume:
        resumed = _resumed(core, participant)
        if resumed is not None:
            return resumed
    body = {
        "participant": participant,
        "exclusive": exclusive,
        "experiment": experiment,
        "seed": seed,
        "labels": texts(labels),
        "record": None if record == "required" else record,
    }
    answer = send(core, _http.post("/v1/sessions", body))
    try:
        started: dict[str, Any] = answer.json()
    except (SessionExclusive, SessionRunning) as error:
        advice = "if its program has ended, go on by `session(..., resume=True)`; else end that session first"
        raise type(error)(error.detail, status=error.status, advice=advice) from None
    core.session = Owned(started["id"], started["token"], resume)
    _kept.keep(started["id"], started["token"])
    return {**started, "resumed": False}


def _resumed(core: Core, participant: str) -> dict[str, Any] | None:
    """The running session, taken over from a program that has ended; None: no session runs."""
    try:
        running: dict[str, Any] = document(core, _http.get("/v1/sessions/running"))
    except NotFound:
        return None
    name = f"session {running['id']} with participant `{running['participant']}` runs"
    if running["participant"] != participant:
        raise SessionRunning(
            f"{name}: end it with `meissner session end`, or resume it for that participant", status=409
        )
    try:
        token = _kept.take(running["id"])
    except BlockingIOError:
        raise SessionRunning(
            f"{name}, and the program that has started it runs, too: end that first", status=409
        ) from None
    if token is None:
        raise SessionRunning(
            f"{name}, but its token is not kept for this user on this machine: end it with `meissner session end`",
            status=409,
        )
    core.session = Owned(running["id"], token, True)
    # A latched fault refuses the stop, and has stopped already.
    with contextlib.suppress(ApiError):
        stop(core)
    return {"id": running["id"], "record_problem": running.get("record_problem"), "resumed": True}


def session_leave(core: Core, session_id: str, failed: bool) -> IncompleteSession | None:
    """End a session after its plays have ended; after an error stop them first, and let a session that resumes go on.

    One that is over already is left. Returns an error to raise if the record has lost something of the session.
    """
    ended: dict[str, Any] = {}
    if not core.is_own or core.session is None:
        return None
    goes_on = failed and core.session.resumes
    if _runs(core, session_id):
        if failed:
            # A latched fault refuses the stop, and has stopped already.
            with contextlib.suppress(ApiError):
                stop(core)
        if not goes_on:
            wait_until_idle(core)
            # Somebody else may end it meanwhile.
            with contextlib.suppress(NotFound, SessionOver):
                ended = document(core, _http.post(f"/v1/sessions/{session_id}/end"))
    _kept.let_go(session_id, forget=not goes_on)
    if core.session is not None and core.session.id == session_id:
        core.session = None
    lost = ended.get("lost", {"entries": 0, "plays": 0})
    if not any(lost.values()):
        return None
    return IncompleteSession(
        f"session {session_id} has ended, but its record has lost {lost['entries']} entries, {lost['plays']} ends of plays among them: see "
        "`meissner session list` and `meissner doctor`; note the answers that your program has"
    )


def _runs(core: Core, session_id: str) -> bool:
    state = status(core)
    running = state.raw["session"]
    return running is not None and bool(running["id"] == session_id)


def answer(core: Core, play_id: int, onset: Instant | None, response: object, given: dict[str, Any]) -> None:
    """Record what the participant answered to a play of the running session. `response` and the factors are kept as text.

    A `Press` has its time: from the play's `onset`. `given` has `correct`, `rt_ms`, `level` and `factors`.
    """
    factors = {} if given["factors"] is None else table("factors", given["factors"], "{'block': 2}")
    rt_ms = given["rt_ms"]
    if isinstance(response, Press) and onset is not None:
        at = response.at(onset)
        factors |= {"response_tick": at.tick, "response_uncertainty_s": f"{at.monotonic_uncertainty:.6f}"}
        if response.is_early(onset):
            factors["response_early"] = "true"
        rt_ms = response.after(onset) * 1000 if rt_ms is None else rt_ms
    said = response.name if isinstance(response, Press) else response
    numbers = {
        name: None if value is None or _is_unknown(value) else number(name, value)
        for name, value in (("rt_ms", rt_ms), ("level", given["level"]))
    }
    body = {"response": whole(str(said)), "correct": verdict(given["correct"]), **numbers}
    try:
        document(core, _http.post(f"/v1/plays/{play_id}/answer", {**body, "factors": texts(factors)}))
    except Exists as error:
        raise Exists(error.detail, status=error.status, advice="the first one counts") from None
    except SessionOver:
        raise
    except SessionRunning as error:
        advice = "play it in the block of `with m.session(...)`, and answer before its end"
        raise SessionRunning(error.detail, status=error.status, advice=advice) from None


def _is_unknown(value: Any) -> bool:
    """Whether it is NaN, which tables have for a number that is not known."""
    return bool(value != value)


def sessions(core: Core) -> list[dict[str, Any]]:
    """List the recorded sessions. Warns of what is missing of the record, or cannot be read."""
    raw = document(core, _http.get("/v1/sessions", timeout=60.0))
    warn_of_gaps(raw)
    listed: list[dict[str, Any]] = raw["sessions"]
    return listed


def warn_of_gaps(recorded: dict[str, Any]) -> None:
    """Warns of what is missing of the record, or cannot be read: whole sessions may be."""
    for problem in recorded["problems"]:
        warnings.warn(problem, stacklevel=2)


def session_plays(core: Core, session_id: str) -> dict[str, Any]:
    """The recorded plays of a session, all pages: keys `session`, `plays`, `complete`, `missing`, `lost`, `problems`."""
    plays: list[dict[str, Any]] = []
    while True:
        path = f"/v1/sessions/{quote(text('session_id', session_id), safe='')}/plays?from={len(plays)}"
        page: dict[str, Any] = document(core, _http.get(path, timeout=60.0))
        plays += page["plays"]
        if not page["more"]:
            return {**page, "plays": plays}
