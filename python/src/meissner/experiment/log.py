"""A CSV file of trials that survives a crash.

Each row is written with one call and flushed to the disk before `add` returns. So a crash loses at most the trial that is
under way. What was answered is never lost: a new column gives the earlier rows an empty cell, and an answer that the session record
does not take has its row all the same, with an error that says so. A row without its line end is unfinished: `Log(..., resume=True)` cuts it off and goes on after the last trial.
One program at a time writes a log: it holds a lock, which the system releases when it ends.

A file that another program has saved is refused when it is opened: a spreadsheet rounds the times, which have 19 digits, and
may write other separators and decimal marks.
"""

from __future__ import annotations

import contextlib
import csv
import io
import itertools
import numbers
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

from .._answers import Answerable
from .._arguments import hints, listed
from .._bodies import verdict
from .._plays import KnownPlay, check_trial, trial_answer
from .._text_file import replacing
from ..clocks import Instant
from ..errors import MeissnerError, NotKnownYet
from .trials import Trial

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# What stands in the columns that the log fills by itself, if it wrote them.
_WHOLE = re.compile(r"(trial|play|(item\d+_)?(onset|offset)_(tick|monotonic_ns|wall_ns))")
_UNCERTAINTY = re.compile(r"(item\d+_)?onset_uncertainty_s")
_FORMS = [(_WHOLE, re.compile(r"(-?\d+)?")), (_UNCERTAINTY, re.compile(r"(\d+\.\d{9})?"))]

_FLAGS = os.O_RDWR | os.O_APPEND | getattr(os, "O_BINARY", 0)


class LogError(MeissnerError):
    """The log cannot be written as asked."""


class _Played(Protocol):
    @property
    def onset(self) -> Instant | None: ...
    @property
    def offset(self) -> Instant | None: ...


def play_columns(play: KnownPlay) -> dict[str, Any]:
    """What the log keeps of a play: pattern, what it reached, onset and offset on each clock, of a sequence for each item.

    Of a play that the program has not waited for, nothing but its number and pattern is known.
    """
    try:
        receipt = play.receipt
    except NotKnownYet:
        return {"play": play.id, "pattern": play.pattern}
    columns: dict[str, Any] = {
        "play": receipt.id,
        "pattern": receipt.pattern,
        "state": receipt.state,
        "late": receipt.late,
        "reached_um": receipt.reached_um,
    }
    columns |= _times(receipt, "")
    for number, item in enumerate(receipt.items, 1):
        columns |= {f"item{number}_pattern": item.pattern, f"item{number}_scale": item.scale}
        columns |= {f"item{number}_reached_um": item.reached_um}
        columns |= _times(item, f"item{number}_")
    return columns


def _times(played: _Played, prefix: str) -> dict[str, Any]:
    onset, offset = played.onset, played.offset
    return {
        f"{prefix}onset_tick": onset and onset.tick,
        f"{prefix}onset_monotonic_ns": onset and onset.monotonic_ns,
        f"{prefix}onset_wall_ns": onset and onset.wall_ns,
        f"{prefix}onset_uncertainty_s": onset and f"{onset.monotonic_uncertainty:.9f}",
        f"{prefix}offset_tick": offset and offset.tick,
        f"{prefix}offset_monotonic_ns": offset and offset.monotonic_ns,
    }


