"""Every method of the client, once: what it sends, what it reads, and when it tries again.

`Core` is what they share: endpoint, tokens, clock, the connection, and what the daemon said last.

Invariants: a command is sent once, and only an emergency stop is repeated; `Core.clock` alone converts instants.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote

from . import _http, errors, motions
from ._arguments import number, text
from ._bodies import (
    At,
    Fit,
    Labels,
    Late,
    SequenceItem,
    Trigger,
    milliseconds,
    sequence_items,
    texts,
    trial_number,
    trigger_of,
)
from ._endpoint import Endpoint
from ._http import Answer, Request
from ._text_file import text_of
from ._transport import BlockingTransport
from ._unreached import warn_of
from .arrays import Array
from .clocks import MAX_SKEW, NS, ClientClock, Instant
from .errors import ApiError, ConnectionLost, MeissnerError, Unreachable
from .motions import Samples
from .results import PlanCheck, Receipt, Status

_LONGEST_WAIT = 50.0
_COMPILING = 60.0
"""How long the daemon may take to compile a play of long motions, s."""
_STORING = 60.0
"""How long a slow disk may take to keep a pattern, s."""
_SYNC_SAMPLES = 8
_SYNC_AGE_NS = NS
"""How old the comparison of two PCs' clocks may be for an onset, ns."""
SILENCE = 10.0
"""How long a client that has armed may be silent before the daemon disarms, s: four times as long as its signs of life are apart."""


@dataclass(frozen=True)
class Owned:
    """A session that this client has started and not left."""

    id: str
    token: str
    resumes: bool = False
    """Whether it goes on after an error, for the next run of the program."""


@dataclass
class Core:
    """What the methods of one client share."""

    endpoint: Endpoint
    clock: ClientClock
    link: BlockingTransport = field(init=False, repr=False)
    token: str | None = None
    reconnect: float = 10.0
    """For how long to look for a daemon that was there before, s."""
    session: Owned | None = None
    """The session that this client owns. Every order names it, so that none counts for another one."""
    daemon: tuple[int, str] | None = None
    """Which daemon answered last: its process and version."""
    array: Array | None = None
    """What that daemon drives; None: it was not asked yet."""
    has_armed: bool = False
    """Whether this client has armed, so that it disarms at its end."""
    silence: float | None = None
    """The silence after which the daemon disarms, as this client has stated it, s; None: silence does not disarm."""
    client: str = field(default_factory=lambda: os.urandom(8).hex())
    """This client's name in every request: the daemon knows by it whose signs of life they are."""
    process: int = field(default_factory=os.getpid)
    """The process that made the client."""
    synced_ns: int = -(1 << 62)
    """When the clock got its last sample."""
    device_clock: dict[str, Any] | None = None
    """The device's clock at that sample, as the status has it, with the device's `boot`."""
    looked_at: set[bytes] = field(default_factory=set)
    """The patterns of plays whose receipts this client has looked at for warnings."""
    warned_of: set[str] = field(default_factory=set)
    """The patterns that it has warned of."""

    @property
    def headers(self) -> dict[str, str]:
        """The headers of every request."""
        return _http.identity(self.client, self.token, self.session.token if self.session else None)

    @property
    def is_own(self) -> bool:
        """Whether this process made the client. A forked child has a copy, and ends nothing of its parent's."""
        return self.process == os.getpid()

    @property
    def shows_signs(self) -> bool:
        """Whether the daemon would do something if this client fell silent."""
        return (self.has_armed and self.silence is not None) or self.session is not None

    def read(self, answer: Answer) -> Any:
        """The document of an answer to what belongs to the client's session. Raises `SessionOver` if that is over."""
        try:
            return answer.json()
        except (errors.SessionRunning, errors.SessionExclusive) as error:
            if self.session is None:
                raise
            raise errors.SessionOver(
                f"session {self.session.id} is over: {error.detail}", status=error.status
            ) from error

    def receipt(self, raw: dict[str, Any]) -> Receipt:
        """A receipt with instants on this client's clocks."""
        return Receipt.of(raw, self.clock)


