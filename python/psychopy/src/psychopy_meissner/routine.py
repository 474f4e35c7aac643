"""A play within a routine of Builder: ordered ahead of its start, and saved with the times at which it really was.

An exported script calls `plan` in each frame until the start, `start` in the frame of the start, and `finish` at the routine's end.
A thread orders the play and waits for its receipt, so that no frame waits for the daemon. Nothing here imports PsychoPy.

Invariant: after `finish` the play is over.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import meissner
from meissner.errors import MeissnerError, TooSoon

if TYPE_CHECKING:
    from .device import ClockReading, MeissnerDevice

GRACE = 0.05
"""A play that ends by itself within this time is not stopped, s: its last strokes would be lost to the length of a frame."""
PATIENCE = 15.0
"""How long the receipt of a play that is over may take, s: longer than a client looks for a daemon that was there before."""


class TactilePlay:
    """What the component is in the script: PsychoPy sets `status` and the times of frames, the rest is the play."""

    def __init__(self, device: MeissnerDevice, ahead: float | None = None) -> None:
        """`ahead`: how long before its start the play is ordered, s; None: 0.2."""
        self.device, self.ahead = device, 0.2 if ahead is None else ahead
        self.status: Any = None
        self.pattern: str | Mapping[str, Any] = ""
        self.scale = 1.0
        self.seconds: float | None = None
        self.reset()

    def reset(self) -> None:
        """Forget the play of the routine before."""
        self.planned: float | None = None
        """The planned onset on PsychoPy's clock, s; None: as soon as possible."""
        self._clock: ClockReading | None = None
        """PsychoPy's clock when the play was ordered: a pause sets that clock back later."""
        self._thread: threading.Thread | None = None
        self._accepted, self._over, self._is_stopping = False, threading.Event(), False
        self._play: meissner.Play | None = None
        self._end = math.inf
        self._error: BaseException | None = None

    def setPattern(self, pattern: str | Mapping[str, Any]) -> None:
        """The pattern's name; or a dict with the keys of a pattern file, or with `samples` and `rate`, or `drives`, as `play` takes them."""
        self.pattern = pattern

    def _what(self) -> dict[str, Any]:
        """What is played, as arguments of `play`."""
        given = self.pattern
        if isinstance(given, str) or not given.keys() & {"samples", "drives"}:
            return {"pattern": given}
        return dict(given)

    def setSeconds(self, seconds: float | None = None) -> None:
        """Duration, s; None: the pattern's."""
        # A conditions file gives numbers of NumPy, which JSON does not take.
        self.seconds = None if seconds is None else float(seconds)

    def setScale(self, scale: float | None = None) -> None:
        """Factor of the amplitudes, 0 to 1; None: 1."""
        self.scale = 1.0 if scale is None else float(scale)

    def plan(self, start: float, flip: float, flip_global: float, period: float | None = None) -> None:
        """Order the play if its start is near enough.

        `start` and `flip`, the next refresh of the screen, are on the routine's clock, `flip_global` is that refresh on the
        experiment's, s. With the `period` of refreshes, s, the onset is planned for the refresh at which a visual stimulus
        with this start appears; without it for `start` itself.
        """
        if self._thread is None and start - flip <= self.ahead:
            wait = start - flip
            if period is not None:
                # As Builder does: a stimulus appears at the first refresh that is less than 1 ms before its start.
                wait = period * max(0, math.ceil((wait - 0.001) / period))
            self._order(flip_global + wait)

    def start(self, onset: float | None) -> None:
        """Order the play now, unless it was ordered ahead. `onset`: on PsychoPy's clock, s; None: as soon as possible."""
        if self._thread is None:
            self._order(onset)
        self.check()

    def _order(self, onset: float | None) -> None:
        self.planned = onset
        self._clock = self.device.readClock()
        at = None if onset is None else self.device.fromExperimentClock(onset, self._clock)
        self._thread = threading.Thread(target=self._run, args=(at,), name="meissner-play", daemon=True)
        self._thread.start()

    def _run(self, at: float | None) -> None:
        client = self.device.client
        try:
            try:
                play = client.play(**self._what(), seconds=self.seconds, at=at, scale=self.scale)
            except TooSoon:
                if self._is_stopping:
                    return
                at = None
                play = client.play(**self._what(), seconds=self.seconds, scale=self.scale)
            duration = math.inf if play.ordered_s is None else play.ordered_s
            if at is not None:
                self._end = at + duration
            self._play, self._accepted = play, True
            if self._is_stopping:
                self._stop_unless_ending()
            # Without an ordered onset the play may wait behind another: only the receipt tells when it begins.
            while at is None and not (receipt := play.refresh()).is_over:
                if receipt.onset is not None:
                    self._end = receipt.onset.monotonic + duration
                    break
                time.sleep(0.02)
            play.wait(check=False)
        except BaseException as error:
            self._error = error
        finally:
            self._over.set()

    def check(self) -> None:
        """Raise the error with which the daemon has refused the play, if it has."""
        if self._error is not None:
            raise self._error

    @property
    def isOver(self) -> bool:
        """Whether the play has ended. Raises the error with which the daemon has refused it."""
        self.check()
        return self._over.is_set()

    def stop(self) -> None:
        """Stop the play, and with it all plays that wait, unless it ends by itself within 50 ms."""
        # If the daemon has not accepted the play yet, the thread stops it: no frame waits.
        self._is_stopping = True
        if self._accepted:
            self._stop_unless_ending()

    def _stop_unless_ending(self) -> None:
        if not self._over.is_set() and self._end - self.device.client.now() > GRACE:
            self.device.stop()

    def finish(self) -> dict[str, Any]:
        """End the play, and return the columns of the experiment's data. Without a play `state` is `not-played`."""
        if self._thread is None:
            return {"state": "not-played"}
        self.stop()
        if not self._over.wait(PATIENCE):
            self.device.estop()
            raise MeissnerError(
                f"the play of `{self.pattern if isinstance(self.pattern, str) else 'inline'}` has no end after {PATIENCE:.0f} s, so all lines were switched off: "
                "see `meissner receipt`"
            )
        self.check()
        if self._play is None:
            return {"state": "not-played"}
        receipt = self._play.receipt
        columns: dict[str, Any] = {
            "play_id": receipt.id,
            "pattern": receipt.pattern,
            "scale": self.scale,
            "state": receipt.state,
            "cause": receipt.cause,
            "late_strokes": receipt.late,
            "planned": self.planned,
        }
        for name, instant in (("onset", receipt.onset), ("offset", receipt.offset)):
            if instant is not None:
                columns[name], columns[f"{name}_uncertainty"] = self.device.onExperimentClock(instant, self._clock)
                columns[f"{name}_tick"] = instant.tick
        columns |= {"array": receipt.array, "tick_hz": receipt.tick_hz}
        return columns
