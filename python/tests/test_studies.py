"""Studies without a person: a simulated participant answers, and its parameters come back from the exported BIDS dataset alone.

The participant's answers depend on a seed, so each study finds the same every time. What a study finds is compared with what its
number of trials can tell: some standard errors of the estimate.
"""

from __future__ import annotations

import csv
import itertools
import math
import random
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner.experiment import SimulatedObserver, Staircase, constant_stimuli, two_afc


@pytest.fixture
def lab() -> Iterator[meissner.Client]:
    """An armed client of a daemon that begins plays soon."""
    with meissner.Daemon("lead_ms = 60\n") as daemon, meissner.connect(daemon.socket) as client:
        client.arm(assume_rest=True, silence=60.0)
        yield client


def events(dataset: Path) -> list[dict[str, str]]:
    """The rows of the dataset's only table of events."""
    (file,) = dataset.glob("sub-*/ses-*/beh/*_events.tsv")
    with file.open(newline="", encoding="utf-8") as opened:
        return list(csv.DictReader(opened, delimiter="\t", quoting=csv.QUOTE_NONE))


def grid(low: float, high: float, steps: int) -> list[float]:
    return [low + (high - low) * step / (steps - 1) for step in range(steps)]


def logistic(x: float) -> float:
    return 1 / (1 + math.exp(-x))


def likeliest(
    parameters: Sequence[tuple[float, float]], answers: Sequence[tuple[float, bool]], model: object
) -> tuple[float, float]:
    """The parameters that make the answers most probable."""
    counts: dict[tuple[float, bool], int] = {}
    for answer in answers:
        counts[answer] = counts.get(answer, 0) + 1

    def log_likelihood(pair: tuple[float, float]) -> float:
        total = 0.0
        for (level, said), count in counts.items():
            share = min(max(model(level, *pair), 1e-9), 1 - 1e-9)  # type: ignore[operator]
            total += count * math.log(share if said else 1 - share)
        return total

    return max(parameters, key=log_likelihood)


def test_2afc_gives_threshold_and_slope(lab: meissner.Client, tmp_path: Path) -> None:
    person = SimulatedObserver(0.3, slope=2.5, lapse=0.0, seed=11)
    levels = [0.1, 0.2, 0.3, 0.45]
    with lab.session("P07", experiment="2afc") as session:
        for trial in two_afc(levels, repeats=40, seed=5):
            edges = [{"pattern": "edge-45", "scale": scale} for scale in trial.intervals(0.5 + trial["level"], 0.5)]
            lab.sequence(edges, seconds=0.03, soa=0.05, trial=trial.number).wait()
            correct = person.is_correct(trial["level"])
            session.answer(trial, trial["interval"] if correct else 3 - trial["interval"], correct=correct)
    lab.export_bids(session.id, tmp_path / "data")
    first = [row for row in events(tmp_path / "data") if row["item"] == "0"]
    second = [row for row in events(tmp_path / "data") if row["item"] == "1"]
    assert len(first) == len(second) == 160
    answers = []
    for one, two in zip(first, second, strict=True):
        stronger = "1" if float(one["scale"]) > float(two["scale"]) else "2"
        assert (one["factor_interval"], one["correct"]) == (stronger, str(one["response"] == stronger).lower())
        answers.append((round(abs(float(one["scale"]) - float(two["scale"])), 6), one["response"] == stronger))

    def weibull(level: float, threshold: float, slope: float) -> float:
        return 0.5 + 0.5 * -math.expm1(-((level / threshold) ** slope))

    pairs = list(itertools.product(grid(0.1, 0.6, 51), grid(0.5, 6, 56)))
    threshold, slope = likeliest(pairs, answers, weibull)
    assert threshold == pytest.approx(0.3, rel=0.2)
    assert slope == pytest.approx(2.5, rel=0.5)


