"""Traces from files as other programs write them: each is read right, or refused in a line that says what to do."""

from __future__ import annotations

import gzip
import struct
import wave
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner import motions

WANTED = [1.5, 2.75, 3.25]


def trace(tmp_path: Path, text: str | bytes, **keys: Any) -> list[float]:
    path = tmp_path / "trace.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return list(meissner.import_csv(path, **{"rate": 10.0, **keys}).um)


@pytest.mark.parametrize(
    "text",
    [
        "1.5\n2.75\n3.25\n",
        "um\n1.5\n2.75\n3.25",
        "um\n1,5\n2,75\n3,25\n",
        "height\r\n1,5\r\n2,75\r\n3,25\r\n",
        "height\r1,5\r2,75\r3,25\r",
        "height\r\r\n1,5\r\r\n2,75\r\r\n3,25\r\r\n",
        '"height, left"\n"1,5"\n"2,75"\n"3,25"\n',
        "displacement [um]\n+1.5\n2.75e0\n.325E+1\n",
        "displacement (\u00b5m)\n1.5\n\u200a2.75\n3.25\n\n \n,,\n",
        "displacement\nmicrons\n1.5\n2.75\n3.25\n",
        "# made by hand\n# um\n1.5\n# half way\n2.75\n3.25\n",
        "\n\nheight\n\n1.5\n2.75\n3.25\n",
        b"\xef\xbb\xbfum\n1.5\n2.75\n3.25\n",
        b"Weg [\xb5m]\n1,5\n2,75\n3,25\n",
        "um\n1.5\n2.75\n3.25\n".encode("utf-16"),
        b"\xfe\xff" + "um\r\n1,5\r\n2,75\r\n3,25\r\n".encode("utf-16-be"),
    ],
)
def test_one_column_is_read(tmp_path: Path, text: str | bytes) -> None:
    assert trace(tmp_path, text) == WANTED


