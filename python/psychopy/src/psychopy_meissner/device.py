"""The display as a device of PsychoPy's device manager: it connects, arms, converts times, and leaves the motors off.

`shared` gives all components of an experiment the same device. `MeissnerDevice.client` is the client of the package `meissner`.

Invariant: after `close`, and at the end of Python, the motors that this device has armed are off. If disarming fails, it orders
an emergency stop.
"""

from __future__ import annotations

import atexit
import contextlib
from typing import Any, NamedTuple

from psychopy import logging
from psychopy.hardware.base import BaseDevice

import meissner
from meissner.clocks import MAX_SKEW
from meissner.errors import Faulted, MeissnerError, NoDevice

CLASS = "psychopy_meissner.device.MeissnerDevice"
NS = 1_000_000_000


def experiment_time() -> float:
    """PsychoPy's clock of the experiment, s: the clock of `tThisFlipGlobal` and of the columns `.started` and `.stopped`."""
    return float(logging.defaultClock.getTime())


class ClockReading(NamedTuple):
    """PsychoPy's clock of the experiment minus `time.monotonic()`, how well that is known, and when it was read, s."""

    offset: float
    uncertainty: float
    monotonic: float


class MeissnerDevice(BaseDevice):
    """A tactile display, armed."""

    def __init__(
        self, address: str = "", token: str = "", simulated: bool = False, checked: str = "", participant: str = ""
    ) -> None:
        """Connect to the daemon and enable the motors.

        `address` is a Unix socket or a URL, with its access `token`; empty: as `meissner.connect()`. `simulated` starts a
        daemon with the simulated array instead. `checked`: who has looked at the pins and seen all at rest; empty: the
        daemon must know where the pins are. `participant` starts an exclusive session with this pseudonym.

        Raises `meissner.MeissnerError`; the device manager turns it into a `ManagedDeviceError` with the same line.
        """
        self.address, self.simulated = address, simulated
        self.settings = {
            "address": address,
            "token": token,
            "simulated": simulated,
            "checked": checked,
            "participant": participant,
        }
        self._session: meissner.Session | None = None
        self._is_closed = False
        self.client = meissner.demo() if simulated else meissner.connect(address or None, token=token or None)
        # It runs before the client's own exit handler, which disarms without an emergency stop.
        atexit.register(self.close)
        try:
            if participant:
                self._session = self.client.session(participant, exclusive=True)
            if not simulated:
                self.client.arm(assume_rest=bool(checked), checked=checked or None)
        except BaseException:
            self.close()
            raise

    @property
    def isClosed(self) -> bool:
        """Whether `close` has been called."""
        return self._is_closed

    def readClock(self) -> ClockReading:
        """Compare PsychoPy's clock of the experiment with `time.monotonic()`. A pause of PsychoPy sets its clock back."""
        clock = self.client.core.clock
        offset_ns, uncertainty_ns = clock.other(lambda: round(experiment_time() * NS))
        return ClockReading(offset_ns / NS, uncertainty_ns / NS, self.client.now())

    def onExperimentClock(self, instant: meissner.Instant, clock: ClockReading | None = None) -> tuple[float, float]:
        """An instant on PsychoPy's clock of the experiment, and its uncertainty, s. `clock`: as it was then; None: as it is now."""
        clock = clock or self.readClock()
        drift = abs(clock.monotonic - instant.monotonic) * MAX_SKEW
        return instant.monotonic + clock.offset, instant.monotonic_uncertainty + clock.uncertainty + drift

    def fromExperimentClock(self, seconds: float, clock: ClockReading | None = None) -> float:
        """A time of PsychoPy's clock of the experiment as the `at` of a play, s. `clock`: as above."""
        return seconds - (clock or self.readClock()).offset

    def stop(self) -> None:
        """Stop the running play and clear the queue. If that fails, order an emergency stop, and raise the error."""
        try:
            self.client.stop()
        except Faulted:
            pass  # The lines are off.
        except MeissnerError:
            self.client.estop()
            raise

    def estop(self) -> None:
        """Switch all lines off at once and latch the fault: plays are refused until somebody calls `reset`."""
        self.client.estop()

    def close(self) -> None:
        """Stop, return the pins to rest, switch the motors off, end the session, and close. If it fails: emergency stop."""
        if self._is_closed:
            return
        self._is_closed = True
        atexit.unregister(self.close)
        with contextlib.ExitStack() as stack:
            stack.callback(self.client.close)
            if self._session is not None:
                # If disarming fails, the session's end stops the play first, so that it does not wait for its end.
                stack.push(self._session)
            if self.client.core.has_armed:
                self._disarm()

    def _disarm(self) -> None:
        try:
            self.client.disarm()
        except (Faulted, NoDevice):
            pass  # The lines are off.
        except BaseException:  # Ctrl-C, too.
            self.client.estop()
            self.client.core.has_armed = False
            raise
        # So that closing the client does not try it again. If the emergency stop fails, too, it does.
        self.client.core.has_armed = False

    def isSameDevice(self, other: object) -> bool:
        """Whether this device, or the dict of settings, is the same display."""

        def of(name: str, default: object) -> object:
            return other.get(name, default) if isinstance(other, dict) else getattr(other, name, default)

        return (of("simulated", False), of("address", "")) == (self.simulated, self.address)

    @staticmethod
    def getAvailableDevices() -> list[dict[str, Any]]:
        """The daemon that `meissner.connect()` finds, if one answers, and the simulated array."""
        found: list[dict[str, Any]] = []
        try:
            with meissner.connect() as client:
                client.status()
                found.append({"deviceName": "Tactile display", "address": "", "simulated": False})
        except MeissnerError:
            pass
        return [*found, {"deviceName": "Tactile display (simulated)", "address": "", "simulated": True}]


def shared(manager: Any, name: str, **settings: Any) -> MeissnerDevice:
    """The device of this name, added to PsychoPy's device manager if it is not there or closed.

    Raises `ValueError` if the device of this name has other settings, or is no tactile display.
    """
    device = manager.getDevice(name)
    if device is not None and not isinstance(device, MeissnerDevice):
        raise ValueError(f"the device `{name}` is a {type(device).__name__}: give the component another device name")
    if device is None or device.isClosed:
        device = manager.addDevice(CLASS, name, **settings)
    different = [key for key, value in settings.items() if device.settings[key] != value]
    if different:
        raise ValueError(
            f"the device `{name}` has two values of {', '.join(different)}: give the components the same, "
            "or another device name"
        )
    found: MeissnerDevice = device
    return found
