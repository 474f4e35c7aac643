"""The text of a file that another program may have written."""

from __future__ import annotations

import codecs
import os
from pathlib import Path

_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


def text_of(path: str | os.PathLike[str], or_encoding: str | None = None) -> str:
    """The text of a file: as its byte order mark says, else UTF-8, else `or_encoding`. Line ends stay as they are.

    Raises `ValueError`, one line, if it is something else.
    """
    data, name = Path(path).read_bytes(), os.fspath(path)
    if data.startswith(b"\x1f\x8b"):
        raise ValueError(f"{name} is packed by gzip: unpack it")
    marked = [encoding for mark, encoding in _MARKS if data.startswith(mark)]
    for encoding in marked or ["utf-8", *([or_encoding] if or_encoding else [])]:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        # UTF-16 without its mark, and what is no text at all.
        if "\0" not in text:
            return text
    raise ValueError(f"{name} is no text in UTF-8, nor in UTF-16 with a byte order mark: save it as UTF-8")
