"""Pin displacement by the motor model: of one play, and of a session's stimuli on an even grid of the recording's clock.

The daemon does not keep traces: the program `meissner displacement` on this machine computes them from what was ordered. So a trace
shows the play as designed: ideal motors, no scatter, no strokes that came late. The exports to BIDS and NWB use `Grid`.

Invariant: samples are made one after the other, so that memory does not grow with the length of a play or session.
"""

from __future__ import annotations

import math
import os
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import IO, Any, Literal

from ._arguments import hinted
from .clocks import NS
from .errors import ProgramError
from .program import as_array, failure, find_array, find_program

ArrayName = str | os.PathLike[str]
"""The name of an array that the program ships, or the file of a description."""
Row = list[float]


@dataclass(frozen=True)
class Displacement:
    """How far the pins of a play move, by the motor model."""

    rate_hz: float
    """Samples a second."""
    motors: tuple[int, ...]
    """The motors that move, in order."""
    um: Any
    """A row per sample with a column per motor, µm upwards: an array with NumPy, else lists."""


@hinted
def displacement(
    pattern: str | os.PathLike[str],
    seconds: float | None = None,
    *,
    scale: float = 1.0,
    fit: Literal["whole", "cover"] = "whole",
    rate_hz: float = 1000.0,
    array: ArrayName | None = None,
) -> Displacement:
    """Compute how far a play moves each pin, from its onset until all pins rest again.

    `pattern` is the name of a shipped pattern, the path of a pattern file, or its text. It runs the installed program `meissner`;
    no daemon is needed. `array`: the file of the array's description, for a pattern of an array that the program does not ship.
    """
    samples = _Samples(pattern, seconds, scale, fit, rate_hz, 0.0, array)
    rows = list(samples)
    return Displacement(rate_hz, samples.motors, as_array(rows))


class _Samples:
    """The samples of a play, read from the program as it makes them."""

    def __init__(
        self,
        pattern: str | os.PathLike[str],
        seconds: float | None,
        scale: float,
        fit: str,
        rate_hz: float,
        first_s: float,
        array: ArrayName | None,
    ) -> None:
        is_text = isinstance(pattern, str) and "\n" in pattern
        self._text = str(pattern) if is_text else ""
        self._arguments = ["displacement", "-" if is_text else os.fspath(pattern)]
        self._arguments += [f"--rate-hz={rate_hz!r}", f"--first-s={first_s!r}", f"--scale={scale!r}", f"--fit={fit}"]
        if seconds is not None:
            self._arguments.append(f"--seconds={seconds!r}")
        if array is not None:
            self._arguments.append(f"--array={os.fspath(array)}")
        self.motors: tuple[int, ...] = ()

    def __iter__(self) -> Iterator[Row]:
        with tempfile.TemporaryFile("w+", encoding="utf-8") as text, tempfile.TemporaryFile("w+") as complaint:
            text.write(self._text)
            text.seek(0)
            with subprocess.Popen(
                [find_program(), *self._arguments], stdin=text, stdout=subprocess.PIPE, stderr=complaint, text=True
            ) as run:
                assert run.stdout is not None
                try:
                    yield from self._read(run.stdout)
                finally:
                    # Nobody reads on if an error or the caller ends this early.
                    run.stdout.close()
            if run.returncode != 0:
                complaint.seek(0)
                raise failure("displacement", complaint.read(), run.returncode)

    def _read(self, out: IO[str]) -> Iterator[Row]:
        names = out.readline().split(",")[1:]
        self.motors = tuple(int(name.split("_")[1]) for name in names)
        for line in out:
            if not line.endswith("\n"):
                # The program has died within a line; its exit code says so.
                return
            yield [float(cell) for cell in line.split(",")[1:]]


@dataclass(frozen=True)
class _Stimulus:
    """A stimulus's place on the grid, with samples from there on. `rest`: no pin moves until `end`; None: that is not known."""

    first: int
    end: int
    samples: _Samples | Literal["rest"] | None


