"""Which of two feels like the real thing: what `render` makes of it, or the best simple rule? Ready to run with people.

python feels_real.py run P07 DATASET     one participant, 48 trials, about 20 minutes; MEISSNER_ANSWERS=0.65 answers without a person
python feels_real.py report DATASET      what all participants say
python feels_real.py plan 16 0.65        of 200 simulated studies of 16 participants who take `auto` in 65 % of trials, how many show it
"""

import csv
import math
import os
import random
import statistics
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import meissner
from meissner.experiment import ask, trials

THINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "bar": (
        "press the bar (12 x 0.8 mm, across the finger) on it for a quarter of a second",
        {"shape": "bar", "length_mm": 12, "width_mm": 0.8, "touch": {"press": {"depth_um": 500}}},
    ),
    "letter": (
        "press the letter (T, 12 mm high, lines of 0.8 mm) on it for a quarter of a second",
        {
            "shape": "lines",
            "lines": [[[-4, 6], [4, 6]], [[0, 6], [0, -6]]],
            "width_mm": 0.8,
            "touch": {"press": {"depth_um": 500}},
        },
    ),
    "edge": (
        "pass the bar along the finger to its tip, 20 mm in half a second",
        {
            "shape": "bar",
            "length_mm": 12,
            "width_mm": 0.8,
            "center_mm": [0, -10],
            "touch": {"scan": {"depth_um": 500, "speed_mm_s": 40, "direction_deg": 90, "duration_s": 0.5}},
        },
    ),
}
"""What the experimenter does with the finger, and the object."""
RULES = ("rule", "stroke")
PAUSE_S = 0.8


class Answer(NamedTuple):
    """Which of the two was taken."""

    participant: str
    thing: str
    against: str
    """`rule`, or `other`: what `auto` makes of another thing, which nobody who feels the pins should take."""
    interval: int
    took_auto: bool


def study(participant: str) -> list[meissner.experiment.Trial]:
    """Each thing 12 times against the rule and 4 times against another thing, `auto` as often first as second."""
    seed = random.Random(participant).getrandbits(32)
    return trials(repeats=2, seed=seed, thing=list(THINGS), interval=(1, 2), against=("rule", "rule", "rule", "other"))


def rendered(m: meissner.Client) -> tuple[dict[str, str], dict[str, str]]:
    """The names of the patterns of each thing: what `auto` makes of it, and the best rule. Ends the program if they are the same."""
    auto, rule = {}, {}
    for thing, (_, described) in THINGS.items():
        made = m.render({"name": thing, **described}, name=f"{thing}-a")
        likeness = made.summary["choice"]["likeness"]
        best = max((name for name in RULES if name in likeness), key=likeness.__getitem__)
        if made.summary["choice"]["taken"] == best:
            sys.exit(f"{thing}: `auto` takes the rule `{best}` itself, there is nothing to compare: take another thing")
        auto[thing] = made.name
        rule[thing] = m.render({"name": thing, **described}, name=f"{thing}-b", method=best).name
    return auto, rule


def run(participant: str, dataset: str) -> None:
    """One participant. Nothing that participant or experimenter sees tells what is played."""
    chance = random.Random(f"{participant} answers")
    given = os.environ.get("MEISSNER_ANSWERS")
    with meissner.connect() as m:
        auto, rule = rendered(m)
        with m.session(participant, experiment="feels-real", exclusive=True, resume=True) as session:
            m.arm(assume_rest=True)  # you state that all pins are at rest
            for trial in session.remaining(study(participant)):
                thing = trial["thing"]
                others = [other for other in THINGS if other != thing]
                other = rule[thing] if trial["against"] == "rule" else auto[others[trial.number % len(others)]]
                if given is None:
                    input(f"{trial.number}: {THINGS[thing][0]}. Finger on the pins, then Enter.")
                m.sequence(trial.intervals(auto[thing], other), isi=PAUSE_S, trial=trial.number).wait()
                took_auto = chance.random() < (0.9 if trial["against"] == "other" else float(given or 0))
                chosen = trial["interval"] if took_auto else 3 - trial["interval"]
                response = int(ask("Which was more like the real thing?")) if given is None else chosen
                session.answer(trial, response, correct=response == trial["interval"])
        m.export_bids(session.id, dataset)


