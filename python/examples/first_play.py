"""Play an edge on a simulated array, and print when it began and ended."""

import meissner

with meissner.demo() as m:
    play = m.play("edge-45", seconds=0.3, at=m.now() + 1.0, scale=0.8)
    play.wait()
    print(f"onset {play.onset.monotonic:.6f} s, known to {play.onset.monotonic_uncertainty * 1e6:.0f} µs")
    print(f"offset {play.offset.monotonic:.6f} s, tick {play.offset.tick}")
