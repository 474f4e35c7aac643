"""What the client costs: time to import it, and time that a call takes over the Unix socket.

    MEISSNER_PROGRAM=target/release/meissner python benchmarks/cost.py

On a busy machine the clock's time says little; the processor's time of this process stands beside it.
"""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable

import meissner

IMPORT = """
import time
begun, used = time.perf_counter(), time.process_time()
import meissner
print(time.perf_counter() - begun, time.process_time() - used)
"""


def show(name: str, taken: list[tuple[float, float]]) -> None:
    """One line: medians, and the slowest of twenty."""
    clock, processor = sorted(each[0] for each in taken), [each[1] for each in taken]
    slow = clock[len(clock) * 19 // 20]
    print(
        f"{name}: p50 {statistics.median(clock) * 1e3:.2f} ms, p95 {slow * 1e3:.2f} ms, "
        f"processor of this process p50 {statistics.median(processor) * 1e3:.2f} ms, {len(taken)} times"
    )


def timed(call: Callable[[], object]) -> tuple[float, float]:
    """How long a call took, and how much of it this process has computed, s."""
    begun, used = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - begun, time.process_time() - used


def main() -> None:
    """All figures."""
    imports = []
    for _ in range(20):
        run = subprocess.run([sys.executable, "-c", IMPORT], capture_output=True, text=True, check=True)
        clock, processor = run.stdout.split()
        imports.append((float(clock), float(processor)))
    show("import meissner", imports)
    with meissner.demo() as m:
        show("status", [timed(m.status) for _ in range(300)])
        taken = []
        for _ in range(300):
            taken.append(timed(lambda: m.play("pin-60", 0.02)))
            m.wait_until_idle()
        show("play", taken)


main()
