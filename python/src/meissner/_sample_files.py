"""Traces read from WAV and CSV files. `import_wav` and `import_csv` give what `play(samples=..., rate=...)` takes.

The client may run where the program `meissner` is not, so it has readers of its own. They take the same WAV files as the program's, and
less CSV: what has two meanings is refused.

Invariant: a row or frame is a sample, so a file with a gap is refused; samples are in µm, or the caller has given a factor.
"""

from __future__ import annotations

import csv
import itertools
import math
import os
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ._text_file import text_of
from .program import as_array


class Trace(NamedTuple):
    """Samples of one pin, and their rate."""

    um: Any
    """Displacement above rest, µm: a NumPy array, if NumPy is installed; else a list."""
    rate: float
    """Hz."""


def _trace(values: Sequence[float], rate: float, scale_um: float, offset_um: float) -> Trace:
    return Trace(as_array([value * scale_um + offset_um for value in values]), rate)


def import_wav(
    path: str | os.PathLike[str], *, scale_um: float, offset_um: float = 0.0, channel: int | None = None
) -> Trace:
    """Read a channel of a WAV file (PCM of 8 to 32 bits, or float): `scale_um` is the displacement at full scale, `offset_um` is added.

    A recording swings about 0 and a pin only goes up, so the offset is usually as large as the scale. At most 8000 Hz can be played;
    `meissner pattern pack` resamples faster files. Raises `ValueError` for other files and for those that are cut.
    """
    name = os.fspath(path)
    try:
        header, raw, length = _chunks(Path(path).read_bytes())
        kind, channels, rate, _, block, bits = struct.unpack_from("<HHIIHH", header)
        if kind == _EXTENSIBLE:
            # The first word of a GUID.
            (kind,) = struct.unpack_from("<H", header, 24)
    except (ValueError, struct.error) as error:
        raise ValueError(f"{name}: not a WAV file: {error}") from error
    width = block // max(channels, 1)
    form = _FORMS.get((kind, width))
    if form is None or width * channels != block or bits > 8 * width:
        raise ValueError(
            f"{name}: not a WAV file of samples: kind {kind} of {bits} bits: save it as PCM of 8 to 32 bits, or as float"
        )
    if len(raw) // block < length // block:
        raise ValueError(f"{name} is truncated: it ends after {len(raw) // block} of {length // block} samples")
    if channel is None and channels > 1:
        raise ValueError(f"{name} has {channels} channels: choose one with `channel`, from 0")
    chosen = channel or 0
    if not 0 <= chosen < channels:
        raise ValueError(f"{name} has {channels} channels: `channel` is {chosen}")
    starts = range(chosen * width, len(raw) // block * block, block)
    values = [form(raw[at : at + width]) for at in starts]
    bad = next((number for number, value in enumerate(values) if not math.isfinite(value)), None)
    if bad is not None:
        raise ValueError(f"{name}: sample {bad} is {values[bad]}: must be a number")
    return _trace(values, float(rate), scale_um, offset_um)


_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE


def _integer(sample: bytes) -> float:
    return int.from_bytes(sample, "little", signed=True) / (1 << (8 * len(sample) - 1))


def _float(sample: bytes) -> float:
    (value,) = struct.unpack("<f" if len(sample) == 4 else "<d", sample)
    return float(value)


_FORMS: dict[tuple[int, int], Callable[[bytes], float]] = {
    # 8-bit samples have no sign.
    (_PCM, 1): lambda sample: (sample[0] - 128) / 128,
    **{(_PCM, width): _integer for width in (2, 3, 4)},
    **{(_FLOAT, width): _float for width in (4, 8)},
}
"""The value of a sample, by the kind of the file and the bytes of a sample. Full scale is 1."""


def _chunks(data: bytes) -> tuple[bytes, bytes, int]:
    """The format, what there is of the samples, and how many bytes of them the header promises."""
    if data[:4] != b"RIFF" or data[8:12] != b"WAVE":
        raise ValueError("it does not begin as one")
    header, at = None, 12
    while at + 8 <= len(data):
        kind, length = data[at : at + 4], int.from_bytes(data[at + 4 : at + 8], "little")
        own = data[at + 8 : at + 8 + length]
        if kind == b"fmt ":
            header = own
        elif kind == b"data" and header is not None:
            return header, own, length
        # Chunks begin at even places.
        at += 8 + length + length % 2
    raise ValueError("it has no samples")


def import_csv(
    path: str | os.PathLike[str],
    *,
    rate: float,
    column: int | str | None = None,
    scale_um: float | None = None,
    offset_um: float = 0.0,
) -> Trace:
    """Read a column of a CSV file: its number from 0, or its name in the first row. `rate` is that of the samples, Hz.

    Semicolons, tabs, bars, commas or spaces divide the columns; numbers have decimal points or commas. A row of units may follow the
    names, and lines that begin with `#` are comments. `scale_um` is the displacement of a value of 1, µm; without it values are µm.

    Raises `ValueError`, one line, if a row has no number or another number of cells, if a column of times says another rate, or if the
    header names another unit than µm and `scale_um` is missing.
    """
    table = _Table(os.fspath(path), text_of(path, "cp1252"))
    chosen = table.column(column)
    if scale_um is None:
        table.check_unit(chosen)
    values = list(table.numbers(chosen))
    table.check_rate(chosen, float(rate))
    return _trace(values, float(rate), 1.0 if scale_um is None else scale_um, offset_um)


_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?", re.ASCII)
_DIGITS = re.compile("[+\u2212-]?[.,]?\\d")
# What spreadsheets and instruments write for no value; `#` alone begins a comment.
_CODE = r"#(n/?a|(num|div/0|value|ref|name|null|spill)[!?])|##+"
_MISSING = re.compile(rf"{_CODE}|\W*|[+-]?(nan|inf|infinity)|n/?a|null|none", re.IGNORECASE)
_CODE_FIRST = re.compile(rf'"?({_CODE})"?\s*([;,|\t]|$)', re.IGNORECASE)
_UM = re.compile(r"um|[\u00b5\u03bc]m|microns?|mikrometer|micromet(er|re)s?")
_OTHER = re.compile(
    r"[mcdknp]?m|(milli|nano)?met(er|re)s?|angstrom|inch(es)?|mils?|thou|min(utes?)?|s(ecs?|econds?)?|sekunden?|[mnu\u00b5\u03bc]s|[mu]sec|"
    r"[mku\u00b5\u03bc]?v|volts?|ma|k?hz|db|deg|rad|%|\u00b0c|counts|digits|lsb|px|[mk]n|newton|k?pa|bar"
)
_STATED = re.compile(r"\b(?:units?|einheit(?:en)?)\b\W*[:=;,\t]\s*(.+)", re.IGNORECASE)
_DELIMITERS = ";\t|,"


class _Row(NamedTuple):
    line: int
    cells: list[str]

    @property
    def used(self) -> int:
        """How many cells it has, without empty ones at the end."""
        return max((place for place, cell in enumerate(self.cells, 1) if cell), default=0)


def _cells(line: str, delimiter: str) -> list[str]:
    """The cells of a line; none of an empty line. Raises `csv.Error` if a quotation mark is not closed."""
    if not line.strip():
        return []
    if delimiter == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True))]


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell.replace("\u2212", "-")) is not None


