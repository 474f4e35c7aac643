"""Clocks that differ in offset and rate, behind a network with jitter, in virtual time: 1 000 plays each."""

from __future__ import annotations

import json
import random
from typing import Any

import pytest

from meissner import _operations as ops
from meissner._endpoint import Endpoint
from meissner._http import Answer, Request
from meissner.clocks import MAX_SKEW, NS, ClientClock, Instant
from meissner.errors import NotKnownYet

HZ = 85_000


class World:
    """A daemon, its device and a client, each with a clock of its own, and a network between them. Time is virtual."""

    def __init__(self, *, skew: float, jitter_s: float, base_s: float = 0.0001, same_clock: bool = False) -> None:
        self.time = 1000.0  # true time: that of the daemon's clock, s
        self.skew, self.jitter_s, self.base_s = skew, jitter_s, base_s
        self.offset_ns = 0 if same_clock else -777_123_456_789
        self.chance = random.Random(5)
        self.plays: list[dict[str, Any]] = []
        self.clock = ClientClock(same_machine=same_clock, monotonic_ns=self.client_ns, wall_ns=self.wall_ns)
        self.core = ops.Core(Endpoint("http://pc"), self.clock)
        link: Any = self
        self.core.link = link

    def host_ns(self, time: float | None = None) -> int:
        return round((self.time if time is None else time) * NS)

    def client_at(self, host_ns: float) -> float:
        """The truth: the client's clock when the daemon's shows `host_ns`."""
        return host_ns * (1 + self.skew) + self.offset_ns

    def client_ns(self) -> int:
        return round(self.client_at(self.time * NS))

    def wall_ns(self) -> int:
        return self.client_ns() + 1_700_000_000 * NS

    def device(self, host_ns: float) -> float:
        """The truth: the device's ticks, 30 ppm fast."""
        return (1 << 32) + host_ns / NS * HZ * (1 + 30e-6)

    def travel(self) -> None:
        self.time += self.base_s + self.chance.uniform(0, self.jitter_s)

    def answer(self, request: Request) -> dict[str, Any]:
        if request.path == "/v1/status":
            clock = {"tick": round(self.device(self.time * NS)), "tick_hz": HZ, "monotonic_ns": self.host_ns()}
            fixed: dict[str, Any] = {
                "state": "armed",
                "cause": "request",
                "position": "known",
                "play": None,
                "queued": [],
                "link": {"missing": None},
                "daemon": {"pid": 1, "version": "0"},
            }
            return {**fixed, "clock": clock, "device": {"boot": 7, "simulated": True}}
        if request.path == "/v1/play":
            body = json.loads(request.content or b"")
            onset_ns = body["at_monotonic_ns"]
            assert onset_ns > self.host_ns(), "the onset has passed"
            tick = round(self.device(onset_ns))
            # The daemon knows its device to 10 us, and errs within that.
            error = round(self.chance.uniform(-10_000, 10_000))
            truth = onset_ns + (tick - self.device(onset_ns)) / HZ * NS
            self.plays.append({"tick": tick, "truth_ns": truth, "reported_ns": round(truth + error), "asked": onset_ns})
            return {"id": len(self.plays), "ordered_ms": 100.0, "compiled_ms": 99.0}
        play = self.plays[int(request.path.split("/")[3].split("?")[0]) - 1]
        self.time = max(self.time, play["truth_ns"] / NS + 0.1)
        record = {"monotonic_ns": play["reported_ns"], "uncertainty_ns": 10_000}
        onset, offset = {"actual_tick": play["tick"], **record}, {"tick": play["tick"], **record}
        done: dict[str, Any] = {
            "id": 1,
            "name": "p",
            "state": "done",
            "cause": None,
            "edges": {"start": None, "stop": None},
            "items": None,
            "counts": {"lateness": {"host": 0, "link": 0, "device": 0}},
            "reach": {"drives": [], "warnings": []},
            "device": {"array": "tula35-6x4", "tick_hz": HZ, "boot": 7},
        }
        return {**done, "onset": onset, "offset": offset}

    def perform(self, request: Request) -> Answer:
        sent = self.client_ns()
        self.travel()
        document = self.answer(request)
        self.travel()
        return Answer(200, json.dumps(document).encode(), sent, self.client_ns())

    def pause(self, seconds: float) -> None:
        self.time += seconds


