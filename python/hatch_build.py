"""Puts the program into the wheel: `python/wheel` names it and the platform's tag in the environment.

Without `$MEISSNER_WHEEL_PROGRAM` the wheel is pure, as on systems where the program does not run.
"""

from __future__ import annotations

import os
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class ProgramHook(BuildHookInterface):
    """Adds the program as the wheel's command `meissner`."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Changes a wheel that shall have the program."""
        program = os.environ.get("MEISSNER_WHEEL_PROGRAM")
        if program is None or self.target_name != "wheel":
            return
        build_data["pure_python"] = False
        build_data["tag"] = os.environ["MEISSNER_WHEEL_TAG"]
        build_data["shared_scripts"][program] = "meissner"
        # The licences of what the program links.
        build_data["extra_metadata"][os.environ["MEISSNER_WHEEL_COPYRIGHT"]] = "copyright"
