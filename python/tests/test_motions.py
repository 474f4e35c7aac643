"""Motions: samples, and what is told before and after a play."""

from __future__ import annotations

import math
from typing import Any

import pytest

import meissner
from meissner import errors, motions

PRESS = [50 - 50 * math.cos(2 * math.pi * t / 500) for t in range(501)]
"""Half a second at 1 kHz, up to 100 um."""


def test_samples_and_drives_are_played_and_told(m: meissner.Client) -> None:
    play = m.play(samples={9: PRESS}, rate=1000, strict=True, hold=1.0, labels={"what": "press"})
    (motion,) = play.motions
    assert (motion["motor"], motion["highest_um"], motion["too_slow_from_s"]) == (9, 100.0, None)
    receipt = play.wait()
    assert (receipt.pattern, receipt.late, receipt.raw["reach"]["motions"]) == ("inline", 0, [motion])
    (pin,) = receipt.raw["pins"]["moved"]
    assert pin["motor"] == 9
    assert play.onset.tick <= pin["first_pulse_tick"] < pin["offset_tick"]
    # Corrections shift the end by some ticks.
    assert abs(pin["offset_tick"] - play.offset.tick) < 850
    drives = [{"motor": 14, "frequency_hz": 60.0, "amplitude_um": 40.0}]
    both = m.play(samples={9: PRESS}, rate=1000, drives=drives, seconds=0.3)
    assert [pin["motor"] for pin in both.wait().raw["pins"]["moved"]] == [9, 14]
    assert m.play(drives=drives, seconds=0.1).wait().raw["reach"]["motions"] == []


def test_an_array_of_all_motors_is_played(m: meissner.Client) -> None:
    numpy = pytest.importorskip("numpy")
    um = numpy.zeros((501, m.array.motors))
    um[:, 3] = PRESS
    um[:, 20] = numpy.asarray(PRESS, dtype=numpy.float32) / 2
    play = m.play(samples=um, rate=1000)
    assert [(motion["motor"], motion["highest_um"]) for motion in play.motions] == [(3, 100.0), (20, 50.0)]
    play.wait()
    rows = [list(row) for row in um]
    assert motions.pattern(rows, 1000, motors=24) == motions.pattern(um, 1000, motors=24)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"samples": {9: [0.0, math.nan]}, "rate": 100}, "motor 9: sample 1 at 0.01 s is nan: must be a number"),
        ({"samples": {9: [0.0, math.inf]}, "rate": 100}, "motor 9: sample 1 at 0.01 s is inf"),
        ({"samples": {9: [0.0, -1.0]}, "rate": 100}, "sample 1 at 0.01 s is -1: must be 0 to 400 um"),
        ({"samples": {9: [0.0, 401.0]}, "rate": 100}, "sample 1 at 0.01 s is 401"),
        ({"samples": {24: [0.0, 1.0]}, "rate": 100}, "motor 24: the array has motors 0 to 23"),
        ({"samples": {9: [1.0]}, "rate": 100}, "motor 9 has 1 samples"),
        ({"samples": {9: [0.0, 1.0]}}, "`samples` need `rate`: how many are a second, 1 to 8000 Hz"),
        ({"samples": {9: [0.0, 1.0]}, "rate": 44100}, "`rate` is 44100"),
        ({"samples": [[0.0, 1.0]], "rate": 100}, "samples at 0 are of 2 motors"),
        ({"samples": {}, "rate": 100}, "nothing would move"),
        ({}, "give `pattern`"),
        ({"pattern": "pin-60", "drives": []}, "not both"),
    ],
)
def test_what_no_pin_can_do_raises_before_anything_moves(m: meissner.Client, given: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=r".") as raised:
        m.play(**given)
    assert says in str(raised.value)
    assert m.status().playing is None


def test_what_a_motor_is_too_slow_for_is_refused(m: meissner.Client) -> None:
    jump = {9: [0.0, 0.0, 200.0, 0.0]}
    with pytest.raises(errors.TooSlow, match="motor 9 is too slow"):
        m.play(samples=jump, rate=100, strict=True)
    with pytest.warns(UserWarning, match="`inline`: motor 9 is too slow for its motion, first after"):
        play = m.play(samples=jump, rate=100)
    assert play.motions[0]["too_slow_from_s"] > 0
    assert "too slow" in play.wait().raw["reach"]["warnings"][0]
    item = {"samples": jump, "rate": 100}
    with pytest.raises(errors.TooSlow, match=r"`items\[1\]`"):
        m.sequence([{"samples": {9: PRESS}, "rate": 1000}, item], isi=0.1, strict=True)
    with pytest.raises(errors.BadRequest, match="hold_ms"):
        m.sequence([item], hold=100.0)
    assert m.sequence([item], hold=0.5).motions[0]["too_slow_from_s"] > 0


def test_items_overlap_and_may_be_blank(m: meissner.Client) -> None:
    items = [{"samples": {9: PRESS}, "rate": 1000}, {"pattern": "pin-60", "start": 0.02}, None]
    with pytest.raises(errors.BadRequest, match=r"`items\[1\]`"):
        m.sequence([items[0], {"samples": {9: PRESS}, "rate": 1000, "start": 0.1}])
    two = [{"samples": {3: PRESS}, "rate": 1000, "start": 0.0}, {"pattern": "pin-60", "start": 0.02}, None]
    play = m.sequence(two, seconds=0.5, scale=0.5)
    play.wait()
    assert [(item.pattern, item.state) for item in play.items] == [
        ("inline", "played"),
        ("pin-60", "played"),
        ("blank", "played"),
    ]
    assert play.items[1].onset is not None
    assert play.items[0].onset is not None
    assert play.items[1].onset.tick - play.items[0].onset.tick == 1700


def test_what_is_too_fast_says_how_to_resample_it() -> None:
    with pytest.raises(ValueError, match=r"must be 1 to 8000; scipy\.signal\.resample_poly resamples"):
        motions.pattern({9: [0.0, 1.0]}, 44_100, motors=24)
