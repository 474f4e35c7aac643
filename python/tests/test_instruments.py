"""Each row of the book's table of instruments reads a file as that instrument writes it, and makes the CSV that the program reads."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

import meissner

pandas = pytest.importorskip("pandas", reason="pandas is not installed")
PAGE = Path(__file__).parents[2] / "docs" / "stimuli.md"
UM = [20 + (n * n) % 30 / 10 for n in range(12)]
"""The same motion in every file, sampled each ms."""
LVM = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
Date\t2026/03/04
Time\t12:00:00.5
***End_of_Header***\t
\t
Channels\t1
Samples\t12
Y_Unit_Label\tMillimeters
Delta_X\t0.001
***End_of_Header***\t
X_Value\tUntitled\tComment
"""
TEKTRONIX = {0: "Record Length,1.2e+01,", 1: "Sample Interval,1.0e-03,", 2: "Vertical Units,V,"}
FILES: dict[str, tuple[str, Callable[[int, float], str]]] = {
    "Keyence": (
        "LK-Navigator 2\nセンサ,LK-G30\n測定周期,1ms\nNo.,OUT1(mm),OUT2(mm)\n",
        lambda n, um: f"{n},{um / 1e3:+.4f},-FFFFFFF",
    ),
    "Micro-Epsilon": (
        "sensorTOOL\noptoNCDT 1420\nIndex;Zeit (ms);Abstand (mm);Intensität (%)\n",
        lambda n, um: f"{n};{n},0;{um / 1e3:.4f};55,1".replace(".", ","),
    ),
    "Tektronix": ("", lambda n, um: f"{TEKTRONIX.get(n, ',,')},{n / 1e3:.9f},{um / 50:.5f},"),
    "LeCroy": (
        "LECROYWS434,41201,Waveform\nSegments,1,SegmentSize,12\nSegment,TrigTime,TimeSinceSegment1\n"
        "#1,04-Mar-2026 12:00:00,0\nTime,Ampl\n",
        lambda n, um: f"{n / 1e3:.9f},{um / 50:.5f}",
    ),
    "Rigol": (
        "X,CH1,Start,Increment,\nSequence,Volt,0.000000e+00,1.000000e-03,\n",
        lambda n, um: f"{n},{um / 50:.5e},,,",
    ),
    "Digilent": (
        "#Digilent WaveForms Oscilloscope Acquisition\n#Device Name: Discovery2\n#Sample rate: 1000Hz\n\nTime (s),Channel 1 (V)\n",
        lambda n, um: f"{n / 1e3},{um / 50}",
    ),
    "Polytec": (
        "Source File Name:\ta.pvd\nSignal:\tVib - Displacement\n\n\nTime\tDisplacement\n[ s ]\t[ m ]\n",
        lambda n, um: f"{n / 1e3:.6f}\t{um / 1e6:.6e}",
    ),
    "LabVIEW": (LVM, lambda n, um: f"{n / 1e3:.6f}\t{um / 1e3:.6f}"),
}


@pytest.mark.skipif(not PAGE.exists(), reason="the book is in the repository only")
def test_the_table_has_these_instruments() -> None:
    rows = re.findall(r"^\| ([\w-]+)[^|]* \| `pandas", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert rows == list(FILES)


@pytest.mark.skipif(not PAGE.exists(), reason="the book is in the repository only")
@pytest.mark.parametrize("instrument", FILES)
def test_the_file_of_an_instrument_is_read(instrument: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    (block,) = re.findall(r"```text\n(import pandas\n.*?)```", page, re.DOTALL)
    (call,) = re.findall(rf"^\| {instrument}[^|]* \| `(pandas.*)` \|$", page, re.MULTILINE)
    header, line = FILES[instrument]
    text = header + "".join(line(n, um) + "\n" for n, um in enumerate(UM))
    encoding = re.search(r'encoding="(.*?)"', call)
    Path("file").write_text(text, encoding=encoding[1] if encoding else "utf-8")
    names = {"file": "file"}
    exec(re.sub(r"(?m)^rows = .*", lambda _: f"rows = {call}", block), names)
    written = pandas.read_csv("recording.csv")
    assert list(written.columns) == ["time_s", "position_um"]
    assert list(written.time_s) == pytest.approx([n / 1e3 for n in range(12)])
    assert list(written.position_um) == pytest.approx(UM)
    wave = 'motor = 9\nfile = "recording.csv"\ncolumn = "position_um"\nrate_hz = 1000.0\n'
    Path("recorded.toml").write_text(f'format = 1\nname = "recorded"\n[[wave]]\n{wave}', encoding="utf-8")
    assert max(max(row) for row in meissner.displacement("recorded.toml").um) == pytest.approx(20, abs=2)
