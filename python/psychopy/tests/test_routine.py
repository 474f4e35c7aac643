"""The lines that the component writes, in a frame loop like that of an exported script, on the simulated array."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import environment
import meissner
from meissner import _http
from meissner import _operations as ops
from psychopy_meissner import device as device_module
from psychopy_meissner import routine as routine_module
from psychopy_meissner import script
from psychopy_meissner.device import MeissnerDevice, experiment_time, shared
from psychopy_meissner.routine import TactilePlay

PERIOD = 1 / 60
NOT_STARTED, STARTED, FINISHED = 0, 1, -1
ENVIRONMENT = Path(environment.__file__).parent


@pytest.fixture(scope="session")
def shared_daemon() -> Iterator[meissner.Daemon]:
    with meissner.Daemon("session_silence_s = 5\n") as daemon:
        yield daemon


@pytest.fixture
def daemon(shared_daemon: meissner.Daemon) -> Iterator[meissner.Daemon]:
    """A daemon that a test leaves without plays, session and armed motors."""
    yield shared_daemon
    with meissner.connect(shared_daemon.socket) as m:
        state = m.status()
        assert state.raw["session"] is None, "a test has left its session"
        if state.state == "faulted":
            m.reset(force=True)
        m.wait_until_idle()
        assert m.status().state == "disarmed", "a test has left the motors armed"


@pytest.fixture
def device(daemon: meissner.Daemon) -> Iterator[MeissnerDevice]:
    device = MeissnerDevice(daemon.socket, checked="a test")
    yield device
    device.close()


def routine(
    play: TactilePlay,
    start: str,
    end: float,
    sync: bool = True,
    stop: float | None = None,
    seconds: float = 0.2,
    pattern: Any = "edge-45",
) -> dict[str, Any]:
    """Runs the component's lines as a script does, and returns what they add to the data.

    `end` cuts the routine, s. `stop`, s, is the component's; None: the play's own end.
    """
    data: dict[str, Any] = {}
    parameters = {
        "name": "touch",
        "startCode": start,
        "periodCode": "win.monitorFramePeriod" if sync else "None",
        "onsetCode": "tThisFlipGlobal" if sync else "None",
    }
    names: dict[str, Any] = {
        "touch": play,
        "NOT_STARTED": NOT_STARTED,
        "win": SimpleNamespace(monitorFramePeriod=PERIOD),
        "thisExp": SimpleNamespace(addData=data.__setitem__),
    }

    def run(lines: str) -> None:
        exec(lines % parameters, names)

    run(script.ROUTINE_START)
    play.setPattern(pattern)
    play.setSeconds(seconds)
    play.setScale(0.5)
    play.status = NOT_STARTED
    zero = experiment_time()
    for frame in range(round(end / PERIOD)):
        flip = (frame + 1) * PERIOD
        names.update(tThisFlip=flip, tThisFlipGlobal=zero + flip, frameN=frame)
        run(script.PLAN)
        if play.status == NOT_STARTED and flip >= eval(start, names) - 0.001:
            play.status = STARTED
            run(script.START)
        is_over = flip > stop if stop is not None else eval("False " + script.IS_OVER % parameters, names)
        if play.status == STARTED and is_over:
            play.status = FINISHED
            run(script.STOP)
            if stop is None:
                break
        time.sleep(max(0.0, zero + flip - experiment_time()))
    run(script.ROUTINE_END)
    return {**{key.removeprefix("touch."): value for key, value in data.items()}, "zero": zero}


def kept(attempt: Callable[[], dict[str, Any]], is_so: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """What the first of five tries saves for which this holds, else the last. A machine that stands still cannot keep an onset."""
    for _ in range(5):
        saved = attempt()
        if is_so(saved):
            break
    return saved


def is_in_time(saved: dict[str, Any]) -> bool:
    """Whether the onset was kept: an order that came too late is played as soon as possible."""
    return "onset" in saved and abs(saved["onset"] - saved["planned"]) < 0.001


@pytest.mark.parametrize(
    ("start", "sync", "expected"),
    [
        ("0.4", True, 24 * PERIOD),
        ("0.395", True, 24 * PERIOD),
        ("0.395", False, 0.395),
        ("tThisFlip + (29 - frameN) * PERIOD", True, 0.5),
    ],
)
def test_a_play_that_is_ordered_ahead_begins_when_planned(
    device: MeissnerDevice, start: str, sync: bool, expected: float
) -> None:
    # As early as the routine allows.
    begin = start.replace("PERIOD", str(PERIOD))
    saved = kept(lambda: routine(TactilePlay(device, ahead=1.0), begin, 2.0, sync), is_in_time)
    assert (saved["state"], saved["pattern"], saved["scale"], saved["cause"]) == ("done", "edge-45", 0.5, None)
    assert saved["planned"] - saved["zero"] == pytest.approx(expected, abs=1e-6)
    assert saved["onset_uncertainty"] < 0.02
    assert abs(saved["onset"] - saved["planned"]) <= saved["onset_uncertainty"] + 1e-4
    assert saved["offset"] - saved["onset"] == pytest.approx(
        (saved["offset_tick"] - saved["onset_tick"]) / 85_000, abs=1e-3
    )
    assert saved["offset_tick"] - saved["onset_tick"] <= 0.2 * 85_000
    receipt = device.client.receipt(saved["play_id"])
    assert receipt.onset is not None
    assert (saved["array"], saved["tick_hz"]) == ("tula35-6x4", 85_000)
    assert (receipt.onset.tick, receipt.items[0].scale) == (saved["onset_tick"], 0.5)


@pytest.mark.parametrize(
    "pattern",
    [
        {"samples": {9: [0.0, 20.0, 40.0, 20.0, 0.0]}, "rate": 100},
        {"drives": [{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 40.0}]},
        {"ramp": [{"motor": 9, "to_um": 40.0, "rise_s": 0.05}]},
    ],
)
def test_a_stimulus_may_be_given_in_place_of_a_name(device: MeissnerDevice, pattern: dict[str, Any]) -> None:
    saved = kept(
        lambda: routine(TactilePlay(device), "0.1", 2.0, pattern=pattern), lambda saved: bool(saved["state"] == "done")
    )
    assert (saved["state"], saved["pattern"]) == ("done", "inline")
    pins = device.client.receipt(saved["play_id"]).raw["pins"]["moved"]
    assert [pin["motor"] for pin in pins] == [9]


def until(is_so: Callable[[], bool]) -> None:
    """Waits, at most 120 s."""
    deadline = time.monotonic() + 120
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def played(play: TactilePlay) -> dict[str, Any]:
    """What a play adds to the data after its own end."""
    until(lambda: play.isOver)
    return play.finish()


def test_a_start_without_notice_is_played_as_soon_as_possible(device: MeissnerDevice) -> None:
    play = TactilePlay(device)
    play.setPattern("edge-45")
    play.setSeconds(0.1)
    play.start(experiment_time() - 1.0)
    saved = played(play)
    assert saved["state"] == "done"
    assert saved["onset"] > saved["planned"] + 1.0
    play.reset()
    play.start(None)
    assert played(play)["planned"] is None


def test_a_routine_that_ends_early_stops_the_play(device: MeissnerDevice) -> None:
    def is_cut(saved: dict[str, Any]) -> bool:
        return is_in_time(saved) and saved["offset_tick"] - saved["onset_tick"] < 2.5 * 85_000

    saved = kept(lambda: routine(TactilePlay(device, ahead=1.0), "0.5", 0.8, seconds=5.0), is_cut)
    assert (saved["state"], saved["cause"], is_cut(saved)) == ("stopped", "stop", True)
    # Ordered ahead, but the routine ended first.
    play = TactilePlay(device, ahead=5.0)
    saved = routine(play, "2.5", 0.2)
    assert saved["state"] == "stopped"
    assert "onset" not in saved
    assert routine(play, "9.0", 0.1)["state"] == "not-played"
    # The daemon has not accepted it yet.
    play.reset()
    play.setSeconds(5.0)
    play.start(None)
    play.stop()
    assert play.finish()["state"] == "stopped"
    # It cannot keep its onset, and is stopped already.
    play.reset()
    play.stop()
    play.start(experiment_time() - 1.0)
    assert play.finish() == {"state": "not-played"}
    assert device.client.status().state == "armed"


def test_the_stop_of_the_component_stops_the_play(device: MeissnerDevice) -> None:
    def is_cut(saved: dict[str, Any]) -> bool:
        # The routine's end would stop it later.
        return "onset" in saved and 0.2 < saved["offset"] - saved["zero"] < 1.2

    saved = kept(lambda: routine(TactilePlay(device), "0.1", 1.5, stop=0.3, seconds=5.0), is_cut)
    assert (saved["state"], saved["cause"], is_cut(saved)) == ("stopped", "stop", True)


def test_a_play_that_is_nearly_over_is_not_cut(device: MeissnerDevice) -> None:
    # On a machine that stands still for a frame the play begins late, and is rightly cut.
    tries = (routine(TactilePlay(device, ahead=1.0), "0.5", 0.5 + 0.2 - PERIOD) for _ in range(5))
    assert any(saved["state"] == "done" for saved in tries)


def test_a_play_that_waits_behind_another_is_stopped(device: MeissnerDevice) -> None:
    front = device.client.play("edge-45", 120.0)
    play = TactilePlay(device)
    play.setPattern("edge-45")
    play.setSeconds(0.1)
    play.start(None)
    until(lambda: play._accepted)
    time.sleep(0.2)
    assert play.finish()["state"] == "stopped"
    # It was not waited for.
    assert front.wait(check=False).cause == "stop"


def test_a_refused_play_ends_the_experiment_with_the_daemons_line(device: MeissnerDevice) -> None:
    play = TactilePlay(device)
    play.setPattern("no-such")
    with pytest.raises(meissner.errors.NotFound, match="no-such"):
        play.start(None)
        play.finish()
    device.estop()
    play.reset()
    play.setPattern("edge-45")
    with pytest.raises(meissner.errors.Faulted):
        play.start(None)
        play.finish()


def test_a_play_whose_session_is_over_ends_the_experiment(daemon: meissner.Daemon) -> None:
    device = MeissnerDevice(daemon.socket, checked="a test", participant="P07")
    core = device.client.core
    assert core.session is not None
    request = _http.post(f"/v1/sessions/{core.session.id}/end")
    ops.send(core, request)  # As after a silence: the client does not know.
    with meissner.connect(daemon.socket) as other, other.session("P08") as following:
        play = TactilePlay(device)
        play.setPattern("edge-45")
        play.setSeconds(0.1)
        with pytest.raises(meissner.errors.SessionOver):
            play.start(None)  # It may have the answer already.
            play.finish()
        device.close()
        assert other.status().raw["session"]["id"] == following.id
    with meissner.connect(daemon.socket) as other:
        assert other.session_plays(following.id)["plays"] == []


def test_an_emergency_stop_by_somebody_is_in_the_data(device: MeissnerDevice) -> None:
    play = TactilePlay(device)
    play.setPattern("edge-45")
    play.setSeconds(5.0)
    play.start(None)
    until(lambda: device.client.status().playing is not None)
    device.estop()
    saved = played(play)
    assert (saved["state"], saved["cause"]) == ("stopped", "estop")


def test_a_pause_after_the_order_does_not_shift_the_times(
    device: MeissnerDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    def paused() -> dict[str, Any]:
        play = TactilePlay(device)
        play.setPattern("edge-45")
        play.setSeconds(0.1)
        play.start(experiment_time() + 2.0)
        before = device.readClock()
        # PsychoPy sets its clock back by the pause.
        with monkeypatch.context() as patch:
            patch.setattr(device_module, "experiment_time", lambda: time.monotonic() + before.offset - 60.0)
            return played(play)

    saved = kept(paused, is_in_time)
    assert saved["onset"] == pytest.approx(saved["planned"], abs=saved["onset_uncertainty"] + 1e-4)


def test_numbers_of_a_conditions_file_are_played(device: MeissnerDevice) -> None:
    numpy = pytest.importorskip("numpy", reason="numpy is not installed")
    play = TactilePlay(device)
    play.setPattern("edge-45")
    for seconds, scale in [(1, 1), (numpy.int64(1), numpy.int64(1)), (numpy.float32(0.5), numpy.float64(0.5))]:
        play.reset()
        play.setSeconds(seconds)
        play.setScale(scale)
        play.start(None)
        until(lambda: play._accepted or play.isOver)
        assert play.finish()["scale"] == scale


def test_closing_disarms_and_ends_the_session(daemon: meissner.Daemon) -> None:
    device = MeissnerDevice(daemon.socket, checked="a test", participant="P07")
    with meissner.connect(daemon.socket) as other:
        session = other.status().raw["session"]
        assert (session["participant"], session["exclusive"]) == ("P07", True)
        device.client.play("edge-45", 5.0)
        device.close()
        device.close()
        state = other.status()
        assert (state.state, state.playing, state.raw["session"]) == ("disarmed", None, None)


def test_a_stop_that_fails_becomes_an_emergency_stop(device: MeissnerDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise meissner.errors.ConnectionLost("the connection was lost")

    play = TactilePlay(device)
    play.setPattern("edge-45")
    play.setSeconds(30.0)
    play.start(None)
    with monkeypatch.context() as patch:
        patch.setattr(device.client, "stop", fail)
        with pytest.raises(meissner.errors.ConnectionLost):
            play.finish()
    assert device.client.status().state == "faulted"
    device.client.reset(force=True)
    device.client.arm(assume_rest=True, checked="a test")
    # A stop that seems to work, but the play goes on.
    play.reset()
    play.start(None)
    monkeypatch.setattr(routine_module, "PATIENCE", 0.2)
    monkeypatch.setattr(device.client, "stop", lambda: None)
    with pytest.raises(meissner.MeissnerError, match="has no end after"):
        play.finish()
    assert device.client.status().state == "faulted"


@pytest.mark.parametrize("error", [meissner.errors.ConnectionLost("the connection was lost"), KeyboardInterrupt()])
def test_a_disarm_that_fails_becomes_an_emergency_stop(
    daemon: meissner.Daemon, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def fail() -> None:
        raise error

    device = MeissnerDevice(daemon.socket, checked="a test", participant="P07")
    monkeypatch.setattr(device.client, "disarm", fail)
    with pytest.raises(type(error)):
        device.close()
    with meissner.connect(daemon.socket) as other:
        state = other.status()
        assert (state.state, state.raw["session"]) == ("faulted", None)
        other.reset(force=True)
    # The emergency stop fails, too: the session's end stops the play, and the client tries again to disarm.
    device = MeissnerDevice(daemon.socket, checked="a test", participant="P07")
    device.client.play("edge-45", 120.0)
    monkeypatch.setattr(device.client, "disarm", fail)
    monkeypatch.setattr(device.client, "estop", fail)
    with pytest.raises(type(error)):
        device.close()
    with meissner.connect(daemon.socket) as other:
        assert other.receipt().state == "stopped"  # Nobody has waited for its end.
        state = other.status()
        assert state.state in ("disarmed", "returning")
        assert state.raw["session"] is None


@pytest.mark.parametrize("end", ["SIGTERM", "SIGHUP", "twice", "error", "end", "fails"])
def test_the_motors_are_off_however_the_script_ends(daemon: meissner.Daemon, end: str) -> None:
    code = f"""
