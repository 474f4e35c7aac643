"""Motions as samples: what `play(samples=..., rate=...)` sends, and traces read from WAV and CSV files.

Samples are displacements above rest, µm: lists of numbers or NumPy arrays. NumPy is not needed.

Invariant: samples that no pin can follow in its range raise `ValueError`, which names motor, sample and time, before anything is sent.
"""

from __future__ import annotations

import array
import base64
import csv
import math
import os
import sys
import wave
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Union

from .program import as_array

Samples = Union[Mapping[int, Any], Any]
RATE = (1.0, 8000.0)
"""Rates of samples, Hz."""


class Trace(NamedTuple):
    """Samples of one pin, and their rate."""

    um: Any
    """Displacement above rest, µm: a NumPy array, if NumPy is installed; else a list."""
    rate: float
    """Hz."""


def _columns(samples: Samples) -> int:
    """How many motors the samples are of."""
    if isinstance(samples, Mapping):
        return 1 + max((int(motor) for motor in samples), default=0)
    shape = getattr(samples, "shape", None)
    if shape is not None:
        return int(shape[-1])
    return len(list(next(iter(samples), [])))


def _by_motor(samples: Samples, motors: int) -> dict[int, Any]:
    """The samples of each motor: of a mapping, or of an array of shape (time, motors), whose pins that stay at rest are left out."""
    if isinstance(samples, Mapping):
        return {int(motor): um for motor, um in samples.items()}
    shape = getattr(samples, "shape", None)
    if shape is not None:
        if len(shape) != 2 or shape[1] != motors:
            raise ValueError(f"samples have the shape {tuple(shape)}: must be (time, {motors}), or a dict by motor")
        columns = {motor: samples[:, motor] for motor in range(motors)}
    else:
        rows = [list(row) for row in samples]
        wrong = next((number for number, row in enumerate(rows) if len(row) != motors), None)
        if wrong is not None:
            raise ValueError(f"samples at {wrong} are of {len(rows[wrong])} motors: must be of {motors}")
        columns = {motor: [row[motor] for row in rows] for motor in range(motors)}
    return {motor: um for motor, um in columns.items() if any(value != 0 for value in um)}


def _wave(motor: int, um: Iterable[float], rate: float, start: float, most_um: float, motors: int) -> dict[str, Any]:
    if not 0 <= motor < motors:
        raise ValueError(f"motor {motor}: the array has motors 0 to {motors - 1}")
    shape = getattr(um, "shape", None)
    if shape is not None and len(shape) != 1:
        raise ValueError(f"motor {motor}: samples have the shape {tuple(shape)}: must be one row of numbers")
    values = [float(value) for value in um]
    if len(values) < 2:
        raise ValueError(f"motor {motor} has {len(values)} samples: must be 2 or more")
    for number, value in enumerate(values):
        if not 0.0 <= value <= most_um + 0.001:
            at = start + number / rate
            wanted = f"0 to {most_um:g} um above rest" if math.isfinite(value) else "a number"
            raise ValueError(f"motor {motor}: sample {number} at {at:g} s is {value:g}: must be {wanted}")
    packed = array.array("f", values)
    if sys.byteorder == "big":
        packed.byteswap()
    samples = base64.b64encode(packed.tobytes()).decode("ascii")
    return {"motor": motor, "rate_hz": rate, "start_s": start, "samples": samples}


