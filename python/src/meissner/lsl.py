"""Lab streaming layer: markers with the true onsets. It needs `pylsl`: `pip install 'pylsl>=1.18'`.

    with meissner.connect() as m, lsl.Bridge(m):
        ...                                  # experiment as usual; every play makes markers

A `Bridge` runs beside a program, in threads of its own; the command `meissner-lsl` runs one beside any program. Markers are
sent as soon as the daemon knows, some ms later, but stamped with the instant on LSL's clock at which the play began or ended: from
the device's tick by the daemon's clock and this process's (`clocks.py`), then by LSL's, which is read between two readings of the latter.

Invariant: a marker's time errs by at most its `uncertainty`.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import sys
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


def text_of(what: str, pattern: str, raw: Mapping[str, Any]) -> str:
    """The text of a marker: `onset/NAME` and `offset/NAME` of a play, `item/NAME` for the onset of each of several items.

    A `Bridge` takes another function of these arguments; `raw` has the keys of the receipt, with `trial` and `labels` in `order`.
    """
    return f"{what}/{pattern}"


@hints
class Bridge:
    """Sends markers of a daemon to LSL. Runs until its block ends."""

    def __init__(
        self,
        client: Client,
        *,
        name: str = "meissner",
        text: Callable[[str, str, Mapping[str, Any]], str] = text_of,
        report: Callable[[str], None] = warnings.warn,
    ) -> None:
        """`name` begins the stream's name. `report` takes lines about what went wrong, as it happens.

        What ends the bridge before its block is raised at the block's end, too.
        """
        self._lsl = needs_pylsl()
        self._of, self._name, self._text, self._report = client.core, name, text, report
        self._sent: collections.deque[Marker] = collections.deque(maxlen=_KEPT)
        self._under_way: set[int] = set()
        self._newest_over = 0
        self.failure: BaseException | None = None
        """What has ended the bridge."""
        self._markers: Any = self._outlet(client.status(), client.array.name)
        self._listens = threading.Event()
        self._ended = threading.Event()
        self._is_closing = self._is_waited_for = False

    def _outlet(self, status: Status, array: str) -> Any:
        raw = status.raw["device"]
        device = status.raw["link"]["identity"] or (raw and raw["kind"]) or "no device"
        # The same after a restart, so that a recorder finds the stream again.
        source = f"{self._name}/{device}/markers"
        info = self._lsl.StreamInfo(f"{self._name}-markers", "Markers", 1, 0.0, "string", source)
        about = info.desc()
        for key, value in (
            ("manufacturer", "meissner"),
            ("device", device),
            ("array", array),
            ("simulated", str(status.simulated).lower()),
            ("daemon_version", status.raw["daemon"]["version"]),
        ):
            about.append_child_value(key, value)
        channel = about.append_child("channels").append_child("channel")
        channel.append_child_value("label", "marker")
        channel.append_child_value("type", "Markers")
        synchronisation = about.append_child("synchronization")
        synchronisation.append_child_value("offset_mean", "0")
        synchronisation.append_child_value("can_drop_samples", "false")
        return self._lsl.StreamOutlet(info)

    @property
    def markers(self) -> tuple[Marker, ...]:
        """The latest markers that were sent, at most 1 000."""
        return tuple(self._sent)

    def __enter__(self) -> Bridge:
        from .client import Client

        # The clock is shared; what the experiment's client has armed, the bridge does not disarm.
        self._client = Client(replace(self._of, has_armed=False))
        # Plays that were over before have no markers.
        with contextlib.suppress(MeissnerError):
            newest = self._client.receipt()
            self._newest_over = newest.id if newest.is_over else newest.id - 1
        self._thread = threading.Thread(target=self._run, name="meissner-lsl", daemon=True)
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
        """End the bridge and its stream."""
        if self.failure is None:
            self._send_last()
        self._is_closing = True
        # It ends the events, too.
        self._client.close()
        self._thread.join()
        self._markers = None

    def _run(self) -> None:
        """The thread: what ends it before `close` has ended the bridge."""
        try:
            self._send_markers(self._client)
        except BaseException as error:
            if not self._is_closing:
                self.failure = error
        finally:
            # Whoever waits has the error at once.
            if self.failure is not None and self._listens.is_set() and not self._is_waited_for:
                self._report(f"markers have ended: {str(self.failure) or type(self.failure).__name__}")
            self._listens.set()
            self._ended.set()

    def _send_last(self) -> None:
        """Waits for the markers of plays that are over already: their events are on their way."""
        m, deadline = self._client, time.monotonic() + 1.0
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
                for item in receipt.items if len(receipt.items) > 1 else ():
                    self._mark(m.core, "item", item.pattern, item.onset, receipt)
                self._mark(m.core, "offset", receipt.pattern, receipt.offset, receipt)
                self._under_way.discard(play)
                self._newest_over = play


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="meissner-lsl", description="Send markers of a meissner daemon to LSL, until Ctrl-C."
    )
    parser.add_argument("--address", help="connect to this socket or URL [default: as meissner.connect() does]")
    parser.add_argument("--token", help="access token of a daemon on the network [default: $MEISSNER_TOKEN]")
    parser.add_argument("--name", default="meissner", help="begin the name of the stream with NAME [default: meissner]")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Runs the command."""
    asked = _parser().parse_args(arguments)

    def report(line: str) -> None:
        print(f"meissner-lsl: {line}", file=sys.stderr, flush=True)

    from . import connect

    try:
        with connect(asked.address, token=asked.token) as m:
            bridge = Bridge(m, name=asked.name, report=report)
            with bridge, contextlib.suppress(KeyboardInterrupt):
                print(
                    f"sending markers of {m.core.endpoint.name} as `{asked.name}-markers`; Ctrl-C ends it", flush=True
                )
                bridge.wait()
    except (MeissnerError, ImportError) as error:
        report(str(error))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
