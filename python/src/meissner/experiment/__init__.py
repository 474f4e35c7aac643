"""Experiments: trial lists, adaptive procedures, and who answers.

    from meissner import experiment

    with meissner.connect() as m, m.session("P07", resume=True) as session:
        m.arm()
        for trial in session.remaining(experiment.two_afc([0.2, 0.4], repeats=40, seed=7)):
            ...
            session.answer(trial, response, correct=response == trial["interval"])

- `trials`, `constant_stimuli`, `two_afc`, `counterbalanced`: lists, random by seed.
- `Staircase`, `QuestPlus`: the next level from the answers so far; `Interleaved`: several of them.
- `SimulatedObserver`, `ask`: who answers. `Keys`, `ButtonBox`: answers with times.
"""

from .._presses import Press
from .answers import SimulatedObserver, ask
from .devices import ButtonBox, Keys
from .quest import QuestPlus
from .staircase import Interleaved, Staircase
from .trials import Trial, constant_stimuli, counterbalanced, trials, two_afc

__all__ = [
    "ButtonBox",
    "Interleaved",
    "Keys",
    "Press",
    "QuestPlus",
    "SimulatedObserver",
    "Staircase",
    "Trial",
    "ask",
    "constant_stimuli",
    "counterbalanced",
    "trials",
    "two_afc",
]
