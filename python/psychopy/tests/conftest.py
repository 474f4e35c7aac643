"""What tests share: a daemon with the simulated array, and a stand-in for the two names of PsychoPy that the device needs.

Where PsychoPy is installed, as by `check`, the tests use it. `python/check` runs them with the stand-in, because PsychoPy takes 1.6 GB.
"""

from __future__ import annotations

import contextlib
import importlib.util
import sys
import time
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

import meissner


def has_psychopy() -> bool:
    """Whether PsychoPy is installed. The folder `psychopy` of this repository alone is not it."""
    with contextlib.suppress(ImportError):
        return importlib.util.find_spec("psychopy.experiment") is not None
    return False


def stand_in() -> None:
    """Puts a module `psychopy` in place: a base class that takes aliases, and a clock that began 100 s ago."""

    class BaseDevice:
        def __init_subclass__(cls, aliases: Any = None) -> None:
            pass

    class Clock:
        def getTime(self) -> float:
            return time.monotonic() - started + 100

    started = time.monotonic()
    modules: dict[str, Any] = {
        name: ModuleType(name) for name in ("psychopy", "psychopy.logging", "psychopy.hardware", "psychopy.hardware.base")
    }
    modules["psychopy.hardware.base"].BaseDevice = BaseDevice
    modules["psychopy.logging"].defaultClock = Clock()
    modules["psychopy"].logging = modules["psychopy.logging"]
    sys.modules.update(modules)


if not has_psychopy():
    stand_in()


@pytest.fixture(scope="session")
def shared_daemon() -> Iterator[meissner.Daemon]:
    with meissner.Daemon("session_silence_s = 5\n") as daemon:
        yield daemon


@pytest.fixture
def daemon(shared_daemon: meissner.Daemon) -> Iterator[meissner.Daemon]:
    """A daemon that a test leaves without plays, session and armed motors."""
    yield shared_daemon
    with meissner.connect(shared_daemon.socket) as m:
        state = m.status()
        assert state.raw["session"] is None, "a test has left its session"
        if state.state == "faulted":
            m.reset(force=True)
        m.wait_until_idle()
        assert m.status().state == "disarmed", "a test has left the motors armed"
