"""The bridge to LSL: true onsets on LSL's clock, and the command."""

from __future__ import annotations

import functools
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Mapping
from typing import Any

import pytest

import meissner
from meissner import lsl
from meissner._endpoint import endpoints
from network import Network

pylsl = pytest.importorskip("pylsl", reason="pylsl or liblsl is not installed")
HZ = 85_000
# Tests run beside one another, and LSL knows streams by their names.
NAME = f"meissner-{uuid.uuid4()}"


def open_inlet(name: str) -> Any:
    """Takes the stream's times as they were sent."""
    found = pylsl.resolve_byprop("name", name, timeout=200)
    assert found, f"no stream {name}"
    inlet = pylsl.StreamInlet(found[0])
    inlet.open_stream(timeout=200)
    return inlet


def pull(inlet: Any, count: int) -> list[tuple[str, float]]:
    """The next markers."""
    found = [inlet.pull_sample(timeout=200) for _ in range(count)]
    assert all(sample for sample, _ in found), found
    return [(sample[0], at) for sample, at in found]


def check_times(received: list[tuple[str, float]], bridge: lsl.Bridge, instants: list[meissner.Instant]) -> None:
    """On this machine LSL's clock is the daemon's, so `host_ns` is what the daemon knows of the truth."""
    low, high = [], []
    assert received == [(marker.text, marker.time) for marker in bridge.markers]
    # Of plays that follow one another the daemon tells the next one's onset first.
    in_time = sorted(bridge.markers, key=lambda marker: marker.time)
    for marker, instant in zip(in_time, instants, strict=True):
        at = marker.time
        assert abs(at - instant.host_ns / 1e9) <= marker.uncertainty
        assert instant.host_uncertainty <= marker.uncertainty < 0.03
        start = at - instant.tick / HZ
        low.append(start - marker.uncertainty)
        high.append(start + marker.uncertainty)
    # The simulated device counts exactly 85 000 ticks per second, from one unknown instant on. The daemon may err by some µs more
    # than it states on a busy machine.
    assert max(low) <= min(high) + 200e-6


def known(*instants: meissner.Instant | None) -> list[meissner.Instant]:
    return [instant for instant in instants if instant is not None]


def test_markers_bear_the_true_times(m: meissner.Client) -> None:
    with lsl.Bridge(m, name=NAME) as bridge:
        inlet = open_inlet(f"{NAME}-markers")
        instants = []
        for trial in range(5):
            play = m.play("pin-60", 0.05, trial=trial)
            play.wait()
            instants += [play.onset, play.offset]
        pair = m.sequence(["pin-60", "edge-45"], seconds=0.05, isi=0.1, name="pair")
        pair.wait()
        instants += known(pair.onset, *(item.onset for item in pair.items), pair.offset)
        received = pull(inlet, len(instants))
        texts = [text for text, _ in received]
        assert texts == ["onset/pin-60", "offset/pin-60"] * 5 + [
            "onset/pair",
            "item/pin-60",
            "item/edge-45",
            "offset/pair",
        ]
        check_times(received, bridge, instants)
        about = inlet.info()
        assert (about.type(), about.channel_count(), about.nominal_srate()) == ("Markers", 1, 0.0)
        assert about.source_id() == f"{NAME}/{m.status().raw['link']['identity']}/markers"
        description = about.desc()
        assert description.child_value("manufacturer") == "meissner"
        assert description.child_value("array") == m.array.name
        assert description.child_value("simulated") == "true"
        channel = description.child("channels").child("channel")
        assert (channel.child_value("label"), channel.child_value("type")) == ("marker", "Markers")
        assert description.child("synchronization").child_value("can_drop_samples") == "false"
        # The bridge ends right after the play: its last marker is sent all the same.
        m.play("pin-60", 0.05).wait()
    assert [marker.text for marker in bridge.markers[-2:]] == ["onset/pin-60", "offset/pin-60"]
    assert m.status().state == "armed"


