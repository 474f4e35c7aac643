"""TouchSim's stimuli go both ways."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import meissner
from meissner import exchange

DATA = Path(__file__).parent / "data"


def touchsim() -> SimpleNamespace:
    """A stimulus as TouchSim's objects have it."""
    return SimpleNamespace(**json.loads((DATA / "touchsim.json").read_text(encoding="utf-8"))["stimulus"])


def test_a_stimulus_of_touchsim_is_played_by_the_nearest_pins(m: meissner.Client) -> None:
    stimulus = touchsim()
    traces = exchange.from_touchsim(stimulus, m.array)
    assert sorted(traces.samples) == [9, 14]
    assert traces.rate == 1000
    assert list(traces.samples[9]) == pytest.approx([1000 * mm for mm in stimulus.trace[0]])
    assert traces.lost == ()
    play = m.play(samples=traces.samples, rate=traces.rate, strict=True)
    assert [motion["motor"] for motion in play.motions] == [9, 14]
    play.wait()
    back = exchange.to_touchsim(
        meissner.displacement(pattern_of(traces), rate_hz=1000.0), m.array, center_mm=(1.0, -2.0)
    )
    assert (back["fs"], back["pin_radius"], back["trace"].shape[0]) == (1000.0, 0.5, 24)
    assert back["location"][9] == pytest.approx((-1.45 + 1.0, 1.45 - 2.0))
    # The motor lags by the mean over 4.3 ms.
    assert back["trace"][9][102] == pytest.approx(stimulus.trace[0][100], abs=0.002)
    assert back["trace"][0] == pytest.approx(0)


def pattern_of(traces: exchange.Traces) -> str:
    lines = ["format = 2", 'name = "touchsim"']
    for motor, um in traces.samples.items():
        lines += ["[[wave]]", f"motor = {motor}", f"rate_hz = {traces.rate}", f"um = {[float(value) for value in um]}"]
    return "\n".join(lines) + "\n"


def test_what_pins_cannot_do_of_a_stimulus_is_told_or_refused(m: meissner.Client) -> None:
    stimulus = touchsim()
    stimulus.location = [[-1.2, 1.45], [1.45, -1.45]]
    stimulus.trace[0][100] = 0.0
    stimulus.pin_radius = 0.05
    lost = exchange.from_touchsim(stimulus, m.array).lost
    assert lost[0] == "the exact places: pins are up to 0.25 mm away"
    assert lost[1].startswith("speeds of up to 200 mm/s: the motor moves at 11.5 mm/s")
    assert lost[2] == "the pins' radius of 0.05 mm: those of tula35-6x4 have 0.5 mm"
    changes: list[tuple[dict[str, Any], str]] = [
        ({"location": [[-1.4, 1.45], [-1.5, 1.45]]}, "two pins of the stimulus are nearest to motor 9"),
        ({"location": [[9.0, 1.45], [1.45, -1.45]]}, "no pin of tula35-6x4 is within half a pitch"),
        ({"location": [[math.nan, 1.45], [1.45, -1.45]]}, "no pin of tula35-6x4 is within half a pitch of .nan, 1.45."),
        ({"location": [[-1.45, 1.45], [1.45, math.inf]]}, "no pin of tula35-6x4 is within half a pitch of .1.45, inf."),
        ({"trace": [[0.1] * 100 + [math.nan] * 100, [0.0] * 200]}, "samples that are no finite numbers"),
        ({"trace": [[0.1] * 200, [0.0] * 199 + [math.inf]]}, "samples that are no finite numbers"),
        ({"fs": 20000.0}, "20000 samples a second: must be 1 to 8000"),
        ({"trace": [[-0.1] * 200, [0.0] * 200]}, "goes from -100 to -100 um: must be 0 to 400"),
    ]
    for change, said in changes:
        with pytest.raises(ValueError, match=said):
            exchange.from_touchsim(SimpleNamespace(**{**vars(touchsim()), **change}), m.array)
