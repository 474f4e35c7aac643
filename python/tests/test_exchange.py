"""Files of other programs become patterns, TouchSim's objects go both ways, and text becomes Braille.

The files, their makers and their licences stand in `data/README.md`. Numbers said to be a program's were taken from that program.
"""

from __future__ import annotations

import array
import base64
import itertools
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
SPEED_UM_S = 85_000 * 0.95 / 7


def samples(wave: dict[str, Any]) -> list[float]:
    values = array.array("f", base64.b64decode(wave["samples"]))
    if sys.byteorder == "big":
        values.byteswap()
    return list(values)


def swing(values: list[float]) -> float:
    return max(values) - min(values)


def follows(m: meissner.Client, imported: exchange.Imported) -> None:
    """The daemon plays it, its motors are fast enough for all of it, and a stored file is the same."""
    play = m.play(imported.pattern, strict=True)
    assert play.motions
    assert all(motion["too_slow_from_s"] is None for motion in play.motions)
    assert play.wait().raw["state"] == "done"
    name = imported.pattern["name"]
    m.store_pattern(name, imported.toml)
    try:
        again = m.play(name)
        assert [motion["error_um"] for motion in again.motions] == [motion["error_um"] for motion in play.motions]
        again.wait()
    finally:
        m.remove_pattern(name)


def test_taps_of_an_ahap_become_tones(m: meissner.Client) -> None:
    imported = exchange.from_ahap(DATA / "two-taps.ahap", motors=[9], array=m.array, amplitude_um=30)
    weak, strong = imported.pattern["tone"]
    assert [tone["start_s"] for tone in (weak, strong)] == [0.0, 0.15]
    assert [tone["amplitude_um"] for tone in (weak, strong)] == pytest.approx([15, 30])
    # Sharpness 0.3 and 0.5 of 40 to 120 Hz: the ratio is 3.
    assert [tone["frequency_hz"] for tone in (weak, strong)] == pytest.approx([40 * 3**0.3, 40 * 3**0.5])
    assert imported.lost == ("the phone's frequencies: sharpness 0 to 1 is played at 40 to 120 Hz",)
    follows(m, imported)
    everywhere = exchange.from_ahap(DATA / "two-taps.ahap")
    assert {tone["motor"] for tone in everywhere.pattern["tone"]} == set(range(24))


def test_a_curve_of_an_ahap_changes_the_amplitude(m: meissner.Client) -> None:
    """Intensity 0.8 by a curve from 0.2 by 1 at 0.3 s to 0.4 at 0.7 s; a tap of sharpness 0.9."""
    imported = exchange.from_ahap(DATA / "swell.ahap", motors=[9], array=m.array, amplitude_um=30)
    (wave,), (tap,) = imported.pattern["wave"], imported.pattern["tone"]
    um, rate = samples(wave), wave["rate_hz"]
    for at_s, intensity in ((0.1, 0.8 * (0.2 + 0.8 / 3)), (0.3, 0.8), (0.55, 0.8 * (1 - 0.6 * 0.25 / 0.4))):
        near = um[round((at_s - 0.012) * rate) : round((at_s + 0.012) * rate)]
        assert swing(near) == pytest.approx(30 * intensity, rel=0.06), at_s
        assert min(near) == pytest.approx(0, abs=0.5)
    assert len(um) / rate == pytest.approx(0.6, abs=0.01)
    hz = 40 * 3**0.9
    assert tap["frequency_hz"] == pytest.approx(hz)
    # The intensity's curve has ended at 0.4, which holds.
    assert tap["amplitude_um"] == pytest.approx(0.4 * 0.5 * 30)
    follows(m, imported)


