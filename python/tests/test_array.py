"""The array is the daemon's: its pins, its ticks, and patterns of other arrays, on each array that the program ships."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import meissner
from meissner import errors, program
from patience import kept
from test_bids import read

NAMES = ("tula35-6x4", "tula35-2x3", "ubi-pen-3x3", "simulated-8x8")
PATIENT = 20.0
OWN = """name = "own-3"
pins = { positions_mm = [[-1.45, 1.45], [1.45, 1.45], [0.0, -0.5]], radius_mm = 0.4 }
tick_hz = 60000
duty = { up = 0.25, down = 0.75 }
[motor]
step_um = 0.1
window_ms = 5.0
travel_um = 100.0
most_pulses = 1500
"""
# The last motor of an array of so many.
PATTERN = 'format = 1\nname = "last"\narray = "{}"\nduration_s = 0.1\n[[drive]]\nmotor = {}\nfrequency_hz = 60.0\namplitude_um = 40.0\nphase = 0.0\n'


def a_second_apart(m: meissner.Client) -> tuple[meissner.Play, meissner.Play]:
    """Two plays of the pattern, the second ordered by the onset of the first."""
    first = m.play("last", 0.1)
    first.wait()
    second = m.play("last", 0.1, at=first.onset.later(1.0))
    second.wait()
    return first, second


def check_a_session(m: meissner.Client, folder: Path, description: Path | None = None) -> None:
    """Plays a pattern of the daemon's array and one of the paper's, and exports both."""
    array, is_paper = m.array, m.array.name == "tula35-6x4"
    last = array.motors - 1
    text = PATTERN.format(array.name, last)
    m.store_pattern("last", text)
    with m.session("P07") as session:
        play, second = kept(lambda: a_second_apart(m))
        receipt = play.receipt
        assert (receipt.array, receipt.tick_hz) == (array.name, array.tick_hz)
        assert second.onset.tick - play.onset.tick == array.ticks(1.0) == array.tick_hz
        assert array.seconds(play.offset.tick - play.onset.tick) == pytest.approx(0.1, abs=0.02)
        if not is_paper:
            with pytest.raises(errors.OtherArray, match="tula35-6x4"):
                m.play("pin-60", 0.1)
            with pytest.raises(errors.OtherArray, match="tula35-6x4"):
                m.sequence(["pin-60"], seconds=0.1)
    export = m.export_bids(session.id, folder)
    rows = read(export.events)
    assert {(row["array"], row["tick_hz"]) for row in rows} == {(array.name, str(array.tick_hz))}
    header = export.events.read_text().splitlines()[0].split("\t")
    first = header.index("array")
    assert header[first : first + 2] == ["array", "tick_hz"]
    # The file of a pattern names its array, so that it can be stored again.
    m.store_pattern("again", (folder / "stimuli" / rows[0]["stim_file"]).read_text().replace('"last"', '"again"'))
    alone = meissner.displacement(text, 0.1, array=description)
    assert alone.motors == (last,)


@pytest.fixture(params=NAMES)
def on(request: pytest.FixtureRequest) -> Iterator[meissner.Client]:
    """A client of a daemon with each shipped array."""
    with meissner.demo(config=f'[array]\ndescription = "{request.param}"\n') as client:
        assert client.array.name == request.param
        yield client


def test_a_session_on_each_array(on: meissner.Client, tmp_path: Path) -> None:
    check_a_session(on, tmp_path)
    array = on.array
    assert array == program.find_array(array.name)
    assert len(on.status().raw["motors"]) == array.motors == len(array.positions_mm)
    assert array.grid is not None
    assert array.grid[0] * array.grid[1] == array.motors
    with on.live(drives=[], timeout=PATIENT) as live:
        with pytest.raises(ValueError, match=f"{array.name} has motors 0 to {array.motors - 1}"):
            live.set(array.motors, frequency_hz=60.0, amplitude_um=20.0)
        moved = live.set(array.motors - 1, frequency_hz=60.0, amplitude_um=20.0).wait(PATIENT)
        assert len(moved.ticks) == array.motors
        assert [motor for motor, tick in enumerate(moved.ticks) if tick] == [array.motors - 1]
    with pytest.raises(ValueError, match="motors 0 to"):
        on.live(drives=[{"motor": -1, "frequency_hz": 60.0, "amplitude_um": 20.0}])


def test_a_pattern_that_is_found_is_for_the_array(tmp_path: Path) -> None:
    with meissner.demo(config='[array]\ndescription = "tula35-2x3"\n') as m:
        found = m.design("edge-45", budget=20)
        assert 'array = "tula35-2x3"' in found.toml
        assert m.play(found.name, 0.1, scale=0.2).wait().array == m.array.name


def check_designs(m: meissner.Client, description: Path) -> None:
    """The client searches for the daemon's array, or for the one that is given."""
    designs = [m.design("edge-45", budget=20, name="found")]
    designs.append(m.design("edge-45", budget=20, name="given", array=description))
    for found in designs:
        assert f'array = "{m.array.name}"' in found.toml
        assert m.play(found.name, 0.1, scale=0.2).wait().array == m.array.name


@pytest.mark.filterwarnings("ignore:.*is saturated")
def test_an_array_that_the_program_does_not_ship(tmp_path: Path) -> None:
    description = tmp_path / "own.toml"
    description.write_text(OWN)
    with meissner.demo(config=f'[array]\ndescription = "{description}"\n') as m:
        assert (m.array.name, m.array.motors, m.array.tick_hz, m.array.grid) == ("own-3", 3, 60_000, None)
        check_a_session(m, tmp_path / "dataset", description)
        check_designs(m, description)


def test_another_daemon_at_the_same_place_is_asked_again(daemon: meissner.Daemon) -> None:
    with meissner.connect(daemon.socket) as m:
        array = m.array
        assert m.array is array
        m.core.daemon = (1, "another")
        m.status()
        assert m.array is not array
