"""Lab streaming layer: markers with the true onsets, telemetry, and plays on incoming markers. It needs `pylsl`: `pip install 'pylsl>=1.18'`.

    with meissner.connect() as m, lsl.Bridge(m):
        ...                                  # experiment as usual; every play makes markers

A `Bridge` runs beside a program, in threads of its own; the command `meissner-lsl` runs one beside any program. Markers are
sent as soon as the daemon knows, some ms later, but stamped with the instant on LSL's clock at which the play began or ended: from
the device's tick by the daemon's clock and this process's (`clocks.py`), then by LSL's, which is read between two readings of the latter.

Invariant: a marker's time errs by at most its `uncertainty`.
"""

from __future__ import annotations

import collections
import contextlib
import threading
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import TracebackType
from typing import TYPE_CHECKING, Any

from ._arguments import hints
from ._operations import Core
from .clocks import NS, Instant
from .errors import MeissnerError
from .results import Receipt, Status

if TYPE_CHECKING:
    from .client import Client

_KEPT = 1000


def needs_pylsl() -> Any:
    """The package pylsl with its library."""
    try:
        import pylsl
    except (ImportError, RuntimeError) as error:
        raise ImportError(f"LSL needs the package pylsl: pip install 'pylsl>=1.18' ({error})") from error
    return pylsl


@dataclass(frozen=True)
class Marker:
    """A marker that was sent."""

    text: str
    time: float
    """LSL's clock, s."""
    uncertainty: float
    """Of `time`, s."""
    play: int


@dataclass(frozen=True)
class Trigger:
    """Which plays incoming markers order."""

    stream: str
    """The name of the stream."""
    plays: Mapping[str, str]
    """The pattern for each marker's text. Other markers order nothing."""
    seconds: float | None = None
    """The duration of each play, s; None: the pattern's."""
    delay: float | None = None
    """From the marker's time to the onset, s; None: as soon as possible."""


def text_of(what: str, pattern: str, raw: Mapping[str, Any]) -> str:
    """The text of a marker: `onset/NAME` and `offset/NAME` of a play, `item/NAME` for the onset of each item of a sequence.

    A `Bridge` takes another function of these arguments; `raw` has the keys of the receipt, with `trial` and `labels`.
    """
    return f"{what}/{pattern}"


