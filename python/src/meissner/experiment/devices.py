"""Answers with times: the keys of a keyboard by evdev, and a button box on a serial line.

    keys = Keys(keys={"KEY_LEFT": "left", "KEY_RIGHT": "right"})
    keys.flush()
    play = m.play("edge-45", seconds=0.3, trial=1)
    play.wait()
    press = keys.wait(timeout=3.0, after=play.onset)
    session.answer(1, press, correct=press.name == "left")

The kernel stamps a key when the keyboard reports it; a thread stamps a byte of a button box when it arrives. Both are times of
`time.monotonic()`, as `play.onset.monotonic`. How late the device itself reports, `uncertainty` tells: its data sheet or a measurement
has it. `Press.at(play.onset)` is the press on every clock, also the array's. `Press.is_early(play.onset)`: nobody reacts so soon.

A thread reads the device from the start, so that no press is lost while a play runs. A key that is held is one press.

Needs `pip install evdev` (Linux) and `pip install pyserial`.
"""

from __future__ import annotations

import contextlib
import math
import os
import queue
import select
import struct
import threading
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from types import TracebackType
from typing import Any, ClassVar, NamedTuple

from .._arguments import hints, number, table
from .._presses import Press
from ..clocks import NS, Instant
from ..errors import MeissnerError

_HOUR_NS = 3600 * NS
_SET_CLOCK = 0x4004_45A0
"""`EVIOCSCLOCKID` of linux/input.h."""


class _Loss(NamedTuple):
    """The kernel has dropped events."""

    monotonic_ns: int


class _Presses(ABC):
    """What keyboards and button boxes have in common: a thread that reads presses, and who waits for them."""

    def __init__(self, uncertainty: float, least_reaction: float) -> None:
        self._uncertainty, self._least_reaction = uncertainty, least_reaction
        self._since_ns = time.monotonic_ns()
        self._came: queue.SimpleQueue[Press | _Loss | Exception] = queue.SimpleQueue()
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name="meissner-presses", daemon=True)

    def _run(self) -> None:
        try:
            while not self._is_closed:
                for came in self._read():
                    self._came.put(came)
        except Exception as error:
            self._came.put(error)

    def flush(self) -> None:
        """Forget all presses so far: call it before each trial."""
        self._since_ns = time.monotonic_ns()

    def wait(self, timeout: float | None = None, *, after: Instant | None = None) -> Press | None:
        """The next press since `flush`, and since the onset `after`; None: there was none for `timeout` s.

        A press within the least reaction time after an onset is a press, too: `press.is_early(onset)` tells it. Warns if the system has
        lost presses meanwhile.
        """
        if after is not None and not isinstance(after, Instant):
            raise TypeError(f"`after` is {after!r}: must be an onset, such as `play.onset`")
        deadline = math.inf if timeout is None else time.monotonic() + number("timeout", timeout)
        since_ns = self._since_ns if after is None else max(self._since_ns, after.monotonic_ns)
        while (came := self._next(deadline - time.monotonic())) is not None:
            if came.monotonic_ns < since_ns:
                continue
            if isinstance(came, Press):
                return came
            warnings.warn(
                f"the system has lost events of the {self._what}: a press may be missing; repeat the trial",
                stacklevel=2,
            )
        return None

    def _next(self, seconds: float) -> Press | _Loss | None:
        """What came next, also an old one, within so many seconds, which may be infinite or below 0."""
        try:
            came = self._came.get(timeout=None if math.isinf(seconds) else max(0.0, seconds))
        except queue.Empty:
            return None
        if isinstance(came, Exception):
            # The thread has ended: who asks again is told again.
            self._came.put(came)
            raise (
                came
                if isinstance(came, MeissnerError)
                else MeissnerError(f"the {self._what} is gone: {getattr(came, 'strerror', None) or came}")
            ) from came
        return came

    def _pressed(self, name: str, stamp_ns: int) -> Press:
        return Press(name, stamp_ns, self._uncertainty, self._least_reaction)

    _what: ClassVar[str]

    @abstractmethod
    def _read(self) -> Iterable[Press | _Loss]:
        """The presses that wait, or come within 0.1 s."""

    @abstractmethod
    def _close(self) -> None:
        """Close the device, which nobody reads any more."""

    def close(self) -> None:
        """Close the device."""
        self._is_closed = True
        if self._thread.ident is not None:
            self._thread.join()
        self._close()

    def __enter__(self) -> Any:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@hints
