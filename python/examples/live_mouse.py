"""Press an edge on the display, and move it by a mouse, a knob or a touchpad, until Ctrl-C or until the device is gone.

python live_mouse.py                      # the first mouse; its wheel turns the edge
python live_mouse.py /dev/input/event3    # this mouse, knob (it turns), touchpad or tablet (its area is the array's)

It needs evdev (`pip install evdev`), an armed daemon, and the right to read input devices: the group `input`.
"""

import contextlib
import select
import sys

import evdev
from evdev import ecodes

import meissner

MM_PER_COUNT = 0.02
DEGREES_PER_NOTCH = 5.0


class Hand:
    """Where the edge is. It stays within `most_mm` of the array's middle, along x and y."""

    def __init__(self, most_mm: list[float], device: evdev.InputDevice) -> None:
        self.most_mm = most_mm
        self.mm = [0.0, 0.0]
        self.degrees = 0.0
        axes = dict(device.capabilities(absinfo=True).get(ecodes.EV_ABS, []))
        self.ranges = [axes.get(code) for code in (ecodes.ABS_X, ecodes.ABS_Y)]

    def hear(self, event: evdev.InputEvent) -> None:
        """Takes a motion of the device, whose y points down."""
        if event.type == ecodes.EV_REL:
            if event.code in (ecodes.REL_X, ecodes.REL_Y):
                axis = int(event.code == ecodes.REL_Y)
                moved = self.mm[axis] + MM_PER_COUNT * (-event.value if axis else event.value)
                self.mm[axis] = min(max(moved, -self.most_mm[axis]), self.most_mm[axis])
            elif event.code in (ecodes.REL_WHEEL, ecodes.REL_DIAL):
                self.degrees = (self.degrees + DEGREES_PER_NOTCH * event.value) % 360
        elif event.type == ecodes.EV_ABS and event.code in (ecodes.ABS_X, ecodes.ABS_Y):
            axis = int(event.code == ecodes.ABS_Y)
            if (found := self.ranges[axis]) is not None and found.max > found.min:
                share = 2 * (event.value - found.min) / (found.max - found.min) - 1
                self.mm[axis] = self.most_mm[axis] * (-share if axis else share)


def follow(live: meissner.Live, hand: Hand, device: evdev.InputDevice) -> None:
    """Sends where the edge is 50 times a second. That is a sign of life, too: without one the play ends after 0.5 s."""
    while True:
        if select.select([device.fd], [], [], 0.02)[0]:
            try:
                for event in device.read():
                    hand.hear(event)
            except OSError as error:
                print(f"the device is gone: {error}")
                return
        live.pose(hand.mm[0], hand.mm[1], hand.degrees)


def main() -> None:
    """Opens the device and follows it."""
    found = [evdev.InputDevice(path) for path in sys.argv[1:] or evdev.list_devices()]
    mice = [device for device in found if sys.argv[1:] or ecodes.REL_X in device.capabilities().get(ecodes.EV_REL, [])]
    if not mice:
        sys.exit("there is no mouse that you may read: name an input device, or join the group `input`")
    print(f"{mice[0].path} ({mice[0].name})")
    with meissner.connect() as m:
        most_mm = [max(abs(place[axis]) for place in m.array.positions_mm) for axis in (0, 1)]
        with m.live(object="edge-45", timeout=0.5) as live:
            with contextlib.suppress(KeyboardInterrupt):
                follow(live, Hand(most_mm, mice[0]), mice[0])


if __name__ == "__main__":
    main()
