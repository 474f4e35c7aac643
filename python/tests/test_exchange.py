"""TouchSim's objects go both ways, and text becomes Braille."""

from __future__ import annotations

import json
import math
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import meissner
from meissner import exchange

DATA = Path(__file__).parent / "data"


def touchsim() -> tuple[SimpleNamespace, SimpleNamespace, dict[str, Any]]:
    """A stimulus and a response as TouchSim's objects have them."""
    recorded = json.loads((DATA / "touchsim.json").read_text(encoding="utf-8"))
    stimulus = SimpleNamespace(**recorded["stimulus"])
    afferents = SimpleNamespace(
        affclass=[each["affclass"] for each in recorded["afferents"]],
        location=[each["location"] for each in recorded["afferents"]],
    )
    return stimulus, SimpleNamespace(aff=afferents, spikes=recorded["spikes"]), recorded


def test_a_stimulus_of_touchsim_is_played_by_the_nearest_pins(m: meissner.Client) -> None:
    stimulus, _, recorded = touchsim()
    traces = exchange.from_touchsim(stimulus, m.array)
    assert sorted(traces.samples) == [9, 14]
    assert traces.rate == 1000
    assert list(traces.samples[9]) == pytest.approx([1000 * mm for mm in recorded["stimulus"]["trace"][0]])
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
    assert back["trace"][9][102] == pytest.approx(recorded["stimulus"]["trace"][0][100], abs=0.002)
    assert back["trace"][0] == pytest.approx(0)


def pattern_of(traces: exchange.Traces) -> str:
    lines = ["format = 2", 'name = "touchsim"']
    for motor, um in traces.samples.items():
        lines += ["[[wave]]", f"motor = {motor}", f"rate_hz = {traces.rate}", f"um = {[float(value) for value in um]}"]
    return "\n".join(lines) + "\n"


def test_what_pins_cannot_do_of_a_stimulus_is_told_or_refused(m: meissner.Client) -> None:
    stimulus, _, _ = touchsim()
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
            exchange.from_touchsim(SimpleNamespace(**{**vars(touchsim()[0]), **change}), m.array)


def test_a_response_of_touchsim_is_read(m: meissner.Client) -> None:
    _, response, recorded = touchsim()
    spikes = exchange.from_touchsim_response(response)
    assert spikes.classes == ("SA1",) * 4 + ("RA",) * 4 + ("PC",) * 4
    assert spikes.positions_mm[0] == (-1.45, 1.45)
    # TouchSim's own rates, impulses/s.
    assert [len(times) / recorded["duration"] for times in spikes.spikes_s] == pytest.approx(recorded["rate"])
    assert sum(map(len, spikes.spikes_s)) == 31


def test_a_prediction_becomes_a_response_of_touchsim(m: meissner.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = {"motor": 9, "frequency_hz": 60.0, "amplitude_um": 80.0}
    scene = {"duration_s": 0.2, "population": {"seed": 0}, "drives": [drive]}
    simulation = meissner.simulate(scene, model="afferents")
    with pytest.raises(ImportError, match="needs the package touchsim"):
        exchange.to_touchsim_response(simulation, None)
    # Its constructors, by TouchSim's documentation.
    classes = SimpleNamespace(
        Afferent=lambda affclass, **args: SimpleNamespace(affclass=affclass, **args),
        AfferentPopulation=lambda *afferents: afferents,
        Response=lambda a, s, r: SimpleNamespace(aff=a, stim=s, spikes=r[0]),
    )
    monkeypatch.setitem(sys.modules, "touchsim", SimpleNamespace(classes=classes))
    monkeypatch.setitem(sys.modules, "touchsim.classes", classes)
    response = exchange.to_touchsim_response(simulation, "stimulus")
    assert response.stim == ["stimulus"]
    assert len(response.aff) == len(response.spikes) == len(simulation.spikes_s)
    assert {afferent.affclass for afferent in response.aff} == {"SA1", "RA", "PC"}
    assert [len(times) for times in response.spikes] == [len(times) for times in simulation.spikes_s]
    with pytest.raises(ValueError, match="simulate with model='afferents'"):
        exchange.to_touchsim_response(meissner.simulate(scene, model="afferents", rates_only=True), "stimulus")


def test_without_liblouis_the_remedy_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(OSError, match="apt install liblouis-bin"):
        exchange.braille_text("a")


@pytest.mark.skipif(shutil.which("lou_translate") is None, reason="liblouis is not installed")
def test_liblouis_gives_the_cells_that_an_object_takes(tmp_path: Path) -> None:
    # Unified English Braille, grade 2: "the", "with" and "knowledge" are signs of their own, 12 has a number sign.
    assert exchange.braille_text("the 12\nknowledge  with") == "⠮ ⠼⠁⠃ ⠅ ⠾"
    # Grade 1 spells; a capital has its sign.
    assert exchange.braille_text("The", "en-ueb-g1.ctb") == "⠠⠞⠓⠑"
    rendered = meissner.render(
        {"name": "hi", "shape": "braille", "text": exchange.braille_text("the")}, touch={"press": {"depth_um": 200}}
    )
    assert rendered.summary["highest_um"] > 50
    with pytest.raises(ValueError, match="no translation by the table 'klingon"):
        exchange.braille_text("a", "klingon.ctb")
    with pytest.raises(ValueError, match="no cell of six dots"):
        exchange.braille_text("A1", "en-us-comp8.ctb")
