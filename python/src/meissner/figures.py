"""Figures by matplotlib: `python -m meissner.figures FIGURE ... -o FILE` writes SVG, PDF or PNG, by the end of the file's name.

    amplitude                   the amplitude that a simulated motor reaches against frequency (the paper's Fig. 3)
    edge PATTERN                afferents, motors and rates of a pattern that `meissner optimise` wrote (Fig. 4)
    felt PATTERN OBJECT         what a finger feels of an object, and of the pattern on the display
    pulses [CALIBRATION]        travel of bursts against their pulses (Fig. 2), of a simulated motor, or as `meissner calibrate --json` said
    tradeoff [SCENE]            time against error of the methods of simulation

The program on this machine computes the numbers. Each function returns a matplotlib figure, to change and to save.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from . import program
from .errors import ProgramError

COLORS = {"SA1": "#0072b2", "RA": "#d55e00", "PC": "#009e73"}
"""Of the classes of afferents. People tell them apart whatever colours they see, and so does paper in grey."""


def amplitude(array: str = "tula35-6x4") -> Figure:
    """The amplitude that a motor reaches against the frequency of its drive: the motor model, and simulated motors, mean and SD."""
    answer = program._run(["motor", "--simulated", f"--array={array}"])["amplitude"]
    figure, axes = _axes(xlabel="frequency, Hz", ylabel="amplitude, µm peak to peak", xscale="log", yscale="log")
    for um in sorted({point["amplitude_um"] for point in answer["model"]}):
        model, measured = (
            [[point[key] for key in keys] for point in answer[of] if point["amplitude_um"] == um]
            for of, keys in (
                ("model", ("frequency_hz", "model_um")),
                ("measured", ("frequency_hz", "measured_um", "sd_um")),
            )
        )
        (line,) = axes.plot(*np.array(model).T, label=f"{um:g} µm")
        axes.errorbar(*np.array(measured).T, fmt="o", markersize=3, color=line.get_color())
    axes.set_ylim(0.5, 500)
    axes.legend(title="drive")
    return figure


def pulses(calibration: Mapping[str, Any] | None = None, motor: int | None = None) -> Figure:
    """Travel of a motor's bursts against their pulses, mean and standard deviation, with the fitted lines.

    Without a `calibration`, whose first motor it is unless `motor` says another, a simulated motor is measured; then each burst is shown.
    """
    if calibration is None:
        fit = program._run(["motor", "--simulated"])["pulses"]
        for direction in ("up", "down"):
            fit[direction]["points"] = _points(
                [of for of in fit["bursts"] if of["up"] == (direction == "up") and not of["warm_up"]]
            )
    else:
        fit = next((fit for fit in calibration["motors"] if motor in (None, fit["motor"])), None)
        if fit is None:
            raise ValueError(f"the calibration has no motor {motor}")
    figure, axes = _axes(xlabel="pulses", ylabel="travel, µm", title=f"motor {fit['motor']}")
    for direction, color in (("up", "#0072b2"), ("down", "#d55e00")):
        line, points = fit[direction], fit[direction]["points"]
        number, um, sd = ([point[key] for point in points] for key in ("pulses", "travel_um", "sd_um"))
        axes.errorbar(number, um, sd, fmt="*", color=color, capsize=3, label=f"{direction}, mean and SD")
        ends = np.array([0, max(number, default=0)])
        label = f"{direction}, {line['slope_um_per_pulse']:.4f} µm per pulse"
        axes.plot(ends, line["offset_um"] + line["slope_um_per_pulse"] * ends, color=color, label=label)
    for marker, warm_up, label in (("o", False, "bursts"), ("s", True, "bursts after a rest, not in the mean")):
        dots = [(of["pulses"], of["travel_um"]) for of in fit.get("bursts", ()) if of["warm_up"] == warm_up]
        if dots:
            axes.plot(*np.array(dots).T, marker, markersize=3, color="#999999", fillstyle="none", zorder=0, label=label)
    axes.legend()
    return figure


def _points(bursts: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mean travel of bursts, and its standard deviation, by pulses."""
    lengths = {
        number: [of["travel_um"] for of in bursts if of["pulses"] == number]
        for number in (of["pulses"] for of in bursts)
    }
    return [{"pulses": number, "travel_um": np.mean(um), "sd_um": np.std(um, ddof=1)} for number, um in lengths.items()]


