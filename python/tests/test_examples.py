"""Each example runs to its end, and the experiments find what they should."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import meissner
from patience import run_kept

EXAMPLES = Path(__file__).parents[1] / "examples"
README = Path(__file__).parents[1] / "README.md"
BOOK = Path(__file__).parents[2] / "docs"
NEEDS = {"from meissner import lsl": "pylsl"}
"""What a block of the book needs beside the package, by its text."""
ELSEWHERE = {"psychopy": "psychopy/tests/test_routine.py", "laser.fit": "tests/test_laser.py"}
"""Blocks that another test runs, by their text."""


def run(name: str, folder: Path, **environment: str) -> str:
    """Runs an example in a folder of its own, and returns what it prints."""
    ended = run_kept([sys.executable, str(EXAMPLES / name)], folder, environment)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_every_example_is_run_here() -> None:
    text = Path(__file__).read_text(encoding="utf-8")
    assert [file.name for file in EXAMPLES.glob("*.py") if f'"{file.name}"' not in text] == []


def test_first_play(tmp_path: Path) -> None:
    assert re.search(r"onset [\d.]+ s, known to \d+ µs\noffset [\d.]+ s, tick \d+\n", run("first_play.py", tmp_path))


def test_events(tmp_path: Path) -> None:
    assert run("events.py", tmp_path).split() == ["state", "queued", "began", "ended"]


def test_live_edge(tmp_path: Path) -> None:
    poses = r"the last pose was applied\n(\d+) poses reached the daemon, (\d+) the device\n"
    found = re.fullmatch(poses, run("live_edge.py", tmp_path))
    assert found
    assert 0 < int(found[2]) <= int(found[1]) <= 101
    command = [sys.executable, str(EXAMPLES / "live_edge.py"), "-"]
    hand = "-3,0,0\n0.5,1.0,10\n3,0,20,300\n"
    ended = run_kept(command, tmp_path, {}, hand)
    assert ended.returncode == 0, ended.stderr
    assert re.fullmatch(poses, ended.stdout)


class Touchpad:
    """What `live_mouse.py` uses of an `evdev.InputDevice`: it has these events, and then it is gone."""

    def __init__(self, *events: tuple[int, int, int]) -> None:
        self.fd, self._writing = os.pipe()
        self._events = events
        os.write(self._writing, b"events")

    def capabilities(self, absinfo: bool) -> dict[int, Any]:
        ecodes, info = importlib.import_module("evdev.ecodes"), importlib.import_module("evdev").AbsInfo
        return {ecodes.EV_ABS: [(code, info(0, 0, 1000, 0, 0, 0)) for code in (ecodes.ABS_X, ecodes.ABS_Y)]}

    def read(self) -> Iterator[Any]:
        event = importlib.import_module("evdev").InputEvent
        yield from (event(0, 0, *of) for of in self._events)
        self._events = ()
        if os.read(self.fd, 6) == b"events":
            os.write(self._writing, b"gone!!")
        else:
            raise OSError("no such device")


def test_live_mouse(capsys: pytest.CaptureFixture[str]) -> None:
    ecodes = pytest.importorskip("evdev", reason="evdev is not installed").ecodes
    spec = importlib.util.spec_from_file_location("live_mouse", EXAMPLES / "live_mouse.py")
    assert spec
    assert spec.loader
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    rel, absolute = ecodes.EV_REL, ecodes.EV_ABS
    moves = [(rel, ecodes.REL_X, 100), (rel, ecodes.REL_Y, 50), (rel, ecodes.REL_WHEEL, -2), (ecodes.EV_KEY, 272, 1)]
    mouse = Touchpad(*moves, (rel, ecodes.REL_DIAL, 1), (rel, ecodes.REL_Y, 0))
    hand = example.Hand([4.35, 7.25], mouse)
    with meissner.demo() as m, m.live(object="edge-45", timeout=5.0) as live:
        example.follow(live, hand, mouse)
    assert ([round(mm, 9) for mm in hand.mm], hand.degrees) == ([2.0, -1.0], 355.0)
    assert live.receipt.raw["live"]["updates"] > 0
    assert "the device is gone" in capsys.readouterr().out
    for event in Touchpad(
        (absolute, ecodes.ABS_X, 750), (absolute, ecodes.ABS_Y, 0), (rel, ecodes.REL_X, 10_000)
    ).read():
        hand.hear(event)
    assert hand.mm == [4.35, 7.25]


def test_replay_keeps_gaps_to_the_tick_and_patterns_as_they_were(tmp_path: Path) -> None:
    own = 'format = 1\nname = "own"\n[[drive]]\nmotor = 3\nfrequency_hz = {}\namplitude_um = 50\n'
    with meissner.Daemon() as daemon, meissner.connect(daemon.socket) as m:
        m.arm(assume_rest=True, checked="a test")
        with m.session(participant="P07") as session:
            m.store_pattern("own", own.format(60))
            recorded = [m.play("own", seconds=0.2, scale=0.9, trial=1, trigger=7).wait()]
            items: list[meissner.SequenceItem] = ["dot", None, {"pattern": "edge-0", "gap": 0.05, "trigger": False}]
            recorded.append(m.sequence(items, seconds=0.1, trial=2).wait())
            with m.live(object="edge-45", timeout=5.0) as live:
                live.pose().wait()
            stopped = m.play("pin-60", endless=True)
            while (onset := stopped.refresh().onset) is None or m.now() < onset.monotonic + 0.2:
                pass
            m.stop()
            recorded.append(stopped.wait(check=False))
        m.store_pattern("own", own.format(30), replace=True)
        command = [sys.executable, str(EXAMPLES / "replay.py"), session.id]
        ended = run_kept(command, tmp_path, {"MEISSNER_SOCKET": daemon.socket})
        assert ended.returncode == 1, ended.stderr
        assert ended.stdout.endswith("left out\n"), ended.stderr
        left_out, *plays, last = ended.stdout.splitlines()
        assert (len(plays), last) == (3, "0 differ, 1 left out"), ended.stderr
        assert left_out.startswith("play 3 is left out: ")
        last_id = m.receipt().id
        again = [m.receipt(last_id - back) for back in (2, 1, 0)]
        ticks = [[receipt.onset.tick for receipt in of if receipt.onset] for of in (recorded, again)]
        assert [tick - ticks[0][0] for tick in ticks[0]] == [tick - ticks[1][0] for tick in ticks[1]]
        for one, two in zip(recorded[:2], again, strict=False):
            assert one.raw["counts"]["ordered"] == two.raw["counts"]["ordered"]
            assert one.raw["order"]["trial"] == two.raw["order"]["trial"]
        first = again[0].raw["items"][0]
        assert first["pattern_sha256"] == recorded[0].raw["items"][0]["pattern_sha256"]
        assert first["trigger"]["code"] == 7
        triggers = [[item["trigger"] is None for item in of.raw["items"]] for of in (recorded[1], again[1])]
        assert triggers[0] == triggers[1] == [False, False, True]


def test_design_loop(tmp_path: Path) -> None:
    assert run("design_loop.py", tmp_path).splitlines()[-1] == "done"


def test_export(tmp_path: Path) -> None:
    lines = run("export.py", tmp_path).splitlines()
    files = [tmp_path / line for line in lines if line.endswith((".tsv", ".nwb"))]
    assert len(files) == 1 + bool(importlib.util.find_spec("pynwb"))
    assert all(file.stat().st_size > 0 for file in files)


def test_eeg_markers(tmp_path: Path) -> None:
    pytest.importorskip("pylsl", reason="pylsl is not installed")
    texts = [line.split(" at ")[0] for line in run("eeg_markers.py", tmp_path).splitlines()]
    assert texts == ["onset/pin-60", "offset/pin-60", "onset/edge-45", "offset/edge-45"]


def test_detection_threshold(tmp_path: Path) -> None:
    """One staircase of 16 reversals scatters by a quarter; the mean of many is tried in test_experiment.py."""
    lines = run("detection_threshold.py", tmp_path).splitlines()
    assert len(lines) == 1 + bool(importlib.util.find_spec("questplus"))
    for line in lines:
        found, true = (float(value) for value in re.findall(r"0\.\d+", line))
        assert found == pytest.approx(true, rel=0.5), line


def answered(daemon: meissner.Daemon) -> list[dict[str, Any]]:
    """The recorded plays of the only session."""
    with meissner.connect(daemon.socket) as watcher:
        (session,) = watcher.sessions()
        plays: list[dict[str, Any]] = watcher.session_plays(session["id"])["plays"]
    return plays


def test_sweep_computes_what_the_table_lacks(tmp_path: Path) -> None:
    for package in ("pandas", "submitit"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    # Two of the cells of "sweep.py": a cell takes seconds.
    two = "import sweep, sys; sweep.GRID = {'width_mm': [0.8, 2.0], 'angle_deg': [45.0], 'depth_um': [300.0]}; sys.exit(sweep.main())"
    command = [sys.executable, "-c", two, "results.csv"]
    here = {"PYTHONPATH": os.pathsep.join([str(EXAMPLES), *filter(None, [os.environ.get("PYTHONPATH")])])}
    ended = run_kept(command, tmp_path, here)
    assert ended.stdout == "2 cells computed, 0 failed, 2 of 2 in results.csv\n", ended.stderr
    table = tmp_path / "results.csv"
    whole = table.read_text(encoding="utf-8")
    lines = whole.splitlines()
    assert lines[0] == "width_mm,angle_deg,depth_um,r,error,r_in_space,SA1_hz,RA_hz,PC_hz"
    assert len({line.split(",", 3)[3] for line in lines}) == 3
    table.write_text(f"{lines[0]}\n{lines[2]}\n", encoding="utf-8")
    ended = run_kept([*command, "--cluster", "debug"], tmp_path, here)
    assert ended.stdout == "1 cells computed, 0 failed, 2 of 2 in results.csv\n", ended.stderr
    assert table.read_text(encoding="utf-8") == whole
    table.unlink()
    ended = run_kept(command, tmp_path, {**here, "MEISSNER_PROGRAM": "/bin/false"})
    assert (ended.returncode, ended.stdout) == (1, "0 cells computed, 2 failed, 0 of 2 in results.csv\n")
    assert ended.stderr.count("`meissner render` failed") >= 2


def test_two_afc_is_short_exact_and_complete(tmp_path: Path) -> None:
    code = (EXAMPLES / "two_afc.py").read_text(encoding="utf-8").split('"""', 2)[2]
    assert sum(bool(line.strip()) for line in code.splitlines()) <= 15
    with meissner.Daemon() as daemon:
        environment = {
            "MEISSNER_SOCKET": daemon.socket,
            "MEISSNER_ANSWERS": "simulated",
            "XDG_RUNTIME_DIR": str(tmp_path),
        }
        run("two_afc.py", tmp_path, **environment)
        plays = answered(daemon)
    assert [play["receipt"]["order"]["trial"] for play in plays] == list(range(1, 41))
    for play in plays:
        first, second = play["receipt"]["items"]
        assert second["onset"]["tick"] - first["onset"]["tick"] == 85_000 // 5
        stronger = 1 if first["scale"] > second["scale"] else 2
        assert (str(stronger), play["receipt"]["state"]) == (play["answer"]["factors"]["interval"], "done")
    assert 20 < sum(play["answer"]["correct"] for play in plays) <= 40


