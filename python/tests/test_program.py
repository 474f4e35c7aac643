"""The program on this machine: simulation, search, and a daemon of one's own."""

from __future__ import annotations

import builtins
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy
import pytest

import meissner
from meissner import errors

SCENE: dict[str, Any] = {
    "duration_s": 0.1,
    "afferents": [{"x_mm": -1.45, "y_mm": 1.45}],
    "drives": [{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 80.0}],
}


def test_spikes_are_arrays_with_numpy_and_lists_without(monkeypatch: pytest.MonkeyPatch) -> None:
    with_numpy = meissner.simulate({**SCENE, "duration_s": numpy.float32(0.1)}, model="membrane")
    assert isinstance(with_numpy.spikes_s[0], numpy.ndarray)
    assert with_numpy.rates_hz[0] == len(with_numpy.spikes_s[0]) / numpy.float32(0.1).item() > 0
    imported = builtins.__import__

    def without_numpy(name: str, *rest: Any) -> Any:
        if name == "numpy":
            raise ImportError(name)
        return imported(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_numpy)
    without = meissner.simulate(SCENE)
    assert isinstance(without.spikes_s[0], list)
    assert isinstance(without.rates_hz, list)
    assert without.spikes_s[0] == pytest.approx(with_numpy.spikes_s[0].tolist())