@dataclass(frozen=True)
class Accepted:
    """A play that the daemon has taken."""

    id: int
    pattern: str
    ordered_s: float | None
    """Duration as ordered, s; None: without end."""
    daemon: tuple[int, str] | None
    motions: tuple[dict[str, Any], ...] = ()
    """How each motor follows its motions, with the keys of the API reference."""


def send(core: Core, request: Request) -> Answer:
    """Sends a request, and again if the daemon cannot have carried it out or it changes nothing."""
    begun, pause = core.clock.now_ns(), 0.05
    while True:
        try:
            return core.link.perform(request)
        except (Unreachable, ConnectionLost) as error:
            is_safe = isinstance(error, Unreachable) or request.repeatable
            if not is_safe or core.clock.now_ns() - begun > core.reconnect * NS:
                raise
        core.link.pause(pause)
        pause = min(2 * pause, 1.0)


def document(core: Core, request: Request) -> Any:
    answer = send(core, request)
    return core.read(answer)


def status(core: Core) -> Status:
    """Ask how daemon and device stand. Each answer improves the clock's estimate."""
    answer = send(core, _http.get("/v1/status"))
    return _take_status(core, answer)


def _take_status(core: Core, answer: Answer) -> Status:
    raw = core.read(answer)
    if not isinstance(raw, dict) or "state" not in raw:
        raise errors.UnexpectedAnswer(f"{core.endpoint.name} does not answer as a meissner daemon: check the address")
    daemon = (raw["daemon"]["pid"], raw["daemon"]["version"])
    if daemon != core.daemon:
        core.daemon, core.array = daemon, None
    if raw["clock"] is not None:
        core.clock.add(answer.sent_ns, answer.received_ns, raw["clock"]["monotonic_ns"])
        core.device_clock = {**raw["clock"], "boot": raw["device"]["boot"] if raw["device"] else None}
        core.synced_ns = answer.received_ns
    return Status.of(raw)


def begin(core: Core) -> Status:
    """Meet the daemon, and compare the clocks. A device that has just been opened gets a moment to connect."""
    state = status(core)
    for _ in range(20):
        if state.raw["clock"] is not None or state.raw["link"]["missing"] is not None:
            break
        core.link.pause(0.05)
        state = status(core)
    synchronise(core)
    return state


def array(core: Core) -> Array:
    """The array that the daemon drives."""
    if core.array is None:
        core.array = Array.of(document(core, _http.get("/v1/array")))
    return core.array


def synchronise(core: Core) -> float:
    """Compare the clocks of client and daemon anew. Returns the uncertainty between them, s."""
    for _ in range(_SYNC_SAMPLES):
        status(core)
        if core.clock.is_shared:
            break
    if not core.clock.has_samples:
        return float("inf")
    return core.clock.to_host(core.clock.now_ns())[1] / NS


def _command(core: Core, path: str, body: dict[str, Any] | None = None, timeout: float = 10.0) -> Status:
    answer = send(core, _http.post(path, body, timeout=timeout))
    return _take_status(core, answer)


def arm(
    core: Core,
    *,
    assume_rest: bool = False,
    checked: str | None = None,
    silence: float = SILENCE,
    stay_armed: bool = False,
) -> Status:
    """Enable the motors. `assume_rest`: you have seen that all pins are at rest; `checked`: who has looked at them.

    The daemon disarms when it hears nothing of this client for `silence` s, 1 to 86400, as of a program that was killed. A thread
    shows that the program is there. `stay_armed`: silence does not disarm. The end of the client disarms in any case.
    """
    if not 1.0 <= number("silence", silence, " of seconds, 1 to 86400") <= 86_400.0:
        raise ValueError(f"`silence` is {silence} s: must be 1 to 86400, or give `stay_armed=True`")
    statement: dict[str, Any] = {"unattended": True} if stay_armed else {"silence_s": silence}
    body = {"assume_rest": assume_rest, "checked": checked}
    before = core.has_armed, core.silence
    # Set first: if the answer is lost, the motors may be on.
    core.has_armed, core.silence = True, None if stay_armed else silence
    try:
        return _command(core, "/v1/arm", {**body, **statement})
    except ApiError as error:
        # What the daemon refused has changed nothing; after a timeout the motors may be on.
        if not isinstance(error, errors.DeviceTimeout):
            core.has_armed, core.silence = before
        raise