class Grid:
    """The displacement of all pins in a session, at `index / rate_hz` seconds after `zero_ns` of the recording PC's clock."""

    def __init__(
        self,
        rows: list[dict[str, Any]],
        texts: Mapping[str, str],
        *,
        zero_ns: int,
        rate_hz: float,
        array: ArrayName | None = None,
    ) -> None:
        """`rows` are the stimuli of `bids.stimulus_rows`; `texts` holds the patterns by SHA-256. `array`: as of `displacement`.

        Raises `ProgramError` if the program is missing or does not know the array, or if `array` is not the array of all rows.
        """
        self.rate_hz = rate_hz
        self._array = array
        names: set[str] = {row["array"] for row in rows}
        found = [find_array(name) for name in (sorted(names) if array is None else [array])]
        if array is not None and (others := sorted(names - {found[0].name})):
            raise ProgramError(
                f"`array` is {found[0].name}, but the session has plays on {' and '.join(others)}: "
                f"pass the description of {others[0]}, or no `array` if the program ships it"
            )
        self.pins = max((each.motors for each in found), default=0)
        """How many pins the samples have."""
        self.problems: list[str] = []
        """What the samples do not show, one line each."""
        self._stimuli = [self._place(row, texts, zero_ns) for row in rows]
        late = sum(bool(row["late_strokes"]) for row in rows)
        if late:
            self.problems.append(f"{late} stimuli had late strokes, which were not played: the displacement has them")

    @property
    def first(self) -> int:
        """The index of the first sample."""
        return self._stimuli[0].first

    def _place(self, row: dict[str, Any], texts: Mapping[str, str], zero_ns: int) -> _Stimulus:
        onset_ns = row["onset_monotonic_ns"]
        after_s = (onset_ns - zero_ns) / NS
        first = math.ceil(after_s * self.rate_hz)
        # Device seconds in a second of the PC's clock, whose grid this is.
        device_s, end = 1.0, first + 1
        if row["offset_monotonic_ns"] is not None and row["offset_monotonic_ns"] > onset_ns:
            lasted_s = (row["offset_monotonic_ns"] - onset_ns) / NS
            device_s = (row["offset_tick"] - row["onset_tick"]) / row["tick_hz"] / lasted_s
            end = max(end, math.ceil((after_s + lasted_s) * self.rate_hz))
        if is_blank(row):
            return _Stimulus(first, end, "rest")
        why, ordered = unknown(row, texts), as_played(row)
        if why is not None or ordered is None:
            self.problems.append(f"{why}, so its displacement is n/a")
            return _Stimulus(first, end, None)
        text = texts[row["pattern_sha256"]]
        first_s = max(0.0, first / self.rate_hz - after_s) * device_s
        scale = 1.0 if row["scale"] is None else row["scale"]
        samples = _Samples(text, ordered[0], scale, ordered[1], self.rate_hz / device_s, first_s, self._array)
        return _Stimulus(first, end, samples)

    def __iter__(self) -> Iterator[tuple[int, Row | None]]:
        """The index and the displacement of each pin, µm; None where it is not known. Between stimuli all pins rest: no samples."""
        # A stimulus moves pins for some ms after its end; the next one may have begun.
        carried: dict[int, Row | None] = {}
        limits = [stimulus.first for stimulus in self._stimuli[1:]]
        for stimulus, limit in zip(self._stimuli, [*limits, None], strict=True):
            for index, row in _samples(stimulus, self.pins):
                carried[index] = _sum(carried[index], row) if index in carried else row
                if limit is None or index < limit:
                    yield index, carried.pop(index)
            for index in sorted(carried):
                if limit is None or index < limit:
                    yield index, carried.pop(index)


def is_blank(row: Mapping[str, Any]) -> bool:
    """Whether a stimulus is an item of a sequence in which no pin moves, as in a catch trial."""
    return bool(row["pattern_sha256"] == "")


def unknown(row: Mapping[str, Any], texts: Mapping[str, str]) -> str | None:
    """Why it is not known how a stimulus moved the pins; None: it is. `texts` holds the patterns by SHA-256."""
    what = f"play {row['play']}" + ("" if row["item"] is None else f", item {row['item']}")
    if (live := row["live"]) is not None:
        return f"{what} was live: the record has the number of its updates ({live['updates']}), not its moves"
    if texts.get(row["pattern_sha256"] or "") is None:
        return f"{what}: its pattern as played is not kept"
    return f"{what}: its end is missing from the record" if as_played(row) is None else None


def as_played(row: Mapping[str, Any]) -> tuple[float | None, str] | None:
    """Duration and fit that give the strokes that were played; None if the record does not tell."""
    if row["state"] in ("done", "played", "incomplete"):
        return row["seconds"], row["fit"]
    lasted_ms = row["played_ms"] if row["cut_after_ms"] is None else row["cut_after_ms"]
    # No stroke that the cut has ended.
    return None if lasted_ms is None else (lasted_ms / 1000, "whole")


def _samples(stimulus: _Stimulus, pins: int) -> Iterator[tuple[int, Row | None]]:
    if stimulus.samples is None or stimulus.samples == "rest":
        for index in range(stimulus.first, stimulus.end):
            yield index, None if stimulus.samples is None else [0.0] * pins
        return
    for index, moved in enumerate(stimulus.samples, stimulus.first):
        row = [0.0] * pins
        for motor, um in zip(stimulus.samples.motors, moved, strict=True):
            row[motor] = um
        yield index, row


def _sum(one: Row | None, other: Row | None) -> Row | None:
    return None if one is None or other is None else [a + b for a, b in zip(one, other, strict=True)]
