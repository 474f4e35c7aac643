"""`python -m meissner`: the program `meissner`, found as `meissner.program` finds it."""

from __future__ import annotations

import os
import sys

from .errors import ProgramError
from .program import find_program


def main() -> None:
    """Becomes the program, with this process's arguments."""
    try:
        program = find_program()
    except ProgramError as error:
        sys.exit(f"meissner: {error}")
    os.execv(program, [program, *sys.argv[1:]])


if __name__ == "__main__":
    main()
