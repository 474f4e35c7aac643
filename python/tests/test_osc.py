"""The example `osc_bridge.py`: OSC messages on the loopback become plays, a stop waits for nothing, and bad messages move nothing."""

from __future__ import annotations

import importlib.util
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

import meissner

pytest.importorskip("pythonosc", reason="python-osc is not installed")
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder

BRIDGE = Path(__file__).parents[1] / "examples" / "osc_bridge.py"


def message(address: str, *given: Any) -> bytes:
    """A datagram, as other programs make them."""
    builder = OscMessageBuilder(address)
    for value in given:
        builder.add_arg(value)
    return bytes(builder.build().dgram)


class Running:
    """The bridge as a program, and a sender of OSC messages."""

    def __init__(self, daemon: meissner.Daemon) -> None:
        environment = {**os.environ, "MEISSNER_SOCKET": daemon.socket}
        self.program = subprocess.Popen(
            [sys.executable, str(BRIDGE), "0"],
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        assert self.program.stdout is not None
        begun = self.program.stdout.readline()
        assert begun.startswith("listening on port ")
        self.port = int(begun.split()[-1])

    def send(self, address: str, *given: Any) -> None:
        self.send_bytes(message(address, *given))

    def send_bytes(self, data: bytes) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            udp.sendto(data, ("127.0.0.1", self.port))

    def complaint(self) -> str:
        """The next line on stderr."""
        assert self.program.stderr is not None
        return self.program.stderr.readline()

    def end(self) -> str:
        """Ends it as Ctrl-C does. Returns the rest of stderr."""
        self.program.send_signal(signal.SIGINT)
        _, complaints = self.program.communicate()
        return complaints


@pytest.fixture
def bridge(m: meissner.Client, daemon: meissner.Daemon) -> Iterator[Running]:
    running = Running(daemon)
    try:
        yield running
    finally:
        running.program.kill()
        running.program.communicate()


def until(m: meissner.Client, fits: Callable[[meissner.Receipt], bool]) -> meissner.Receipt:
    """The newest receipt, once it fits."""
    newest = None
    for _ in range(3000):
        try:
            newest = m.receipt()
            if fits(newest):
                return newest
        except meissner.errors.NotFound:
            pass
        time.sleep(0.01)
    raise AssertionError(f"the newest receipt is {newest}")


def test_messages_play_follow_and_stop(m: meissner.Client, bridge: Running) -> None:
    before = m.play("pin-60", 0.05)
    before.wait()
    bridge.send("/meissner/play", "edge-45", 0.5, 300.0)
    play = until(m, lambda receipt: receipt.id > before.id and receipt.onset is not None)
    assert (play.pattern, play.raw["scale"]) == ("edge-45", 0.5)
    bridge.send("/meissner/stop")
    assert until(m, lambda receipt: receipt.id == play.id and receipt.is_over).raw["state"] == "stopped"
    bridge.send("/meissner/pin", 9, 40.0)
    live = until(m, lambda receipt: receipt.id > play.id and receipt.raw["state"] == "running")
    assert live.pattern == "live"
    bridge.send("/meissner/pin", 10, 20.0)
    # The newest message wins.
    bridge.send("/meissner/play", "pin-60")
    short = until(m, lambda receipt: receipt.id > live.id and receipt.is_over)
    assert (short.pattern, short.raw["state"]) == ("pin-60", "done")
    assert bridge.end() == ""
    assert bridge.program.returncode == 0


def test_a_bad_message_gets_one_line_and_moves_nothing(m: meissner.Client, bridge: Running) -> None:
    before = m.play("pin-60", 0.05)
    before.wait()
    refused: list[tuple[str, list[Any], str]] = [
        ("/meissner/play", [], "send /meissner/play pattern [scale [seconds]]"),
        ("/meissner/play", [3], "send /meissner/play pattern"),
        ("/meissner/play", ["edge-45", float("nan")], "send /meissner/play pattern"),
        ("/meissner/play", ["no-such-pattern"], "no-such-pattern"),
        ("/meissner/play", ["edge-45", 99.0], "scale"),
        (
            "/meissner/pin",
            ["nine", 40.0],
            "motor is 'nine': must be an integer from 0 on; send /meissner/pin motor amplitude_um",
        ),
        ("/meissner/pin", [9.5, 40.0], "motor is 9.5: must be an integer from 0 on"),
        ("/meissner/pin", [9, "much"], "amplitude_um is 'much': must be a finite number"),
        ("/meissner/pin", [9], "/meissner/pin with 1 arguments: send /meissner/pin motor amplitude_um"),
        ("/meissner/pin", [24, 40.0], "the array tula35-6x4 has motors 0 to 23"),
        ("/meissner/pin", [9, -1.0], "amplitude_um"),
        ("/meissner/pins", [9, 40.0], "send one of /meissner/play, /meissner/pin, /meissner/stop"),
    ]
    for address, given, said in refused:
        bridge.send(address, *given)
        line = bridge.complaint()
        assert line.startswith("refused: "), line
        assert said in line
    bundle = OscBundleBuilder(IMMEDIATELY)
    bundle.add_content(OscMessageBuilder("/meissner/stop").build())
    for junk in (bundle.build().dgram, b"", b"\xff" * 40, b"/meissner/play\0\0,s\0\0"):
        bridge.send_bytes(junk)
        assert "no OSC message" in bridge.complaint()
    assert m.receipt().id == before.id
    m.disarm()
    while m.status().state != "disarmed":
        time.sleep(0.01)
    bridge.send("/meissner/play", "edge-45")
    assert "disarmed" in bridge.complaint()
    # A stop is taken in every state: the next line is not about it.
    bridge.send("/meissner/stop", "whatever")
    bridge.send("/meissner/nothing")
    assert "/meissner/nothing" in bridge.complaint()


def example() -> Any:
    """The example as a module."""
    spec = importlib.util.spec_from_file_location("osc_bridge", BRIDGE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "error",
    [
        meissner.PlayStopped(cast("Any", SimpleNamespace(id=1, pattern="live", state="stopped", cause="silent"))),
        meissner.errors.ConnectionLost("the daemon has ended"),
        TimeoutError(),
    ],
)
def test_pins_follow_in_one_live_play_until_it_has_ended(error: Exception) -> None:
    said: list[Any] = []

    class Live:
        is_over = False

        def drives(self, drives: list[dict[str, Any]]) -> SimpleNamespace:
            if self.is_over:
                raise error
            if drives[0]["amplitude_um"] > 400:
                raise meissner.errors.BadRequest("too large", status=400)
            said.append(drives)
            return SimpleNamespace(wait=lambda _: None)

    def begin(**given: Any) -> Live:
        said.append(given)
        return Live()

    bridge = example().Bridge(SimpleNamespace(live=begin), None)
    bridge.pin(9, 40.0)
    # What is refused changes nothing of what plays.
    with pytest.raises(meissner.errors.BadRequest):
        bridge.pin(9, 401.0)
    bridge.pin(10, 20.0)
    bridge.live.is_over = True
    bridge.pin(9, 30.0)
    nine, ten = ({"motor": motor, "frequency_hz": 60.0, "amplitude_um": um} for motor, um in ((9, 40.0), (10, 20.0)))
    begun = {"timeout": 2.0, "replace": True}
    assert said == [{"drives": [nine], **begun}, [ten], {"drives": [{**nine, "amplitude_um": 30.0}], **begun}]


def test_a_stop_waits_for_no_message_before_it() -> None:
    """The daemon is slow with a play: the stop passes it, what waits is dropped, and the play is stopped once it is there."""
    under_way, goes_on, stopped_again = threading.Event(), threading.Event(), threading.Event()
    done: list[str] = []

    def play(pattern: str, *_: object, **__: object) -> None:
        under_way.set()
        goes_on.wait()
        done.append(pattern)

    def stop() -> None:
        done.append("stop")
        if done.count("stop") == 2:
            stopped_again.set()

    bridge = example().Bridge(SimpleNamespace(play=play), SimpleNamespace(stop=stop))
    bridge.start()

    bridge.receive(message("/meissner/play", "slow"))
    under_way.wait()
    bridge.receive(message("/meissner/play", "waits"))
    bridge.receive(message("/meissner/stop"))
    while not done:
        time.sleep(0.001)
    assert done == ["stop"]
    goes_on.set()
    stopped_again.wait()
    bridge.receive(message("/meissner/play", "after"))
    while "after" not in done:
        time.sleep(0.001)
    assert done == ["stop", "slow", "stop", "after"]


def test_of_messages_that_wait_only_the_newest_is_done_after_the_stops_before_it() -> None:
    """Play and stop are slow, and a burst comes meanwhile: it is taken at once."""
    play_under_way, stop_under_way, play_goes_on, stop_goes_on = (threading.Event() for _ in range(4))
    done: list[str] = []

    def play(pattern: str, *_: object, **__: object) -> None:
        play_under_way.set()
        play_goes_on.wait()
        done.append(pattern)

    def stop() -> None:
        stop_under_way.set()
        stop_goes_on.wait()
        done.append("stop")

    bridge = example().Bridge(SimpleNamespace(play=play), SimpleNamespace(stop=stop))
    bridge.start()

    bridge.receive(message("/meissner/play", "slow"))
    play_under_way.wait()
    for number in range(1000):
        bridge.receive(message("/meissner/play", f"waits-{number}"))
    play_goes_on.set()
    while "waits-999" not in done:
        time.sleep(0.001)
    assert done == ["slow", "waits-999"]

    bridge.receive(message("/meissner/stop"))
    stop_under_way.wait()
    for number in range(1000):
        bridge.receive(message("/meissner/play", f"after-{number}"))
    assert done == ["slow", "waits-999"]
    stop_goes_on.set()
    while "after-999" not in done:
        time.sleep(0.001)
    assert done == ["slow", "waits-999", "stop", "after-999"]


def test_whole_numbers_name_motors_as_integers_do() -> None:
    address, (motor, amplitude_um) = example().parsed(message("/meissner/pin", 9.0, 40.0))
    assert (address, motor, amplitude_um) == ("/meissner/pin", 9, 40.0)
    assert isinstance(motor, int)
