"""What is reached, where less than what was ordered is."""

from __future__ import annotations

import csv
import warnings
from pathlib import Path
from typing import Any

import pytest

import meissner


def drive(frequency_hz: float, amplitude_um: float) -> dict[str, Any]:
    return {"drive": [{"motor": 9, "frequency_hz": frequency_hz, "amplitude_um": amplitude_um}]}


FAST = drive(300.0, 60.0)
FAST_TOML = (
    'format = 1\nname = "fast"\narray = "tula35-6x4"\n\n[[drive]]\nmotor = 9\nfrequency_hz = {}\namplitude_um = 300.0\n'
)


def test_a_play_warns_once_where_its_caller_stands(m: meissner.Client) -> None:
    with pytest.warns(UserWarning, match=r"reaches 3\.1 of 60 um \(5 %\) at 300 Hz") as told:
        m.play(FAST, 0.05)
    assert len(told) == 1
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # As a staircase does: the same motor and frequency, other amplitudes.
        for amplitude_um in (60.0, 30.0, 10.0):
            m.play(drive(300.0, amplitude_um), 0.05).wait()
        m.play("pin-60", 0.05).wait()
    with pytest.warns(UserWarning, match="at 250 Hz"):
        m.play(drive(250.0, 60.0), 0.05).wait()


def test_wait_warns_of_what_only_another_scale_shows(m: meissner.Client) -> None:
    m.store_pattern("fast", FAST_TOML.format(60.0), replace=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        m.play("fast", 0.05, scale=0.2).wait()
        play = m.play("fast", 0.05)
    with pytest.warns(UserWarning, match=r"`fast`: drive 1 \(motor 9\)") as told:
        play.wait()
    assert told[0].filename == __file__
    # A pattern that takes its place is another one.
    m.store_pattern("fast", FAST_TOML.format(70.0), replace=True)
    with pytest.warns(UserWarning, match="at 70 Hz"):
        m.play("fast", 0.05).wait()
    m.remove_pattern("fast")


def test_a_sequence_warns(m: meissner.Client) -> None:
    items: list[Any] = ["pin-60", {"pattern": {"name": "quick", **FAST}, "scale": 0.5}]
    with pytest.warns(UserWarning, match=r"`quick`: drive 1 \(motor 9\) .*reaches 3\.1 of 30 um") as told:
        play = m.sequence(items, seconds=0.05, soa=0.1)
    play.wait()
    m.sequence(items, seconds=0.05, soa=0.1).wait()
    assert len(told) == 1
    assert [item.reached_um for item in play.items] == pytest.approx([68.685, 3.069], abs=0.1)
    assert play.receipt.reached_um == pytest.approx(68.685, abs=0.1)


@pytest.mark.filterwarnings("ignore:.*reaches")
def test_what_is_reached_stands_beside_the_level_in_each_table(m: meissner.Client, tmp_path: Path) -> None:
    pynwb = pytest.importorskip("pynwb")
    press: dict[str, Any] = {"samples": {9: [0.0, 10.0, 10.0, 0.0]}, "rate": 15}
    with m.session("P07", experiment="reached") as session:
        fast = m.play(FAST, 0.05, trial=1)
        two: list[Any] = [{"pattern": FAST}, {"pattern": "pin-60", "scale": 0.1}]
        for play in (fast, m.sequence(two, seconds=0.05, soa=0.1, trial=2), m.sequence([press], trial=3)):
            play.wait()
            play.answer("felt", level=60)
    export = m.export_bids(session.id, tmp_path / "bids")
    with export.events.open(newline="", encoding="utf-8") as opened:
        rows = list(csv.DictReader(opened, delimiter="\t"))
    assert [row["level"] for row in rows] == ["60.0"] * 4
    reached = [None if row["reached_um"] == "n/a" else float(row["reached_um"]) for row in rows]
    assert reached[:3] == pytest.approx([3.069, 3.069, 8.0], abs=0.5)
    assert reached[3] is None, "what a motion reaches is not known, so it is not 0"
    file = m.export_nwb(session.id, tmp_path / "x.nwb").file
    with pynwb.NWBHDF5IO(str(file), "r") as io:
        trials = io.read().trials
        assert list(trials["level"][:]) == [60.0] * 3
        found = [None if um != um else um for um in trials["reached_um"][:]]
    assert found[2] is None
    assert found[:2] == pytest.approx([3.069, 8.0], abs=0.5)
