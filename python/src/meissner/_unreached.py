"""Warnings of plays that do less than was ordered: a person who is not told takes the ordered amplitude for the felt one.

`warn_of(receipt, told)` gives the daemon's warnings of a play to Python, once a pattern.
"""

from __future__ import annotations

import re
import sys
import warnings

from .results import Receipt

_ENOUGH = 0.8
"""The share of its amplitude that a drive has to reach, as the daemon has it."""


def warn_of(receipt: Receipt, told: set[str]) -> None:
    """Warns of a play, once a pattern. `told` is what nobody is told again."""
    lines = [line for line in receipt.raw["reach"]["warnings"] if not _is_meant(receipt, line)]
    # Of a sequence the daemon says the pattern's name before each line.
    lines = [line if line.startswith("`") else f"`{receipt.pattern}`: {line}" for line in lines]
    new = [line for line in lines if _key(line) not in told]
    if not new:
        return
    told.update(map(_key, lines))
    more = f" ({len(lines) - 1} more in `receipt.raw['reach']['warnings']`)" if len(lines) > 1 else ""
    warn(f"{new[0]}{more}")


def warn(line: str) -> None:
    """Warns where the caller of this package stands."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "meissner":
        level, frame = level + 1, frame.f_back
    warnings.warn(line, stacklevel=level)


def _key(line: str) -> str:
    """A pattern is told by its name. One without a name: by the line, whatever its amplitudes and times."""
    name = line.split(": ")[0]
    return re.sub(r"is saturated: it |[\d.]+ (of|s|um|%|pulses)", "", line) if name == "`inline`" else name


def _is_meant(receipt: Receipt, line: str) -> bool:
    """Whether a drive is saturated as stored, and not with the `scale` of the play."""
    saturated = re.match(r"drive (\d+) .* is saturated", line)
    found = [drive for drive in receipt.raw["reach"]["drives"] if saturated and drive["drive"] == int(saturated[1])]
    return any(drive["reached_um"] >= _ENOUGH * drive["ordered_um"] for drive in found)
