"""Every clock conversion of the package: device ticks, the daemon's clock, and the clocks of this process.

Three clocks matter. The device counts ticks. The daemon reads `CLOCK_MONOTONIC` of its own PC and reports every onset on
it (`monotonic_ns`, with an uncertainty). Your program reads `time.monotonic()`, and perhaps `time.time()`. `ClientClock` maps
the second to the third, and `Instant` holds one event on all of them.

How it maps: the daemon reads its clock while it answers `GET /v1/status`. So that reading lies between the moments at which
the client sent the request and had the answer. Each answer bounds the offset between the two clocks, and the bounds of
all answers hold together, each widened by `MAX_SKEW` for the time that has passed. The middle of what remains is the
estimate, and half of its width is the uncertainty.

Invariant: while the clocks differ in rate by less than `MAX_SKEW`, no error exceeds the stated uncertainty.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from ._arguments import hints, number
from ._base import NotKnownYet

NS = 1_000_000_000
MAX_SKEW = 200e-6
"""Largest difference in rate between two PCs' clocks: quartz errs by up to 100e-6, and NTP corrects slowly."""
_MAX_SAMPLES = 64
_DAY = 86_400.0


@hints
@dataclass(frozen=True)
class Instant:
    """One moment of a play, on every clock."""

    tick: int
    """The device's clock, ticks. The device schedules by ticks, so this is exact: its uncertainty is 0."""
    boot: int | None
    """The device's start that the tick belongs to."""
    tick_hz: int
    """Nominal rate of the device's clock, Hz."""
    host_ns: int
    """`CLOCK_MONOTONIC` of the daemon's PC, ns."""
    host_uncertainty: float
    """Uncertainty of `host_ns`, s."""
    monotonic_ns: int
    """This process's `time.monotonic_ns()`."""
    monotonic_uncertainty: float
    """Uncertainty of `monotonic`, s."""
    wall_ns: int
    """This PC's wall clock, Unix time, ns."""
    wall_uncertainty: float
    """Uncertainty of `wall` against this PC's wall clock, s. It does not contain the wall clock's own error."""

    @property
    def monotonic(self) -> float:
        """This process's `time.monotonic()`, s."""
        return self.monotonic_ns / NS

    @property
    def wall(self) -> float:
        """This PC's wall clock, Unix time, s."""
        return self.wall_ns / NS

    def later(self, seconds: float) -> Instant:
        """The instant `seconds` later, at a whole tick. As the `at` of a play it makes the distance exact to the tick."""
        ticks = round(number("seconds", seconds) * self.tick_hz)
        shift_ns = round(ticks * NS / self.tick_hz)
        widened = abs(ticks) / self.tick_hz * MAX_SKEW
        return replace(
            self,
            tick=self.tick + ticks,
            host_ns=self.host_ns + shift_ns,
            host_uncertainty=self.host_uncertainty + widened,
            monotonic_ns=self.monotonic_ns + shift_ns,
            monotonic_uncertainty=self.monotonic_uncertainty + widened,
            wall_ns=self.wall_ns + shift_ns,
            wall_uncertainty=self.wall_uncertainty + widened,
        )


@dataclass(frozen=True)
class _Sample:
    """The client's clock minus the daemon's lies from `low` to `high` when the daemon's clock shows `host`, ns."""

    host: int
    low: int
    high: int

    def bounds(self, host: int) -> tuple[int, int]:
        widened = round(abs(host - self.host) * MAX_SKEW)
        return self.low - widened, self.high + widened

    def is_implied_by(self, other: _Sample) -> bool:
        low, high = other.bounds(self.host)
        return low >= self.low and high <= self.high


