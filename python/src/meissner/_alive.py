"""Signs of life: a thread that shows the daemon that a client is there, while it has armed or owns a session.

The daemon disarms when the client that armed is silent for as long as it has stated, and gives an exclusive session free. The
program itself may say nothing for long: in a rest break, or while it waits for an answer. So a thread asks for the status. It
ends with the process, whatever ends that.

Invariant: at most one thread per client, with a connection of its own.
"""

from __future__ import annotations

import contextlib
import copy
import threading

from . import _operations as ops
from ._operations import Core
from ._transport import BlockingTransport
from .errors import MeissnerError


class Alive:
    """The signs of life of a client."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self.problem: MeissnerError | None = None
        """Why the last sign did not reach the daemon; None if it did."""
        self._changed = threading.Event()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        """Call it after arming, and after the start of a session."""
        with self._lock:
            # A forked child has the parent's object, and no thread.
            if self._thread is None or not self._thread.is_alive():
                self.problem = None
                self._changed.clear()
                self._thread = threading.Thread(target=self._run, name="meissner-alive", daemon=True)
                self._thread.start()
            else:
                self._changed.set()

    def end(self) -> None:
        """Call it when a session has ended, and at the end of the client."""
        self._changed.set()

    def _run(self) -> None:
        # Arming is a sign itself. How soon a session needs one, the daemon has to tell.
        pause = 0.0 if self._core.session else (self._core.silence or 0.0) / 4
        with self._transport() as transport:
            while self._is_wanted(pause):
                try:
                    pause = ops.heartbeat(self._by(transport))
                    self.problem = None
                except MeissnerError as error:
                    pause = min(1.0, (self._core.silence or 4.0) / 4)
                    self.problem = error if self._core.shows_signs else None

    def _is_wanted(self, pause: float) -> bool:
        """Whether the next sign is, after this pause."""
        self._changed.wait(pause)
        self._changed.clear()
        with self._lock:
            if not self._core.shows_signs:
                # Under the lock: whoever begins anew starts another thread.
                self._thread = None
                return False
            return True

    def _transport(self) -> contextlib.closing[BlockingTransport]:
        core = self._core
        return contextlib.closing(BlockingTransport(core.endpoint, lambda: core.headers, core.clock.now_ns))

    def _by(self, transport: BlockingTransport) -> Core:
        """What the client's operations take, for another connection."""
        core = copy.copy(self._core)
        core.link = transport
        return core

    def release(self) -> None:
        """Disarm, if the client has armed: in any thread, on a connection that no other thread uses.

        The client disarms once more when it is closed: an `arm` that was under way may come after this.
        """
        if self._core.has_armed and self._core.is_own:
            with self._transport() as transport:
                ops.switch_off(self._by(transport))
