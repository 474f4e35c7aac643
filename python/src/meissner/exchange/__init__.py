"""Exchange with other programs: TouchSim's stimuli and responses go both ways, and text becomes Braille.

    from meissner import exchange

    traces = exchange.from_touchsim(stimulus, m.array)
    m.play(samples=traces.samples, rate=traces.rate)

- `to_touchsim`, `from_touchsim`, `to_touchsim_response`, `from_touchsim_response`: the package TouchSim.
- `braille_text`: the Braille cells of a text, by liblouis.

Nothing here is needed to use it but the standard library. What each takes and loses stands in `docs/stimuli.md`.
"""

from __future__ import annotations

from .._arguments import hinted
from . import braille, touchsim
from .touchsim import Spikes, Traces

__all__ = [
    "Spikes",
    "Traces",
    "braille_text",
    "from_touchsim",
    "from_touchsim_response",
    "to_touchsim",
    "to_touchsim_response",
]

braille_text = hinted(braille.braille_text)
to_touchsim, from_touchsim = hinted(touchsim.to_touchsim), hinted(touchsim.from_touchsim)
to_touchsim_response = hinted(touchsim.to_touchsim_response)
from_touchsim_response = hinted(touchsim.from_touchsim_response)
