"""What the daemon answers, as typed values. Each keeps the whole document in `raw`, with the keys of the API reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .clocks import ClientClock, Instant


@dataclass(frozen=True)
class Status:
    """How the daemon and its device stand."""

    state: str
    """`disarmed`, `armed`, `returning`, `faulted` or `no-device`."""
    cause: str
    position: str
    """`known` or `unknown`."""
    simulated: bool
    """Whether the motors are simulated; False without a device."""
    playing: int | None
    """The running play's id."""
    queued: tuple[int, ...]
    """The ids of the plays that wait."""
    raw: dict[str, Any] = field(repr=False)

    @staticmethod
    def of(raw: dict[str, Any]) -> Status:
        """The status in a document."""
        return Status(
            state=raw["state"],
            cause=raw["cause"],
            position=raw["position"],
            simulated=bool(raw["device"] and raw["device"]["simulated"]),
            playing=raw["play"]["id"] if raw["play"] else None,
            queued=tuple(play["id"] for play in raw["queued"]),
            raw=raw,
        )


@dataclass(frozen=True)
class PlanCheck:
    """Whether a plan would come to its end on a board."""

    ends: bool
    """Whether it comes to its end."""
    stopped_at: int | None
    """The number of the item, from 0, in which a pin would pass the drift limit; None: no pin does."""
    stopped_after: float | None
    """When, s from the onset of the plan."""
    drift_um: float
    """The largest estimate of a pin's distance from rest, root mean square, µm: at the end, or when the plan stops."""
    limit_um: float
    """The daemon's `drift_limit_um`, µm."""
    motor: int
    """The motor of that pin."""
    raw: dict[str, Any] = field(repr=False)

    @staticmethod
    def of(raw: dict[str, Any]) -> PlanCheck:
        """The answer in a document."""
        stop = raw["stopped_at"]
        return PlanCheck(
            ends=stop is None and raw["followed_ms"] is None,
            stopped_at=stop and stop["item"],
            stopped_after=stop and stop["after_ms"] / 1000,
            drift_um=raw["drift_um"],
            limit_um=raw["drift_limit_um"],
            motor=raw["motor"],
            raw=raw,
        )


def reached_um(item: Mapping[str, Any]) -> float | None:
    """What the drives of an item reach, µm; None: not known. A motion without drives is recorded as 0."""
    reached: float | None = item["reached_um"]
    return None if reached == 0 and item["ordered_um"] else reached


@dataclass(frozen=True)
class Item:
    """What became of an item of a play."""

    pattern: str
    state: str
    """`played`, `incomplete`, `cut` or `not-begun`."""
    onset: Instant | None
    offset: Instant | None
    scale: float
    reached_um: float | None
    """The largest amplitude that its drives reach, peak to peak, µm, by the motor model; None: not known, as of motions."""
    raw: dict[str, Any] = field(repr=False)


@dataclass(frozen=True)
class LiveResult:
    """What became of an update of a live play."""

    state: str
    """`applied`: the device has it; `merged`: a newer update took its place before it was sent."""
    merged_into: int | None
    """The number of the newer update."""
    ticks: tuple[int | None, ...]
    """For each motor the tick from which it has its new drive; None: it had it before, or gets it with a later update."""
    onset: Instant | None
    """When the first motor has its new drive, on every clock; None: this update changed no motor."""
    repeats: int
    """How often the device got it too late for some motor, so that the daemon sent it again."""
    raw: dict[str, Any] = field(repr=False)


@dataclass(frozen=True)
class Receipt:
    """What became of a play."""

    id: int
    pattern: str
    state: str
    """`queued`, `running`, `done`, `stopped` or `aborted`."""
    cause: str | None
    onset: Instant | None
    offset: Instant | None
    start_edge: Instant | None
    """The edge of the trigger input that it waited for, of a play that is over; its number is in `raw`."""
    stop_edge: Instant | None
    """The edge that stopped it."""
    late: int
    """Number of strokes that came too late; the device left them out."""
    items: tuple[Item, ...]
    """What it has played, each pattern with its times; empty until it is over."""
    array: str
    """The name of the array that was driven."""
    tick_hz: int
    """Ticks per second of its device's clock."""
    raw: dict[str, Any] = field(repr=False)

    @property
    def is_over(self) -> bool:
        """Whether the play has ended."""
        return self.state not in ("queued", "running")

    @property
    def reached_um(self) -> float | None:
        """The largest amplitude that the drives reach, peak to peak, µm, by the motor model, whatever was ordered.

        Of several items once the play is over. None: not known, as of motions.
        """
        drives: list[float] = [drive["reached_um"] for drive in self.raw["reach"]["drives"]]
        return max(drives + [item.reached_um for item in self.items if item.reached_um is not None], default=None)

    @staticmethod
    def of(raw: dict[str, Any], clock: ClientClock) -> Receipt:
        """The receipt in a document, with instants by this clock."""
        device, edges, lateness = raw["device"], raw["edges"], raw["counts"]["lateness"]

        def instant(record: dict[str, Any] | None, tick: str = "tick") -> Instant | None:
            if record is None:
                return None
            return clock.instant(
                tick=record[tick],
                boot=device["boot"],
                tick_hz=device["tick_hz"],
                host_ns=record["monotonic_ns"],
                host_uncertainty_ns=record["uncertainty_ns"],
            )

        return Receipt(
            id=raw["id"],
            pattern=raw["name"],
            state=raw["state"],
            cause=raw["cause"],
            onset=instant(raw["onset"], "actual_tick"),
            offset=instant(raw["offset"]),
            start_edge=instant(edges["start"]),
            stop_edge=instant(edges["stop"]),
            late=lateness["host"] + lateness["link"] + lateness["device"],
            items=tuple(
                Item(
                    pattern=item["pattern"],
                    state=item["state"],
                    onset=instant(item["onset"]),
                    offset=instant(item["offset"]),
                    scale=item["scale"],
                    reached_um=reached_um(item),
                    raw=item,
                )
                for item in raw["items"] or ()
            ),
            array=device["array"],
            tick_hz=device["tick_hz"],
            raw=raw,
        )