def disarm(core: Core) -> Status:
    """Stop, return the pins to rest and switch the motors off."""
    state = _command(core, "/v1/disarm")
    core.has_armed = False
    return state


def stop(core: Core) -> Status:
    """Stop the running play and clear the queue. The motors stay armed."""
    return _command(core, "/v1/stop")


def reset(core: Core, *, force: bool = False, keep: bool = False) -> Status:
    """Clear a latched emergency stop or fault. Pins that stand above rest return to it, unless `keep`. The motors stay disarmed."""
    return _command(core, "/v1/reset", {"force": force or None, "keep": keep or None})


def home(core: Core) -> Status:
    """Move every pin to rest; takes up to 25 s."""
    return _command(core, "/v1/home", timeout=600.0)


def edge(core: Core, *, after: float | None = None, at: Instant | None = None) -> Status:
    """Make an edge at the trigger input of a simulated array: now, in `after` s, or `at` an instant, exact to the tick. A board refuses."""
    if after is not None and at is not None:
        raise ValueError("give `after` or `at`, not both")
    if at is not None and not isinstance(at, Instant):
        raise TypeError(f"`at` is {at!r}: must be an instant, such as `play.onset.later(1.0)`; or give `after`, s")
    body = {"at_ms": milliseconds("after", after), "at_tick": at and at.tick}
    return _command(core, "/v1/edge", body)


def _onset(core: Core, at: At, on_edge: float | None) -> dict[str, Any]:
    """The keys of an onset: an instant of the device's clock, or of this process's `time.monotonic()`, or a delay after an edge."""
    if on_edge is not None:
        if at is not None:
            raise ValueError("give `at` or `on_edge`, not both")
        return {"on_edge_ms": milliseconds("on_edge", on_edge)}
    if at is None:
        return {}
    if isinstance(at, Instant):
        return {"at_tick": at.tick, "boot": at.boot}
    seconds = number("at", at, " of seconds, such as `m.now() + 0.2`, or an instant, such as `play.onset.later(1.5)`")
    core.clock.check(seconds)
    if not core.clock.is_shared and core.clock.now_ns() - core.synced_ns > _SYNC_AGE_NS:
        status(core)
    return {"at_monotonic_ns": core.clock.to_host(round(seconds * NS))[0]}


def instant(core: Core, tick: int) -> Instant:
    """A tick near the present, on every clock. The device's clock is compared anew if that was more than a second ago."""
    if core.device_clock is None or core.clock.now_ns() - core.synced_ns > _SYNC_AGE_NS:
        status(core)
    sample = core.device_clock
    if sample is None:
        raise errors.NotKnownYet("no device is connected, so its ticks have no times: connect one")
    distance_ns = round((tick - sample["tick"]) * NS / sample["tick_hz"])
    return core.clock.instant(
        tick=tick,
        boot=sample["boot"],
        tick_hz=sample["tick_hz"],
        host_ns=sample["monotonic_ns"] + distance_ns,
        host_uncertainty_ns=round(sample["uncertainty_us"] * 1000 + abs(distance_ns) * MAX_SKEW),
    )


def _accepted(core: Core, request: Request, pattern: str, played: Any) -> Accepted:
    raw = document(core, request)
    ordered = raw["ordered_ms"]
    followed = tuple(raw.get("motions", ()))
    accepted = Accepted(raw["id"], pattern, None if ordered is None else ordered / 1000, core.daemon, followed)
    key = _fingerprint(played)
    if key not in core.looked_at:
        core.looked_at.add(key)
        # The play is queued, whatever becomes of this question.
        with contextlib.suppress(MeissnerError):
            warn_of(receipt(core, accepted.id), core.warned_of)
    return accepted


def _fingerprint(played: Any) -> bytes:
    return hashlib.sha256(_http.encode(played)).digest()