@pytest.mark.parametrize(
    ("text", "column"),
    [
        ("t,um\n0,1.5\n1,2.75\n2,3.25\n", "um"),
        ("t;um\n0,0;1,5\n0,1;2,75\n0,2;3,25\n", "um"),
        ("0,0;1,5\n0,1;2,75\n0,2;3,25\n", 1),
        ("t\tum\n0\t1.5\n1\t2.75\n2\t3.25\n", "um"),
        ("t|um\n0|1.5\n1|2.75\n2|3.25\n", 1),
        ("t um\n0,0   1,5\n0,1 2,75\n  0,2 3,25\n", "um"),
        ("1,5 2,5\n2,75 3,5\n3,25 1,5\n", 0),
        ('t,um\n0,"1,5"\n1,"2,75"\n2,"3,25"\n', "um"),
        ("t , um \n0, 1.5\n1 ,2.75\n2, 3.25,,\n", "um"),
        ("t,height\ns,um\n0,1.5\n0.1,2.75\n0.2,3.25\n", "height"),
        ("t,height\n[s],[\u03bcm]\n\n0,1.5\n0.1,2.75\n0.2,3.25\n", 1),
        ("t [ms],height [um],force [N]\n0,1.5,7\n100,2.75,8\n200,3.25,\n", 1),
        ("# t,um\n0,1.5\n1,2.75\n2,3.25\n", "um"),
        ("time,9\n0,1.5\n1,2.75\n2,3.25\n", "9"),
        ("13:05:07,1.5\n13:05:08,2.75\n13:05:09,3.25\n", 1),
        (
            "clock;um;remark\n2026-03-04 13:05:07;1,5;first, good\n2026-03-04 13:05:08;2,75;\n2026-03-04 13:05:09;3,25;",
            1,
        ),
        ("n,um\n\u22121,1.5\n0,2.75\n1,3.25\n,\n,\n", "um"),
    ],
)
def test_a_column_is_chosen(tmp_path: Path, text: str, column: int | str) -> None:
    assert trace(tmp_path, text, column=column) == WANTED
    several = r"columns: choose one with `column`"
    with pytest.raises(ValueError, match=several):
        trace(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "column", "says"),
    [
        # Decimal commas that may be delimiters.
        (
            "1,5\n2,75\n3,25\n",
            None,
            "has 2 columns: choose one with `column`; if commas are decimal marks, write a name",
        ),
        ("1,5\n2\n3,25\n", None, "line 2 has 1 cells, line 1 has 2"),
        (
            "t,um\n0,1,1,5\n0,2,2,75\n",
            "um",
            "line 2 has 4 cells, line 1 has 2: correct it; if commas are decimal marks",
        ),
        ("t,um\n0,1.5\n1,2,75\n", "um", "line 3 has 3 cells, line 1 has 2"),
        ("um\n1,5\n2.5\n", None, "line 3: '2.5' has another decimal mark"),
        ("um\n1,234.5\n2,345.5\n", None, "line 2: '1,234.5' in column 0 must be a number"),
        ("um\n1 234\n", None, "line 2: '1 234' in column 0 must be a number"),
        # Rows and cells without a value.
        ("um\n1\n\n3\n", None, "line 3 has no value"),
        ("um\n1\n   \n3\n", None, "line 3 has no value"),
        ('um\n""\n1\n3\n', None, "line 2 has no value"),
        ("t,um\n,\n0,1\n", 1, "line 2 has no value"),
        ("t,um\n0,1\n,,\n1,2\n", 1, "line 3 has no value"),
        ("t,um\n0,1\n\n1,2\n", 1, "line 3 has no value"),
        ("t,um\n0,1\n1,\n2,2\n", 1, "line 3: '' in column 1 must be a number"),
        ("t,um\n0,1\n1\n2,2\n", 1, "line 3 has 1 cells, line 1 has 2"),
        ("t,um\n0,1,7\n1,2,7\n", 1, "line 2 has 3 cells, line 1 has 2"),
        ("x,um\n1,0,2\n2,1,3\n", "um", "line 2 has 3 cells, line 1 has 2"),
        ("nan\n1\n2\n", None, "line 1: 'nan' in column 0 must be a number"),
        ("1\nnan\n", None, "line 2: 'nan' in column 0"),
        ("um\n#N/A\n1\n2\n", None, "line 2: '#N/A' in column 0"),
        ("um\n1\n#DIV/0!\n2\n", None, "line 3: '#DIV/0!' in column 0"),
        ("t,um\n#NUM!,1\n0,2\n", 0, "line 2: '#NUM!' in column 0"),
        ("um\n1\ninf\n", None, "line 3: 'inf' in column 0"),
        ("um\n1\n1e999\n", None, "line 3: '1e999' in column 0"),
        ("um\n1\n1_0\n", None, "line 3: '1_0' in column 0"),
        ("um\n1\n\u0661\n", None, "line 3: '\u0661' in column 0"),
        ("um\n1\n2 um\n", None, "line 3: '2 um' in column 0"),
        ("Recorder\nheight\n1\n2\n", None, "line 2: 'height' in column 0"),
        ("\nt,um\n0,1\n1\n", 1, "line 4 has 1 cells, line 2 has 2"),
        ("um\n", None, "has no rows of numbers"),
        ("height\n", None, "line 1: 'height' in column 0 must be a number"),
        ("", None, "has no rows"),
        ("# um\n\n", None, "has no rows"),
        ('um\n1\n"2\n3\n', None, "line 3 has a quotation mark that is not closed"),
        # Names and numbers of columns.
        ("t,um\n0,1\n", "mm", "has no column 'mm' in its first row"),
        ("0,1\n1,2\n", "um", "has no column 'um'"),
        ("um,um\n0,1\n", "um", "has several columns 'um'"),
        ("t,um\n0,1\n", 2, "has no column 2: it has 2"),
        ("t,um\n0,1\n", -1, "has no column -1: it has 2"),
        # Encodings.
        (b"u\0m\0\n\0", None, "is no text in UTF-8"),
        (b"PK\x03\x04\0\0", None, "is no text in UTF-8"),
        (b"\xff\xfeu\0m", None, "is no text in UTF-8"),
        (gzip.compress(b"um\n1\n", mtime=0), None, "is packed by gzip: unpack it"),
    ],
)
def test_what_has_no_sample_or_two_meanings_is_refused(
    tmp_path: Path, text: str | bytes, column: int | str | None, says: str
) -> None:
    with pytest.raises(ValueError, match=r".") as raised:
        trace(tmp_path, text, column=column, scale_um=1.0)
    line = str(raised.value)
    assert says in line
    assert line.startswith(str(tmp_path / "trace.csv"))
    assert "\n" not in line


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("displacement [mm]", "mm"),
        ("displacement_mm", "mm"),
        ("Weg / nm", "nm"),
        ("height (cm)", "cm"),
        ("height_cm", "cm"),
        ("m", "m"),
        ("displacement\nmm", "mm"),
        ("displacement\n[kPa]", "kpa"),
        ("CH1 (V)", "v"),
        ("velocity [um/s]", "um/s"),
        ("velocity um/s", "um/s"),
        ("height [furlong]", "furlong"),
        ("height [um] or [mm]", "um mm"),
        ("# displacement [mm]", "mm"),
        ("# Unit: mm\n# made by hand\nheight", "mm"),
    ],
)
def test_another_unit_needs_a_factor(tmp_path: Path, header: str, unit: str) -> None:
    text = f"{header}\n0.1\n0.2\n"
    with pytest.raises(ValueError, match="not um: give `scale_um`") as raised:
        trace(tmp_path, text)
    assert repr(unit) in str(raised.value)
    assert trace(tmp_path, text, scale_um=1000.0, offset_um=5.0) == [105.0, 205.0]