class ClientClock:
    """Maps the daemon's `CLOCK_MONOTONIC` to this process's clocks. Threads may share one."""

    def __init__(
        self,
        *,
        same_machine: bool = False,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """`same_machine`: both clocks may be one. The clock believes it only while every answer agrees."""
        self._monotonic_ns = monotonic_ns
        self._wall_ns = wall_ns
        self._lock = threading.Lock()
        self._samples: list[_Sample] = []
        self._is_shared = same_machine
        self.restarts = 0
        """How often an answer contradicted the earlier ones, because a clock was set or a PC slept."""

    def now_ns(self) -> int:
        """This process's clock, ns."""
        return self._monotonic_ns()

    def check(self, at: float) -> None:
        """Raises `ValueError` for an onset that is a time of another clock than this process's `time.monotonic()`, or no seconds."""
        now, wall = self.now_ns(), self._wall_ns()
        others = {"time.time()": wall / NS, "time.time_ns()": wall, "time.monotonic_ns()": now}
        for name, value in others.items():
            # Within a day of that clock, and farther than that from this one.
            unit = NS if name.endswith("_ns()") else 1
            if abs(at - value) / unit < _DAY < abs(at - now / NS):
                raise ValueError(
                    f"`at` is {at:.0f}, which is a time of `{name}`: give seconds of `time.monotonic()`, such as `m.now() + 0.5`"
                )

    @property
    def is_shared(self) -> bool:
        """Whether daemon and client read the same clock, so that nothing is uncertain between them."""
        return self._is_shared and bool(self._samples)

    @property
    def has_samples(self) -> bool:
        """Whether the clock can convert anything yet."""
        return bool(self._samples)

    def add(self, sent_ns: int, received_ns: int, host_ns: int) -> None:
        """Takes one answer: when it was asked for and received, and the daemon's clock in between."""
        sample = _Sample(host_ns, sent_ns - host_ns, received_ns - host_ns)
        with self._lock:
            if not sample.low <= 0 <= sample.high:
                self._is_shared = False
            low, high = self._bounds(host_ns)
            if sample.low > high or sample.high < low:
                self._samples.clear()
                self.restarts += 1
            if not any(sample.is_implied_by(other) for other in self._samples):
                self._samples = [other for other in self._samples if not other.is_implied_by(sample)]
                self._samples.append(sample)
                del self._samples[:-_MAX_SAMPLES]

    def _bounds(self, host_ns: int) -> tuple[int, int]:
        low, high = -(1 << 80), 1 << 80
        for sample in self._samples:
            sample_low, sample_high = sample.bounds(host_ns)
            low, high = max(low, sample_low), min(high, sample_high)
        return low, high

    def _offset(self, host_ns: int) -> tuple[int, int]:
        """The client's clock minus the daemon's, and its uncertainty, ns."""
        with self._lock:
            if not self._samples:
                raise NotKnownYet(
                    "no device was connected when the clocks were compared: connect one, then call `status()`"
                )
            if self._is_shared:
                return 0, 0
            low, high = self._bounds(host_ns)
        return (low + high) // 2, (high - low + 1) // 2

    def to_client(self, host_ns: int) -> tuple[int, int]:
        """The client's clock at an instant of the daemon's clock, and its uncertainty, ns."""
        offset, uncertainty = self._offset(host_ns)
        return host_ns + offset, uncertainty

    def to_host(self, monotonic_ns: int) -> tuple[int, int]:
        """The daemon's clock at an instant of the client's clock, and its uncertainty, ns."""
        host_ns = monotonic_ns
        # The offset belongs to an instant of the daemon's clock, which the first round does not know yet.
        for _ in range(2):
            offset, uncertainty = self._offset(host_ns)
            host_ns = monotonic_ns - offset
        return host_ns, uncertainty

    def other(self, read_ns: Callable[[], int]) -> tuple[int, int]:
        """Another clock of this machine minus the client's clock, and the uncertainty of having read one after the other, ns."""
        best = (0, 1 << 62)
        for _ in range(3):
            before, there, after = self._monotonic_ns(), read_ns(), self._monotonic_ns()
            width = after - before
            if width < best[1]:
                best = (there - (before + after) // 2, width)
        return best[0], (best[1] + 1) // 2

    def on_other(self, read_ns: Callable[[], int], monotonic_ns: int, uncertainty: float) -> tuple[float, float]:
        """An instant of the client's clock, known to `uncertainty` s, on another clock of this machine, and its uncertainty, s."""
        offset, width = self.other(read_ns)
        drift = abs(self.now_ns() - monotonic_ns) * MAX_SKEW
        return (monotonic_ns + offset) / NS, uncertainty + (width + drift) / NS

    def instant(self, *, tick: int, boot: int | None, tick_hz: int, host_ns: int, host_uncertainty_ns: int) -> Instant:
        """An event that the daemon reported, on every clock."""
        monotonic_ns, uncertainty = self.to_client(host_ns)
        uncertainty += host_uncertainty_ns
        wall_offset, wall_uncertainty = self.other(self._wall_ns)
        return Instant(
            tick=tick,
            boot=boot,
            tick_hz=tick_hz,
            host_ns=host_ns,
            host_uncertainty=host_uncertainty_ns / NS,
            monotonic_ns=monotonic_ns,
            monotonic_uncertainty=uncertainty / NS,
            wall_ns=monotonic_ns + wall_offset,
            wall_uncertainty=(uncertainty + wall_uncertainty) / NS,
        )
