"""The array that a daemon drives: its pins, its carrier and its motors.

`Client.array` reads it once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ._arguments import hints, number


@hints
@dataclass(frozen=True)
class Array:
    """An array of pins."""

    name: str
    positions_mm: tuple[tuple[float, float], ...]
    """The place of each motor's pin, mm: x across the finger, y towards its tip. The index is the motor's number."""
    grid: tuple[int, int] | None
    """Rows and columns, if the pins stand in such: a motor's number is columns times row plus column."""
    pitch_mm: float
    """The smallest distance of two pins, mm."""
    tick_hz: int
    """Ticks of the device's clock a second, and pulses a second."""
    raw: dict[str, Any] = field(repr=False)
    """The whole document, with the keys of the API reference."""

    @staticmethod
    def of(raw: dict[str, Any]) -> Array:
        """The array in a document."""
        grid = raw["grid"]
        return Array(
            name=raw["name"],
            positions_mm=tuple((x, y) for x, y in raw["positions_mm"]),
            grid=None if grid is None else (grid["rows"], grid["columns"]),
            pitch_mm=raw["pitch_mm"],
            tick_hz=raw["tick_hz"],
            raw=raw,
        )

    @property
    def motors(self) -> int:
        """How many motors it has."""
        return len(self.positions_mm)

    @property
    def motor(self) -> dict[str, float]:
        """Its motors: `speed_mm_s`, `window_ms` (of the mean over which they settle) and `travel_um`."""
        motor: dict[str, float] = self.raw["motor"]
        return motor

    def ticks(self, seconds: float) -> int:
        """The nearest number of ticks to a time."""
        return round(number("seconds", seconds) * self.tick_hz)

    def seconds(self, ticks: int) -> float:
        """How long ticks last, s."""
        return number("ticks", ticks) / self.tick_hz

    def check_motors(self, drives: Iterable[Mapping[str, Any]]) -> None:
        """Raises `ValueError` for a drive whose motor the array does not have."""
        for drive in drives:
            motor = drive.get("motor")
            if isinstance(motor, int) and not 0 <= motor < self.motors:
                raise ValueError(f"`motor` is {motor}: the array {self.name} has motors 0 to {self.motors - 1}")
