"""The component `Meissner` of PsychoPy Builder: plays a pattern in a routine.

Builder shows the parameters, and asks for the code at each part of the exported script. The lines are in `script`; PsychoPy itself writes
the tests for start and stop.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from psychopy.experiment.components import BaseComponent, Param

from . import script

REPEATS = ["constant", "set every repeat"]
SIMULATED = {"no": "False", "when piloting": "PILOTING", "always": "True"}


class MeissnerComponent(BaseComponent):
    """Play a pattern on a tactile display."""

    categories = ["Stimuli", "I/O"]
    targets = ["PsychoPy"]
    plugin = "psychopy-meissner"
    iconSVG = Path(__file__).parent / "component.svg"
    tooltip = "Tactile display: play a pattern on the finger"
    version = "2026.1.0"

    def __init__(self, exp: Any, parentName: str, **given: Any) -> None:
        own = {"name": "touch", "startType": "time (s)", "startVal": 0.5, "stopType": "duration (s)", "stopVal": ""}
        super().__init__(exp, parentName, **{**own, "syncScreenRefresh": True, "saveStartStop": True, **given})
        for what, module, alias in script.IMPORTS:
            exp.requireImport(importName=what, importFrom=module, importAs=alias)
        self.params["stopVal"].hint = "When does the play end? Blank: when the pattern, or its seconds, are over"
        self.params[
            "syncScreenRefresh"
        ].hint = "Plan the onset for the refresh of the screen at which a stimulus with this start appears"
        changing = {"updates": "set every repeat", "allowedUpdates": REPEATS}
        pattern = "Name of a pattern of the daemon; or a $variable: a dict of `samples` and `rate`, `drives`, or a whole pattern"
        self._add("Basic", "pattern", "edge-45", "Pattern", pattern, **changing)
        # `code`, not `num`: it takes `$duration` as well as `duration`, and a blank one means no argument.
        code = {"valType": "code"}
        self._add("Basic", "seconds", 0.3, "Seconds", "Duration, s. Blank: that of the pattern", **code, **changing)
        self._add("Basic", "scale", 1.0, "Scale", "Factor of the amplitudes, 0 to 1. Blank: 1", **code, **changing)
        ahead = "Order this long before the start, so that the onset can be kept. Blank: 0.2"
        self._add("Basic", "ahead", 0.2, "Order ahead (s)", ahead, **code)
        for key, label, hint in (
            ("deviceName", "Device name", "Components with one name share a display"),
            ("simulated", "Simulated array", "Play on a simulated array: no hardware is needed, and nothing moves"),
            ("address", "Address", "URL or Unix socket of the daemon. Blank: $MEISSNER_URL, or the daemon of this PC"),
            ("token", "Access token", "Blank: $MEISSNER_TOKEN. Better blank: experiment and script would contain it"),
            (
                "checked",
                "Pins checked by",
                "Who has looked at the pins and seen all at rest. Blank: the daemon must know",
            ),
            ("participant", "Participant", "Pseudonym: starts an exclusive session. Blank: no session"),
        ):
            value = {"deviceName": "display", "simulated": "when piloting"}.get(key, "")
            choice = {"inputType": "choice", "allowedVals": list(SIMULATED)} if key == "simulated" else {}
            self._add("Device", key, value, label, hint, **choice)
        for key in ("address", "token"):
            self.params[key].canBePath = False
        self.order += ["pattern", "seconds", "scale", "ahead", "deviceName", "simulated", "address", "token", "checked"]

    def _add(self, categ: str, key: str, value: Any, label: str, hint: str, **more: Any) -> None:
        kinds = {"valType": "str", "allowedTypes": [], **more}
        self.params[key] = Param(value, categ=categ, label=label, hint=hint, **kinds)

    def _fill(self, text: str) -> str:
        """The lines with this component's parameters."""
        sync = bool(self.params["syncScreenRefresh"].val)
        start, simulated = str(self.params["startVal"]), self.params["simulated"].val
        if simulated not in SIMULATED:
            raise ValueError(
                f"`Simulated array` of the component `{self.params['name']}` is `{simulated}`: choose {', '.join(SIMULATED)}"
            )
        if self.params["startType"].val == "frame N":
            start = f"tThisFlip + ({start} - frameN) * win.monitorFramePeriod"
        return text % {
            **self.params,
            "simulatedCode": SIMULATED[simulated],
            "startCode": start,
            "periodCode": "win.monitorFramePeriod" if sync else "None",
            "onsetCode": "tThisFlipGlobal" if sync else "None",
        }

    def writeInitCode(self, buff: Any) -> None:
        """Connect, and set what is constant."""
        buff.writeIndentedLines(self._fill(script.INIT))
        self.writeParamUpdates(buff, "constant", ["pattern", "seconds", "scale"])

    def writeRoutineStartCode(self, buff: Any) -> None:
        """Forget the play before, and set what changes."""
        buff.writeIndentedLines(self._fill(script.ROUTINE_START))
        super().writeRoutineStartCode(buff)

    def writeFrameCode(self, buff: Any) -> None:
        """Order ahead, start, stop."""
        if self.params["startType"].val != "condition" and self.params["startVal"].val not in ("", None):
            buff.writeIndentedLines(self._fill(script.PLAN))
        indented = self.writeStartTestCode(buff)
        if indented:
            buff.writeIndentedLines(self._fill(script.START))
            buff.setIndentLevel(-indented, relative=True)
        is_blank = self.params["stopVal"].val in ("", None, -1, "None")
        indented = self.writeStopTestCode(buff, extra=script.IS_OVER if is_blank else "")
        if indented:
            buff.writeIndentedLines(self._fill(script.STOP))
            buff.setIndentLevel(-indented, relative=True)

    def writeRoutineEndCode(self, buff: Any) -> None:
        """End the play, and save its times."""
        buff.writeIndentedLines(self._fill(script.ROUTINE_END))
        super().writeRoutineEndCode(buff)
