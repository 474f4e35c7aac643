"""Files that other programs may have written: reads their text, and replaces them whole."""

from __future__ import annotations

import codecs
import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


def text_of(path: str | os.PathLike[str]) -> str:
    """The text of a file: as its byte order mark says, else UTF-8. Line ends stay as they are.

    Raises `ValueError`, one line, if it is something else.
    """
    data, name = Path(path).read_bytes(), os.fspath(path)
    if data.startswith(b"\x1f\x8b"):
        raise ValueError(f"{name} is packed by gzip: unpack it")
    encoding = next((encoding for mark, encoding in _MARKS if data.startswith(mark)), "utf-8")
    with contextlib.suppress(UnicodeDecodeError):
        text = data.decode(encoding)
        # UTF-16 without its mark, and what is no text at all.
        if "\0" not in text:
            return text
    raise ValueError(f"{name} is no text in UTF-8, nor in UTF-16 with a byte order mark: save it as UTF-8")


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
