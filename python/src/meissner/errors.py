"""Errors: one class for each stable code of the API, each with what to do about it in Python.

Catch `MeissnerError` for all of them, `ApiError` for what the daemon refused, and a class such as `Disarmed` for one code.
A code that this version does not know becomes a plain `ApiError`; `code`, `status` and `detail` are always there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from ._base import MeissnerError as MeissnerError
from ._base import NotKnownYet as NotKnownYet

if TYPE_CHECKING:
    from .results import Receipt


class Unreachable(MeissnerError):
    """No daemon answers. The request was not sent."""


class ConnectionLost(MeissnerError):
    """The connection ended before the answer came. The daemon may have carried out the request: look at `status()`."""


class UnexpectedAnswer(MeissnerError):
    """What answers is no daemon of meissner, or one of another version."""


class DaemonRestarted(MeissnerError):
    """The daemon was restarted after the play was ordered. The device is disarmed, and the play's result is in the session record."""


class PlayStopped(MeissnerError):
    """A play did not come to its end. `receipt` has what became of it."""

    def __init__(self, receipt: Receipt) -> None:
        super().__init__(
            f"play {receipt.id} ({receipt.pattern}) was {receipt.state}: {receipt.cause or 'no cause given'}; "
            "do not count the trial, or call `wait(check=False)`"
        )
        self.receipt = receipt


class IncompleteSession(MeissnerError):
    """The record of a session lacks something. An export has written nothing; a session has ended all the same."""


class BidsConflict(MeissnerError):
    """An export would write two sources under one name of a BIDS dataset, or replace what it has not written. Nothing was written."""


class ProgramError(MeissnerError):
    """The program `meissner` is missing or has failed."""


class ApiError(MeissnerError):
    """The daemon refused a request."""

    code: str = "unknown"
    advice: ClassVar[str] = ""
    by_code: ClassVar[dict[str, type[ApiError]]] = {}

    def __init_subclass__(cls, code: str = "", advice: str = "", **rest: Any) -> None:
        super().__init_subclass__(**rest)
        if code:
            cls.code, cls.advice = code, advice
            ApiError.by_code[code] = cls

    def __init__(
        self, detail: str, *, status: int, title: str = "", code: str | None = None, advice: str | None = None
    ) -> None:
        self.detail, self.status, self.title = detail, status, title
        if code is not None:
            self.code = code
        advice = self.advice if advice is None else advice
        super().__init__(f"{detail} [{self.code}{': ' + advice if advice else ''}]")

    @staticmethod
    def of(problem: dict[str, Any], status: int) -> ApiError:
        """The error that a problem document describes."""
        code = str(problem.get("code", "unknown"))
        kind = ApiError.by_code.get(code, ApiError)
        detail = str(problem.get("detail") or problem.get("title") or f"HTTP status {status}")
        return kind(detail, status=status, title=str(problem.get("title", "")), code=code)


class Unauthorized(ApiError, code="unauthorized", advice="pass `connect(..., token=...)` a token that is valid"):
    """The network client has no valid access token."""


class Forbidden(
    ApiError, code="forbidden", advice="use a token of the role `operate`, and a host name that the daemon knows"
):
    """The access token, or the name of the host, does not allow this."""


class BadRequest(ApiError, code="bad-request", advice="correct the value that the message names"):
    """A value of the request is out of range."""


class NotFound(
    ApiError, code="not-found", advice="check the name or id; `patterns()` and `sessions()` list what there is"
):
    """There is no such pattern, play or session."""


class MethodNotAllowed(ApiError, code="method-not-allowed", advice="update daemon and package to the same version"):
    """The route does not take this method."""


class SlowRequest(ApiError, code="slow-request", advice="send it again; the network is slow"):
    """The request took too long to arrive."""


class Exists(ApiError, code="exists", advice="choose another name, or pass `replace=True`"):
    """The pattern's name is taken."""


class Disarmed(ApiError, code="disarmed", advice="call `arm()`"):
    """The motors are disarmed."""


class Faulted(ApiError, code="faulted", advice="find out why, then call `reset()` and `arm()`"):
    """An emergency stop or a fault is latched."""


class RecentEstop(ApiError, code="recent-estop", advice="ask who stopped; a person decides on `reset(force=True)`"):
    """Somebody else has ordered an emergency stop."""


class Returning(ApiError, code="returning", advice="wait a second and try again"):
    """The device returns pins to rest."""


class Playing(ApiError, code="playing", advice="`wait()` for the play, or call `stop()`"):
    """A play is queued or runs."""


class NothingToGoBy(
    ApiError,
    code="nothing-to-go-by",
    advice="level the pins by hand, `disarm()`, then `arm(assume_rest=True, checked='NAME')`",
):
    """Nothing tells where the pins are."""


