"""Each figure is drawn from the program's numbers: what its lines and points are, not how they look."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner import program

pytest.importorskip("matplotlib", reason="matplotlib is not installed")
np = pytest.importorskip("numpy", reason="NumPy is not installed")
from meissner import figures  # noqa: E402

CALIBRATION = Path(__file__).parent / "data" / "laser" / "plain.json"
SCENE = Path(__file__).parents[2] / "library" / "scenes" / "one-pin.toml"


def lines(axes: Any) -> dict[str, Any]:
    return {line.get_label(): line.get_xydata() for line in axes.get_lines()}


def test_amplitude_has_the_model_and_what_simulated_motors_reach() -> None:
    axes: Any = figures.amplitude().axes[0]
    models = {label: line for label, line in lines(axes).items() if label.endswith("µm")}
    assert list(models) == [f"{um} µm" for um in (10, 20, 40, 80, 160, 320)]
    for um, place in ((10, 0), (80, 100), (320, 50)):
        hz, found = models[f"{um} µm"][place].tolist()
        answer = program._run(["motor", f"--frequency-hz={hz!r}", f"--amplitude-um={um}"])
        assert found == pytest.approx(answer["peak_to_peak_um"], rel=1e-6)
    for (label, line), measured in zip(models.items(), axes.containers, strict=True):
        hz, um = measured.lines[0].get_data()
        assert len(hz) > 20
        near = um > 20
        assert um[near] == pytest.approx(np.interp(hz, *line.T)[near], rel=0.15), label


def test_pulses_shows_each_burst_of_a_simulated_motor() -> None:
    axes: Any = figures.pulses().axes[0]
    drawn = lines(axes)
    assert len(drawn["bursts"]) > 5 * len(drawn["bursts after a rest, not in the mean"]) > 0
    up = axes.containers[0].lines[0].get_xydata()
    ends = next(line for label, line in drawn.items() if label.startswith("up, 0."))
    assert up[:, 1] == pytest.approx(np.interp(up[:, 0], *ends.T), rel=0.1)


def test_pulses_has_the_points_and_lines_of_a_calibration() -> None:
    data = json.loads(CALIBRATION.read_text(encoding="utf-8"))
    keys = ("pulses", "travel_um", "sd_um", "bursts")
    for line in data.values():
        line["points"] = [dict(zip(keys, point, strict=True)) for point in line["points"]]
    calibration = {"motors": [{"motor": 3, **data}]}
    axes: Any = figures.pulses(calibration, 3).axes[0]
    up, down = data["up"], data["down"]
    drawn = lines(axes)
    for name, line in data.items():
        end = drawn[f"{name}, {line['slope_um_per_pulse']:.4f} µm per pulse"][1]
        assert list(end) == pytest.approx([140, line["offset_um"] + 140 * line["slope_um_per_pulse"]])
    means = [container.lines[0].get_ydata() for container in axes.containers]
    assert [list(of) for of in means] == [[point["travel_um"] for point in line["points"]] for line in (up, down)]
    with pytest.raises(ValueError, match="no motor 4"):
        figures.pulses(calibration, 4)


def test_edge_shows_target_motors_and_rates(tmp_path: Path) -> None:
    pattern = tmp_path / "found.toml"
    pattern.write_text(meissner.design("edge-45", setting="always_on", budget=20).toml, encoding="utf-8")
    drawn: Any = figures.edge(pattern)
    target, motors, rates = drawn.axes[:3]
    assert np.allclose(lines(motors)["target"], 6 / 2**0.5 * np.array([[-1, -1], [1, 1]]), atol=1e-6)
    assert [len(points.get_offsets()) for points in target.collections] == [306, 24]
    (driven,) = motors.collections
    assert [f"{hz:.0f}" for hz in driven.get_array()] == [text.get_text() for text in motors.texts]
    answer = meissner.simulate(pattern, model="membrane", rates_only=True)
    assert list(rates.collections[0].get_array()) == list(answer.rates_hz)
    assert max(answer.rates_hz) > 0


def test_felt_shows_each_spike_under_the_object_and_under_the_display() -> None:
    felt = meissner.judge("edge-45-rendered", "edge-45", fingers=1).felt
    all_axes: Any = figures.felt("edge-45-rendered", "edge-45").axes
    for row, trains in enumerate((felt["object_spikes_s"], felt["pattern_spikes_s"])):
        sizes = [(size - 4) / 12 for axes in all_axes[4 * row :][:3] for size in axes.collections[0].get_sizes()]
        spikes = [s for line in lines(all_axes[4 * row + 3]).values() for s in line[:, 0]]
        assert sorted(spikes) == sorted(s for times in trains for s in times)
        assert sum(sizes) == len(spikes) > 100
    assert all_axes[5].get_title().startswith("RA, display, r = 0.")


def test_tradeoff_has_a_series_for_each_method() -> None:
    drawn = lines(figures.tradeoff(str(SCENE)).axes[0])
    assert drawn["exact"][0][1] == 0
    euler = next(points for name, points in drawn.items() if name.startswith("stepped, euler"))
    assert len(euler) > 5
    assert euler[:, 1].max() > 10 * euler[:, 1].min()


@pytest.mark.parametrize(
    ("end", "begins", "arguments"),
    [
        ("svg", b"<?xml", ["amplitude"]),
        ("svg", b"<?xml", ["felt", "edge-45-rendered", "edge-45"]),
        ("pdf", b"%PDF-", ["pulses"]),
        ("png", b"\x89PNG\r", ["tradeoff", str(SCENE)]),
    ],
)
def test_a_figure_is_written_by_the_end_of_its_name(
    end: str, begins: bytes, arguments: list[str], tmp_path: Path
) -> None:
    files = [tmp_path / f"{name}.{end}" for name in ("one", "two")[: 1 + (end == "svg")]]
    for file in files:
        subprocess.run([sys.executable, "-m", "meissner.figures", *arguments, "-o", str(file)], check=True)
    written = [file.read_bytes() for file in files]
    assert written[0].startswith(begins)
    assert written[0] == written[-1], "the same numbers give the same bytes"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["felt", "no", "edge-45"], "`meissner judge` failed"),
        (["pulses", "no.json"], "no.json"),
        (["pulses", str(CALIBRATION)], "is no answer of `meissner calibrate --json`"),
    ],
)
def test_what_cannot_be_drawn_is_told_in_a_line(arguments: list[str], says: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "meissner.figures", *arguments, "-o", str(tmp_path / "x.svg")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1), ended.stderr
    assert ended.stderr.startswith("meissner.figures: ")
    assert says in ended.stderr
