"""PsychoPy, or a stand-in for the two names of it that the device needs. Tests import this before the plugin.

Where PsychoPy is installed, as by `check`, the tests use it. `python/check` runs them with the stand-in, because PsychoPy takes 1.6 GB.
"""

from __future__ import annotations

import contextlib
import importlib.util
import sys
import time
from types import ModuleType
from typing import Any


def has_psychopy() -> bool:
    """Whether PsychoPy is installed. The folder `psychopy` of this repository alone is not it."""
    with contextlib.suppress(ImportError):
        return importlib.util.find_spec("psychopy.experiment") is not None
    return False


def stand_in() -> None:
    """Puts a module `psychopy` in place: a base class, and a clock that began 100 s ago."""

    class BaseDevice:
        pass

    class Clock:
        def getTime(self) -> float:
            return time.monotonic() - started + 100

    started = time.monotonic()
    modules: dict[str, Any] = {
        name: ModuleType(name)
        for name in ("psychopy", "psychopy.logging", "psychopy.hardware", "psychopy.hardware.base")
    }
    modules["psychopy.hardware.base"].BaseDevice = BaseDevice
    modules["psychopy.logging"].defaultClock = Clock()
    modules["psychopy"].logging = modules["psychopy.logging"]
    sys.modules.update(modules)


if not has_psychopy():
    stand_in()