def _is_unit(cell: str) -> bool:
    bare = cell.strip("[]()<>{} ").lower()
    return bool(_UM.fullmatch(bare) or _OTHER.fullmatch(bare))


def _other_unit(title: str) -> str | None:
    """The unit that a header's cell names, if it is not µm: `mm` of `Weg [mm]`, `height_mm` and `Weg / mm`."""
    lower = title.lower()
    bracketed = [inner.strip() for inner in re.findall(r"[\[({<]([^\])}>]*)[\])}>]", lower) if inner.strip(" -")]
    if bracketed:
        known = [inner for inner in bracketed if _is_unit(inner)] or bracketed
        return None if len(known) == 1 and _UM.fullmatch(known[0]) else " ".join(known)
    tokens = [token for token in re.split(r"[^\w%\u00b0]+|_", lower) if token]
    # One letter is a unit only at the end: it may be a name.
    known = [
        token for place, token in enumerate(tokens, 1) if _is_unit(token) and (len(token) > 1 or place == len(tokens))
    ]
    is_ratio = "/" in lower and len(tokens) > 1 and _is_unit(tokens[-2])
    return None if not known or (len(known) == 1 and _UM.fullmatch(known[0]) and not is_ratio) else "/".join(known)


_BRACKETED = re.compile(r"[\[({<]\s*([^\])}>]*?)\s*[\])}>]")
_SECONDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sekunde", "sekunden"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "\u00b5s", "\u03bcs", "usec", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds"), 1e-9),
}
"""Units of time, s."""