def play(
    core: Core,
    pattern: str | Mapping[str, Any] | None = None,
    seconds: float | None = None,
    *,
    samples: Samples | None = None,
    rate: float | None = None,
    drives: Iterable[Mapping[str, Any]] | None = None,
    strict: bool = False,
    hold: float | None = None,
    at: At = None,
    on_edge: float | None = None,
    stop_on_edge: bool = False,
    scale: float | None = None,
    trigger: Trigger = None,
    trial: int | None = None,
    labels: Labels = None,
    late: Late = None,
    fit: Fit = None,
    replace: bool = False,
    endless: bool = False,
    open_loop: bool = False,
) -> Accepted:
    """Queue a play of a pattern: of its name, or of a dict with the keys of a pattern file.

    In its place `samples` are displacements above rest, µm: a dict by motor, or an array of shape (time, motors), at `rate` Hz;
    `drives` are dicts with the keys of a drive. A sample that no pin can follow raises `ValueError` before anything moves.
    `strict` refuses motions that a motor is too slow for (`TooSlow`); `hold`: how long a pin may stay above rest without a pulse, s.

    `at` is the onset: an instant of this process's `time.monotonic()` such as `m.now() + 0.2`, or the `Instant` of an
    earlier play, such as `play.onset.later(1.5)`, which is exact to the tick. Without it the play begins as soon as
    it can. `scale` multiplies the amplitudes. `trigger`: a code from 1 to 255, or False for none.

    Warns once a pattern, here or in `wait()`, of what will not be felt as ordered, such as a motor that does not reach its amplitude.

    With `on_edge` the play waits for an edge of the trigger input, the first after those before it are over, and begins so many s after
    it, exact to the tick. `stop_on_edge`: the first edge after the onset stops it and clears the queue.
    """
    given = pattern
    if samples is not None or drives is not None:
        if pattern is not None:
            raise ValueError("give `pattern`, or `samples` and `drives`, not both")
        given = _inline(core, {"samples": samples, "rate": rate, "drives": drives})
    if given is None:
        raise ValueError("give `pattern`, or `samples` with `rate`, or `drives`")
    if not isinstance(given, (str, Mapping)):
        raise TypeError(
            f"`pattern` is {given!r}: must be a pattern's name, or a dict with the keys of a pattern file; `store_pattern` stores a file"
        )
    name = given if isinstance(given, str) else str(given.get("name", "inline"))
    body = {
        "pattern": given,
        "seconds": seconds,
        "scale": scale,
        "trigger": trigger_of(trigger),
        "fit": fit,
        "endless": endless or None,
        "strict": strict or None,
        "hold_ms": milliseconds("hold", hold),
        "stop_on_edge": stop_on_edge or None,
        **terms(core, trial, labels, late, replace, open_loop),
        **_onset(core, at, on_edge),
    }
    return _accepted(core, _http.post("/v1/play", body, timeout=_COMPILING), name, given)


def terms(core: Core, trial: Any, labels: Labels, late: Late, replace: bool, open_loop: bool) -> dict[str, Any]:
    """The keys that all plays have in common."""
    return {
        "trial": trial_number(trial),
        "labels": texts(labels),
        "late": late,
        "replace": replace or None,
        "open_loop": open_loop or None,
        "session": core.session and core.session.id,
    }


def _inline(core: Core, given: Mapping[str, Any]) -> dict[str, Any]:
    """The inline pattern of samples and drives, for the daemon's array."""
    driven = array(core)
    return motions.pattern(**given, motors=driven.motors, most_um=driven.motor["travel_um"])