@pytest.mark.parametrize("skew", [0.0, 150e-6, -150e-6])
@pytest.mark.parametrize(("jitter_s", "most_s"), [(0.0, 0.0006), (0.020, 0.020)])
def test_no_onset_of_1000_plays_errs_by_more_than_its_uncertainty(skew: float, jitter_s: float, most_s: float) -> None:
    world = World(skew=skew, jitter_s=jitter_s)
    ops.begin(world.core)
    uncertainties = []
    for number in range(1000):
        at = world.clock.now_ns() / NS + 0.2
        accepted = ops.play(world.core, "p", 0.1, at=at)
        onset = ops.wait(world.core, accepted).onset
        assert onset is not None
        truth = world.client_at(world.plays[-1]["truth_ns"])
        assert abs(onset.monotonic_ns - truth) <= onset.monotonic_uncertainty * NS + 1, number
        assert abs(onset.wall_ns - truth - 1_700_000_000 * NS) <= onset.wall_uncertainty * NS + 1, number
        # What was asked for came, as exactly as the clocks are known to each other.
        asked = world.client_at(world.plays[-1]["asked"])
        assert abs(asked - at * NS) <= onset.monotonic_uncertainty * NS + most_s * NS, number
        uncertainties.append(onset.monotonic_uncertainty)
        world.time += world.chance.choice([0.0, 0.5, 3.0])
    assert max(uncertainties) < most_s
    assert not world.clock.is_shared
    assert world.clock.restarts == 0


def test_one_machine_has_one_clock() -> None:
    world = World(skew=0.0, jitter_s=0.001, same_clock=True)
    assert ops.synchronise(world.core) == 0
    assert world.clock.is_shared
    assert world.clock.to_client(12345) == world.clock.to_host(12345) == (12345, 0)


def test_a_tunnel_is_no_machine_of_its_own() -> None:
    """A forwarded socket looks local, but the daemon's clock does not stand between sending and receiving."""
    clock = ClientClock(same_machine=True)
    clock.add(1000, 2000, 1500)
    assert clock.is_shared
    clock.add(3000, 4000, 90_000)
    assert not clock.is_shared


def test_a_clock_that_jumps_begins_anew() -> None:
    clock = ClientClock()
    clock.add(0, 1000, 500_000)
    assert clock.to_client(500_000) == (500, 500)
    clock.add(10_000_000, 10_001_000, 900_000)
    assert clock.restarts == 1
    assert clock.to_client(900_000) == (10_000_500, 500)


def test_what_is_not_known_is_said() -> None:
    with pytest.raises(NotKnownYet, match="call `status"):
        ClientClock().to_client(0)
    world = World(skew=0.0, jitter_s=0.0)
    answer = world.answer

    def without_device(request: Request) -> dict[str, Any]:
        return {**answer(request), "clock": None, "device": None, "link": {"missing": "no device"}}

    world.answer = without_device  # type: ignore[method-assign]
    assert ops.begin(world.core).raw["link"]["missing"] == "no device"
    assert ops.synchronise(world.core) == float("inf")


def test_a_later_instant_is_exact_in_ticks_and_less_certain_in_time() -> None:
    def now() -> int:
        return 5 * NS

    clock = ClientClock(same_machine=True, monotonic_ns=now, wall_ns=now)
    clock.add(5 * NS, 5 * NS, 5 * NS)
    onset = clock.instant(tick=1000, boot=7, tick_hz=HZ, host_ns=5 * NS, host_uncertainty_ns=10_000)
    later = onset.later(1.5)
    assert isinstance(later, Instant)
    assert (later.tick, later.boot) == (1000 + 127_500, 7)
    assert later.monotonic == later.wall == 6.5
    assert later.monotonic_uncertainty == pytest.approx(10e-6 + 1.5 * MAX_SKEW)


def test_samples_that_tell_nothing_are_left_out() -> None:
    clock = ClientClock()
    for number in range(2000):
        host = number * 1_000_000
        clock.add(host + 7 - number % 5, host + 1007 + number % 7, host)
    assert len(clock._samples) <= 64
    assert clock.to_client(1_999_000_000)[1] <= 1000
