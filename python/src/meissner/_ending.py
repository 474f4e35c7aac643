"""The end of the program: whatever ends it, armed clients disarm and the program's own daemons end, if Python can see to it.

Clients and daemons enter themselves by `opened` and leave by `closed`. At Python's end `end` closes what is still open. While
something is open, SIGTERM, and SIGHUP of a closed terminal, end a script as `sys.exit` does, so that `with` and `finally` blocks
run; by default they kill it at once. A thread hears of these signals too and disarms at once: the main thread may be blocked in
a C call, or its program may catch `SystemExit`.

Not here: a program that is killed, or whose client was opened outside of the main thread. The daemon's watch over silence
(`_alive.py`) is for them. A handler or a descriptor that the program has set stays, and so does a signal that it ignores.

Invariants: without anything open, the handlers are as they were, unless the end is under way. A forked child touches nothing that its parent has opened.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
import time
from typing import NoReturn, Protocol

from .errors import MeissnerError

ENDINGS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""The signals that end a program. Windows has no SIGHUP."""
_SAME_END = 30.0
"""For how long further signals belong to the same end, s. A terminal that is closed sends two; `finally` blocks must not be cut."""
_SETTLE = 2.0
"""How long Python's end waits for this package's threads, s. A thread that runs on while Python takes itself apart can crash it."""
_PATIENCE = 15.0
"""How long an interactive shell waits for the motors to be off before it dies, s."""


class Open(Protocol):
    """What has to be ended with the program."""

    def end(self) -> None:
        """Ends it, as Python ends."""

    def release(self, last: bool) -> None:
        """Disarms at once, by another thread. `last`: the program dies right after."""


_open: dict[int, Open] = {}


def opened(each: Open) -> None:
    """Ends this with the program, unless `closed` was called before."""
    _open[id(each)] = each
    _signals.watch()


def closed(each: Open) -> None:
    """Takes note that this has ended."""
    _open.pop(id(each), None)
    if not _open and not _signals.is_ending():
        _signals.leave()


def _newest_first() -> list[Open]:
    # A client before the daemon that it talks to.
    return list(reversed(_open.values()))


def _report(error: MeissnerError) -> None:
    with contextlib.suppress(OSError):  # The terminal may be closed.
        print(f"meissner: at the end of the program: {error}", file=sys.stderr)


@atexit.register
def _end_all() -> None:
    _signals.ending_since = time.monotonic()
    for each in _newest_first():
        try:
            each.end()
        except MeissnerError as error:
            _report(error)
    _signals.deafen()
    deadline = time.monotonic() + _SETTLE
    for thread in threading.enumerate():
        if thread.daemon and thread.name.startswith("meissner-") and thread is not threading.current_thread():
            thread.join(max(0.0, deadline - time.monotonic()))


def _is_interactive() -> bool:
    """Whether a shell would catch `SystemExit`: Python's own, IPython, Jupyter."""
    return hasattr(sys, "ps1") or bool(sys.flags.inspect)


def _may_handle() -> bool:
    """Python lets the main thread alone set handlers."""
    return threading.current_thread() is threading.main_thread()


class _Signals:
    """The handlers of the signals, and the thread that hears of them."""

    def __init__(self) -> None:
        self.ending_since: float | None = None
        """When the end began; None: it has not."""
        self._pipe: tuple[int, int] | None = None
        """What the signals are written to, for the thread: its ends for reading and writing."""
        self._released = threading.Event()
        self._forking = threading.local()

    def watch(self) -> None:
        """Handles the signals, if this is the main thread and nobody else does."""
        if not _may_handle():
            return
        for number in ENDINGS:
            if signal.getsignal(number) is signal.SIG_DFL:
                # Python refuses it in an interpreter within another one.
                with contextlib.suppress(ValueError):
                    signal.signal(number, self._handle)
                    self._listen()

    def _listen(self) -> None:
        if self._pipe is not None:
            return
        reading, writing = self._pipe = os.pipe()
        if hasattr(os, "set_blocking"):
            os.set_blocking(writing, False)
        threading.Thread(target=self._hear, args=(reading,), name="meissner-signals", daemon=True).start()
        # C code writes to it also while the main thread is blocked.
        before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        if before != -1:
            signal.set_wakeup_fd(before)

    def leave(self) -> None:
        """Restores the handlers. Outside of the main thread they stay until the next time."""
        if not _may_handle():
            return
        for number in ENDINGS:
            if signal.getsignal(number) == self._handle:
                signal.signal(number, signal.SIG_DFL)
        self.deafen()

    def deafen(self) -> None:
        """Ends the thread, and leaves the handlers. In the main thread only."""
        if not _may_handle():
            return
        pipe, self._pipe = self._pipe, None
        if pipe is not None:
            before = signal.set_wakeup_fd(-1)
            if before not in (-1, pipe[1]):
                signal.set_wakeup_fd(before)
            os.close(pipe[1])  # The thread reads the end, and closes its own.

    def before_fork(self) -> None:
        """Holds the signals back: Python in the child would lose one that comes before `forget`."""
        if self._pipe is not None:
            self._forking.mask = signal.pthread_sigmask(signal.SIG_BLOCK, ENDINGS)

    def after_fork(self) -> None:
        """Lets the signals through again."""
        mask = self._forking.__dict__.pop("mask", None)
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def forget(self) -> None:
        """In a forked child: the parent's end and what it has opened are the parent's."""
        _open.clear()
        self.ending_since = None
        if self._pipe is not None:
            os.close(self._pipe[0])
        self.leave()
        self.after_fork()

    def is_ending(self) -> bool:
        """Whether the end is under way. A program that is still there long afterwards has decided otherwise."""
        return self.ending_since is not None and time.monotonic() - self.ending_since < _SAME_END

    def _handle(self, number: int, frame: object) -> None:
        if self.is_ending():
            return
        if not _open:
            _die(number)
        self.ending_since = time.monotonic()
        self._released.clear()
        if self._pipe is not None:
            # Also where somebody else has the descriptor for signals.
            with contextlib.suppress(OSError):
                os.write(self._pipe[1], bytes([number]))
        if _is_interactive():
            self._released.wait(_PATIENCE)
            _die(number)
        sys.exit(128 + number)

    def _hear(self, reading: int) -> None:
        """The thread."""
        while heard := os.read(reading, 1):
            number = heard[0]
            # Other signals are written as well, and the program may have set a handler since.
            if number in ENDINGS and signal.getsignal(number) == self._handle:
                for each in _newest_first():
                    try:
                        each.release(_is_interactive())
                    except MeissnerError as error:
                        _report(error)
                self._released.set()
        os.close(reading)


def _die(number: int) -> NoReturn:
    """As if the signal had not been handled."""
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)
    raise SystemExit(128 + number)  # Where a signal does not end the program.


_signals = _Signals()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_signals.before_fork, after_in_parent=_signals.after_fork, after_in_child=_signals.forget
    )