def _tokens(title: str) -> list[str]:
    return [token for token in re.split(r"[^\w%\u00b0]+|_", title.lower()) if token]


def _is_time(title: str) -> bool:
    tokens = _tokens(title)
    return any(token in ("t", "time", "zeit", "timestamp") for token in tokens) or (
        bool(tokens) and all(token in _SECONDS for token in tokens)
    )


class _Table:
    """The rows of a CSV file: perhaps one of names and one of units, then data."""

    def __init__(self, file: str, text: str) -> None:
        self._file = file
        lines = list(enumerate(re.split(r"\r+\n|\r|\n", text), 1))
        while lines and not lines[-1][1].strip().strip(_DELIMITERS + ' "'):
            lines.pop()
        is_comment = [row.lstrip().startswith("#") and not _CODE_FIRST.match(row.strip()) for _, row in lines]
        filled = [line for line, is_one in zip(lines, is_comment, strict=True) if not is_one]
        while filled and not filled[0][1].strip():
            filled.pop(0)
        if not filled:
            raise ValueError(f"{file} has no rows")
        rows = self._divided(filled)
        self._comments = [
            text.strip("# \t")
            for (line, text), is_one in zip(lines, is_comment, strict=True)
            if is_one and line < rows[0].line
        ]
        self._names = self._units = list[str]()
        if self._has_names(rows):
            self._names, rows = rows[0].cells, _below(rows)
        elif self._comments and (cells := _cells_or_none(self._comments[-1], self._delimiter)):
            # As `numpy.savetxt` writes the names.
            self._names = cells if len(cells) == len(rows[0].cells) else []
        if rows and any(rows[0].cells) and all(map(_is_unit, filter(None, rows[0].cells))):
            self._units, rows = rows[0].cells, _below(rows)
        if not rows:
            raise ValueError(f"{file} has no rows of numbers")
        self._rows = rows

    def _divided(self, lines: Sequence[tuple[int, str]]) -> list[_Row]:
        """The rows, by the delimiter that gives each row as many cells."""
        found, uneven = list[tuple[float, str, list[_Row]]](), list[tuple[_Row, _Row]]()
        for delimiter in _DELIMITERS + " ":
            if delimiter not in lines[0][1] and delimiter not in lines[-1][1]:
                continue
            try:
                rows = [_Row(line, _cells(row, delimiter)) for line, row in lines]
            except csv.Error:
                continue
            filled = [row for row in rows if row.used]
            width = max((row.used for row in filled), default=0)
            cells = [cell for row in filled[1:] or filled for cell in row.cells if cell]
            share = sum(map(_is_number, cells)) / max(len(cells), 1)
            if width > 1 and all(len(row.cells) >= width for row in filled):
                if delimiter != " " or share == 1.0:
                    found.append((share, delimiter, [_Row(line, cells[:width]) for line, cells in rows]))
            elif delimiter != " " and filled and (first := filled[0]).used > 1:
                uneven += [(first, row) for row in filled if row.used > len(first.cells) or len(row.cells) < first.used]
        if found:
            _, self._delimiter, rows = max(found, key=lambda each: each[0])
            return rows
        if uneven:
            first, other = uneven[0]
            raise ValueError(
                f"{self._file}: line {other.line} has {other.used} cells, line {first.line} has {first.used}: correct it; if commas are "
                "decimal marks, put semicolons between the columns"
            )
        self._delimiter = "\x1f"
        rows = []
        for line, row in lines:
            try:
                rows.append(_Row(line, _cells(row, self._delimiter)))
            except csv.Error as error:
                raise ValueError(f"{self._file}: line {line} has a quotation mark that is not closed") from error
        return rows

    def _has_names(self, rows: Sequence[_Row]) -> bool:
        """Whether the first row has names: a word above what begins as a number does."""
        places = [
            place
            for place, cell in enumerate(rows[0].cells)
            if not _DIGITS.match(cell) and not _MISSING.fullmatch(cell)
        ]
        return any(_DIGITS.match(row.cells[place]) for row in rows[1:] if row.cells for place in places)

    def column(self, asked: int | str | None) -> int:
        """The number of the column that is asked for, or of the only one."""
        width = len(self._rows[0].cells)
        if asked is None and width > 1:
            raise ValueError(
                f"{self._file} has {width} columns: choose one with `column`; if commas are decimal marks, write a name above the "
                "numbers"
            )
        if isinstance(asked, str):
            if (names := self._names or self._units).count(asked) != 1:
                how = "several columns" if asked in names else "no column"
                raise ValueError(f"{self._file} has {how} {asked!r} in its first row")
            return names.index(asked)
        chosen = asked or 0
        if not 0 <= chosen < width:
            raise ValueError(f"{self._file} has no column {chosen}: it has {width}, counted from 0")
        return chosen

    def check_unit(self, column: int) -> None:
        """Raises `ValueError` if the header says that a column is not in µm."""
        titles = [cells[column] for cells in (self._names, self._units) if cells]
        titles += [f"[{stated[1]}]" for comment in self._comments if (stated := _STATED.search(comment))]
        for unit in filter(None, map(_other_unit, titles)):
            raise ValueError(
                f"{self._file}: the header has the unit {unit!r} for column {column}, not um: give `scale_um`, the um of a value of 1"
            )

    def check_rate(self, column: int, rate: float) -> None:
        """Raises `ValueError` if another column has times that contradict this rate. As the program's reader does."""
        titles = [*zip(self._names or self._units, self._units or self._names, strict=True)]
        found = next((at for at, names in enumerate(titles) if at != column and _is_time(names[0])), None)
        if found is None:
            return
        cells = [cells[found] for _, cells in self._rows]
        title = " ".join(titles[found])
        units = [token for token in _tokens(title) if _is_unit(token)] + _BRACKETED.findall(title.lower())
        if not all(map(_is_number, cells)) or any(unit not in _SECONDS for unit in units):
            return
        times = [float(cell.replace("\u2212", "-").replace(",", ".")) for cell in cells]
        steps = [later - time for time, later in itertools.pairwise(times)]
        span, wanted = times[-1] - times[0], len(steps) / rate
        is_even = bool(steps) and max(steps) - min(steps) <= 0.01 * max(steps)
        if not steps or span <= 0 or (not units and is_even and abs(max(steps) - 1) < 0.01):
            # Without a unit, those that count by 1 may be numbers of rows.
            return
        seconds = [_SECONDS[unit] for unit in units[:1]] or sorted(set(_SECONDS.values()), reverse=True)
        # Times that are not even are rounded.
        rounded = 0.0 if is_even else max(steps)
        if not any(abs(span * unit - wanted) <= 0.01 * wanted + rounded * unit for unit in seconds):
            own = len(steps) / (span * seconds[0])
            raise ValueError(
                f"{self._file}: `rate` is {rate:g}, but the times of column {titles[found][0]!r} say {own:.10g} Hz: correct the one or the other"
            )

    def numbers(self, column: int) -> Iterator[float]:
        """The numbers of a column."""
        mark = None
        for line, cells in self._rows:
            if not any(cells):
                raise ValueError(
                    f"{self._file}: line {line} has no value, and each row is a sample: delete it, or write the value"
                )
            cell = cells[column]
            value = float(cell.replace("\u2212", "-").replace(",", ".")) if _is_number(cell) else math.nan
            if not math.isfinite(value):
                raise ValueError(f"{self._file}: line {line}: {cell!r:.40} in column {column} must be a number")
            found = next((each for each in ".," if each in cell), None)
            if found and found != (mark := mark or found):
                raise ValueError(
                    f"{self._file}: line {line}: {cell!r:.40} has another decimal mark than the numbers above it"
                )
            yield value


def _below(rows: list[_Row]) -> list[_Row]:
    """The rows below the first one, without empty lines right below it."""
    return rows[next((place for place, row in enumerate(rows) if place and row.cells), len(rows)) :]


def _cells_or_none(line: str, delimiter: str) -> list[str] | None:
    try:
        return _cells(line, delimiter)
    except csv.Error:
        return None
