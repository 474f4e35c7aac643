"""Braille cells of a text, by liblouis: contractions, numbers, capitals, and the languages of its tables.

It runs liblouis's program `lou_translate`, which every package of liblouis brings, so that any Python can use it.
"""

from __future__ import annotations

import shutil
import subprocess


def braille_text(text: str, table: str = "en-ueb-g2.ctb") -> str:
    """The six-dot characters of Unicode for a text, with spaces between words: what an object of the shape `braille` takes.

    `table` is one of liblouis's, such as `en-ueb-g1.ctb` (English, uncontracted) or `de-g2.ctb` (German, contracted). Raises `OSError`
    if liblouis is not installed, and `ValueError` for a table that it does not have, and for cells of eight dots.
    """
    program = shutil.which("lou_translate")
    if program is None:
        raise OSError(
            "Braille text needs liblouis's program `lou_translate`: apt install liblouis-bin, or brew install liblouis"
        )
    # The program translates line by line.
    line = " ".join(text.split())
    ended = subprocess.run(
        [program, "--forward", f"unicode.dis,{table}"],
        input=line + "\n",
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    cells = ended.stdout.strip("\n").replace("\u2800", " ").strip()
    if ended.returncode != 0 or (line and not cells):
        # It exits with 0 without a table, too.
        why = (ended.stderr.strip().splitlines() or [f"exit code {ended.returncode}"])[0]
        raise ValueError(f"liblouis has no translation by the table {table!r}: {why}")
    other = next((cell for cell in cells if cell != " " and not "\u2801" <= cell <= "\u283f"), None)
    if other is not None:
        raise ValueError(
            f"the table {table!r} gives {other!r}, which is no cell of six dots: choose a table of six dots"
        )
    return cells