def test_two_afc_killed_in_the_middle_loses_no_answer_and_goes_on(tmp_path: Path) -> None:
    with meissner.Daemon() as daemon:
        environment = {
            "MEISSNER_SOCKET": daemon.socket,
            "MEISSNER_ANSWERS": "simulated",
            "XDG_RUNTIME_DIR": str(tmp_path),
        }
        command = [sys.executable, str(EXAMPLES / "two_afc.py")]
        experiment = subprocess.Popen(command, cwd=tmp_path, env={**os.environ, **environment})
        with meissner.connect(daemon.socket) as watcher:
            last = None
            while last is None or last.id < 10 or not last.is_over:
                assert experiment.poll() is None
                try:
                    last = watcher.receipt()
                except meissner.errors.NotFound:
                    time.sleep(0.01)
            os.kill(experiment.pid, signal.SIGKILL)
            experiment.wait()
        # The answer to a play is in before the next play begins.
        found = {play["receipt"]["order"]["trial"] for play in answered(daemon) if play["answer"]}
        assert found in (set(range(1, last.id)), set(range(1, last.id + 1)))
        run("two_afc.py", tmp_path, **environment)
        trials = [play["receipt"]["order"]["trial"] for play in answered(daemon) if play["answer"]]
    assert sorted(trials) == list(range(1, 41))


