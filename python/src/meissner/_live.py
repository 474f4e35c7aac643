"""Live plays: the request, the messages, and which of them have no answer yet.

`live.py` sends, and reads with a thread. `Updates` numbers the messages of one
play and gives each its answer.

Bounds: `WINDOW` messages without an answer. An answered update is the caller's alone. Invariant: every method of `Updates` is called by one thread at a time.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from . import _http
from . import _operations as ops
from ._arguments import drive_list, hints, number, table
from ._bodies import Labels, Late, Trigger, milliseconds, trigger_of
from ._endpoint import Endpoint
from ._operations import Accepted, Core
from .arrays import Array
from .errors import ApiError, ConnectionLost, MeissnerError, PlayStopped, UnexpectedAnswer
from .results import LiveResult, Receipt

Drives = Iterable[Mapping[str, Any]]
Pose = Mapping[str, float]
WINDOW = 24
"""Messages without an answer, at most. The daemon takes 32, refuses more, and keeps 128 answers for who does not read."""
_LONGEST = 65_000
"""A message's JSON, bytes: the daemon takes 65536 with its number."""
END_TIMEOUT = 20.0
"""How long the daemon may take to end a live play, s. The stroke that runs ends first."""


@dataclass(frozen=True)
class Started:
    """A live play that the daemon has taken, and where its connection is opened."""

    accepted: Accepted
    path: str
    array: Array | None = None
    """The array whose motors it drives; None: not known, so no motor is checked."""


def start(
    core: Core,
    object: str | Mapping[str, Any] | None = None,
    *,
    drives: Drives | None = None,
    scale: float | None = None,
    timeout: float | None = None,
    updates_hz: float | None = None,
    max_frequency_hz: float | None = None,
    trigger: Trigger = None,
    trial: int | None = None,
    labels: Labels = None,
    late: Late = None,
    replace: bool = False,
    open_loop: bool = False,
) -> Started:
    """Start a live play, whose drives change while it runs: use it in a `with` block, which ends it.

    `object` is a thing that your poses press and move: a dict with the keys of an object file, or the name of a shipped one; its
    pins are at rest until the first pose. Without an object, `drives` are those at the onset: dicts with `motor`, `frequency_hz`,
    `amplitude_um` and perhaps `phase`.

    The play ends when the program sends nothing for `timeout` s (0.5; the first message may take 2 s), and the pins return.
    No thread keeps it alive: a program that hangs must not leave pins moving. A loop without a change calls `keep()`.
    """
    array = ops.array(core)
    body = {
        "object": object,
        "drives": None if drives is None else plain_drives(drives, array),
        "scale": scale,
        "timeout_ms": milliseconds("timeout", timeout),
        "updates_hz": updates_hz,
        "max_frequency_hz": max_frequency_hz,
        "trigger": trigger_of(trigger),
        **ops.terms(core, trial, labels, late, replace, open_loop),
    }
    answer = ops.send(core, _http.post("/v1/live", body, timeout=20.0))
    raw = core.read(answer)
    return Started(Accepted(raw["id"], "live", None, core.daemon), raw["path"], array)


def plain_drives(drives: Drives, array: Array | None) -> list[dict[str, Any]]:
    """Drives as JSON has them; NumPy's numbers become Python's. Raises `ValueError` for a motor that the array does not have."""
    plain = [
        {key: value.tolist() if hasattr(value, "tolist") else value for key, value in drive.items()}
        for drive in drive_list(drives)
    ]
    if array is not None:
        array.check_motors(plain)
    return plain


def plain_pose(pose: Pose) -> dict[str, float]:
    return {key: number(f"pose.{key}", value) for key, value in table("pose", pose, "{'x_mm': 1.5}").items()}


def address(endpoint: Endpoint, path: str) -> str:
    """Where a live play's WebSocket is opened."""
    url = urlsplit(endpoint.url)
    return f"{'wss' if endpoint.is_secure else 'ws'}://{url.netloc.rpartition('@')[2]}{url.path}{path}"