@hints
class Bridge:
    """Sends markers and telemetry of a daemon to LSL, and plays on incoming markers. Runs until its block ends."""

    def __init__(
        self,
        client: Client,
        *,
        name: str = "meissner",
        text: Callable[[str, str, Mapping[str, Any]], str] = text_of,
        telemetry_hz: float = 10.0,
        trigger: Trigger | None = None,
        report: Callable[[str], None] = warnings.warn,
    ) -> None:
        """`name` begins the streams' names. `telemetry_hz`: 0 for none. `report` takes lines about what went wrong, as it happens.

        What ends the bridge before its block is raised at the block's end, too.
        """
        self._lsl = needs_pylsl()
        self._of, self._name, self._text, self._report = client.core, name, text, report
        self._telemetry_hz, self._trigger = telemetry_hz, trigger
        self._sent: collections.deque[Marker] = collections.deque(maxlen=_KEPT)
        self._under_way: set[int] = set()
        self._newest_over = 0
        self.failure: BaseException | None = None
        """What has ended the bridge."""
        # Which device it is, for the streams; and whether the daemon answers.
        status, self._array = client.status(), client.array
        self._markers = self._outlet("Markers", "markers", 0.0, "string", ["marker"], "", status)
        self._telemetry: Any = None
        if telemetry_hz > 0:
            pins = [f"pin_{pin}" for pin in range(self._array.motors)]
            self._telemetry = self._outlet("Telemetry", "telemetry", 0.0, "float32", pins, "microns", status)
        self._listens = threading.Event()
        self._over = threading.Event()
        self._ended = threading.Event()
        self._is_waited_for = False
        self._thread = threading.Thread(target=self._run, name="meissner-lsl", daemon=True)

    def _outlet(
        self, kind: str, name: str, rate: float, values: str, channels: list[str], unit: str, status: Status
    ) -> Any:
        raw = status.raw["device"]
        device = status.raw["device_identity"] or (raw and raw["kind"]) or "no device"
        # The same after a restart, so that a recorder finds the stream again.
        source = f"{self._name}/{device}/{name}"
        info = self._lsl.StreamInfo(f"{self._name}-{name}", kind, len(channels), rate, values, source)
        about = info.desc()
        about.append_child_value("manufacturer", "meissner")
        about.append_child_value("device", device)
        about.append_child_value("array", self._array.name)
        about.append_child_value("simulated", str(status.simulated).lower())
        about.append_child_value("daemon_version", status.raw["version"])
        channel_list = about.append_child("channels")
        for label in channels:
            channel = channel_list.append_child("channel")
            channel.append_child_value("label", label)
            channel.append_child_value("type", kind)
            if unit:
                channel.append_child_value("unit", unit)
        synchronisation = about.append_child("synchronization")
        synchronisation.append_child_value("offset_mean", "0")
        synchronisation.append_child_value("can_drop_samples", "false" if kind == "Markers" else "true")
        return self._lsl.StreamOutlet(info)

    @property
    def markers(self) -> tuple[Marker, ...]:
        """The latest markers that were sent, at most 1 000."""
        return tuple(self._sent)

    def __enter__(self) -> Bridge:
        self._thread.start()
        self._listens.wait()
        if self.failure is not None:
            self.close()
            raise self.failure
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
        if self.failure is not None and kind is None:
            raise self.failure

    def wait(self) -> None:
        """Wait until the bridge ends, which it does by itself only after an error."""
        self._is_waited_for = True
        # Python 3.11 takes a thread for ended whose `join` Ctrl-C has interrupted, and Windows does not interrupt a wait without end.
        while not self._ended.wait(0.5):
            pass
        if self.failure is not None:
            raise self.failure

    def close(self) -> None:
        """End the bridge and its streams."""
        self._over.set()
        self._thread.join()
        self._markers = self._telemetry = None

    def _run(self) -> None:
        from .client import Client

        try:
            # The clock is shared; what the experiment's client has armed, the bridge does not disarm.
            m = Client(replace(self._of, has_armed=False))
            works: list[Callable[[Client], None]] = [self._send_markers]
            if self._telemetry is not None:
                works.append(self._send_telemetry)
            if (trigger := self._trigger) is not None:
                works.append(lambda m: self._play_on(m, trigger))
            threads = [
                threading.Thread(target=self._until_over, args=(work, m), name="meissner-lsl", daemon=True)
                for work in works
            ]
            try:
                # Plays that were over before have no markers.
                with contextlib.suppress(MeissnerError):
                    newest = m.receipt()
                    self._newest_over = newest.id if newest.is_over else newest.id - 1
                for thread in threads:
                    thread.start()
                self._over.wait()
                if self.failure is None:
                    self._send_last(m)
            finally:
                self._over.set()
                # It ends the events, too.
                m.close()
                for thread in threads:
                    thread.join()
        except BaseException as error:
            self.failure = self.failure or error
        finally:
            # Whoever waits has the error at once.
            if self.failure is not None and self._listens.is_set() and not self._is_waited_for:
                self._report(f"markers and telemetry have ended: {str(self.failure) or type(self.failure).__name__}")
            self._listens.set()
            self._ended.set()

    def _until_over(self, work: Callable[[Client], None], m: Client) -> None:
        """A thread: what ends it before the bridge's end has ended the bridge."""
        try:
            work(m)
        except BaseException as error:
            if not self._over.is_set():
                self.failure = error
        finally:
            self._over.set()

    def _send_last(self, m: Client) -> None:
        """Waits for the markers of plays that are over already: their events are on their way."""
        deadline = time.monotonic() + 1.0
        with contextlib.suppress(MeissnerError):
            while time.monotonic() < deadline:
                newest = m.receipt()
                unseen = newest.is_over and newest.id > self._newest_over
                if not unseen and not any(m.receipt(play).is_over for play in list(self._under_way)):
                    return
                time.sleep(0.01)

    def lsl_time(self, core: Core, instant_ns: int, uncertainty_s: float) -> tuple[float, float]:
        """An instant of this process's clock on LSL's clock, and its uncertainty, s."""
        return core.clock.on_other(lambda: round(self._lsl.local_clock() * NS), instant_ns, uncertainty_s)

    def _mark(self, core: Core, what: str, pattern: str, at: Instant | None, receipt: Receipt) -> None:
        if at is None:
            return
        time, uncertainty = self.lsl_time(core, at.monotonic_ns, at.monotonic_uncertainty)
        text = self._text(what, pattern, receipt.raw)
        # First, so that who receives it finds it in `markers`.
        self._sent.append(Marker(text, time, uncertainty, receipt.id))
        self._markers.push_sample([text], time)

    def _send_markers(self, m: Client) -> None:
        for event in m.events():
            # The first event says that the daemon has begun to report.
            self._listens.set()
            if event.name == "reconnected":
                self._report("the connection was lost: markers in between are missing")
            if event.name not in ("began", "ended"):
                continue
            play = event["id"] if event.name == "began" else event["receipt"]["id"]
            try:
                if not m.core.clock.is_shared:
                    m.status()
                receipt = m.receipt(play)
            except MeissnerError as error:
                self._report(f"no marker of play {play}: {error}")
                continue
            if event.name == "began":
                self._under_way.add(play)
                self._mark(m.core, "onset", receipt.pattern, receipt.onset, receipt)
            else:
                for item in receipt.items:
                    self._mark(m.core, "item", item.pattern, item.onset, receipt)
                self._mark(m.core, "offset", receipt.pattern, receipt.offset, receipt)
                self._under_way.discard(play)
                self._newest_over = play

    def _send_telemetry(self, m: Client) -> None:
        """The estimated offset of each pin from rest, as the status has it."""
        while not self._over.wait(1 / self._telemetry_hz):
            with contextlib.suppress(MeissnerError):
                status = m.status()
                clock, motors = status.raw["clock"], status.raw["motors"]
                if clock is not None and len(motors) == self._array.motors:
                    at_ns, uncertainty = m.core.clock.to_client(clock["monotonic_ns"])
                    time, _ = self.lsl_time(m.core, at_ns, uncertainty / NS)
                    self._telemetry.push_sample([motor["rest_error_um"] for motor in motors], time)

    def _play_on(self, m: Client, trigger: Trigger) -> None:
        inlet = self._find(trigger.stream)
        while not self._over.is_set():
            sample, time = inlet.pull_sample(0.1)
            pattern = trigger.plays.get(sample[0]) if sample else None
            if pattern is None or self._over.is_set():
                continue
            offset, _ = m.core.clock.other(lambda: round(self._lsl.local_clock() * NS))
            at = None if trigger.delay is None else time + trigger.delay - offset / NS
            # A session that the experiment has begun since.
            m.core.session = self._of.session
            try:
                m.play(pattern, trigger.seconds, at=at)
            except MeissnerError as error:
                self._report(f"no play on the marker {sample[0]}: {error}")

    def _find(self, stream: str) -> Any:
        """An inlet of this stream with times on this machine's clock. Waits until there is one."""
        while not self._over.is_set():
            found = self._lsl.resolve_byprop("name", stream, timeout=0.5)
            if found:
                return self._lsl.StreamInlet(found[0], processing_flags=self._lsl.proc_clocksync)
        return None
