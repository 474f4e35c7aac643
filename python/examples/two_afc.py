"""2AFC of 40 trials: which of two edges was stronger? MEISSNER_ANSWERS=simulated runs it without a person."""

import os

import meissner
from meissner.experiment import SimulatedObserver, ask, two_afc

observer = SimulatedObserver(0.3) if os.environ.get("MEISSNER_ANSWERS") == "simulated" else None
with meissner.connect() as m, m.session(participant="P07", exclusive=True, seed=7, resume=True) as session:
    m.arm(assume_rest=True)
    for trial in session.remaining(two_afc([0.2, 0.3, 0.4, 0.5], repeats=10, seed=7)):
        edges = [{"pattern": "edge-45", "scale": scale} for scale in trial.intervals(0.5 + trial["level"], 0.5)]
        m.sequence(edges, seconds=0.1, soa=0.2, trial=trial.number).wait()
        stronger = trial["interval"]
        if observer:
            response = stronger if observer.is_correct(trial["level"]) else 3 - stronger
        else:
            response = int(ask("Stronger?"))
        session.answer(trial, response, correct=response == stronger)