def edge(pattern: Path) -> Figure:
    """The finger's RA afferents under the pins and the target; the motors of the pattern; the afferents' rates by the paper's model."""
    text = pattern.read_text(encoding="utf-8")
    target = re.search(r"(?m)^points = (\[.*\])$", text)
    line = np.array(json.loads(target[1])) if target else np.zeros((0, 2))
    drive = r"\[\[drive\]\]\s+motor = (\d+)\s+frequency_hz = ([\d.]+)"
    hz = {int(motor): float(of) for motor, of in re.findall(drive, text)}
    named = re.search(r'(?m)^array = "(.*)"$', text)
    pins = np.array(program.find_array(named[1] if named else "tula35-6x4").positions_mm)
    answer = program.simulate(pattern, model="membrane", rates_only=True)
    places = np.array([(of["x_mm"], of["y_mm"]) for of in answer.raw["afferents"]])
    figure, all_axes = _pads("target", "motors, Hz", "rates, impulses/s")
    for axes in all_axes:
        axes.plot(line[:, 0], line[:, 1], color="black", linewidth=2, label="target")
    all_axes[0].scatter(*places.T, s=9, color="#999999")
    all_axes[0].scatter(*pins.T, s=70, facecolors="none", edgecolors="black")
    shown = all_axes[1].scatter(*pins[list(hz)].T, s=260, c=list(hz.values()), cmap="viridis", vmin=0)
    for motor, of in hz.items():
        ink = "black" if of > 0.6 * max(hz.values()) else "white"
        all_axes[1].annotate(f"{of:.0f}", pins[motor], ha="center", va="center", fontsize=7, color=ink)
    all_axes[1].margins(0.15)
    figure.colorbar(shown, ax=all_axes[1])
    figure.colorbar(all_axes[2].scatter(*places.T, s=16, c=answer.rates_hz, cmap="viridis"), ax=all_axes[2])
    return figure


def felt(pattern: str, object: str) -> Figure:
    """By class, the spikes of a finger's afferents under an object and under the display, in space and over time."""
    judged = program.judge(pattern, object, fingers=1)
    spikes = {"object": judged.felt["object_spikes_s"], "display": judged.felt["pattern_spikes_s"]}
    afferents = judged.felt["afferents"]
    places = np.array([(of["x_mm"], of["y_mm"]) for of in afferents])
    figure, all_axes = _pads(*COLORS, "over time", rows=2)
    r = list(judged.lines.values())[1]["r_by_class"]
    for row, (of, trains) in enumerate(spikes.items()):
        counts = np.array([len(times) for times in trains])
        time = all_axes[4 * row + 3]
        for column, (name, color) in enumerate(COLORS.items()):
            mine = np.array([afferent["class"] == name for afferent in afferents])
            axes = all_axes[4 * row + column]
            axes.scatter(*places[mine].T, s=4 + 12 * counts[mine], color=color, alpha=0.6)
            axes.set_title(f"{name}, {of}" + (f", r = {r[column]:.2f}" if row else ""))
            dots = [(s, places[number, 1]) for number in np.flatnonzero(mine) for s in trains[number]]
            time.plot(*np.array(dots).reshape(-1, 2).T, ".", markersize=2, color=color, label=name)
        time.set(
            title=f"spikes, {of}", xlabel="time, s", ylabel="along the finger, mm", xlim=(0, judged.raw["seconds"])
        )
        time.set_aspect("auto")
    all_axes[3].legend()
    return figure


