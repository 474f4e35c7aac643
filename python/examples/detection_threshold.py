"""Find the weakest edge that a simulated participant detects, by a staircase and by QUEST+ if it is installed."""

import importlib.util

import meissner
from meissner.experiment import QuestPlus, SimulatedObserver, Staircase

LEVELS = [round(0.02 * 1.2**step, 4) for step in range(22)]  # factors of the amplitude, up to 0.92


def present(m: meissner.Client, observer: SimulatedObserver, level: float) -> bool:
    """One trial: play the edge, and ask."""
    m.play("edge-45", seconds=0.03, scale=level).wait()
    return observer.is_correct(level)


def main() -> None:
    """Both procedures, and what they should find."""
    with meissner.demo() as m:
        observer = SimulatedObserver(threshold=0.2, seed=3)
        stairs = Staircase(0.9, ratio=1.2, down=2, minimum=LEVELS[0], maximum=1.0, reversals=16)
        while not stairs.done:
            stairs.answer(present(m, observer, stairs.level))
        print(
            f"staircase {stairs.threshold:.3f} after {len(stairs.answers)} trials, true {observer.level_of(0.5**0.5):.3f}"
        )
        if importlib.util.find_spec("questplus"):
            quest = QuestPlus(LEVELS, max_trials=40)
            while not quest.done:
                quest.answer(present(m, observer, quest.level))
            print(f"quest+ {quest.threshold:.3f} after {len(quest.answers)} trials, true {observer.threshold:.3f}")


main()
