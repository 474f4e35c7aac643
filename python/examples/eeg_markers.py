"""Send markers of two plays to LSL, and receive them as a recorder of EEG does. It needs pylsl."""

import pylsl

import meissner
from meissner import lsl

with meissner.demo() as m, lsl.Bridge(m, name="example") as bridge:
    inlet = pylsl.StreamInlet(pylsl.resolve_byprop("name", "example-markers", timeout=60)[0])
    inlet.open_stream(timeout=60)
    for pattern in ("pin-60", "edge-45"):
        m.play(pattern, seconds=0.2).wait()
    for _ in range(4):
        (text,), time = inlet.pull_sample(timeout=60)
        print(f"{text} at {time:.6f} s of LSL's clock")
