"""Exchange with other programs: haptic files become patterns, TouchSim's stimuli and responses go both ways, and text becomes Braille.

    from meissner import exchange

    imported = exchange.from_ahap("heartbeat.ahap")
    print(imported.lost)
    m.play(imported.pattern)

- `from_ahap`, `from_hjif`: haptic files of phones and of MPEG, as patterns with what is lost.
- `to_touchsim`, `from_touchsim`, `to_touchsim_response`, `from_touchsim_response`: the package TouchSim.
- `braille_text`: the Braille cells of a text, by liblouis.

Nothing here is needed to use it but the standard library. What each takes and loses stands in `docs/how-to/exchange.md`.
"""

from __future__ import annotations

from .._arguments import hinted
from . import ahap, braille, hjif, touchsim
from .imported import Imported
from .touchsim import Spikes, Traces

__all__ = [
    "Imported",
    "Spikes",
    "Traces",
    "braille_text",
    "from_ahap",
    "from_hjif",
    "from_touchsim",
    "from_touchsim_response",
    "to_touchsim",
    "to_touchsim_response",
]

from_ahap, from_hjif, braille_text = hinted(ahap.from_ahap), hinted(hjif.from_hjif), hinted(braille.braille_text)
to_touchsim, from_touchsim = hinted(touchsim.to_touchsim), hinted(touchsim.from_touchsim)
to_touchsim_response = hinted(touchsim.to_touchsim_response)
from_touchsim_response = hinted(touchsim.from_touchsim_response)