@hints
class Update:
    """A message of a live play, and the daemon's answer to it once that is known."""

    def __init__(self, seq: int, wait_for: Callable[[Update, float | None], LiveResult]) -> None:
        self.seq = seq
        """The message's number."""
        self._wait_for = wait_for
        self._answered = threading.Event()
        self._raw: dict[str, Any] | None = None
        self._error: MeissnerError | None = None
        self._over: ApiError | None = None
        """It came too late for the play. Why the play was over follows."""
        self._waiting = 0

    def wait(self, timeout: float | None = None) -> LiveResult:
        """Wait for the daemon's answer. Raises the refusal, or `TimeoutError` after `timeout` s.

        Waiting is no sign of life: if it takes longer than the play's `timeout`, the daemon ends the play.
        """
        return self._wait_for(self, None if timeout is None else number("timeout", timeout, " of seconds"))

    @property
    def is_answered(self) -> bool:
        """Whether `wait()` would return at once."""
        return self._raw is not None or self._error is not None

    def _settle(self, raw: dict[str, Any] | None, error: MeissnerError | None) -> None:
        self._raw, self._error = raw, error
        self._answered.set()

    def __repr__(self) -> str:
        if self._error is not None:
            state = "failed"
        elif self._raw is not None:
            state = "applied" if "applied" in self._raw else "merged"
        else:
            state = "under way"
        return f"<update {self.seq}: {state}>"


class Updates:
    """The messages of one live play."""

    def __init__(
        self, play_id: int, array: Array | None, wait_for: Callable[[Update, float | None], LiveResult]
    ) -> None:
        self.play_id, self._array, self._wait_for = play_id, array, wait_for
        self.under_way: dict[int, Update] = {}
        """The messages that were sent and have no answer, the oldest first."""
        self.cause: str | None = None
        """Why the daemon ended the play; None: it has not said so."""
        self.failure: MeissnerError | None = None
        """Why the play is over, if its client has not ended it."""
        self.is_over = False
        self.is_ending = False
        """Whether `end` was sent."""
        self._seq = 0
        self._problem: tuple[Update, MeissnerError] | None = None
        """The newest refusal that nobody has waited for."""

    @property
    def ended_as_asked(self) -> bool:
        """Whether the play is over because its client has ended it."""
        return self.is_over and self.failure is None

    @property
    def is_full(self) -> bool:
        """Whether the next message has to wait for an answer."""
        return len(self.under_way) >= WINDOW and not self.is_over

    def message(self, drives: Drives | None, pose: Pose | None, scale: float | None) -> tuple[Update, str]:
        """A message, and its text. Raises why the play is over, or an earlier refusal, once."""
        self.check_open()
        self.raise_problem()
        body: dict[str, Any] = {}
        if drives is not None:
            body["drives"] = plain_drives(drives, self._array)
        if pose is not None:
            body["pose"] = plain_pose(pose)
        if scale is not None:
            body["scale"] = float(scale)
        # What is no JSON, or more than the daemon takes, is refused here.
        if len(json.dumps(body, allow_nan=False)) > _LONGEST:
            raise ValueError(f"a message of a live play has more than {_LONGEST} bytes: send less")
        self._seq += 1
        update = self.under_way[self._seq] = Update(self._seq, self._wait_for)
        return update, _http.encode({"seq": self._seq, **body}).decode()

    def check_open(self) -> None:
        """Raises why the play takes no message."""
        self.raise_failure()
        if self.is_ending:
            raise ValueError(f"live play {self.play_id} has ended: start another one with `live(...)`")

    def end(self) -> str:
        """What ends the play."""
        self.is_ending = True
        self._seq += 1
        return json.dumps({"seq": self._seq, "end": True})

    def raise_failure(self) -> None:
        """Raises why the play is over, unless its client has ended it."""
        if self.failure is not None:
            raise self.failure.with_traceback(None)

    def raise_problem(self) -> None:
        """Raises the newest refusal that nobody has waited for, once."""
        problem, self._problem = self._problem, None
        if problem is not None:
            raise problem[1]

    def take(self, text: str | bytes) -> None:
        """Takes an answer of the daemon."""
        try:
            self._answered(json.loads(text))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise UnexpectedAnswer(f"an answer of the live play cannot be read: {text[:60]!r}") from error

    def _answered(self, answer: dict[str, Any]) -> None:
        seq: int | None = answer["seq"]
        problem = answer.get("problem")
        if answer.get("ended") is not None:
            self.cause = str(answer["ended"])
        elif problem is None:
            update = self.under_way.pop(seq or 0, None)
            if update is not None:
                update._settle(answer, None)
        else:
            error = ApiError.of(problem, problem["status"])
            if seq is None:
                # The daemon cannot read a message without end, and closes the connection.
                raise error
            if seq not in self.under_way:
                return
            if error.code == "not-found":
                # The play was over. Why so follows, and says more.
                self.under_way[seq]._over = error
            else:
                self._refused(seq, error)

    def _refused(self, seq: int, error: MeissnerError) -> None:
        update = self.under_way.pop(seq)
        update._settle(None, error)
        if not update._waiting:
            self._problem = update, error

    def over(self, failure: MeissnerError | None) -> None:
        """The play is over: why, unless its client has ended it. No update gets an answer any more."""
        self.failure, self.is_over = failure, True
        for update in self.under_way.values():
            lost = ConnectionLost(f"live play {self.play_id} ended before update {update.seq} was answered")
            update._settle(None, failure or update._over or lost)
        self.under_way.clear()

    def wait_begins(self, update: Update) -> None:
        """Somebody waits for this update from now on, so its refusal is not raised elsewhere."""
        update._waiting += 1
        if self._problem is not None and self._problem[0] is update:
            self._problem = None

    def wait_ends(self, update: Update) -> None:
        """That wait is over."""
        update._waiting -= 1

    def answer(self, update: Update) -> dict[str, Any]:
        """The daemon's answer to an update that was waited for. Raises the refusal."""
        if update._raw is not None:
            return update._raw
        if update._error is not None:
            raise update._error.with_traceback(None)
        raise TimeoutError(f"the daemon has not answered update {update.seq} yet: wait longer")

    def lost(self, reason: object) -> ConnectionLost:
        """The connection ended without a word about the play."""
        return ConnectionLost(
            f"the connection of live play {self.play_id} ended ({reason}): the daemon ends the play, and its pins return"
        )