def test_a_scene_may_be_a_file(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(
        "duration_s = 0.1\npopulation = { seed = 0 }\n[[drives]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = 80.0\n"
    )
    answer = meissner.simulate(file, rates_only=True)
    assert answer.rates_hz.shape == (306,)
    assert answer.spikes_s == []


def test_errors_say_what_is_wrong(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(errors.ProgramError, match=r"`meissner simulate` failed.*durtion_s"):
        meissner.simulate({"durtion_s": 1})
    with pytest.raises(TypeError, match=r"`scene\.duration_s` is \{1\}: must be a number"):
        meissner.simulate({"duration_s": {1}})
    with pytest.raises(errors.ProgramError, match=r"the daemon has ended.*sede"):
        meissner.Daemon("[mock]\nsede = 1\n")
    monkeypatch.setenv("MEISSNER_PROGRAM", str(tmp_path / "none"))
    with pytest.raises(errors.ProgramError, match="which cannot be run"):
        meissner.simulate(SCENE)
    monkeypatch.delenv("MEISSNER_PROGRAM")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(errors.ProgramError, match=r"nor the PATH has the program.*install the wheel"):
        meissner.demo()


def test_a_search_finds_a_pattern_that_can_be_played(m: meissner.Client) -> None:
    found = m.design("dot", budget=20, seed=3, setting="default", robust=True)
    assert found.name == "dot-found"
    assert (found.summary["seed"], found.summary["robust"]) == (3, True)
    assert m.pattern("dot-found")["pattern"]["provenance"]["target"] == "dot"
    assert m.simulate(SCENE, rates_only=True).rates_hz[0] > 0
    m.remove_pattern("dot-found")


BAR: dict[str, Any] = {"name": "bar", "shape": "bar", "length_mm": 12, "width_mm": numpy.float64(0.8)}
PRESS = {"press": {"depth_um": 150, "rise_s": 0.02, "hold_s": 0.03, "fall_s": 0.02}}


def test_an_object_is_rendered_and_played(m: meissner.Client) -> None:
    rendered = m.render({**BAR, "center_mm": [0, 0.8]}, touch=PRESS, method="field")
    assert (rendered.name, rendered.summary["method"], rendered.summary["object"]) == ("bar-rendered", "field", "bar")
    assert m.pattern("bar-rendered")["pattern"]["provenance"]["object"]["name"] == "bar"
    receipt = m.play("bar-rendered").wait()
    moved = [pin["motor"] for pin in receipt.raw["pins"]["moved"]]
    assert len(moved) == rendered.summary["motors"] > 3
    m.remove_pattern("bar-rendered")


def test_an_object_may_be_a_name_or_a_file_and_may_name_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named = meissner.render("edge-45", method="rule", name="edge")
    assert (named.name, named.summary["object"]) == ("edge", "edge-45")
    file = tmp_path / "dots.toml"
    file.write_text(
        'kind = "object"\nname = "dots"\nshape = "dots"\npoints = [[0, 0]]\ndiameter_mm = 2\n'
        "[touch]\npress = { depth_um = 300, hold_s = 0.02 }\n"
    )
    assert meissner.render(file, method="rule").name == "dots-rendered"
    with pytest.raises(ValueError, match="`touch` goes with an object that is a dict"):
        meissner.render(file, touch=PRESS)
    monkeypatch.chdir(tmp_path)
    numpy.save("hill.npy", numpy.zeros((20, 20)))
    hill = {"shape": "heightmap", "file": "hill.npy", "mm_per_pixel": 0.2}
    assert meissner.render(hill, touch=PRESS, method="field").summary["object"] == "object"


def test_a_bad_object_is_refused_in_a_line() -> None:
    for wrong, says in [
        ({**BAR, "lenght_mm": 3}, "lenght_mm"),
        ({**BAR, "width_mm": float("nan")}, "width_mm"),
        ({**BAR, "name": 'a "b"'}, "name"),
    ]:
        with pytest.raises(errors.ProgramError, match=f"`meissner render` failed.*{says}"):
            meissner.render(wrong, touch=PRESS)
    with pytest.raises(TypeError, match="cannot hold a set"):
        meissner.render({**BAR, "points": {1}}, touch=PRESS)


def test_a_rendered_pattern_is_judged() -> None:
    bar = {**BAR, "touch": PRESS}
    rendered = meissner.render(bar, method="field")
    judged = meissner.judge(rendered.toml, bar, fingers=1)
    pattern, method, again = (judged.lines[name] for name in ("bar-rendered", "render field", "the object again"))
    assert {**pattern, "name": ""} == {**method, "name": ""}
    assert pattern["r"] < again["r"] <= 1
    with pytest.raises(errors.ProgramError, match=r"`meissner judge` failed.*press"):
        meissner.judge("edge-45", BAR)


def test_the_end_of_python_ends_the_daemon_and_disarms(daemon: meissner.Daemon) -> None:
    """A script without `with`: its clients disarm, and its daemon ends."""
    script = (
        "import meissner, sys\n"
        "m = meissner.connect(sys.argv[1]); m.arm(assume_rest=True, checked='a test'); m.play('pin-60', endless=True)\n"
        "d = meissner.demo(); at = d.status().raw['daemon']; print(at['pid'], at['socket'])\n"
    )
    ended = subprocess.run([sys.executable, "-c", script, daemon.socket], capture_output=True, text=True, check=True)
    pid, socket = ended.stdout.split()
    assert ended.stderr == ""
    assert not Path("/proc", pid).exists()
    assert not Path(socket).parent.exists()
    with meissner.connect(daemon.socket) as watcher:
        assert watcher.status().state in ("returning", "disarmed")


def test_a_demo_may_be_as_a_board_is() -> None:
    plan: list[meissner.SequenceItem] = [{"pattern": "edge-45", "gap": 0.05}] * 40
    with meissner.demo(board=True) as m:
        device = m.status().raw["device"]
        assert (device["kind"], device["simulated"], device["telemetry"]) == ("mock:board", True, False)
        told = m.check(plan, seconds=numpy.float32(0.25))
        assert (told.ends, told.limit_um) == (False, 150.0)
        assert told.stopped_at is not None
        receipt = m.sequence(plan, seconds=0.25).wait(check=False)
        assert (receipt.state, receipt.cause) == ("stopped", "drift-limit")
    with meissner.demo(board="lower-stop") as m:
        told = m.check(plan, seconds=0.25)
        assert (told.ends, told.stopped_at, told.drift_um) == (True, None, 0.0)
        assert m.play("edge-45", seconds=0.2).wait().state == "done"


def test_python_m_runs_the_program() -> None:
    ended = subprocess.run([sys.executable, "-m", "meissner", "--version"], capture_output=True, text=True, check=True)
    assert ended.stdout.startswith("meissner ")