def test_a_bridge_that_is_behind_sends_the_markers_of_all_plays_that_are_over(m: meissner.Client) -> None:
    texts: list[str] = []

    def slow(what: str, pattern: str, raw: Mapping[str, Any]) -> str:
        texts.append(lsl.text_of(what, pattern, raw))
        if len(texts) == 2:  # the first play's offset
            time.sleep(0.3)
        return texts[-1]

    with lsl.Bridge(m, name=f"{NAME}-behind", text=slow) as bridge:
        plays = []
        for _ in range(2):
            plays.append(m.play("pin-60", 0.05))
            plays[-1].wait()
    assert [marker.play for marker in bridge.markers] == [play.id for play in plays for _ in range(2)]


def test_markers_over_a_slow_network_with_a_skewed_clock_err_by_less_than_they_state(network: Network) -> None:
    def client_at(host_ns: int) -> int:
        return host_ns + host_ns // 10_000 + 321_000_000_000

    network.jitter_s = 0.02
    core = meissner._core(endpoints(network.url)[0], None, 10.0)
    core.clock._monotonic_ns = lambda: client_at(time.monotonic_ns())
    with meissner.Client(core) as m:
        m.synchronise()
        m.arm(assume_rest=True, checked="a test")
        with lsl.Bridge(m, name=f"{NAME}-far") as bridge:
            inlet = open_inlet(f"{NAME}-far-markers")
            plays = [m.play("pin-60", 0.05) for _ in range(4)]
            for play in plays:
                play.wait()
            instants = [instant for play in plays for instant in (play.onset, play.offset)]
            check_times(pull(inlet, len(instants)), bridge, instants)


def test_a_bridge_that_ends_too_soon_says_so_at_once_and_at_the_end(m: meissner.Client) -> None:
    lines: list[str] = []
    told = threading.Event()

    def report(line: str) -> None:
        lines.append(line)
        told.set()

    def broken(what: str, pattern: str, raw: Mapping[str, Any]) -> str:
        raise KeyError("block")

    def study(options: dict[str, Any]) -> None:
        with lsl.Bridge(m, name=f"{NAME}-broken", text=broken, **options) as bridge:
            m.play("pin-60", 0.05).wait()
            bridge._ended.wait(120.0)

    with pytest.raises(KeyError, match="block"):
        study({"report": report})
    assert told.wait(120.0)
    assert lines == ["markers have ended: 'block'"]
    with pytest.warns(UserWarning, match="have ended: 'block'"), pytest.raises(KeyError):
        study({})


def test_a_bridge_says_why_it_cannot_begin(daemon: meissner.Daemon) -> None:
    with meissner.connect(daemon.socket) as m:
        bridge = lsl.Bridge(m, name=f"{NAME}-none")
        m.core.endpoint = endpoints("http://127.0.0.1:9")[0]
        m.core.reconnect = 0.0
        bridge._of = m.core
        with pytest.raises(meissner.Unreachable), bridge:
            pass
        m.core.endpoint = endpoints(daemon.socket)[0]


def test_the_command_bridges_until_ctrl_c(daemon: meissner.Daemon) -> None:
    command = [sys.executable, "-m", "meissner.lsl", "--address", daemon.socket, "--name", f"{NAME}-command"]
    # A shell's background job, as which tests may run, ignores Ctrl-C, and so do its children.
    heeds = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    bridge = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heeds)
    try:
        assert bridge.stdout is not None
        assert f"`{NAME}-command-markers`" in bridge.stdout.readline()
        inlet = open_inlet(f"{NAME}-command-markers")
        with meissner.connect(daemon.socket) as m:
            m.arm(assume_rest=True, checked="a test")
            play = m.play("pin-60", 0.05)
            play.wait()
            (text, at), _ = pull(inlet, 2)
            assert text == "onset/pin-60"
            assert abs(at - play.onset.host_ns / 1e9) < 1e-3
        bridge.send_signal(signal.SIGINT)
        _, complaint = bridge.communicate(timeout=300)
        assert bridge.returncode == 0, complaint
    finally:
        bridge.kill()
        bridge.wait()


def test_the_command_says_what_is_wrong() -> None:
    command = [sys.executable, "-m", "meissner.lsl", "--address", "http://127.0.0.1:9"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode != 0
    assert "meissner-lsl: no daemon answers" in ended.stderr


def test_without_pylsl_the_remedy_is_told() -> None:
    code = "import sys; sys.modules['pylsl'] = None; from meissner import lsl; lsl.needs_pylsl()"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "pip install 'pylsl>=1.18'" in ended.stderr
