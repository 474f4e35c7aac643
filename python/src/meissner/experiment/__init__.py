"""Experiments: trial lists, adaptive procedures, and a log that survives a crash.

    from meissner import experiment

    with meissner.connect() as m, experiment.Log("P07.csv") as log:
        m.arm()
        for trial in log.remaining(experiment.two_afc(["edge-45"], repeats=40, seed=7)):
            ...
            log.add(trial, play, answer=answer)

- `trials`, `constant_stimuli`, `two_afc`, `counterbalanced`: lists, random by seed.
- `Staircase`, `QuestPlus`: the next level from the answers so far; `Interleaved`: several of them.
- `Log`: a CSV file, each trial on the disk before the next one begins.
- `SimulatedObserver`, `ask`: who answers. `Keys`, `ButtonBox`: answers with times.
"""

from .._presses import Press
from .answers import SimulatedObserver, ask
from .devices import ButtonBox, Keys
from .log import Log, LogError
from .quest import QuestPlus
from .staircase import Interleaved, Staircase
from .trials import Trial, constant_stimuli, counterbalanced, trials, two_afc

__all__ = [
    "ButtonBox",
    "Interleaved",
    "Keys",
    "Log",
    "LogError",
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