def tradeoff(scene: str | None = None) -> Figure:
    """Time against error of the methods of simulation, on this machine."""
    answer = program._run(["tradeoff", *([scene] if scene else [])])
    figure, axes = _axes(
        xlabel="time per afferent and second of the scene, µs",
        ylabel="error of rates, impulses/s RMS",
        xscale="log",
    )
    # An error of 0 has a place, too.
    axes.set_yscale("symlog", linthresh=0.01)
    series: dict[str, list[tuple[float, float]]] = {}
    for row in answer["rows"]:
        name = ", ".join(str(row[key]) for key in ("method", "integrator") if row.get(key))
        # A method that was left out has no time.
        if row["us_per_receptor_s"] is not None and row["rate_rms_hz"] is not None:
            series.setdefault(name, []).append((row["us_per_receptor_s"], row["rate_rms_hz"]))
    for (name, points), marker in zip(series.items(), "*os", strict=False):
        axes.plot(*np.array(points).T, marker=marker, label=name)
    axes.legend()
    return figure


def _axes(**keys: Any) -> tuple[Figure, Any]:
    figure = Figure(figsize=(6, 4.5), layout="constrained")
    axes = figure.add_subplot()
    axes.set(**keys)
    return figure, axes


def _pads(*titles: str, rows: int = 1) -> tuple[Figure, list[Any]]:
    """Axes in mm, from above, with the fingertip up."""
    figure = Figure(figsize=(3.6 * len(titles), 4.6 * rows), layout="constrained")
    all_axes = list(np.ravel(figure.subplots(rows, len(titles))))
    for number, axes in enumerate(all_axes):
        axes.set(title=titles[number % len(titles)], xlabel="x, mm", ylabel="y, mm (fingertip up)", aspect="equal")
    return figure, all_axes


def main() -> None:
    """Draws a figure into a file."""
    parser = argparse.ArgumentParser(prog="python -m meissner.figures", description="Draw a figure as SVG, PDF or PNG")
    commands = parser.add_subparsers(dest="figure", required=True)
    for name, needed, help in (
        ("amplitude", [], "Draw the amplitude of a motor against frequency"),
        ("edge", ["pattern"], "Draw the motors and rates of a pattern that `meissner optimise` wrote to a file"),
        ("felt", ["pattern", "object"], "Draw what a finger feels of an object and of a pattern"),
        ("pulses", [], "Draw travel of bursts against their pulses"),
        ("tradeoff", [], "Draw time against error of the methods of simulation"),
    ):
        command = commands.add_parser(name, help=help, description=help)
        for argument in needed:
            command.add_argument(argument)
        command.add_argument("-o", "--output", type=Path, required=True, help="write to this file: .svg, .pdf or .png")
    commands.choices["amplitude"].add_argument("--array", default="tula35-6x4", help="draw a motor of this array")
    commands.choices["pulses"].add_argument(
        "calibration", nargs="?", help="what `meissner calibrate --json` printed [default: a simulated motor]"
    )
    commands.choices["pulses"].add_argument("--motor", type=int, help="draw this motor [default: the first]")
    commands.choices["tradeoff"].add_argument(
        "scene", nargs="?", help="compare on this scene [default: all motors at 60 Hz]"
    )
    asked = vars(parser.parse_args())
    draw, output = asked.pop("figure"), asked.pop("output")
    if draw == "edge":
        asked["pattern"] = Path(asked["pattern"])
    try:
        if file := asked.get("calibration"):
            asked["calibration"] = json.loads(Path(file).read_text(encoding="utf-8"))
            if "motors" not in asked["calibration"]:
                raise ValueError(f"{file} is no answer of `meissner calibrate --json`")
        # The same numbers give the same bytes.
        with mpl.rc_context({"svg.hashsalt": "meissner"}):
            figure: Figure = globals()[draw](**asked)
            figure.savefig(output, metadata={"Date": None} if output.suffix == ".svg" else None)
    except (OSError, ValueError, ProgramError) as error:
        sys.exit(f"meissner.figures: {error}")


if __name__ == "__main__":
    main()
