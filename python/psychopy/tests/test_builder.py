"""The plugin in PsychoPy itself: entry points, a Builder experiment that is exported, and the script run on a virtual screen.

It needs PsychoPy, and `Xvfb` for the runs; without them these tests are left out.
"""

from __future__ import annotations

import csv
import importlib.metadata
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import meissner
from environment import has_psychopy

if not has_psychopy():
    pytest.skip("PsychoPy is not installed", allow_module_level=True)

XVFB = shutil.which("Xvfb")
# Opening a window takes OpenGL, by software here.
needs_screen = pytest.mark.skipif(XVFB is None, reason="Xvfb is not installed")
GROUPS = {
    "psychopy.experiment.components": "psychopy_meissner.component:MeissnerComponent",
    "psychopy.hardware": "psychopy_meissner.device:MeissnerDevice",
}


@pytest.mark.parametrize("group", GROUPS)
def test_the_entry_points_are_found(group: str) -> None:
    found = [point for point in importlib.metadata.entry_points(group=group) if point.value == GROUPS[group]]
    assert len(found) == 1
    assert found[0].load().__name__ == found[0].name


def load_plugin() -> type:
    """Loads the plugin as PsychoPy does when it starts, and returns the component."""
    import psychopy.hardware
    from psychopy.experiment import getAllComponents
    from psychopy.plugins import loadPlugin, scanPlugins

    scanPlugins()
    assert loadPlugin("psychopy-meissner")
    assert psychopy.hardware.MeissnerDevice.__module__ == "psychopy_meissner.device"
    component: type = getAllComponents()["MeissnerComponent"]
    return component