def test_feels_real_asks_people_and_analyses_what_they_say(tmp_path: Path) -> None:
    """Ten trials of one participant are in the dataset as they were answered; a simulated study tells the truth that it was made with."""
    # Ten of the trials of "feels_real.py".
    ten = (
        "import feels_real as f, json; every = f.study; f.study = lambda name: every(name)[:10]; f.PAUSE_S = 0.02; f.run('P07', 'data');"
        "told = [f.report(f.simulated(30, 0.7, seed)) for seed in range(4)];"
        "print(json.dumps([f.read('data'), f.report(f.read('data')), told, f.plan(12, 0.5, 40)]))"
    )
    with meissner.Daemon() as daemon:
        found = run_kept(
            [sys.executable, "-c", ten],
            tmp_path,
            {
                "MEISSNER_SOCKET": daemon.socket,
                "MEISSNER_ANSWERS": "0.6",
                "PYTHONPATH": os.pathsep.join([str(EXAMPLES), *filter(None, [os.environ.get("PYTHONPATH")])]),
            },
        )
        assert found.returncode == 0, found.stderr
        plays = answered(daemon)
    answers, (report, p), told, plan = json.loads(found.stdout)
    assert len(answers) == len(plays) == 10
    for (participant, thing, against, interval, took_auto), play in zip(answers, plays, strict=True):
        names = [item["pattern"] for item in play["receipt"]["items"]]
        assert (participant, names[interval - 1]) == ("sub-P07", f"{thing}-a")
        assert (names[2 - interval] == f"{thing}-b") is (against == "rule")
        assert took_auto is (play["answer"]["response"] == str(interval))
    assert (report.split(";")[0], p) in [(f"{count} participants", 1.0) for count in (0, 1)]
    means = [float(re.findall(r"taken in (0\.\d+)", text)[0]) for text, _ in told]
    assert all(mean == pytest.approx(0.68, abs=0.06) and p < 0.01 for mean, (_, p) in zip(means, told, strict=True))
    assert int(plan.split()[0]) <= 6