import environment, os, signal, sys, time
from psychopy_meissner.device import MeissnerDevice
from psychopy_meissner.routine import TactilePlay
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # `nohup` has it ignored.
play = TactilePlay(MeissnerDevice({daemon.socket!r}, checked="a test"))
client = play.device.client
disarm = client.disarm
def interrupted():
    if {end!r} == "fails":
        raise RuntimeError("the disarm has failed")
    if {end!r} == "twice":
        os.kill(os.getpid(), signal.SIGTERM)
    disarm()
client.disarm = interrupted
play.setPattern("edge-45")
play.setSeconds(300.0)
play.start(None)
deadline = time.monotonic() + 120
while not play._accepted and time.monotonic() < deadline:
    time.sleep(0.01)
print("playing", flush=True)
if {end!r} == "error":
    raise RuntimeError("an error of the experiment")
if {end!r} in ("SIGTERM", "SIGHUP", "twice"):
    time.sleep(300)
"""
    # Coverage would handle SIGTERM itself.
    variables = {key: value for key, value in os.environ.items() if not key.startswith("COVERAGE")}
    child = subprocess.Popen(
        [sys.executable, "-c", code],
        env={**variables, "PYTHONPATH": os.pathsep.join([str(ENVIRONMENT), *sys.path])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    first = child.stdout.readline()
    number = {"SIGTERM": signal.SIGTERM, "SIGHUP": signal.SIGHUP, "twice": signal.SIGTERM}.get(end)
    if number is not None:
        os.kill(child.pid, number)
    _, errors = child.communicate(timeout=120)
    assert first == "playing\n", errors
    assert child.returncode == (128 + number if number is not None else int(end == "error")), errors
    with meissner.connect(daemon.socket) as other:
        # Only a disarm that fails becomes an emergency stop.
        assert other.status().state in (["faulted"] if end == "fails" else ["disarmed", "returning"]), errors
        assert other.receipt().state == "stopped"


BOOK = Path(__file__).parents[3] / "docs" / "first-study.md"


@pytest.mark.skipif(not BOOK.exists(), reason="the book is in the repository only")
def test_the_page_of_the_book_runs(tmp_path: Path) -> None:
    found = re.findall(r"```py\n(.*?)```", BOOK.read_text(encoding="utf-8"), re.DOTALL)
    found = [block for block in found if "psychopy" in block]
    assert found
    for block in found:
        for _ in range(5):
            ended = subprocess.run(
                [sys.executable, "-c", f"import environment\n{block}"],
                cwd=tmp_path,
                env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ENVIRONMENT), *sys.path])},
                capture_output=True,
                text=True,
                check=False,
                timeout=120,
            )
            # A machine that stands still misses the onset.
            if "the onset could not be kept" not in ended.stderr and "[too-soon" not in ended.stderr:
                break
        assert ended.returncode == 0, block + ended.stderr
        onset, uncertainty = (float(number) for number in ended.stdout.split())
        assert 0.5 < onset < 60
        assert uncertainty < 0.1


class Manager:
    """The two methods of PsychoPy's device manager that `shared` calls."""

    def __init__(self) -> None:
        self.devices: dict[str, Any] = {}

    def getDevice(self, name: str) -> Any:
        return self.devices.get(name)

    def addDevice(self, deviceClass: str, deviceName: str, **settings: Any) -> MeissnerDevice:
        assert deviceClass == f"{MeissnerDevice.__module__}.MeissnerDevice"
        device = self.devices[deviceName] = MeissnerDevice(**settings)
        return device