@hints
class Log:
    """A CSV file with a row per trial. A row with new columns adds them to the earlier rows, without values."""

    def __init__(self, path: str | os.PathLike[str], *, resume: bool = False, answers: bool = False) -> None:
        """`resume`: go on with a file that is there. Without it the log refuses to touch one.

        `answers`: `add` also records what was answered, in the session that runs, so that exports have it in the row of the play.
        That is for blocking plays; with asyncio, `await session.answer(...)`.
        """
        if not isinstance(path, (str, os.PathLike)):
            raise TypeError(f"`path` is {path!r}: must be the path of a file")
        self.path = Path(path)
        self._answers = answers
        self._columns: list[str] | None = None
        self.rows: list[dict[str, str]] = []
        """The rows, as text."""
        flags = _FLAGS | os.O_CREAT
        try:
            self._file: int | None = os.open(self.path, flags if resume else flags | os.O_EXCL, 0o644)
        except FileExistsError:
            raise LogError(
                f"{self.path} is there already: choose another name, or go on with it by `Log(..., resume=True)`"
            ) from None
        except OSError as error:
            raise LogError(f"{self.path} cannot be opened: {error.strerror}") from error
        try:
            self._lock(self._file)
            if resume:
                self._take_over(self._file)
        except BaseException:
            self.close()
            raise

    def _lock(self, file: int) -> None:
        # A file system without locks has none.
        with contextlib.suppress(OSError):
            try:
                if fcntl is not None:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise LogError(
                    f"{self.path} is written by another program, or by another `Log`: close that first"
                ) from None

    def _take_over(self, file: int) -> None:
        data = self.path.read_bytes()
        whole = data[: _end_of_whole_rows(data)]
        lines = self._lines(whole, data)
        if len(whole) < len(data):
            os.truncate(file if os.truncate in os.supports_fd else self.path, len(whole))
        if lines:
            self._columns = lines[0]
            self.rows = [dict(zip(self._columns, line, strict=True)) for line in lines[1:]]

    def _lines(self, whole: bytes, data: bytes) -> list[list[str]]:
        """The cells of the whole rows. A log writes the same bytes for them again."""
        if not whole and data and not (data.startswith(b"trial,") or b"trial\n".startswith(data)):
            raise self._refusal("it does not begin with the column `trial`")
        try:
            lines = list(csv.reader(io.StringIO(whole.decode("utf-8"), newline="")))
        except (ValueError, csv.Error) as error:
            raise self._refusal(f"it cannot be read: {error}") from error
        if whole.startswith(b"\xef\xbb\xbf"):
            raise self._refusal("it begins with a byte order mark")
        if _text_of(lines) != whole:
            raise self._refusal("its separators, quotation marks or line ends have changed")
        if lines and lines[0][0] != "trial":
            raise self._refusal("it does not begin with the column `trial`")
        for number, line in enumerate(lines[1:], 1):
            if len(line) != len(lines[0]):
                raise self._refusal(f"row {number} has {len(line)} cells, not {len(lines[0])}")
            for name, cell in zip(lines[0], line, strict=True):
                if any(column.fullmatch(name) and not form.fullmatch(cell) for column, form in _FORMS):
                    raise self._refusal(f"row {number} has `{name}` {cell!r}")
        return lines

    def _refusal(self, why: str) -> LogError:
        return LogError(
            f"{self.path} is not as a log writes it ({why}): a spreadsheet or an editor has saved it, or it is another file; "
            "restore the original, or give a new log another name"
        )

    def remaining(self, trials: Iterable[Trial]) -> list[Trial]:
        """The trials that have no row yet.

        Trials that the log cannot take, or that are others than those of its rows, are refused.
        """
        trials = listed("trials", trials, "that of `two_afc(...)`")
        for place, trial in enumerate(trials):
            check_trial(f"trials[{place}]", trial)
        finished = {row["trial"]: row for row in self.rows}
        columns = self._columns or (["trial", *trials[0].factors] if trials else [])
        for trial in trials:
            unknown = [name for name in trial.factors if name not in columns]
            if unknown:
                raise LogError(
                    f"{self.path} has no column `{unknown[0]}` for trial {trial.number}: give all trials the same factors"
                )
            row = finished.get(str(trial.number), {})
            for name, value in trial.factors.items():
                if row and row[name] != _text(value):
                    raise LogError(
                        f"{self.path} has `{name}` {row[name]!r} in trial {trial.number}, the list has {_text(value)!r}: make the "
                        "list as before, with its seed; if another program has saved the log, restore the original"
                    )
        return [trial for trial in trials if str(trial.number) not in finished]

    def add(self, trial: Trial | int, play: KnownPlay | None = None, **columns: Any) -> None:
        """Writes a trial: its number and factors, the play's times, and columns of your own. It is on the disk then.

        Of a log with `answers` the columns `response`, `correct`, `rt_ms` and `level` are those of `play.answer`, and factors and other
        columns are its factors. Of a participant who has not answered, `response` is None. If the answer is refused, the row is
        written, and `LogError` says why. A column whose name is taken gets a number, as `level_2`.
        """
        if not isinstance(trial, (int, numbers.Integral)):
            check_trial("trial", trial)
        if play is not None and not isinstance(play, KnownPlay):
            raise TypeError(f"`play` is {play!r}: must be what `m.play(...)` returns; give your own columns by name")
        number, factors = (
            (int(trial), {}) if isinstance(trial, (int, numbers.Integral)) else (trial.number, trial.factors)
        )
        if self._file is None:
            raise LogError(f"{self.path} is closed: add trials inside its `with` block")
        row: dict[str, Any] = {"trial": number, **factors}
        for name, value in [*(play_columns(play) if play else {}).items(), *columns.items()]:
            row[_free(name, row)] = value
        problem = None
        if self._answers and play is not None:
            try:
                self._answer(trial, play, dict(columns))
            except Exception as error:
                problem = error
        names = list(dict.fromkeys([*(self._columns or ()), *row]))
        cells = [_text(row.get(name)) for name in names]
        if self._columns in (None, names):
            self._write(self._file, [cells] if self._columns else [names, cells])
        else:
            rows = [{name: old.get(name, "") for name in names} for old in self.rows]
            self._rewrite(self._file, [names, *(list(old.values()) for old in rows), cells])
            self.rows[:] = rows
        self._columns = names
        self.rows.append(dict(zip(names, cells, strict=True)))
        if problem is not None:
            raise LogError(
                f"{self.path} has the row of trial {number}, but the session record has not its answer: {problem}"
            ) from problem

    def _answer(self, trial: Trial | int, play: KnownPlay, columns: dict[str, Any]) -> None:
        if not isinstance(play, Answerable):
            raise LogError(
                f"{self.path} cannot await the answer of an asynchronous play: make the log without `answers`, and "
                "`await session.answer(...)`"
            )
        if "response" not in columns and "correct" not in columns:
            raise LogError(
                f"{self.path} records answers: give `response` or `correct` (None: the participant has not answered)"
            )
        response, correct, rt_ms = (columns.pop(name, None) for name in ("response", "correct", "rt_ms"))
        _, level, own = trial_answer(trial, columns.pop("level", None), columns)
        correct = verdict(correct)
        if response is not None or correct is not None:
            said = str(correct).lower() if response is None else response
            play.answer(said, correct=correct, rt_ms=rt_ms, level=level, factors=own)

    def _write(self, file: int, lines: list[list[str]]) -> None:
        data, end = _text_of(lines), os.fstat(file).st_size
        try:
            while data:
                data = data[os.write(file, data) :]
            os.fsync(file)
        except OSError as error:
            # Half a row would spoil the next one.
            with contextlib.suppress(OSError):
                os.ftruncate(file, end)
            raise self._unwritten(error, lines[-1]) from error

    def _rewrite(self, file: int, lines: list[list[str]]) -> None:
        """Writes all rows anew, as there are new columns. A crash leaves the old file or the new one."""
        place = Path(os.path.realpath(self.path))
        try:
            with replacing(place) as beside:
                beside.write_bytes(_text_of(lines))
            os.close(file)
            self._file = None
            self._file = os.open(place, _FLAGS)
        except OSError as error:
            raise self._unwritten(error, lines[-1]) from error
        self._lock(self._file)

    def _unwritten(self, error: OSError, row: list[str]) -> LogError:
        return LogError(
            f"{self.path} cannot be written ({error.strerror}): make room, and write this row down: {_text_of([row]).decode().strip()}"
        )

    def close(self) -> None:
        """Closes the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _text_of(lines: list[list[str]]) -> bytes:
    buffer = io.StringIO(newline="")
    csv.writer(buffer, lineterminator="\n").writerows(lines)
    return buffer.getvalue().encode("utf-8", "backslashreplace")


def _free(name: str, row: Mapping[str, Any]) -> str:
    """A name that no column of the row has: this one, if it is free."""
    numbered = (f"{name}_{number}" for number in itertools.count(2))
    return next(each for each in itertools.chain([name], numbered) if each not in row)


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def _end_of_whole_rows(data: bytes) -> int:
    """Where the last line end outside of quotes stands: a text may contain line ends, too."""
    end, is_quoted = 0, False
    for place, byte in enumerate(data):
        if byte == ord('"'):
            is_quoted = not is_quoted
        elif byte == ord("\n") and not is_quoted:
            end = place + 1
    return end
