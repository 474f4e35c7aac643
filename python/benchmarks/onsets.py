"""Onsets of 1 000 plays in the client's clock, against the truth: over the Unix socket, and over TCP with 20 ms of jitter.

    MEISSNER_PROGRAM=target/release/meissner python benchmarks/onsets.py [PLAYS]

Over TCP the client's clock is shifted, and 100 ppm fast: the truth is that function of the daemon's clock. Over the
socket both read one clock, so the mapping cannot err, and the run tests only the daemon's own uncertainty.
The simulated device counts exactly `tick_hz` ticks per second of the daemon's clock, from an unknown instant on. One such
instant must fit all onsets within the uncertainties.
"""

import sys
import time
from pathlib import Path

import meissner
from meissner._endpoint import endpoints

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from network import Network


def skewed(host_ns: int) -> int:
    """The client's clock."""
    return host_ns + host_ns // 10_000 + 321_000_000_000


def agreement(low: list[float], high: list[float]) -> tuple[int, float]:
    """How many of the intervals share a point, and how far the farthest other one lies from it, ns."""
    edges = sorted([(each, -1) for each in low] + [(each, 1) for each in high])
    open_now, best, point = 0, 0, 0.0
    for place, edge in edges:
        open_now -= edge
        if open_now > best:
            best, point = open_now, place
    return best, max(max(start - point, point - end, 0.0) for start, end in zip(low, high, strict=True))


def measure(name: str, client: meissner.Client, plays: int, *, is_skewed: bool) -> None:
    """Plays, and compares each onset with the truth."""
    errors, uncertainties, low, high = [], [], [], []
    with client as m:
        m.synchronise()
        m.arm(assume_rest=True)
        for _ in range(plays):
            play = m.play("pin-60", 0.02)
            play.wait()
            onset = play.onset
            start, width = onset.host_ns - onset.tick * 1e9 / onset.tick_hz, onset.host_uncertainty * 1e9
            low.append(start - width)
            high.append(start + width)
            truth_ns = skewed(onset.host_ns) if is_skewed else onset.host_ns
            errors.append(abs(onset.monotonic_ns - truth_ns) / 1e9)
            uncertainties.append(onset.monotonic_uncertainty)
    wrong = sum(error > uncertainty for error, uncertainty in zip(errors, uncertainties, strict=True))
    fits, excess = agreement(low, high)
    print(
        f"{name}: {plays} plays, {wrong} errors above the uncertainty; largest error of the mapping {max(errors) * 1e6:.1f} us, "
        f"largest uncertainty {max(uncertainties) * 1e6:.1f} us; one start of the device fits {fits} onsets, the others err by up to {excess / 1e3:.1f} us more than the daemon states"
    )


def main() -> None:
    """Both connections."""
    plays = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    with meissner.Daemon("participant.max_continuous_s = 3600\n") as daemon:
        measure("unix", meissner.connect(daemon.socket), plays, is_skewed=False)
        with Network(daemon.socket) as network:
            network.jitter_s = 0.02
            core = meissner._core(endpoints(network.url)[0], None, 10.0)
            core.clock._monotonic_ns = lambda: skewed(time.monotonic_ns())
            measure("tcp, 20 ms of jitter, skewed", meissner.Client(core), plays, is_skewed=True)


main()