def experiment(
    folder: Path, conditions: list[dict[str, object]], parameters: dict[str, object], twice: bool = False
) -> Path:
    """Exports an experiment with a word and a touch at 0.5 s. It is saved and loaded first, as Builder does.

    `twice` adds a second touch at 0.9 s, with a stop.
    """
    from psychopy.experiment import Experiment
    from psychopy.experiment.components.text import TextComponent
    from psychopy.experiment.loops import TrialHandler

    touch = load_plugin()
    exp = Experiment()
    exp.addRoutine("trial")
    trial = exp.routines["trial"]
    trial.addComponent(TextComponent(exp, "trial", name="word", startVal=0.5, stopVal=0.2))
    for name in ["touch", "again"][: 1 + twice]:
        component = touch(exp, "trial", name=name)
        for key, value in parameters.items():
            component.params[key].val = value
        if name == "again":
            component.params["startVal"].val, component.params["stopVal"].val = "0.9", "0.2"
        trial.addComponent(component)
    exp.flow.addRoutine(trial, 0)
    with (folder / "conditions.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.DictWriter(file, list(conditions[0]))
        rows.writeheader()
        rows.writerows(conditions)
    loop = TrialHandler(exp, "trials", nReps=1, loopType="sequential", conditionsFile="conditions.csv")
    exp.flow.addLoop(loop, 0, 1)
    for key, value in {"Show info dlg": False, "Full-screen window": False, "Window size (pixels)": [200, 150]}.items():
        exp.settings.params[key].val = value
    exp.saveToXML(str(folder / "edges.psyexp"))
    loaded = Experiment()
    loaded.loadFromXML(str(folder / "edges.psyexp"))
    exported = folder / "edges.py"
    exported.write_text(loaded.writeScript(str(exported)), encoding="utf-8")
    return exported


CONDITIONS: list[dict[str, object]] = [{"angle": "edge-45", "level": 0.5}, {"angle": "edge-135", "level": 1.0}]
PARAMETERS: dict[str, object] = {
    "pattern": "$angle",
    "scale": "$level",
    "seconds": "0.2",
    "simulated": "always",
    "ahead": "0.5",
}


@pytest.mark.parametrize("start", [("time (s)", "0.5"), ("frame N", "30"), ("condition", "t > 0.3")])
@pytest.mark.parametrize("stop", ["", "0.4"])
@pytest.mark.parametrize("sync", [True, False])
def test_an_exported_script_compiles(tmp_path: Path, start: tuple[str, str], stop: str, sync: bool) -> None:
    parameters = {"startType": start[0], "startVal": start[1], "stopVal": stop, "syncScreenRefresh": sync}
    file = experiment(tmp_path, CONDITIONS, {**PARAMETERS, **parameters})
    text = file.read_text(encoding="utf-8")
    compile(text, str(file), "exec")
    assert ("touch.plan(" in text) == (start[0] != "condition")
    assert ("or touch.isOver:" in text) == (stop == "")
    assert "touch.setPattern(angle)" in text


def test_what_is_constant_is_set_once_and_builder_has_a_template(tmp_path: Path) -> None:
    file = experiment(tmp_path, CONDITIONS, PARAMETERS)
    touch: Any = load_plugin()
    from psychopy.experiment import Experiment

    template = touch.getTemplateJSON()
    assert template["iconSVG"].startswith("<svg")
    assert set(template["params"]) >= {"pattern", "seconds", "scale", "ahead", "simulated", "address"}
    exp = Experiment()
    exp.loadFromXML(str(file.with_suffix(".psyexp")))
    component = exp.routines["trial"][-1]
    component.params["pattern"].val, component.params["pattern"].updates = "edge-90", "constant"
    head, routine = exp.writeScript(str(file)).split("# --- Prepare to start Routine")
    assert "touch.setPattern('edge-90')" in head
    assert "touch.setPattern" not in routine
    assert "touch.setScale(level)" in routine


@pytest.mark.parametrize(("ahead", "argument"), [("", ""), ("$lead", "lead"), (0.3, "0.3")])
def test_order_ahead_may_be_blank_or_code(tmp_path: Path, ahead: object, argument: str) -> None:
    text = experiment(tmp_path, CONDITIONS, {**PARAMETERS, "ahead": ahead}).read_text(encoding="utf-8")
    compile(text, "edges.py", "exec")
    assert f"    ),\n        {argument}\n    )\n    runAtExit.insert(0, touch.device.close)" in text


def test_another_value_of_simulated_array_names_the_parameter(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"`Simulated array` of the component `touch` is `yes`: choose no, .*always"):
        experiment(tmp_path, CONDITIONS, {**PARAMETERS, "simulated": "yes"})


@pytest.fixture(scope="module")
def screen() -> Iterator[str]:
    """A virtual screen."""
    assert XVFB is not None
    reading, writing = os.pipe()
    command = [XVFB, "-displayfd", str(writing), "-screen", "0", "640x480x24", "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        number = pipe.readline().strip()
    yield f":{number}"
    server.terminate()
    server.wait()


def start(file: Path, screen: str, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(file)],
        cwd=file.parent,
        env={**os.environ, "DISPLAY": screen, "LIBGL_ALWAYS_SOFTWARE": "1", **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def data(folder: Path) -> list[dict[str, str]]:
    (file,) = (folder / "data").glob("*.csv")
    with file.open(newline="", encoding="utf-8-sig") as opened:
        return [row for row in csv.DictReader(opened) if row["touch.state"]]


@needs_screen
def test_an_exported_script_runs_and_its_data_has_the_true_times(tmp_path: Path, screen: str) -> None:
    running = start(experiment(tmp_path, CONDITIONS, PARAMETERS, twice=True), screen)
    output, _ = running.communicate(timeout=120)
    assert running.returncode == 0, output
    rows = data(tmp_path)
    assert [(row["touch.pattern"], float(row["touch.scale"])) for row in rows] == [("edge-45", 0.5), ("edge-135", 1.0)]
    for row in rows:
        onset, offset, planned = (float(row[f"touch.{name}"]) for name in ("onset", "offset", "planned"))
        uncertainty = float(row["touch.onset_uncertainty"])
        assert row["touch.state"] == "done"
        assert uncertainty < 0.01
        assert abs(onset - planned) <= uncertainty + 1e-4
        # Without a graphics card frames are late: the word then appears after the touch, and the data shows by how much.
        print(f"onset minus word {onset - float(row['word.started']):+.4f} s, ±{uncertainty * 1e6:.0f} µs")
        assert 0.15 < offset - onset <= 0.2 + 1e-3
        assert int(row["touch.offset_tick"]) > int(row["touch.onset_tick"])
        assert row["again.state"] == "done"
        # Both are planned for a refresh, so up to one refresh more or less than 0.4 s lies between them.
        assert float(row["again.onset"]) - onset == pytest.approx(0.4, abs=0.05)
    plays = [int(row[f"{name}.play_id"]) for row in rows for name in ("touch", "again")]
    assert plays == [1, 2, 3, 4]


@needs_screen
@pytest.mark.parametrize("end", ["escape", "SIGTERM", "refused"])
def test_the_motors_are_off_however_the_experiment_ends(tmp_path: Path, screen: str, end: str) -> None:
    with meissner.Daemon() as daemon, meissner.connect(daemon.socket) as m:
        parameters = {"simulated": "no", "address": daemon.socket, "checked": "a test", "seconds": "60"}
        conditions = [*CONDITIONS[:1], {"angle": "no-such", "level": 1.0}]
        stop = {"refused": "0.3"}.get(end, "")
        file = experiment(tmp_path, conditions, {**PARAMETERS, **parameters, "stopVal": stop})
        if end == "escape":
            # The test cannot press the key: what the script does then begins with this flag.
            text = file.read_text(encoding="utf-8")
            check = "# check for quit (typically the Esc key)\n"
            assert "endExpNow = False" in text
            assert check in text
            text = text.replace(check, "endExpNow = touch.status == STARTED and t > 1.0\n")
            file.write_text(text, encoding="utf-8")
        running = start(file, screen)
        try:
            deadline = time.monotonic() + 60
            while m.status().playing is None:
                assert running.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.02)
            assert m.status().state == "armed"
            if end == "SIGTERM":
                os.kill(running.pid, signal.SIGTERM)
            output, _ = running.communicate(timeout=60)
        finally:
            running.kill()
        m.wait_until_idle()
        assert m.status().state == "disarmed", output
        assert m.receipt().state == "stopped"
        assert running.returncode == {"escape": 0, "SIGTERM": 143, "refused": 1}[end], output
        if end == "refused":
            assert "no pattern is called `no-such`" in output