def pattern(
    samples: Samples | None = None,
    rate: float | None = None,
    drives: Iterable[Mapping[str, Any]] | None = None,
    *,
    start: float = 0.0,
    name: str | None = None,
    motors: int | None = None,
    most_um: float = 400.0,
) -> dict[str, Any]:
    """An inline pattern: samples of displacement, and drives beside them.

    `samples` maps motors to samples in µm, or is an array of shape (time, motors); `rate` is theirs, Hz, and `start` the time of the
    first one, s. A drive is a dict with the keys of a pattern file. `motors` and `most_um` are the array's, and its motors' travel.
    """
    keys: dict[str, Any] = {} if name is None else {"name": name}
    if samples is not None:
        if rate is None or not RATE[0] <= rate <= RATE[1]:
            raise ValueError(f"`rate` is {rate} Hz: must be {RATE[0]:g} to {RATE[1]:g}")
        if not 0.0 <= start <= 1e8:
            raise ValueError(f"`start` is {start} s: must be 0 or more")
        count = _columns(samples) if motors is None else motors
        of = _by_motor(samples, count)
        keys["wave"] = [_wave(motor, of[motor], float(rate), start, most_um, count) for motor in sorted(of)]
    if drives is not None:
        keys["drive"] = [dict(drive) for drive in drives]
    if not keys.get("wave") and not keys.get("drive"):
        raise ValueError("nothing would move: give `samples` with `rate`, or `drives`")
    return keys


def _trace(values: Sequence[float], rate: float, scale_um: float, offset_um: float) -> Trace:
    return Trace(as_array([value * scale_um + offset_um for value in values]), rate)


def import_wav(
    path: str | os.PathLike[str], *, scale_um: float, offset_um: float = 0.0, channel: int | None = None
) -> Trace:
    """Read a channel of a WAV file (PCM of 8 to 32 bits): `scale_um` is the displacement at full scale, `offset_um` is added.

    A recording swings about 0 and a pin only goes up, so the offset is usually as large as the scale. At most 8000 Hz can be played;
    `meissner pattern pack` resamples faster files.
    """
    try:
        with wave.open(os.fspath(path), "rb") as file:
            channels, width, rate, count = file.getparams()[:4]
            raw = file.readframes(count)
    except (wave.Error, EOFError) as error:
        raise ValueError(f"{os.fspath(path)}: not a WAV file of PCM samples: {error}") from error
    if channel is None and channels > 1:
        raise ValueError(f"{os.fspath(path)} has {channels} channels: choose one with `channel`, from 0")
    chosen = channel or 0
    if not 0 <= chosen < channels:
        raise ValueError(f"{os.fspath(path)} has {channels} channels: `channel` is {chosen}")
    full = float(1 << (8 * width - 1))
    frames = range(chosen * width, len(raw) - width + 1, width * channels)
    if width == 1:
        # 8-bit samples have no sign.
        values = [(raw[at] - 128) / full for at in frames]
    else:
        values = [int.from_bytes(raw[at : at + width], "little", signed=True) / full for at in frames]
    return _trace(values, float(rate), scale_um, offset_um)


def import_csv(
    path: str | os.PathLike[str],
    *,
    rate: float,
    column: int | str | None = None,
    scale_um: float = 1.0,
    offset_um: float = 0.0,
) -> Trace:
    """Read a column of a CSV file: its number from 0, or its name in the first row. Separators are commas, semicolons or tabs.

    Lines that begin with `#` and empty lines are skipped. `rate` is that of the samples, Hz.
    """
    name = os.fspath(path)
    with open(path, encoding="utf-8-sig", newline="") as file:
        lines = [line for line in file if line.strip() and not line.startswith("#")]
    separator = max(",;\t", key=lambda mark: lines[0].count(mark)) if lines else ","
    rows = list(csv.reader(lines, delimiter=separator))
    if not rows:
        raise ValueError(f"{name} has no rows")
    head = None if all(_is_number(cell) for cell in rows[0]) else [cell.strip() for cell in rows[0]]
    if column is None and len(rows[0]) > 1:
        raise ValueError(f"{name} has {len(rows[0])} columns: choose one with `column`")
    if isinstance(column, str):
        if head is None or column not in head:
            raise ValueError(f"{name} has no column {column!r} in its first row")
        column = head.index(column)
    chosen, values = column or 0, []
    for number, row in enumerate(rows[1:] if head else rows):
        cell = row[chosen] if 0 <= chosen < len(row) else ""
        if not _is_number(cell) or not math.isfinite(float(cell)):
            raise ValueError(f"{name}: sample {number} of column {chosen} is {cell!r}: must be a number")
        values.append(float(cell))
    return _trace(values, float(rate), scale_um, offset_um)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
