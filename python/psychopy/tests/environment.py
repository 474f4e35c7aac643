"""PsychoPy, or a stand-in for the names of it that the device and the page of the book need. Tests import this before the plugin.

Where PsychoPy is installed, as by `check`, the tests use it. `python/check` runs them with the stand-in, because PsychoPy takes 1.6 GB.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import sys
import time
from types import ModuleType
from typing import Any, ClassVar


def has_psychopy() -> bool:
    """Whether PsychoPy is installed. The folder `psychopy` of this repository alone is not it."""
    with contextlib.suppress(ImportError):
        return importlib.util.find_spec("psychopy.experiment") is not None
    return False


def stand_in() -> None:
    """Puts a module `psychopy` in place: a base class, a device manager, and a clock that begins now."""

    class BaseDevice:
        pass

    class Clock:
        def getTime(self) -> float:
            return time.monotonic() - started

    class DeviceManager:
        devices: ClassVar[dict[str, Any]] = {}

        @staticmethod
        def addDevice(deviceClass: str, deviceName: str, **settings: Any) -> Any:
            module, _, name = deviceClass.rpartition(".")
            device = DeviceManager.devices[deviceName] = getattr(importlib.import_module(module), name)(**settings)
            return device

        @staticmethod
        def removeDevice(deviceName: str) -> None:
            DeviceManager.devices.pop(deviceName).close()

    started = time.monotonic()
    modules: dict[str, Any] = {
        name: ModuleType(name)
        for name in ("psychopy", "psychopy.core", "psychopy.logging", "psychopy.hardware", "psychopy.hardware.base")
    }
    modules["psychopy.hardware.base"].BaseDevice = BaseDevice
    modules["psychopy.logging"].defaultClock = Clock()
    modules["psychopy.core"].getTime = Clock().getTime
    modules["psychopy.hardware"].DeviceManager = DeviceManager
    modules["psychopy"].core, modules["psychopy"].logging = modules["psychopy.core"], modules["psychopy.logging"]
    sys.modules.update(modules)


if not has_psychopy():
    stand_in()
