"""Play by OSC messages, as Max, Pure Data, TouchDesigner and Bonsai send them on this machine.

pip install 'python-osc>=1.9'; python osc_bridge.py [PORT]     # 9000 on this machine

/meissner/play pattern [scale [seconds]]   a stored pattern, 1 s unless told otherwise
/meissner/pin motor amplitude_um           a vibration of 60 Hz that follows; the pins return 2 s after the last message
/meissner/stop                             all pins return

The newest message wins. OSC goes by UDP, which may lose messages, so send a stop again until the pins rest. The bridge arms nothing:
arm by `meissner arm`, or on the page.
"""

import math
import socket
import sys
import threading
from typing import Any

from pythonosc.osc_message import OscMessage

import meissner

TEXT, INTEGER, NUMBER = "a text", "an integer from 0 on", "a finite number"
FORMS: dict[str, tuple[str, int, dict[str, str]]] = {
    "/meissner/play": ("pattern [scale [seconds]]", 1, {"pattern": TEXT, "scale": NUMBER, "seconds": NUMBER}),
    "/meissner/pin": ("motor amplitude_um", 2, {"motor": INTEGER, "amplitude_um": NUMBER}),
    "/meissner/stop": ("", 0, {}),
}
BUFFER_BYTES = 1 << 20
"""What the system is asked to keep of a burst; it may keep less."""


def fits(value: Any, kind: str) -> bool:
    """Whether an argument is of a kind. Programs without integers, such as Pure Data, send whole numbers as floats."""
    if kind == TEXT:
        return isinstance(value, str)
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    return is_number and (kind == NUMBER or (value >= 0 and value == int(value)))


def parsed(data: bytes) -> tuple[str, list[Any]]:
    """The address and the arguments of a message. Raises `ValueError` for what is no command of the bridge."""
    try:
        message = OscMessage(data)
        address, given = message.address, list(message.params)
    except Exception as error:  # The parser raises what it meets, and a datagram may hold anything.
        raise ValueError(f"no OSC message, {len(data)} bytes: send one message, not a bundle ({error})") from None
    if address not in FORMS:
        raise ValueError(f"{address!r:.60}: send one of {', '.join(FORMS)}")
    form, least, kinds = FORMS[address]
    if address == "/meissner/stop":
        return address, []
    if not least <= len(given) <= len(kinds):
        raise ValueError(f"{address} with {len(given)} arguments: send {address} {form}")
    for (name, kind), value in zip(kinds.items(), given, strict=False):
        if not fits(value, kind):
            raise ValueError(f"{address}: {name} is {value!r:.60}: must be {kind}; send {address} {form}")
    return address, [
        int(value) if kind == INTEGER else value for kind, value in zip(kinds.values(), given, strict=False)
    ]


class Bridge:
    """Does what messages say. A stop goes by a client of its own, and waits for nothing.

    `receive` only notes what came, so that datagrams do not pile up. Invariants: of messages that wait only the newest is kept, and it
    begins after every stop that came before it.
    """

    def __init__(self, client: meissner.Client, stopper: meissner.Client) -> None:
        self.client, self.stopper = client, stopper
        self.live: meissner.Live | None = None
        self.changed = threading.Condition()
        self.newest: tuple[str, list[Any]] | None = None
        self.stops, self.stopped = 0, 0
        """How many stops were asked for, and how many of these are done."""

    def start(self) -> None:
        """Begins to do what is received, for ever."""
        for work in (self.work, self.work_stops):
            threading.Thread(target=work, daemon=True).start()

    def receive(self, data: bytes) -> None:
        """Takes a datagram. It waits for no earlier one."""
        try:
            address, given = parsed(data)
        except ValueError as error:
            print(f"refused: {error}", file=sys.stderr, flush=True)
            return
        with self.changed:
            if address == "/meissner/stop":
                self.stops += 1
                self.newest = None
            else:
                self.newest = address, given
            self.changed.notify_all()

    def work_stops(self) -> None:
        """Stops, as often as asked for."""
        while True:
            with self.changed:
                self.changed.wait_for(lambda: self.stopped < self.stops)
                stops = self.stops
            try:
                self.stopper.stop()
            except meissner.MeissnerError as error:
                print(f"refused: {error}", file=sys.stderr, flush=True)
            with self.changed:
                self.stopped = stops
                self.changed.notify_all()

    def work(self) -> None:
        """Does what the newest message says."""
        while True:
            with self.changed:
                self.changed.wait_for(lambda: self.newest is not None and self.stopped == self.stops)
                newest, self.newest, stops = self.newest, None, self.stops
            if newest is None:
                continue
            address, given = newest
            try:
                self.play(*given) if address == "/meissner/play" else self.pin(*given)
            except (ValueError, TimeoutError, meissner.MeissnerError) as error:
                print(f"refused: {error}", file=sys.stderr, flush=True)
            with self.changed:
                if stops != self.stops:
                    # The stop may have come before the daemon had this: it is done again.
                    self.stops += 1
                    self.changed.notify_all()

    def play(self, pattern: str, scale: float = 1.0, seconds: float = 1.0) -> None:
        """Plays a pattern, in place of what plays."""
        self.client.play(pattern, seconds, scale=scale, replace=True)

    def pin(self, motor: int, amplitude_um: float) -> None:
        """Changes the vibration of a pin, or begins one in place of what plays."""
        drive = {"motor": motor, "frequency_hz": 60.0, "amplitude_um": amplitude_um}
        try:
            if self.live is not None:
                self.live.drives([drive]).wait(10.0)
                return
        except (TimeoutError, meissner.PlayStopped, meissner.Unreachable, meissner.errors.ConnectionLost):
            # It is over, or its connection is.
            self.live = None
        self.live = self.client.live(drives=[drive], timeout=2.0, replace=True)


def main() -> None:
    """Listens on this machine alone: OSC has no passwords."""
    with (
        meissner.connect() as client,
        meissner.connect() as stopper,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
    ):
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        udp.bind(("127.0.0.1", int(sys.argv[1]) if len(sys.argv) > 1 else 9000))
        bridge = Bridge(client, stopper)
        bridge.start()
        print(f"listening on port {udp.getsockname()[1]}", flush=True)
        try:
            while True:
                bridge.receive(udp.recv(65536))
        except KeyboardInterrupt:
            print("stopped", flush=True)
        finally:
            stopper.stop()


if __name__ == "__main__":
    main()
