"""Files that other programs may have written: reads their text, and replaces them whole."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path


def text_of(path: str | os.PathLike[str]) -> str:
    """The text of a file in UTF-8. Line ends stay as they are. Raises `ValueError`, one line, if it is something else."""
    try:
        return Path(path).read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{os.fspath(path)} is no text in UTF-8: save it as UTF-8") from error


def sync(path: Path) -> None:
    """Waits until a file is on the disk, or the names in a folder."""
    opened = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """The path of a file to write beside this one, which takes its place at the end: once it is whole and on the disk."""
    beside = path.with_name(f".meissner-{os.urandom(8).hex()}{path.suffix}")
    try:
        yield beside
        sync(beside)
        with contextlib.suppress(FileNotFoundError):
            shutil.copymode(path, beside)
        beside.replace(path)
        if os.name == "posix":
            sync(path.parent)
    finally:
        beside.unlink(missing_ok=True)