def test_an_amplitude_beyond_the_motor_is_reduced_and_told(m: meissner.Client) -> None:
    imported = exchange.from_ahap(
        DATA / "two-taps.ahap", motors=[9], array=m.array, amplitude_um=200, frequency_hz=(100, 100)
    )
    strong = imported.pattern["tone"][1]
    assert strong["amplitude_um"] == pytest.approx(SPEED_UM_S / math.pi / 100, rel=1e-3)
    (line,) = [line for line in imported.lost if "amplitude" in line]
    mean = math.sin(math.pi * 0.43) / (math.pi * 0.43)
    assert "100 to 100 Hz" in line
    assert f"moves by {SPEED_UM_S / math.pi / 100:.3g} of 200 um" in line
    assert f"leaves {100 * mean:.0f} %" in line
    follows(m, imported)


def test_what_overlaps_stays_within_the_motors_speed(m: meissner.Client, tmp_path: Path) -> None:
    events = [
        {"Event": {"Time": 0.05 * number, "EventType": kind, "EventDuration": 0.3, "EventParameters": []}}
        for number, kind in enumerate(["HapticContinuous", "HapticContinuous", "HapticTransient", "AudioCustom"])
    ]
    events[0]["Event"]["EventParameters"] = [{"ParameterID": "AttackTime", "ParameterValue": 0.5}]
    steps = [
        {"Parameter": {"ParameterID": "HapticSharpnessControl", "Time": 0.2, "ParameterValue": -0.5}},
        {"Parameter": {"ParameterID": "AudioVolumeControl", "Time": 0.2, "ParameterValue": 0.5}},
    ]
    file = tmp_path / "Two at once!.ahap"
    # A comma after the last item, as in files that Apple gives.
    file.write_text(json.dumps({"Pattern": events + steps})[:-2] + ",]}")
    imported = exchange.from_ahap(file, motors=[9], array=m.array, amplitude_um=80)
    assert imported.pattern["name"] == "two-at-once"
    assert list(imported.pattern) == ["name", "array", "wave"]
    um, rate = samples(imported.pattern["wave"][0]), imported.pattern["wave"][0]["rate_hz"]
    assert max(abs(b - a) for a, b in itertools.pairwise(um)) * rate <= SPEED_UM_S * 1.001
    assert um[-1] == 0
    told = " / ".join(imported.lost)
    for part in (
        "AudioCustom, which are sounds",
        "`AttackTime`",
        "AudioVolumeControl",
        "motion faster than the motor's 11.5 mm/s",
    ):
        assert part in told
    follows(m, imported)


def test_a_step_of_sharpness_changes_the_frequency(tmp_path: Path) -> None:
    event = {"Event": {"Time": 0, "EventType": "HapticContinuous", "EventDuration": 1, "EventParameters": []}}
    step = {"Parameter": {"ParameterID": "HapticSharpnessControl", "Time": 0.5, "ParameterValue": 0.5}}
    file = tmp_path / "step.ahap"
    file.write_text(json.dumps({"Pattern": [event, step]}))
    (wave,) = exchange.from_ahap(file, motors=[0], amplitude_um=20, frequency_hz=(25, 100)).pattern["wave"]
    um, rate = samples(wave), round(wave["rate_hz"])

    def cycles(begin_s: float, end_s: float) -> int:
        cut = um[round(begin_s * rate) : round(end_s * rate)]
        return sum(a < 5 <= b for a, b in itertools.pairwise(cut))

    # Sharpness 0.5, then 1, of 25 to 100 Hz.
    assert cycles(0.05, 0.45) == pytest.approx(0.4 * 50, abs=1)
    assert cycles(0.52, 0.92) == pytest.approx(0.4 * 100, abs=1)