def test_components_share_a_device(daemon: meissner.Daemon) -> None:
    manager, settings = Manager(), {"address": daemon.socket, "checked": "a test"}
    first = shared(manager, "display", **settings)
    assert shared(manager, "display", **settings) is first
    assert first.isSameDevice({"address": daemon.socket})
    assert not first.isSameDevice({"simulated": True})
    with pytest.raises(ValueError, match=r"the device `display` has two values of address: .*same"):
        shared(manager, "display", **{**settings, "address": "elsewhere"})
    first.close()
    second = shared(manager, "display", **settings)
    assert second is not first
    second.close()
    # An experiment's own code may have added a device of that name.
    added = manager.addDevice(device_module.CLASS, "display", **settings)
    assert shared(manager, "display", **settings, simulated=False) is added
    with pytest.raises(ValueError, match="two values of participant"):
        shared(manager, "display", **settings, participant="P07")
    added.close()
    manager.devices["keys"] = SimpleNamespace()
    with pytest.raises(ValueError, match="`keys` is a SimpleNamespace: give the component another device name"):
        shared(manager, "keys", **settings)


def test_without_hardware_it_plays_on_a_simulated_array() -> None:
    assert MeissnerDevice.getAvailableDevices()[-1]["simulated"]
    device = MeissnerDevice(simulated=True)
    try:
        assert device.client.status().simulated
        assert math.isclose(routine(TactilePlay(device), "0.1", 1.0)["scale"], 0.5)
    finally:
        device.close()