def read(dataset: str) -> list[Answer]:
    """All answers of a dataset. The play of a trial has a row for each of its two items."""
    answers = []
    for file in sorted(Path(dataset).glob("sub-*/ses-*/beh/*feelsreal*_events.tsv")):
        with file.open(newline="", encoding="utf-8") as opened:
            for row in csv.DictReader(opened, delimiter="\t", quoting=csv.QUOTE_NONE):
                if row["item"] == "0" and row["correct"] in ("true", "false"):
                    of: Mapping[str, str] = {name: row[f"factor_{name}"] for name in ("thing", "against", "interval")}
                    interval, took_auto = int(of["interval"]), row["correct"] == "true"
                    answers.append(Answer(file.name.split("_")[0], of["thing"], of["against"], interval, took_auto))
    return answers


def share(answers: list[Answer]) -> float:
    """Of the trials, how many took `auto`."""
    return sum(answer.took_auto for answer in answers) / max(len(answers), 1)


def report(answers: list[Answer]) -> tuple[str, float]:
    """What the answers say, and the p of a preference for either against one half.

    Left out, as stated before the study, is who takes the other thing in more than a quarter of its trials. Interval and p are of
    participants, by bootstrap and by random signs: nothing is assumed of how they differ.
    """
    by_name: dict[str, list[Answer]] = {}
    for answer in answers:
        by_name.setdefault(answer.participant, []).append(answer)
    felt = [name for name, of in by_name.items() if share([one for one in of if one.against == "other"]) >= 0.75]
    left_out = ", ".join(sorted(by_name.keys() - felt)) or "none"
    told = f"{len(felt)} participants; left out: {left_out}"
    if len(felt) < 2:
        return f"{told}; two are the least for a mean", 1.0
    kept = {name: [one for one in by_name[name] if one.against == "rule"] for name in felt}
    chance, shares = random.Random(0), [share(of) for of in kept.values()]
    mean = statistics.mean(shares)
    means = sorted(statistics.mean(chance.choices(shares, k=len(shares))) for _ in range(1000))
    signs = (sum(math.copysign(each - 0.5, chance.random() - 0.5) for each in shares) for _ in range(2000))
    p = (1 + sum(abs(of) >= abs(sum(shares) - 0.5 * len(shares)) - 1e-9 for of in signs)) / 2001
    every = [one for of in kept.values() for one in of]
    second = statistics.mean((one.interval == 2) == one.took_auto for one in every)
    things = ", ".join(f"{thing} {share([one for one in every if one.thing == thing]):.2f}" for thing in THINGS)
    return (
        f"{told}\n`auto` was taken in {mean:.2f} of trials (95 % interval {means[24]:.2f} to {means[974]:.2f}, p {p:.4f})\n"
        f"{things}; the second interval {second:.2f}"
    ), p


def simulated(count: int, prefers: float, seed: int) -> list[Answer]:
    """Answers of participants who differ by 0.5 in logits around this share, and take the second interval a little too often."""
    chance, answers = random.Random(seed), []
    for number in range(count):
        own = math.log(prefers / (1 - prefers)) + chance.gauss(0, 0.5)
        for trial in study(f"{seed} {number}"):
            logit = (own if trial["against"] == "rule" else 2.5) + (0.2 if trial["interval"] == 2 else -0.2)
            took_auto = chance.random() < 1 / (1 + math.exp(-logit))
            answers.append(Answer(f"sub-{number}", trial["thing"], trial["against"], trial["interval"], took_auto))
    return answers


def plan(count: int, prefers: float, studies: int = 200) -> str:
    """How many of so many simulated studies would find a preference for `auto`."""
    shown = sum(report(simulated(count, prefers, seed))[1] < 0.05 for seed in range(studies))
    return f"{shown} of {studies} studies of {count} participants who take `auto` in {prefers:.2f} of trials show it (p below 0.05)"


def main() -> None:
    """A participant, a report or a plan."""
    command, *words = sys.argv[1:] or ["help"]
    if command == "run" and len(words) == 2:
        run(*words)
    elif command == "report" and len(words) == 1:
        print(report(read(words[0]))[0])
    elif command == "plan" and len(words) == 2:
        print(plan(int(words[0]), float(words[1])))
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main()