class Keys(_Presses):
    """The keys of a keyboard, with the kernel's times. It may be read while another program has the keyboard, too."""

    _what = "keyboard"

    def __init__(
        self,
        device: Any = None,
        *,
        keys: Mapping[str, str] | None = None,
        uncertainty: float = 0.008,
        least_reaction: float = 0.1,
    ) -> None:
        """`device`: a path such as `/dev/input/event3`, or an `evdev.InputDevice`; None: the first keyboard that this user may read.

        `keys`: the names of the answers by evdev's names of the keys, such as `{"KEY_LEFT": "left"}`; other keys are no answers. Without it
        every key is one, by its name without `KEY_`, in lower case. `uncertainty`: how late the keyboard may report a key, s; a USB
        keyboard is asked every 8 ms at least, and many debounce some ms more. `least_reaction`: a press so soon after an onset, s, is
        marked as too early.
        """
        try:
            import evdev
        except ImportError as error:
            raise ImportError(f"keys need the package evdev: pip install evdev ({error})") from error
        super().__init__(uncertainty, least_reaction)
        self._codes: Any = evdev.ecodes
        self._names = keys
        for name in () if keys is None else table("keys", keys, "{'KEY_LEFT': 'left'}"):
            if name not in self._codes.ecodes:
                raise ValueError(f"`keys` has `{name}`, which is no key: names are as `KEY_LEFT`, `KEY_1`, `KEY_SPACE`")
        try:
            self._device: Any = (
                self._first(evdev)
                if device is None
                else evdev.InputDevice(os.fspath(device))
                if isinstance(device, (str, os.PathLike))
                else device
            )
        except OSError as error:
            raise MeissnerError(
                f"the keyboard {device} cannot be opened: {error.strerror}: may this user read it?"
            ) from error
        self._is_cut = False
        """Whether the kernel has dropped events, up to the next report."""
        # A device of one's own making has no such clock to set: `_press` checks what it tells.
        with contextlib.suppress(OSError, ImportError):
            import fcntl

            fcntl.ioctl(self._device.fileno(), _SET_CLOCK, struct.pack("i", time.CLOCK_MONOTONIC))
        self._thread.start()

    def _first(self, evdev: Any) -> Any:
        for path in evdev.list_devices():
            device = evdev.InputDevice(path)
            if self._codes.KEY_SPACE in device.capabilities().get(self._codes.EV_KEY, ()):
                return device
            device.close()
        raise MeissnerError(
            "this user may read no keyboard: add the user to the group `input`, log in again, or give `device`"
        )

    def _read(self) -> Iterable[Press | _Loss]:
        ready, _, _ = select.select([self._device], [], [], 0.1)
        return [press for event in (self._device.read() if ready else ()) if (press := self._press(event))]

    def _press(self, event: Any) -> Press | _Loss | None:
        is_sync = event.type == self._codes.EV_SYN
        if is_sync and event.code == self._codes.SYN_DROPPED:
            self._is_cut = True
            return _Loss(time.monotonic_ns())
        if self._is_cut:
            # What comes up to the next report is not whole.
            self._is_cut = not (is_sync and event.code == self._codes.SYN_REPORT)
            return None
        # A release is 0, and a key that is held repeats as 2.
        if event.type != self._codes.EV_KEY or event.value != 1:
            return None
        named = self._codes.bytype[event.type].get(event.code, f"KEY_{event.code}")
        names = [named] if isinstance(named, str) else list(named)
        if self._names is None:
            name = names[0].removeprefix("KEY_").lower()
        else:
            known = [self._names[each] for each in names if each in self._names]
            if not known:
                return None
            name = known[0]
        stamp_ns = event.sec * NS + event.usec * 1000
        if abs(time.monotonic_ns() - stamp_ns) > _HOUR_NS:
            raise MeissnerError("the keyboard's times are not of CLOCK_MONOTONIC: give the path of its device")
        return self._pressed(name, stamp_ns)

    def _close(self) -> None:
        self._device.close()


@hints
class ButtonBox(_Presses):
    """A box that sends a byte for each press on a serial line. A thread stamps each byte as it arrives."""

    _what = "button box"

    def __init__(
        self,
        port: str,
        *,
        buttons: Mapping[bytes, str] | None = None,
        baudrate: int = 115_200,
        uncertainty: float = 0.016,
        least_reaction: float = 0.1,
    ) -> None:
        """`port`: such as `/dev/ttyUSB0` or `COM3`. `buttons`: the names of the answers by byte; other bytes are no answers. Without it
        each byte is one, as its character. `uncertainty`: how late a byte may arrive, s; USB adapters hold bytes for up to 16 ms, unless
        their latency timer is set to 1 ms. `least_reaction`: as of `Keys`.
        """
        try:
            import serial
        except ImportError as error:
            raise ImportError(f"button boxes need the package pyserial: pip install pyserial ({error})") from error
        super().__init__(uncertainty, least_reaction)
        self._buttons = buttons
        try:
            self._serial: Any = serial.Serial(port, baudrate, timeout=0.1)
        except serial.SerialException as error:
            raise MeissnerError(f"the button box at {port} cannot be opened: {error}") from error
        self._thread.start()

    def _read(self) -> Iterable[Press]:
        byte = self._serial.read(1)
        stamp_ns = time.monotonic_ns()
        name = byte.decode("latin-1") if self._buttons is None else self._buttons.get(byte)
        return [self._pressed(name, stamp_ns)] if byte and name is not None else []

    def _close(self) -> None:
        self._serial.close()
