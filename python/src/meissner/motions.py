"""Motions as samples: what `play(samples=..., rate=...)` sends.

Samples are displacements above rest, µm: lists of numbers or NumPy arrays. NumPy is not needed.

Invariant: samples that no pin can follow in its range raise `ValueError`, which names motor, sample and time, before anything is sent.
"""

from __future__ import annotations

import array
import base64
import math
import sys
from collections.abc import Iterable, Mapping
from typing import Any, Union

from ._arguments import drive_list, listed, number, whole
from .program import toml_value

Samples = Union[Mapping[int, Any], Any]
MOTIONS = ("wave", "ramp", "tone", "noise")
"""The tables of a pattern file that are motions."""
_TABLES = ("drive", *MOTIONS)
RATE = (1.0, 8000.0)
"""Rates of samples, Hz."""


_SUCH_AS = "{9: [0, 20, 20, 0]}, or an array of shape (time, motors)"


def _row(name: str, um: Any) -> list[Any]:
    """The samples of a motor, or of an instant."""
    return listed(name, um, "[0, 20, 20, 0]")


def _by_motor(samples: Samples, motors: int) -> dict[int, Any]:
    """The samples of each motor: of a mapping, or of an array of shape (time, motors), whose pins that stay at rest are left out."""
    if isinstance(samples, Mapping):
        return {whole("motor", motor, 0): um for motor, um in samples.items()}
    shape = getattr(samples, "shape", None)
    if shape is not None:
        if len(shape) != 2 or shape[1] != motors:
            raise ValueError(f"samples have the shape {tuple(shape)}: must be (time, {motors}), or a dict by motor")
        columns = {motor: samples[:, motor] for motor in range(motors)}
    else:
        rows = listed("samples", samples, _SUCH_AS)
        if rows and not isinstance(rows[0], (list, tuple)) and not getattr(rows[0], "shape", ()):
            raise TypeError(f"`samples` are one row of values: must be {_SUCH_AS}")
        rows = [_row(f"samples[{place}]", row) for place, row in enumerate(rows)]
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
    try:
        values = [float(value) for value in _row(f"samples[{motor}]", um)]
    except (TypeError, ValueError) as error:
        if "must be a list" in str(error):
            raise
        raise TypeError(f"`samples[{motor}]` has values that are no numbers: {error}") from None
    if len(values) < 2:
        raise ValueError(f"motor {motor} has {len(values)} samples: must be 2 or more")
    for place, value in enumerate(values):
        if not 0.0 <= value <= most_um + 0.001:
            at = start + place / rate
            wanted = f"0 to {most_um:g} um above rest" if math.isfinite(value) else "a number"
            raise ValueError(f"motor {motor}: sample {place} at {at:g} s is {value:g}: must be {wanted}")
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
    motors: int,
    most_um: float = 400.0,
) -> dict[str, Any]:
    """An inline pattern: samples of displacement, and drives beside them.

    `samples` maps motors to samples in µm, or is an array of shape (time, motors); `rate` is theirs, Hz, and `start` the time of the
    first one, s. A drive is a dict with the keys of a pattern file. `motors` and `most_um` are the array's, and its motors' travel.
    """
    keys: dict[str, Any] = {} if name is None else {"name": name}
    if samples is not None:
        if rate is None:
            raise ValueError(f"`samples` need `rate`: how many are a second, {RATE[0]:g} to {RATE[1]:g} Hz")
        if not RATE[0] <= number("rate", rate, ", Hz") <= RATE[1]:
            raise ValueError(
                f"`rate` is {rate} Hz: must be {RATE[0]:g} to {RATE[1]:g}; scipy.signal.resample_poly resamples"
            )
        if not 0.0 <= start <= 1e8:
            raise ValueError(f"`start` is {start} s: must be 0 or more")
        of = _by_motor(samples, motors)
        keys["wave"] = [_wave(motor, of[motor], float(rate), start, most_um, motors) for motor in sorted(of)]
    if drives is not None:
        keys["drive"] = drive_list(drives)
    if not keys.get("wave") and not keys.get("drive"):
        raise ValueError("nothing would move: give `samples` with `rate`, or `drives`")
    return keys


def pattern_toml(keys: Mapping[str, Any]) -> str:
    """A pattern file of these keys, without its provenance."""
    tables = [(kind, table) for kind in _TABLES for table in keys.get(kind) or ()]
    least = 1 if all(kind == "drive" for kind, _ in tables) else 2
    lines = [f"format = {keys.get('format', least)}"]
    lines += [
        f"{key} = {toml_value(keys[key])}" for key in ("name", "array", "duration_s") if keys.get(key) is not None
    ]
    for kind, table in tables:
        lines += [
            f"\n[[{kind}]]",
            *(f"{key} = {toml_value(value)}" for key, value in table.items() if value is not None),
        ]
    return "\n".join(lines) + "\n"