class NotHome(ApiError, code="not-home", advice="look at the pins that the message names"):
    """Not all pins are at rest after homing."""


class ParticipantLimit(ApiError, code="participant-limit", advice="pause as long as the message says"):
    """A limit for the participant does not allow the play."""


class SessionExclusive(
    ApiError, code="session-exclusive", advice="wait for its end, or play through the client that owns it"
):
    """Only the session's owner may do that."""


class SessionRunning(ApiError, code="session-running", advice="end the running session first"):
    """Another session runs, or none."""


class SessionOver(SessionRunning):
    """The session of this client was ended by somebody else, or by a restart of the daemon. Nothing was played."""

    advice = "start another session, or leave this one with its `end()`"


class RenderingRunning(ApiError, code="rendering-running", advice="wait for its end, or cancel it"):
    """A rendering runs already."""


class BehindEndless(ApiError, code="behind-endless", advice="call `stop()`, or pass `replace=True`"):
    """The play in front has no end."""


class TooSoon(ApiError, code="too-soon", advice="give a later `at` or `on_edge`, 0.1 s ahead or more"):
    """The onset is too close or has passed."""


class Overlaps(ApiError, code="overlaps", advice="give an `at` after the end of the queued play"):
    """The onset lies within a queued play."""


class LineTooSlow(ApiError, code="line-too-slow", advice="use fewer drives, lower frequencies or fewer live updates"):
    """The line to the device does not carry the pattern."""


class StaleBoot(
    ApiError, code="stale-boot", advice="take a new instant: ticks of the device's earlier start mean nothing now"
):
    """The device has restarted."""


class PositionUnknown(ApiError, code="position-unknown", advice="level the pins, then `arm(assume_rest=True)`"):
    """The device does not know where its pins are."""


class DeviceRefused(ApiError, code="device-refused", advice="do as the message says"):
    """The device refused the command."""


class LowerStop(ApiError, code="lower-stop", advice="calibrate without the lower stop"):
    """The array has a lower stop."""


class PushLimit(ApiError, code="push-limit", advice="use fewer strokes or a smaller surplus"):
    """The play would push the lower stop too much."""


class TooDense(ApiError, code="too-dense", advice="make drives, repeats or items longer"):
    """More strokes of all motors would begin within 10 ms than the controller allows."""


class TooSlow(ApiError, code="too-slow", advice="make the motion slower or smaller, or play it without `strict`"):
    """A motor is too slow for its motion."""


class PowerLimit(ApiError, code="power-limit", advice="play with smaller amplitudes or fewer motors of a rail"):
    """More motors of a rail or a driver chip would have pulses at once than the configuration allows."""


class NoTelemetry(ApiError, code="no-telemetry", advice="calibrate with a laser"):
    """The device has no telemetry."""


class NoTriggerInput(ApiError, code="no-trigger-input", advice="play it without `on_edge`"):
    """The device has no trigger input."""


class DriftLimit(
    ApiError,
    code="drift-limit",
    advice="level the pins, then `arm(assume_rest=True, checked='NAME')`; with a calibration, `home()`",
):
    """Pins may be too far from rest."""


class LevelNotChecked(
    ApiError, code="level-not-checked", advice="look at the pins, then `arm(assume_rest=True, checked='NAME')`"
):
    """The pins may have drifted, and no person was named who has looked at them."""


class TooLarge(ApiError, code="too-large", advice="split the request"):
    """The request is too large."""


class BadPattern(ApiError, code="bad-pattern", advice="correct the line that the message names"):
    """The text is not a valid pattern."""


class Empty(ApiError, code="empty", advice="give more `seconds` or amplitude: no stroke fits"):
    """Nothing would be played."""


class QueueFull(ApiError, code="queue-full", advice="`wait()` for a play before you order more"):
    """Sixteen plays wait already."""


class OtherArray(ApiError, code="other-array", advice="find a pattern for this one by `design()`"):
    """The pattern is for another array than the daemon's."""


class StoreError(ApiError, code="store", advice="look at the disk of the daemon's PC"):
    """The daemon cannot use its files."""


class NoDevice(ApiError, code="no-device", advice="connect the board; `meissner doctor` helps"):
    """No device is connected."""


class Busy(ApiError, code="busy", advice="try again in a moment"):
    """Too many commands wait for the device."""


class TooManyClients(ApiError, code="too-many-clients", advice="close clients that are not needed"):
    """Too many clients are connected."""


class ShuttingDown(ApiError, code="shutting-down", advice="connect again when the daemon runs again"):
    """The daemon shuts down."""


class DeviceTimeout(ApiError, code="timeout", advice="look at the device and its cable; `meissner doctor` helps"):
    """The device does not answer."""