def sequence(
    core: Core,
    items: Iterable[SequenceItem],
    *,
    isi: float | None = None,
    soa: float | None = None,
    seconds: float | None = None,
    scale: float | None = None,
    at: At = None,
    on_edge: float | None = None,
    stop_on_edge: bool = False,
    name: str | None = None,
    strict: bool = False,
    hold: float | None = None,
    trial: int | None = None,
    labels: Labels = None,
    late: Late = None,
    replace: bool = False,
    open_loop: bool = False,
) -> Accepted:
    """Queue patterns as one play with exact times.

    An item is a pattern's name, or a dict with `pattern` (or `samples` and `rate`, or `drives`, as in `play`) and any of `seconds`,
    `scale`, `trigger`, `gap` (pause after the items before, s) and `start` (from the sequence's onset, s). None, or a dict whose
    `pattern` is None, is a blank item: nothing is played for its `seconds`. Items may overlap if they drive different motors. `isi` is the pause from one item's end to the next
    onset, `soa` the distance of onsets, s. `seconds` and `scale` are for items that give none. `strict`, `hold`,
    `on_edge` and `stop_on_edge`: as in `play`.
    """
    made = items_of(core, items, isi, soa, seconds, scale)
    name = name or "sequence"
    body = {
        "items": made,
        "name": name,
        "strict": strict or None,
        "hold_ms": milliseconds("hold", hold),
        "stop_on_edge": stop_on_edge or None,
        **terms(core, trial, labels, late, replace, open_loop),
        **_onset(core, at, on_edge),
    }
    return _accepted(core, _http.post("/v1/play", body, timeout=_COMPILING), name, [item["pattern"] for item in made])


def items_of(
    core: Core,
    items: Iterable[SequenceItem],
    isi: float | None,
    soa: float | None,
    seconds: float | None,
    scale: float | None,
) -> list[dict[str, Any]]:
    """The items of a sequence as the daemon takes them."""

    def inline(item: dict[str, Any]) -> dict[str, Any]:
        own: dict[str, Any] = {key: item.pop(key) for key in ("samples", "rate", "drives") if key in item}
        return {**item, "pattern": _inline(core, own)} if own else item

    return sequence_items(items, isi, soa, {"seconds": seconds, "scale": scale}, inline)


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
    body = {"items": items_of(core, items, isi, soa, seconds, scale)}
    # Compiling long motions takes a while.
    answer = send(core, _http.post("/v1/play/check", body, timeout=60.0))
    return PlanCheck.of(core.read(answer))


def receipt(core: Core, play_id: int | str = "last") -> Receipt:
    """Ask for what became of a play."""
    raw = document(core, _http.get(f"/v1/plays/{quote(str(play_id), safe='')}"))
    return core.receipt(raw)


def withdraw(core: Core, play_id: int) -> Receipt:
    """Take a waiting play out of the queue, and return its receipt."""
    raw = document(core, Request("DELETE", f"/v1/plays/{play_id}"))
    return core.receipt(raw)


def checked(result: Receipt) -> Receipt:
    """Refuses a play that did not come to its end."""
    if result.state != "done":
        raise errors.PlayStopped(result)
    return result


def wait(core: Core, accepted: Accepted, timeout: float | None = None) -> Receipt:
    """Wait until a play has ended, at most `timeout` s (then `TimeoutError`), and return its receipt."""
    deadline = None if timeout is None else core.clock.now_ns() + round(number("timeout", timeout, " of seconds") * NS)
    while True:
        left = _LONGEST_WAIT if deadline is None else (deadline - core.clock.now_ns()) / NS
        seconds = max(0.0, min(left, _LONGEST_WAIT))
        request = _http.get(f"/v1/plays/{accepted.id}?wait={seconds:.3f}", timeout=seconds + 10.0)
        try:
            raw = document(core, request)
        except MeissnerError:
            _same_daemon(core, accepted)
            raise
        _same_daemon(core, accepted)
        result = core.receipt(raw)
        if result.is_over:
            warn_of(result, core.warned_of)
            return result
        if deadline is not None and core.clock.now_ns() >= deadline:
            raise TimeoutError(f"play {accepted.id} is {result.state} after {timeout} s: wait longer, or call `stop()`")


def _same_daemon(core: Core, accepted: Accepted) -> None:
    """Refuses a receipt of another daemon's play of that number. The answer also keeps the clock's estimate fresh."""
    status(core)
    if accepted.daemon is not None and core.daemon != accepted.daemon:
        raise errors.DaemonRestarted(
            f"the daemon was restarted after it took play {accepted.id}: arm again and repeat the trial; "
            "the session record has what was played"
        )


