"""Keys, button boxes and questions, at devices that these tests make: a pipe of the kernel's events, and pseudoterminals."""

from __future__ import annotations

import errno
import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

import meissner
from meissner.errors import MeissnerError
from meissner.experiment import ButtonBox, Keys, Press

EVENT = struct.Struct("llHHi")
"""`struct input_event` of linux/input.h on 64-bit machines: time (s, us), type, code, value."""
EV_SYN, EV_KEY = 0, 1
SYN_REPORT, SYN_DROPPED = 0, 3
LEFT, RIGHT, A = 105, 106, 30
"""Of linux/input-event-codes.h."""


class Pipe:
    """A keyboard: the bytes that the kernel gives."""

    def __init__(self) -> None:
        self._reading, self._writing = os.pipe()

    def fileno(self) -> int:
        return self._reading

    def read(self) -> Iterator[Any]:
        for sec, usec, kind, code, value in EVENT.iter_unpack(os.read(self._reading, 64 * EVENT.size)):
            yield SimpleNamespace(sec=sec, usec=usec, type=kind, code=code, value=value)

    def close(self) -> None:
        os.close(self._reading)
        os.close(self._writing)

    def send(self, code: int, value: int = 1, *, ns: int | None = None) -> int:
        """A key and its report. Returns when it was, in whole us."""
        return self.report((EV_KEY, code, value), (EV_SYN, SYN_REPORT, 0), ns=ns)

    def report(self, *events: tuple[int, int, int], ns: int | None = None) -> int:
        us = (time.monotonic_ns() if ns is None else ns) // 1000
        for event in events:
            os.write(self._writing, EVENT.pack(us // 10**6, us % 10**6, *event))
        return us * 1000

    @property
    def waiting(self) -> int:
        """The bytes that nobody has read yet."""
        return struct.unpack("i", fcntl.ioctl(self._reading, termios.FIONREAD, struct.pack("i", 0)))[0]  # type: ignore[no-any-return]


def test_a_key_has_the_time_of_the_kernel() -> None:
    pytest.importorskip("evdev")
    pipe = Pipe()
    with Keys(pipe, keys={"KEY_LEFT": "left", "KEY_RIGHT": "right"}, uncertainty=0.01) as keys:
        assert keys.wait(timeout=0) is None
        pipe.send(LEFT)
        keys.flush()
        pipe.send(A)
        stamp_ns = pipe.send(RIGHT)
        pipe.send(RIGHT, 2)
        pipe.send(RIGHT, 0)
        # The kernel's time has whole us, so it may lie just before `flush`.
        press = keys.wait(timeout=300)
        assert press == Press("right", stamp_ns, 0.01)
        assert keys.wait(timeout=0) is None
    pipe = Pipe()
    with Keys(pipe) as keys:
        pipe.send(A, ns=time.monotonic_ns() + 10**6)
        time.sleep(0.002)
        press = keys.wait(timeout=300)
        assert press is not None
        assert press.name == "a"
        pipe.send(A, ns=time.time_ns())
        with pytest.raises(MeissnerError, match="not of CLOCK_MONOTONIC"):
            keys.wait(timeout=300)


def test_a_held_key_is_one_press_and_fills_no_queue() -> None:
    """The kernel keeps 64 events. A key that is held for 4 s is 130 repeats."""
    pytest.importorskip("evdev")
    pipe = Pipe()
    with Keys(pipe) as keys:
        held_ns = pipe.send(LEFT)
        for _ in range(130):
            pipe.send(LEFT, 2)
        pipe.send(LEFT, 0)
        # Nobody waits for a press, as while a play runs.
        while pipe.waiting:
            time.sleep(0.001)
        last_ns = pipe.send(RIGHT)
        assert keys.wait(timeout=300) == Press("left", held_ns, 0.008)
        assert keys.wait(timeout=300) == Press("right", last_ns, 0.008)


def test_lost_events_are_told_and_no_press_is_made_of_their_rest() -> None:
    pytest.importorskip("evdev")
    pipe = Pipe()
    lost = (EV_SYN, SYN_DROPPED, 0), (EV_KEY, LEFT, 1), (EV_SYN, SYN_REPORT, 0)
    with Keys(pipe) as keys:
        pipe.report(*lost)
        stamp_ns = pipe.send(RIGHT)
        with pytest.warns(UserWarning, match="lost events of the keyboard: a press may be missing"):
            assert keys.wait(timeout=300) == Press("right", stamp_ns, 0.008)
        pipe.report(*lost)
        while keys._came.empty():
            time.sleep(0.001)
        with pytest.warns(UserWarning, match="lost events"):
            assert keys.wait(timeout=0) is None
        # Of what was lost before `flush` nobody is told.
        pipe.report(*lost)
        while keys._came.empty():
            time.sleep(0.001)
        keys.flush()
        # The kernel's time has whole us.
        stamp_ns = pipe.send(RIGHT, ns=time.monotonic_ns() + 1000)
        assert keys.wait(timeout=300) == Press("right", stamp_ns, 0.008)


def test_a_press_that_comes_too_early_is_marked_and_kept(m: meissner.Client) -> None:
    pytest.importorskip("evdev")
    pipe = Pipe()
    with m.session("P07") as session, Keys(pipe) as keys:
        for trial, after_ms in enumerate((2.5, 99, 100, 250), 1):
            play = m.play("pin-60", 0.05, trial=trial)
            play.wait()
            pipe.send(LEFT, ns=play.onset.monotonic_ns + round(after_ms * 1e6) + 1000)
            press = keys.wait(timeout=300, after=play.onset)
            assert press is not None
            assert press.is_early(play.onset) == (after_ms < 100)
            session.answer(trial, press)
        marks = [row["answer"]["factors"].get("response_early") for row in session.plays]
    assert marks == ["true", "true", None, None]


def test_a_keyboard_that_goes_away_is_told_at_each_wait() -> None:
    pytest.importorskip("evdev")
    pipe = Pipe()
    with Keys(pipe) as keys:
        os.close(pipe._writing)
        pipe._writing = os.open(os.devnull, os.O_RDONLY)
        pipe.read = broken  # type: ignore[method-assign]
        for _ in range(2):
            with pytest.raises(MeissnerError, match="the keyboard is gone: No such device"):
                keys.wait(timeout=300)
        with pytest.raises(TypeError, match="`timeout` is '3': must be a number"):
            keys.wait(timeout="3")
        with pytest.raises(TypeError, match=r"`after` is 3\.0: must be an onset"):
            keys.wait(after=3.0)


def broken() -> Iterator[Any]:
    raise OSError(errno.ENODEV, "No such device")


def test_keys_that_are_none_are_refused() -> None:
    pytest.importorskip("evdev")
    with pytest.raises(ValueError, match="`LEFT`, which is no key"):
        Keys(Pipe(), keys={"LEFT": "left"})
    with pytest.raises(MeissnerError, match="/dev/none cannot be opened: No such file"):
        Keys("/dev/none")


def test_a_press_is_recorded_on_the_clock_of_the_device(m: meissner.Client) -> None:
    pytest.importorskip("evdev")
    pipe = Pipe()
    with m.session("P07") as session, Keys(pipe, uncertainty=0.004) as keys:
        pipe.send(LEFT)
        play = m.play("pin-60", 0.05, trial=1)
        play.wait()
        pipe.send(RIGHT, ns=play.onset.monotonic_ns - 10**7)
        pressed_ns = pipe.send(LEFT, ns=play.onset.monotonic_ns + 40_000_000)
        press = keys.wait(timeout=300, after=play.onset)
        assert press is not None
        session.answer(1, press, correct=press.name == "left")
        (row,) = session.plays
    answer = row["answer"]
    assert (answer["response"], answer["correct"]) == ("left", True)
    after_s = (pressed_ns - play.onset.monotonic_ns) / 1e9
    assert answer["rt_ms"] == pytest.approx(after_s * 1000, abs=1e-6)
    assert int(answer["factors"]["response_tick"]) == play.onset.tick + round(after_s * 85_000)
    uncertainty = float(answer["factors"]["response_uncertainty_s"])
    assert 0.004 < uncertainty < 0.004 + play.onset.monotonic_uncertainty + 0.001
    assert press.at(play.onset).wall == pytest.approx(play.onset.wall + after_s, abs=1e-4)


def test_a_button_box_speaks_on_a_serial_line() -> None:
    pytest.importorskip("serial")
    box, line = pty.openpty()
    tty.setraw(line)
    with ButtonBox(os.ttyname(line), buttons={b"1": "left", b"2": "right"}, uncertainty=0.002) as buttons:
        os.write(box, b"1")
        # The thread has it: only then is it old.
        assert (early := buttons.wait(timeout=300)) is not None
        os.write(box, b"1")
        while buttons._came.empty():
            time.sleep(0.001)
        buttons.flush()
        begun_ns = time.monotonic_ns()
        os.write(box, b"x2")
        press = buttons.wait(timeout=300)
        assert press is not None
        assert (early.name, press.name, press.uncertainty) == ("left", "right", 0.002)
        assert begun_ns <= press.monotonic_ns <= time.monotonic_ns()
        assert buttons.wait(timeout=0) is None
        os.close(box)
        with pytest.raises(MeissnerError, match="the button box is gone"):
            buttons.wait(timeout=300)
    os.close(line)
    with pytest.raises(MeissnerError, match="cannot be opened"):
        ButtonBox("/dev/none")


def test_a_question_does_not_take_what_was_typed_before() -> None:
    terminal, line = pty.openpty()
    go, going = os.pipe()
    code = "import os; from meissner.experiment import ask; print('ready', flush=True); "
    code += f"os.read({go}, 1); print('said', ask('Which?'))"
    command = [sys.executable, "-c", code]
    script = subprocess.Popen(command, stdin=line, stdout=line, stderr=line, pass_fds=(go,))
    os.close(line)
    said = b""

    def until(text: bytes) -> None:
        nonlocal said
        while text not in said:
            said += os.read(terminal, 1000)

    until(b"ready")
    os.write(terminal, b"1\n")
    until(b"1\r\n")
    os.write(going, b"!")
    until(b"Which?")
    os.write(terminal, b"2\n")
    until(b"said 2")
    script.wait()
    os.close(terminal)
