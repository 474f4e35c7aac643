"""What tests repeat, because a machine that stands still for a second cannot keep an onset."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from meissner import errors

T = TypeVar("T")

LEAD = "lead_ms = 1000\nlease_ms = 10000\n"
"""The longest lead: an onset that is 2 s ahead outlasts a stop of 1 s. The line does not carry the updates of a live object then."""
_TRIES = 5
_MISSED = "the onset could not be kept"
_SIGNS = (_MISSED, "[too-soon", "is too soon", "[timeout:")


def kept(attempt: Callable[[], T]) -> T:
    """Does this again, at most five times in all, if an onset was missed or the device did not answer in time."""
    for _ in range(_TRIES - 1):
        try:
            return attempt()
        except (errors.TooSoon, errors.DeviceTimeout):
            pass
        except errors.PlayStopped as stopped:
            if stopped.receipt.cause != _MISSED:
                raise
    return attempt()


def run_kept(
    command: Sequence[str], folder: Path, environment: dict[str, str], stdin: str | None = None
) -> subprocess.CompletedProcess[str]:
    """Runs a program as `kept` does. What a run without success has left in the folder goes."""
    before = set(folder.iterdir())
    for left in reversed(range(_TRIES)):
        ended = subprocess.run(
            command,
            cwd=folder,
            env={**os.environ, **environment},
            input=stdin,
            capture_output=True,
            text=True,
            check=False,
        )
        if ended.returncode == 0 or not left or not any(sign in ended.stdout + ended.stderr for sign in _SIGNS):
            break
        for made in set(folder.iterdir()) - before:
            with contextlib.suppress(NotADirectoryError):
                shutil.rmtree(made)
                continue
            made.unlink()
    return ended
