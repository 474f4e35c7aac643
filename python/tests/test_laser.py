"""The fit of a laser's recording: the coefficients of recorded cases, and recordings that give none."""

from __future__ import annotations

import gzip
import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

import meissner
from patience import run_kept

np = pytest.importorskip("numpy", reason="NumPy is not installed")
from meissner import laser  # noqa: E402

BOOK = Path(__file__).parents[2] / "docs" / "board.md"
DATA = Path(__file__).parent / "data" / "laser"
PLAN = json.loads((DATA / "plan.json").read_text(encoding="utf-8"))


def recording(case: str) -> tuple[Any, Any]:
    with gzip.open(DATA / f"{case}.csv.gz", "rt") as file:
        time, um = np.loadtxt(file, delimiter=",", skiprows=1).T
    return time, um


@pytest.mark.parametrize("case", ["plain", "reversed"])
def test_a_recording_gives_the_recorded_coefficients(case: str) -> None:
    """`reversed`: the sensor counts downwards and drifts, its clock is 700 ppm slow, and it begins after the first bursts."""
    found = laser.fit(*recording(case), plan=PLAN)
    for direction, wanted in json.loads((DATA / f"{case}.json").read_text(encoding="utf-8")).items():
        line = vars(getattr(found, direction))
        assert line.pop("points") == [tuple(point) for point in wanted.pop("points")]
        assert line == pytest.approx(wanted, rel=1e-9)
    assert found.reversed == (case == "reversed")
    assert found.clock_error_ppm == pytest.approx(500 if case == "plain" else -700, abs=20)
    residual = found.trace[:, 1] - found.trace[:, 2]
    assert residual.std() == pytest.approx(found.noise_um, rel=0.05)


def test_the_daemon_stores_the_gains_of_a_fit() -> None:
    fit = laser.fit(*recording("plain"), plan=PLAN)
    with meissner.demo() as m:
        (stored,) = m.store_calibration(fit.toml)["motors"]
        assert (stored["motor"], stored["up"]["slope_um_per_pulse"]) == (3, fit.up.slope_um_per_pulse)
        assert stored["down"]["points"][0]["travel_um"] == fit.down.points[0][1]
        with pytest.raises(meissner.errors.MeissnerError, match="gain"):
            m.store_calibration(fit.toml.replace("gain = 1.0", "gain = 1.4"))


def still(time: Any, um: Any) -> Any:
    return time, np.random.default_rng(1).normal(size=len(um))


BAD: dict[str, Any] = {
    "the pin moves by": still,
    "does not follow the plan's bursts": lambda time, um: (time, um + 5 * np.sin(40 * time)),
    r"covers \d+ of 80 bursts": lambda time, um: (time[:2000], um[:2000]),
    "clipped at": lambda time, um: (time, um.clip(None, np.quantile(um, 0.7))),
    "too slow": lambda time, um: (time[::4], um[::4]),
    "lasts 13378 s": lambda time, um: (time * 1000, um),
    "must increase": lambda time, um: (np.round(time, 2), um),
    "times the model's value": lambda time, um: (time, um * 3),
    "covers 0 of 80|differs by|follow": lambda time, um: (time * 1.004, um),
    "at least 100": lambda time, um: (time, np.where(time < 12.6, um, np.nan)),
}


@pytest.mark.parametrize("problem", BAD)
def test_a_recording_that_cannot_be_trusted_gives_no_gains(problem: str) -> None:
    time, um = BAD[problem](*recording("plain"))
    with pytest.raises(ValueError, match=problem):
        laser.fit(time, um, PLAN)


@pytest.mark.skipif(not BOOK.exists(), reason="the book is in the repository only")
def test_the_block_of_the_book_stores_a_fit(tmp_path: Path) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed")
    (block,) = re.findall(r"```py\n(.*?)```", BOOK.read_text(encoding="utf-8"), re.DOTALL)
    rows = np.column_stack(recording("plain"))
    np.savetxt(tmp_path / "motor-3.csv", rows, delimiter=",", header="time_s,position_um", comments="")
    (tmp_path / "motor-3.json").write_text(json.dumps(PLAN), encoding="utf-8")
    with meissner.Daemon() as daemon:
        ended = run_kept([sys.executable, "-c", block], tmp_path, {"MEISSNER_SOCKET": daemon.socket})
    assert "Fit(motor=3, up=Line(gain=1.0298" in ended.stdout, ended.stderr