def result(core: Core, raw: dict[str, Any]) -> LiveResult:
    """What the daemon's answer says, with the onset on every clock."""
    applied = raw.get("applied")
    if applied is None:
        return LiveResult("merged", raw["merged_into"], (), None, 0, raw)
    ticks = tuple(applied["ticks"])
    changed = [tick for tick in ticks if tick is not None]
    onset = ops.instant(core, min(changed)) if changed else None
    return LiveResult("applied", None, ticks, onset, applied["repeats"], raw)


def outcome(core: Core, updates: Updates, lost: MeissnerError | None) -> tuple[Receipt | None, MeissnerError | None]:
    """The receipt of a play that is over, and why it is over, unless its client has ended it.

    `lost`: the connection ended without the daemon's last word, which a lost connection may take along. The request is
    sent once: the client's next call must not wait for a daemon that shuts down.
    """
    receipt, cause = None, updates.cause
    try:
        answer = core.link.perform(_http.get(f"/v1/plays/{updates.play_id}?wait=10.000", timeout=20.0))
        receipt = core.receipt(answer.json())
    except MeissnerError as error:
        detail = f"the daemon has ended live play {updates.play_id} ({cause}), and gives no receipt: {error}"
        lost = lost or ConnectionLost(detail)
    if receipt is not None and receipt.is_over:
        cause = receipt.cause
    if updates.is_ending and cause == "stop":
        return receipt, None
    if receipt is None or (lost is not None and not receipt.is_over):
        return receipt, lost
    stopped = PlayStopped(receipt)
    stopped.__cause__ = lost
    return receipt, stopped
