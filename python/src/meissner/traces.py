"""Pin displacement of a play by the motor model.

The daemon does not keep traces: the program `meissner displacement` on this machine computes them from what was ordered. So a trace
shows the play as designed: ideal motors, no scatter, no strokes that came late.
"""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from typing import Any, Literal

from ._arguments import hinted
from .program import as_array, failure, find_program

ArrayName = str | os.PathLike[str]
"""The name of an array that the program ships, or the file of a description."""


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
    is_text = isinstance(pattern, str) and "\n" in pattern
    arguments = ["displacement", "-" if is_text else os.fspath(pattern)]
    arguments += [f"--rate-hz={rate_hz!r}", f"--scale={scale!r}", f"--fit={fit}"]
    if seconds is not None:
        arguments.append(f"--seconds={seconds!r}")
    if array is not None:
        arguments.append(f"--array={os.fspath(array)}")
    given = str(pattern) if is_text else ""
    ended = subprocess.run([find_program(), *arguments], input=given, capture_output=True, text=True, check=False)
    if ended.returncode != 0:
        raise failure("displacement", ended.stderr, ended.returncode)
    head, *lines = ended.stdout.splitlines()
    motors = tuple(int(name.split("_")[1]) for name in head.split(",")[1:])
    return Displacement(rate_hz, motors, as_array([[float(cell) for cell in line.split(",")[1:]] for line in lines]))