def blocks(file: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", file.read_text(encoding="utf-8"), re.DOTALL)


def run_blocks(found: list[str], folder: Path, **environment: str) -> None:
    """Runs these one after the other, each in a Python of its own."""
    assert found
    for number, block in enumerate(found):
        (folder / f"block{number}.py").write_text(block, encoding="utf-8")
        ended = run_kept([sys.executable, f"block{number}.py"], folder, environment)
        assert ended.returncode == 0, block + ended.stderr


def test_the_readme_begins_with_a_play_in_five_lines(tmp_path: Path) -> None:
    found = blocks(README, "python")
    assert len([line for line in found[0].splitlines() if line.strip()]) <= 5
    run_blocks(found, tmp_path)


@pytest.mark.parametrize("page", sorted(page.name for page in BOOK.glob("*.md")))
def test_a_page_of_the_book_runs(page: str, tmp_path: Path) -> None:
    found = [block for block in blocks(BOOK / page, "py") if not any(text in block for text in ELSEWHERE)]
    for text, needed in NEEDS.items():
        if not importlib.util.find_spec(needed):
            found = [block for block in found if text not in block]
    if found:
        with meissner.Daemon() as daemon:
            run_blocks(found, tmp_path, MEISSNER_SOCKET=daemon.socket)


@pytest.mark.skipif(not BOOK.exists(), reason="the book is in the repository only")
def test_what_another_test_runs_is_in_the_book() -> None:
    book = "".join(page.read_text(encoding="utf-8") for page in BOOK.glob("*.md"))
    for text, test in ELSEWHERE.items():
        assert f"{text}" in book
        assert (Path(__file__).parents[1] / test).exists()