def tap(*parameters: Any, **changes: Any) -> str:
    """An AHAP file of one event, by default a tap at 0 s."""
    event = {"EventType": "HapticTransient", "Time": 0, "EventParameters": parameters, **changes}
    return json.dumps({"Pattern": [{"Event": event}]})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "is no AHAP file"),
        ("[]", "has no list `Pattern`"),
        ('{"Pattern": [1]}', "has no list `Pattern`"),
        ('{"Pattern": []}', "nothing in it that a pin can do"),
        ('{"Pattern": [{"Event": {"EventType": "AudioCustom", "Time": 0}}]}', "nothing in it.*AudioCustom"),
        (
            '{"Pattern": [{"Event": {"EventType": "HapticTransient", "Time": "soon"}}]}',
            "`Time` of a HapticTransient is 'soon'",
        ),
        ('{"Pattern": [{"Event": {"EventType": "HapticTransient", "Time": NaN}}]}', "is nan: must be a number"),
        ('{"Pattern": [{"Event": {"EventType": "HapticContinuous", "Time": 0}}]}', "`EventDuration` is None"),
        ('{"Pattern": [{"Event": 3}]}', "is no AHAP file"),
        ("[" * 100_000, "is no AHAP file: its brackets are nested too deeply"),
        (b'{"a": "\xe9"}', "broken.ahap is no text in UTF-8, nor in UTF-16 with a byte order mark: save it as UTF-8"),
        ("{}".encode("utf-16-le"), "is no text in UTF-8"),
        ("\ufeff{}".encode("utf-16-le"), "has no list `Pattern`"),
        (tap()[:-20], "is no AHAP file"),
        (tap({"ParameterID": "HapticIntensity"}), "`ParameterValue` of `HapticIntensity` is None: must be a number"),
        (tap({"ParameterValue": 1}), "`ParameterID` of a HapticTransient is None: must be a name"),
        (tap({"ParameterID": "HapticIntensity", "ParameterValue": 10**400}), r"is 10+: must be a number from -1e\+15"),
        (tap(Time=-0.01), "lasts from -0.01 to .* s: must be within 0 and 1000 s"),
        (tap(Time=1e300), r"is 1e\+300: must be a number from"),
        (tap(Time=1001), "lasts from 1001 to .* s: must be within 0 and 1000 s"),
        (
            tap(EventType="HapticContinuous", EventDuration=1e9),
            r"lasts from 0 to 1e\+09 s: must be within 0 and 1000 s",
        ),
    ],
)
def test_a_broken_ahap_gets_one_line(text: str | bytes, said: str, tmp_path: Path) -> None:
    file = tmp_path / "broken.ahap"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=said) as caught:
        exchange.from_ahap(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_mpeg_file_of_a_phones_pattern_is_as_the_reference_software_evaluates_it(m: meissner.Client) -> None:
    imported = exchange.from_hjif(DATA / "swell.hjif", motors=[9], array=m.array, amplitude_um=30)
    (wave,), (tap,) = imported.pattern["wave"], imported.pattern["tone"]
    um, rate = samples(wave), wave["rate_hz"]
    # The largest amplitudes that the reference software gives from 280 to 320 ms, and from 560 to 600 ms, where the ends fall.
    assert swing(um[round(0.28 * rate) : round(0.32 * rate)]) == pytest.approx(30 * 0.488055, rel=0.03)
    assert swing(um[round(0.5 * rate) : round(0.55 * rate)]) == pytest.approx(
        30 * (0.49104 - 0.220968 * 0.2 / 0.3), rel=0.03
    )
    # Of the tap, 750 to 772 ms.
    assert tap["amplitude_um"] == pytest.approx(30 * 0.391969, rel=0.02)
    assert (tap["start_s"], tap["duration_s"], tap["frequency_hz"]) == pytest.approx((0.75, 0.022, 2 / 0.022))
    follows(m, imported)


def test_channels_of_an_mpeg_file_play_on_their_pins(m: meissner.Client) -> None:
    imported = exchange.from_hjif(DATA / "channels.hjif", motors={0: [9], 1: [13, 14]}, array=m.array, amplitude_um=40)
    tones = [tone for tone in imported.pattern["tone"] if tone["motor"] == 9]
    assert [(tone["start_s"], tone["duration_s"], tone["frequency_hz"]) for tone in tones] == [
        (0.0, 0.3, 50.0),
        (0.7, 0.022, pytest.approx(2 / 0.022)),
    ]
    # The reference software's 0.6 and 0.8, times the channel's gain of 0.5.
    assert [tone["amplitude_um"] for tone in tones] == pytest.approx([0.3 * 40, 0.4 * 40])
    waves = {wave["motor"]: wave for wave in imported.pattern["wave"]}
    assert sorted(waves) == [9, 13, 14]
    triangle, rate = samples(waves[9]), waves[9]["rate_hz"]
    assert waves[9]["start_s"] == 0.4
    # It grows from nothing to half of the amplitude in 200 ms; the last 20 are its end.
    assert swing(triangle[round(0.15 * rate) : round(0.18 * rate)]) == pytest.approx(0.85 * 0.5 * 40, rel=0.08)
    press = samples(waves[13])
    # What the reference software gives at these ms, and the press of 1, 200 um.
    for ms, share in ((50, 0.15625), (100, 0.5), (200, 1.0), (300, 0.844444), (400, 0.555556), (500, 0.4), (700, 0.2)):
        assert press[round(ms / 1000 * rate)] == pytest.approx(200 * share, abs=0.01), ms
    assert press == samples(waves[14])
    follows(m, imported)


def test_channels_without_pins_of_their_own_play_together(m: meissner.Client) -> None:
    imported = exchange.from_hjif(DATA / "channels.hjif", motors=[9], array=m.array)
    assert [wave["motor"] for wave in imported.pattern["wave"]] == [9]
    assert any(line.startswith("the places of 2 channels") for line in imported.lost)
    follows(m, imported)
    one = exchange.from_hjif(DATA / "channels.hjif", motors={1: [9]}, array=m.array)
    assert "channel 0: `motors` names no motor for it" in one.lost
    assert "tone" not in one.pattern


def hjif(tmp_path: Path, *bands: Any, **channel: Any) -> Path:
    perception = {"perception_modality": "Vibrotactile", "channels": [{"bands": list(bands), **channel}]}
    file = tmp_path / "made.hjif"
    file.write_text(json.dumps({"timescale": 8000, "perceptions": [perception]}))
    return file


def test_what_an_mpeg_file_loses_is_told(tmp_path: Path) -> None:
    high = [{"relative_position": at, "amplitude_modulation": 0.9, "frequency_modulation": 250} for at in (0, 1600)]
    wavelets = {"band_type": "WaveletWave", "effects": [{"position": 0}]}
    vibrations = {
        "band_type": "VectorialWave",
        "effects": [{"position": 4000, "keyframes": high, "base_signal": "Square"}],
    }
    swung = [
        {"relative_position": at, "amplitude_modulation": a}
        for at, a in ((0, 0.0), (400, -1.0), (800, 1.0), (1200, 0.0))
    ]
    curves = {"band_type": "Curve", "curve_type": "Akima", "effects": [{"position": 0, "keyframes": swung}]}
    imported = exchange.from_hjif(hjif(tmp_path, wavelets, vibrations, curves, gain=1.5), motors=[9])
    told = " / ".join(imported.lost)
    for part in (
        "bands of the type WaveletWave",
        "frequencies of up to 250 Hz: above 120 Hz that is played",
        "amplitudes above 1 by their gain",
        "the form of Akima curves",
        "curves that go below 0: a pin only goes up, so it is raised by 30 um",
        "the amplitude of Square vibrations of 120 to 120 Hz",
        "motion faster than the motor",
    ):
        assert part in told, told
    (wave,) = imported.pattern["wave"]
    um, rate = samples(wave), round(wave["rate_hz"])
    # 1 swings by half of the amplitude, 20 um, times the gain of 1.5; ticks are an eighth of a ms.
    assert (um[rate // 20], um[rate // 10]) == pytest.approx((0, 60), abs=1.5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is no hjif file"),
        ("{}", "has no list `perceptions`"),
        ('{"perceptions": []}', "nothing in it"),
        ('{"perceptions": [], "timescale": 0}', "`timescale` is 0: must be above 0"),
        ('{"perceptions": [{"perception_modality": "Wind", "channels": [{}]}]}', "perceptions of the kind Wind"),
        ('{"perceptions": [5]}', "is no hjif file"),
        ("[" * 100_000, "is no hjif file: its brackets are nested too deeply"),
        ("\ufeff{}".encode("utf-16-le"), "has no list `perceptions`"),
        ("{}".encode("utf-16-be"), "is no text in UTF-8, nor in UTF-16"),
        ('{"perceptions": [], "timescale": 1' + 400 * "0" + "}", r"`timescale` is 10+: must be a number from -1e\+15"),
    ],
)
def test_a_broken_mpeg_file_gets_one_line(text: str | bytes, said: str, tmp_path: Path) -> None:
    file = tmp_path / "broken.hjif"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=said) as caught:
        exchange.from_hjif(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def keyframes(*points: tuple[float, float], hz: float | None = None) -> list[dict[str, float]]:
    """Keyframes of positions and amplitudes."""
    tone = {} if hz is None else {"frequency_modulation": hz}
    return [{"relative_position": at, "amplitude_modulation": amplitude, **tone} for at, amplitude in points]


@pytest.mark.parametrize(
    ("kind", "given", "effect", "timescale", "said"),
    [
        ("Transient", keyframes((0, 1.0)), {"position": -80}, 8000, "lasts from -0.01 to 0.012 s: must be within 0"),
        ("Transient", keyframes((0, 1.0)), {"position": 1}, 1e-320, "lasts from inf to inf s: must be within 0"),
        ("Transient", keyframes((0, 1.0), (-1, 1.0)), {}, 8000, "`relative_position` is -1: must be 0 or more"),
        (
            "VectorialWave",
            keyframes((0, 1.0), (100, 1.0), hz=60),
            {},
            1e-10,
            "lasts from 0 to 1e.12 s: must be within 0",
        ),
        ("VectorialWave", keyframes((0, 1.0), (8000, 1.0), hz=1e-300), {}, 8000, "has 1e-300 Hz: must be at least 0.1"),
        ("Curve", keyframes((-800, 0.1), (-400, 0.2)), {}, 8000, "`relative_position` is -800: must be 0 or more"),
        ("Curve", keyframes((0, 0.1), (400, 1e15)), {}, 8000, "must be 0 to 400 um"),
    ],
)
def test_impossible_times_of_an_mpeg_file_get_one_line(
    kind: str, given: Any, effect: dict[str, Any], timescale: float, said: str, tmp_path: Path
) -> None:
    file = hjif(tmp_path, {"band_type": kind, "effects": [{**effect, "keyframes": given}]})
    file.write_text(json.dumps({**json.loads(file.read_text()), "timescale": timescale}))
    with pytest.raises(ValueError, match=said) as caught:
        exchange.from_hjif(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("kind", "hz"), [("Curve", None), ("VectorialWave", 60.0), ("Transient", None)])
def test_keyframes_count_by_their_times_not_by_their_order(kind: str, hz: float | None, tmp_path: Path) -> None:
    points = [(0, 0.0), (800, 0.5), (1600, 1.0), (2400, 0.0)]

    def imported(order: list[tuple[int, float]]) -> dict[str, Any]:
        band = {"band_type": kind, "effects": [{"position": 0, "keyframes": keyframes(*order, hz=hz)}]}
        return exchange.from_hjif(hjif(tmp_path, band), motors=[9]).pattern

    assert imported([points[place] for place in (2, 0, 3, 1)]) == imported(points)


def test_arguments_that_no_pin_has_are_refused(m: meissner.Client) -> None:
    with pytest.raises(ValueError, match="the array tula35-6x4 has motors 0 to 23"):
        exchange.from_ahap(DATA / "two-taps.ahap", motors=[24], array=m.array)
    with pytest.raises(ValueError, match="`amplitude_um` is 500"):
        exchange.from_hjif(DATA / "swell.hjif", amplitude_um=500)
    with pytest.raises(ValueError, match="`frequency_hz` is 90 to 40"):
        exchange.from_ahap(DATA / "two-taps.ahap", frequency_hz=(90, 40))
    with pytest.raises(ValueError, match="`highest_hz` is 400"):
        exchange.from_hjif(DATA / "swell.hjif", highest_hz=400)
    with pytest.raises(ValueError, match=r"channels.hjif: .*must be 0 to 400 um"):
        exchange.from_hjif(DATA / "channels.hjif", press_um=600)


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