@pytest.mark.parametrize(
    "header", ["pin 9", "s displacement", "height (filtered) [um]", "x_um_filtered", "# by A. Smith"]
)
def test_other_words_are_no_units(tmp_path: Path, header: str) -> None:
    assert trace(tmp_path, f"{header}\n1\n2\n") == [1.0, 2.0]


def frames(path: Path, width: int, samples: list[tuple[int, int]]) -> None:
    with wave.open(str(path), "wb") as file:
        file.setparams((2, width, 1000, 0, "NONE", ""))
        for pair in samples:
            for value in pair:
                file.writeframes(bytes([value + 128]) if width == 1 else value.to_bytes(width, "little", signed=True))


@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_wav_files_are_read(tmp_path: Path, width: int) -> None:
    path = tmp_path / "trace.wav"
    full = 1 << (8 * width - 1)
    frames(path, width, [(0, 0), (full // 2, 1), (-full, 2), (full - 1, 3)])
    read = meissner.import_wav(path, scale_um=100, offset_um=100, channel=0)
    assert read.rate == 1000
    assert list(read.um) == pytest.approx([100, 150, 0, 100 + 100 * (full - 1) / full])
    with pytest.raises(ValueError, match="2 channels: choose one"):
        meissner.import_wav(path, scale_um=1)
    with pytest.raises(ValueError, match="`channel` is 2"):
        meissner.import_wav(path, scale_um=1, channel=2)


def raw_wav(kind: int, bits: int, width: int, is_extensible: bool, samples: bytes) -> bytes:
    """A mono WAV file of 1 kHz with a plain or an extensible header, of a length that may be odd."""
    tag = 0xFFFE if is_extensible else kind
    header = struct.pack("<HHIIHH", tag, 1, 1000, 1000 * width, width, 8 * width if is_extensible else bits)
    if is_extensible:
        header += struct.pack("<HHIH", 22, bits, 4, kind) + b"\0\0\0\0\x10\0\x80\0\0\xaa\0\x38\x9b\x71"
    chunks = [(b"LIST", b"odd"), (b"fmt ", header), (b"fact", bytes(4)), (b"data", samples)]
    return b"RIFF\0\0\0\0WAVE" + b"".join(
        name + struct.pack("<I", len(data)) + data + bytes(len(data) % 2) for name, data in chunks
    )


# What recorders, Audacity, SciPy and `soundfile` write. The program's reader has the same test.
@pytest.mark.parametrize("is_extensible", [False, True])
@pytest.mark.parametrize(
    ("kind", "bits", "width", "samples"),
    [
        (1, 8, 1, bytes([192, 0, 128])),
        (1, 12, 2, bytes([0, 64, 0, 128, 0, 0])),
        (1, 16, 2, bytes([0, 64, 0, 128, 0, 0])),
        (1, 24, 3, bytes([0, 0, 64, 0, 0, 128, 0, 0, 0])),
        (1, 24, 4, bytes([0, 0, 0, 64, 0, 0, 0, 128, 0, 0, 0, 0])),
        (1, 32, 4, bytes([0, 0, 0, 64, 0, 0, 0, 128, 0, 0, 0, 0])),
        (3, 32, 4, struct.pack("<3f", 0.5, -1, 0)),
        (3, 64, 8, struct.pack("<3d", 0.5, -1, 0)),
    ],
    ids=["8", "12", "16", "24", "24 in 32", "32", "float", "double"],
)
def test_wav_of_each_form_is_read(
    tmp_path: Path, kind: int, bits: int, width: int, samples: bytes, is_extensible: bool
) -> None:
    path = tmp_path / "trace.wav"
    path.write_bytes(raw_wav(kind, bits, width, is_extensible, samples))
    read = meissner.import_wav(path, scale_um=100, offset_um=100)
    assert (list(read.um), read.rate) == ([150.0, 0.0, 100.0], 1000.0)
    # The program reads the same.
    pattern = tmp_path / "wav.toml"
    pattern.write_text(
        'format = 2\nname = "wav"\n[[wave]]\nmotor = 9\nfile = "trace.wav"\nscale_um = 100\noffset_um = 100\n'
    )
    assert meissner.displacement(pattern).motors == (9,)


@pytest.mark.parametrize(
    ("kind", "bits", "width"), [(6, 8, 1), (2, 4, 1), (1, 64, 8), (3, 16, 2), (1, 24, 2), (1, 0, 0), (85, 0, 1)]
)
def test_other_forms_of_wav_are_refused(tmp_path: Path, kind: int, bits: int, width: int) -> None:
    path = tmp_path / "trace.wav"
    path.write_bytes(raw_wav(kind, bits, width, False, bytes(24)))
    with pytest.raises(ValueError, match=r"not a WAV file of samples: .*save it as PCM"):
        meissner.import_wav(path, scale_um=1)


def test_a_sample_that_is_no_number_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "trace.wav"
    path.write_bytes(raw_wav(3, 32, 4, False, struct.pack("<3f", 0.5, float("nan"), 0)))
    with pytest.raises(ValueError, match="sample 1 is nan: must be a number"):
        meissner.import_wav(path, scale_um=1)


# The program's reader has the same test.
@pytest.mark.parametrize(
    ("text", "rate", "own"),
    [
        ("t,um\n0,1\n0.001,2\n0.002,3\n0.003,4\n", 1000, None),
        ("t,um\n0,1\n0.001,2\n0.002,3\n0.003,4\n", 1009, None),
        ("t,um\n0,1\n0.001,2\n0.002,3\n0.003,4\n", 500, "1000 Hz"),
        ("um,time\n1,0\n2,0.001\n3,0.002\n4,0.003\n", 8000, "1000 Hz"),
        ("um;Zeit [ms]\n1;5\n2;5,5\n3;6\n4;6,5\n", 2000, None),
        ("um;Zeit [ms]\n1;5\n2;5,5\n3;6\n4;6,5\n", 1000, "2000 Hz"),
        ("s,um\n0,1\n1,2\n2,3\n", 1, None),
        ("s,um\n0,1\n1,2\n2,3\n", 10, "1 Hz"),
        ("Time,height\nms,um\n0,1\n1,2\n2,3\n", 1000, None),
        ("Time,height\nms,um\n0,1\n1,2\n2,3\n", 44_100, "1000 Hz"),
        # Without a unit they may be in any, or numbers of rows.
        ("t,um\n0,1\n0.5,2\n1,3\n1.5,4\n", 2000, None),
        ("t,um\n0,1\n1,2\n2,3\n", 10, None),
        ("time [frames],um\n0,1\n2,2\n4,3\n", 10, None),
        # Rounded times, and those that are no measure.
        ("t,um\n0.000,1\n0.000,2\n0.000,3\n0.000,4\n0.001,5\n0.001,6\n", 8000, None),
        ("t,um\n0.000,1\n0.000,2\n0.001,3\n0.001,4\n0.002,5\n0.002,6\n0.003,7\n", 500, "2000 Hz"),
        ("t,um\n5,1\n5,2\n5,3\n", 10, None),
        ("t,um\n0,1\nnan,2\n0.2,3\n", 70, None),
        ("force,um\n0,1\n0.001,2\n0.002,3\n", 10, None),
    ],
)
def test_times_that_contradict_the_rate_are_refused(tmp_path: Path, text: str, rate: float, own: str | None) -> None:
    column = 0 if text.startswith("um") else 1
    if own is None:
        assert len(trace(tmp_path, text, rate=rate, column=column)) >= 3
        return
    with pytest.raises(ValueError, match=f"say {own}: correct") as raised:
        trace(tmp_path, text, rate=rate, column=column)
    assert "\n" not in str(raised.value)


def test_what_is_too_fast_says_how_to_resample_it() -> None:
    with pytest.raises(
        ValueError, match=r"must be 1 to 8000; scipy\.signal\.resample_poly\(um, 80, 441, .* to rate=8000"
    ):
        motions.pattern({9: [0.0, 1.0]}, 44_100)
    with pytest.raises(ValueError, match=r"must be 1 to 8000$"):
        motions.pattern({9: [0.0, 1.0]}, 0.5)


@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_a_wav_file_that_is_cut_is_refused(tmp_path: Path, width: int) -> None:
    path = tmp_path / "trace.wav"
    frames(path, width, [(1, 1)] * 100)
    whole = path.read_bytes()
    header = len(whole) - 200 * width
    assert len(meissner.import_wav(path, scale_um=1, channel=0).um) == 100
    for kept in (header, header + 1, header + 60 * width, len(whole) - 1):
        path.write_bytes(whole[:kept])
        found = (kept - header) // (2 * width)
        with pytest.raises(ValueError, match=f"is truncated: it ends after {found} of 100 samples"):
            meissner.import_wav(path, scale_um=1, channel=0)
    for kept in (0, 3, 12, header - 5):
        path.write_bytes(whole[:kept])
        with pytest.raises(ValueError, match=r"not a WAV file: .") as raised:
            meissner.import_wav(path, scale_um=1, channel=0)
        assert "\n" not in str(raised.value)
    path.write_bytes(struct.pack("<I", 7) * 9)
    with pytest.raises(ValueError, match="not a WAV file"):
        meissner.import_wav(path, scale_um=1)