def wait_until_idle(core: Core) -> None:
    """Wait until no play runs or waits."""
    while True:
        state = status(core)
        if state.playing is None and not state.queued and state.state != "returning":
            return
        core.link.pause(0.02)


def doctor(core: Core) -> dict[str, Any]:
    """Check what could keep the daemon's machine or its device from playing: keys `ok` and `findings`, each with its remedy."""
    raw: dict[str, Any] = document(core, _http.get("/v1/doctor", timeout=20.0))
    return raw


def patterns(core: Core) -> list[dict[str, Any]]:
    """List the patterns."""
    raw = document(core, _http.get("/v1/patterns"))
    listed: list[dict[str, Any]] = raw["patterns"]
    return listed


def pattern(core: Core, name: str, *, sha256: str | None = None) -> dict[str, Any]:
    """Show one pattern with its drives. `sha256` asks for another text of that name, as it was played: the session record keeps it."""
    path = f"/v1/patterns/{quote(text('name', name), safe='')}" + ("" if sha256 is None else f"?sha256={sha256}")
    raw: dict[str, Any] = document(core, _http.get(path))
    return raw


def store_pattern(core: Core, name: str, toml: str | os.PathLike[str], *, replace: bool = False) -> dict[str, Any]:
    """Store a pattern: its TOML text, or the path of its file."""
    if isinstance(toml, os.PathLike):
        toml = text_of(toml).replace("\r\n", "\n")
    elif text("toml", toml).endswith(".toml"):
        raise ValueError(
            f"`toml` is {toml!r}: must be the text of a pattern file, or its path as `pathlib.Path({toml!r})`"
        )
    path = f"/v1/patterns/{quote(text('name', name), safe='')}" + ("?replace=true" if replace else "")
    request = Request("PUT", path, toml.encode(), {"Content-Type": "application/toml"}, timeout=_STORING)
    with _library("choose another name"):
        raw: dict[str, Any] = document(core, request)
    # It is another pattern now.
    core.looked_at.discard(_fingerprint(name))
    core.warned_of.discard(f"`{name}`")
    return raw


def remove_pattern(core: Core, name: str) -> None:
    """Remove a pattern that was stored."""
    with _library("the library stays as it is"):
        document(core, Request("DELETE", f"/v1/patterns/{quote(text('name', name), safe='')}", timeout=_STORING))


def store_calibration(core: Core, toml: str) -> dict[str, Any]:
    """Store gains of motors: the text of a calibration file, such as `meissner.laser.fit` makes. Other motors keep theirs."""
    request = Request(
        "PUT", "/v1/calibration", text("toml", toml).encode(), {"Content-Type": "application/toml"}, timeout=_STORING
    )
    raw: dict[str, Any] = document(core, request)
    return raw


@contextlib.contextmanager
def _library(advice: str) -> Generator[None]:
    """Advice where the name is one of the library's, which nothing replaces."""
    try:
        yield
    except errors.Exists as error:
        if "library" not in error.detail:
            raise
        raise errors.Exists(error.detail, status=error.status, advice=advice) from None


def leave(core: Core) -> None:
    """Disarm at the end if this client has armed, unless another one has armed, too. A device that is off already is fine."""
    if core.has_armed and core.is_own:
        switch_off(core)
        core.has_armed = False


def switch_off(core: Core) -> None:
    """Take back what this client has armed: motors that another one has armed stay armed for that one. A device that is off is fine."""
    with contextlib.suppress(errors.Faulted, errors.NoDevice):
        _command(core, "/v1/disarm", {"own": True})


def heartbeat(core: Core) -> float:
    """Show that the client is there. Returns how soon to do so again, s."""
    status(core)
    pauses = [30.0]
    if core.has_armed and core.silence is not None:
        pauses.append(core.silence / 4)
    owned = core.session
    if owned is not None:
        try:
            raw = document(core, _http.get("/v1/sessions/running"))
        except errors.NotFound:
            raw = {"id": None}
        if raw["id"] != owned.id:
            raise errors.SessionOver(f"session {owned.id} is over", status=409)
        pauses.append((raw["release_in_s"] or 120.0) / 4)
    return max(0.05, min(pauses))