def test_a_staircase_gives_the_threshold(lab: meissner.Client, tmp_path: Path) -> None:
    person = SimulatedObserver(0.2, slope=3, lapse=0.0, seed=4)
    stairs = Staircase(0.9, ratio=1.15, down=2, minimum=0.02, maximum=1.0, reversals=30)
    with lab.session("P07", experiment="detection") as session:
        for trial in itertools.count(1):
            if stairs.done:
                break
            lab.play("edge-45", 0.03, scale=stairs.level, trial=trial).wait()
            correct = person.is_correct(stairs.level)
            session.answer(trial, "yes" if correct else "no", correct=correct, level=stairs.level)
            stairs.answer(correct)
    lab.export_bids(session.id, tmp_path)
    rows = events(tmp_path)
    assert [float(row["level"]) for row in rows] == pytest.approx([level for level, _ in stairs.answers])
    levels = [math.log(float(row["scale"])) for row in rows]
    directions = [b - a for a, b in itertools.pairwise(levels) if b != a]
    steps = [a for a, b in itertools.pairwise(levels) if b != a]
    turns = [
        at for at, (before, after) in zip(steps[1:], itertools.pairwise(directions), strict=True) if before * after < 0
    ]
    found = math.exp(statistics.mean(turns[4:]))
    assert found == pytest.approx(person.level_of(0.5**0.5), rel=0.2)


def test_temporal_order_at_5_ms_gives_pse_and_jnd(lab: meissner.Client, tmp_path: Path) -> None:
    """The participant feels the left pin 6 ms late, and judges with a slope of 8 ms."""
    chance = random.Random(3)
    pse_ms, width_ms = 6.0, 8.0
    with lab.session("P07", experiment="order") as session:
        for trial in constant_stimuli([-30, -20, -10, -5, 5, 10, 20, 30], repeats=16, seed=9):
            soa_s = trial["level"] / 1000
            pins: list[dict[str, Any]] = [
                {"pattern": "pin-60", "start": max(0.0, -soa_s)},
                {"drives": [{"motor": 14, "frequency_hz": 60.0, "amplitude_um": 40.0}], "start": max(0.0, soa_s)},
            ]
            pins.sort(key=lambda pin: float(pin["start"]))
            lab.sequence(pins, seconds=0.03, trial=trial.number, labels={"soa_ms": trial["level"]}).wait()
            left_first = chance.random() < logistic((trial["level"] - pse_ms) / width_ms)
            session.answer(trial, "left" if left_first else "right")
    lab.export_bids(session.id, tmp_path)
    by_play: dict[str, list[dict[str, str]]] = {}
    for row in events(tmp_path):
        by_play.setdefault(row["play"], []).append(row)
    assert len(by_play) == 128
    answers = []
    for pair in by_play.values():
        left, right = sorted(pair, key=lambda row: row["trial_type"] != "pin-60")
        # What was played, by the device's clock.
        soa_ms = (int(right["onset_tick"]) - int(left["onset_tick"])) * 1000 / int(left["tick_hz"])
        assert soa_ms == float(left["label_soa_ms"])
        answers.append((soa_ms, left["response"] == "left"))
    pairs = list(itertools.product(grid(-10, 20, 61), grid(2, 20, 37)))
    pse, width = likeliest(pairs, answers, lambda soa, pse, width: logistic((soa - pse) / width))
    assert pse == pytest.approx(pse_ms, abs=4)
    assert width == pytest.approx(width_ms, rel=0.5)


def test_reaction_times_stand_beside_the_codes_of_the_trigger(lab: meissner.Client, tmp_path: Path) -> None:
    """An EEG amplifier gets the code of the condition at the onset; the weaker stimulus is answered 80 ms later."""
    chance = random.Random(5)
    medians_ms = {11: 300.0, 12: 380.0}
    with lab.session("P07", experiment="reactions") as session:
        for trial in constant_stimuli(list(medians_ms), repeats=40, seed=7):
            code = int(trial["level"])
            lab.play("edge-45", 0.03, scale=1.0 if code == 11 else 0.3, trigger=code, trial=trial.number).wait()
            session.answer(trial, "felt", rt_ms=medians_ms[code] * math.exp(chance.gauss(0, 0.15)))
    lab.export_bids(session.id, tmp_path)
    rows = events(tmp_path)
    assert len(rows) == 80
    for code, median_ms in medians_ms.items():
        times_s = [float(row["response_time"]) for row in rows if row["trigger_code"] == str(code)]
        assert len(times_s) == 40
        assert 1000 * statistics.median(times_s) == pytest.approx(median_ms, rel=0.1)
