"""A press of a key or button, and when it was."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ._arguments import hints
from .clocks import NS, Instant


@hints
@dataclass(frozen=True)
class Press:
    """A press of a key or button by a participant."""

    name: str
    """Which one."""
    monotonic_ns: int
    """This process's `time.monotonic_ns()`."""
    uncertainty: float
    """Uncertainty of that, s: how late the device may have told it."""
    least_reaction: float = 0.1
    """The least reaction time, s: whoever presses earlier after an onset did not react to it."""

    @property
    def monotonic(self) -> float:
        """This process's `time.monotonic()`, s."""
        return self.monotonic_ns / NS

    def after(self, onset: Instant) -> float:
        """The time since an onset, s."""
        if not isinstance(onset, Instant):
            raise TypeError(f"`onset` is {onset!r}: must be an instant, such as `play.onset`")
        return (self.monotonic_ns - onset.monotonic_ns) / NS

    def is_early(self, onset: Instant) -> bool:
        """Whether it came before anybody could react to an onset. The answer's factor `response_early` says so."""
        return self.after(onset) < self.least_reaction

    def at(self, onset: Instant) -> Instant:
        """The press on every clock, by an onset of about that time: the device's nearest tick, and the uncertainty of each clock, s."""
        after = self.after(onset)
        there = onset.later(after)
        return replace(
            there,
            host_uncertainty=there.monotonic_uncertainty + self.uncertainty,
            monotonic_uncertainty=there.monotonic_uncertainty + self.uncertainty,
            wall_uncertainty=there.wall_uncertainty + self.uncertainty,
        )
