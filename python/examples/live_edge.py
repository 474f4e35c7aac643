"""Move an edge that is pressed on a simulated array.

python live_edge.py                  # along a sine
tracker | python live_edge.py -      # along a tracked hand: lines of x_mm,y_mm,angle_deg,depth_um, as they come
"""

import math
import sys
import time
from collections.abc import Iterator

import meissner


def sine(seconds: float) -> Iterator[tuple[float, ...]]:
    """An edge that sways and turns, 50 poses a second."""
    for step in range(round(50 * seconds)):
        yield 3.0 * math.sin(step / 16), 0.0, 0.9 * step
        time.sleep(0.02)


def hand() -> Iterator[tuple[float, ...]]:
    """Poses as they arrive."""
    for line in sys.stdin:
        yield tuple(float(number) for number in line.split(","))


# The play ends, and the pins return, when no pose comes for `timeout` s.
with meissner.demo() as m, m.live(object="edge-45", timeout=2.0) as live:
    update = live.pose()
    for pose in hand() if "-" in sys.argv[1:] else sine(2.0):
        update = live.pose(*pose)
    print(f"the last pose was {update.wait().state}")
figures = live.receipt.raw["live"]
print(f"{figures['updates']} poses reached the daemon, {figures['applied']} the device")
