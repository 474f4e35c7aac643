"""Trial lists, procedures and answers."""

from __future__ import annotations

import collections
import itertools
import json
import math
import os
import random
import statistics
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meissner
from meissner import errors
from meissner._labels import exact
from meissner.experiment import (
    Interleaved,
    QuestPlus,
    SimulatedObserver,
    Staircase,
    Trial,
    ask,
    constant_stimuli,
    counterbalanced,
    trials,
    two_afc,
)


def test_every_block_holds_every_combination_once() -> None:
    made = trials(repeats=5, seed=1, hand=("left", "right"), level=[1, 2, 3])
    assert [trial.number for trial in made] == list(range(1, 31))
    orders = set()
    for block in range(5):
        part = [(trial["hand"], trial["level"]) for trial in made[6 * block : 6 * block + 6]]
        assert sorted(part) == sorted(itertools.product(("left", "right"), (1, 2, 3)))
        orders.add(tuple(part))
    assert len(orders) > 1
    assert made == trials(repeats=5, seed=1, hand=("left", "right"), level=[1, 2, 3])
    assert made != trials(repeats=5, seed=2, hand=("left", "right"), level=[1, 2, 3])


def test_a_seed_means_the_same_list_for_ever() -> None:
    levels = [trial["level"] for trial in constant_stimuli([1, 2, 3, 4], repeats=2, seed=42)]
    assert levels == [1, 4, 2, 3, 2, 1, 3, 4]


def test_two_afc_has_the_target_in_each_interval_equally_often() -> None:
    made = two_afc([0.1, 0.2], repeats=10, seed=3)
    counts = collections.Counter((trial["level"], trial["interval"]) for trial in made)
    assert set(counts.values()) == {5}
    assert len(counts) == 4
    for trial in made:
        intervals = trial.intervals("target", "other")
        assert sorted(intervals) == ["other", "target"]
        assert intervals[trial["interval"] - 1] == "target"


def test_bad_lists_are_refused() -> None:
    with pytest.raises(ValueError, match="must be even"):
        two_afc([1], repeats=3, seed=0)
    with pytest.raises(ValueError, match="`repeats` is 0"):
        trials(repeats=0, seed=0, level=[1])
    with pytest.raises(ValueError, match="`hand` has no values"):
        trials(seed=0, hand=[])


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
def test_orders_are_balanced(count: int) -> None:
    conditions = [f"c{number}" for number in range(count)]
    people = count * (2 if count % 2 else 1)
    orders = [counterbalanced(conditions, participant) for participant in range(people)]
    places = collections.Counter((place, condition) for order in orders for place, condition in enumerate(order))
    followers = collections.Counter(pair for order in orders for pair in itertools.pairwise(order))
    assert set(places.values()) == {people // count}
    assert len(places) == count * count
    assert len(followers) == count * (count - 1)
    assert len(set(followers.values())) == 1


def run_staircase(seed: int, down: int) -> float:
    observer = SimulatedObserver(0.2, slope=3, seed=seed)
    stairs = Staircase(0.9, ratio=1.15, down=down, maximum=1.0, minimum=0.01, reversals=40, coarse=4, max_trials=1000)
    while not stairs.done:
        stairs.answer(observer.is_correct(stairs.level))
    with warnings.catch_warnings():
        # One in a hundred has not settled.
        warnings.simplefilter("ignore")
        return stairs.threshold


@pytest.mark.parametrize("down", [2, 3])
def test_a_staircase_finds_its_point(down: int) -> None:
    """Staircases are biased by the size of their steps: within 7 % of the point here, over 200 observers."""
    true = SimulatedObserver(0.2, slope=3).level_of(0.5 ** (1 / down))
    found = statistics.mean(run_staircase(seed, down) for seed in range(200))
    assert found == pytest.approx(true, rel=0.07)


def test_a_staircase_steps_and_turns() -> None:
    stairs = Staircase(10, step=1, down=2, minimum=0, maximum=11, reversals=6, coarse=2)
    levels = []
    for correct in (True, True, True, True, False, True, True, False, False, False, True, True, False):
        levels.append(stairs.level)
        stairs.answer(correct)
    assert levels == [10, 10, 8, 8, 6, 8, 8, 7, 8, 9, 10, 10, 9]
    assert stairs.reversals == [6, 8, 7, 10, 9]
    assert stairs.threshold == statistics.mean([10, 9])
    assert not stairs.done
    stairs.answer(True)
    stairs.answer(True)
    assert stairs.done
    # Turns at 7, 10, 9, 10: steps since the second turn from 8, 7, 8, 9, 10, 9, 10.
    assert stairs.threshold == statistics.mean([7, 10, 9, 10])
    assert stairs.standard_error == pytest.approx(2 * statistics.variance([8, 7, 8, 9, 10, 9, 10]) / 7**0.5)
    assert len(stairs.answers) == 15
    up = Staircase(11, step=1, down=1, maximum=11)
    up.answer(False)
    assert up.level == 11
    with pytest.raises(ValueError, match="has 0 reversals"):
        _ = up.threshold


def run_to_its_end(is_correct: Callable[[float], bool], **options: Any) -> Staircase:
    stairs = Staircase(**{"start": 0.8, "ratio": 1.26, "minimum": 0.01, "maximum": 1.0, **options})
    while not stairs.done:
        stairs.answer(is_correct(stairs.level))
        assert len(stairs.answers) <= 200
    return stairs


@pytest.mark.parametrize(("always", "bound"), [(True, "minimum"), (False, "maximum")])
def test_a_staircase_of_a_participant_who_is_always_right_or_wrong_ends_at_its_bound(always: bool, bound: str) -> None:
    stairs = run_to_its_end(lambda level: always)
    assert len(stairs.answers) < 50
    assert stairs.at_bound == bound
    with pytest.warns(UserWarning, match=f"reached its `{bound}` .*: the threshold may lie"):
        assert stairs.threshold == pytest.approx(0.01 if always else 1.0)
    assert math.isnan(stairs.standard_error)
    # Without bounds the number of trials ends it.
    free = run_to_its_end(lambda level: always, minimum=None, maximum=None)
    assert (len(free.answers), free.at_bound) == (200, None)
    assert free.problem == "the staircase has 0 reversals: it needs at least 6"
    assert len(run_to_its_end(lambda level: always, minimum=None, maximum=None, max_trials=7).answers) == 7


def guessing(seed: int) -> Callable[[float], bool]:
    chance = random.Random(seed)
    return lambda level: chance.random() < 0.5


def test_guessing_participants_are_told_and_others_are_not() -> None:
    """Of 500 each. At 0.2 of 1 a participant is far from both bounds."""
    bounded = [run_to_its_end(guessing(seed)) for seed in range(500)]
    assert sum(stairs.problem is not None for stairs in bounded) >= 490
    assert sum(stairs.at_bound == "maximum" for stairs in bounded) >= 485
    for down in (2, 3):
        real = [run_to_its_end(SimulatedObserver(0.2, slope=3, seed=seed).is_correct, down=down) for seed in range(500)]
        assert sum(stairs.problem is not None for stairs in real) <= 25
        assert not any(stairs.at_bound for stairs in real)
    # Without a bound the reversals drift.
    free = [run_to_its_end(guessing(seed), minimum=None, maximum=None) for seed in range(500)]
    assert sum("drift up" in (stairs.problem or "") for stairs in free) > 300


@pytest.mark.parametrize(
    ("slope", "options"),
    [
        (3.0, {}),
        (1.5, {}),
        (3.0, {"down": 3}),
        (3.0, {"reversals": 20}),
        (3.0, {"ratio": None, "step": 0.04, "minimum": 0.0}),
    ],
)
def test_the_standard_error_is_how_far_thresholds_scatter(slope: float, options: dict[str, Any]) -> None:
    """Against the scatter of 500 thresholds. The reversals' own spread says half of it."""
    found, errors = [], []
    for seed in range(500):
        stairs = run_to_its_end(SimulatedObserver(0.2, slope=slope, seed=seed).is_correct, **options)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found.append(stairs.threshold)
        errors.append(stairs.standard_error)
    assert statistics.fmean(error**2 for error in errors) ** 0.5 == pytest.approx(statistics.stdev(found), rel=0.5)


def test_interleaved_staircases_are_those_that_are_run_alone() -> None:
    def procedures() -> dict[str, Staircase]:
        return {"low": Staircase(0.05, ratio=1.26), "high": Staircase(0.9, ratio=1.26, down=3)}

    observers = {name: SimulatedObserver(0.2, slope=3, seed=1) for name in procedures()}
    both, order, answers = Interleaved(procedures(), seed=7), [], []
    while not both.done:
        order.append(both.name)
        correct = observers[both.name].is_correct(both.level)
        answers.append((both.name, both.level, correct))
        both.answer(correct)
    for name, stairs in procedures().items():
        observer = SimulatedObserver(0.2, slope=3, seed=1)
        while not stairs.done:
            stairs.answer(observer.is_correct(stairs.level))
        assert [(level, correct) for own, level, correct in answers if own == name] == stairs.answers
    # At random: as often the other one as the same one, while both run.
    together = order[: min(len(order) - 1 - order[::-1].index(name) for name in observers)]
    changes = sum(one != other for one, other in itertools.pairwise(together))
    assert 0.3 < changes / len(together) < 0.7
    # After a crash the rest is the same.
    for cut in (0, 1, 20, len(answers)):
        again = Interleaved(procedures(), seed=7)
        again.resume({name: [(level, ok) for own, level, ok in answers[:cut] if own == name] for name in observers})
        for name, level, correct in answers[cut:]:
            assert (again.name, again.level) == (name, level)
            again.answer(correct)
        assert again.done
    with pytest.raises(ValueError, match="all procedures have ended"):
        _ = both.name
    with pytest.raises(ValueError, match="`left` is no procedure: there are low, high"):
        both.resume({"left": []})
    with pytest.raises(ValueError, match="is empty"):
        Interleaved({}, seed=1)


@pytest.mark.parametrize("correct", ["False", "left", None, 2])
def test_a_procedure_takes_no_text_for_an_answer(correct: Any) -> None:
    stairs = Staircase(1.0, ratio=1.26)
    with pytest.raises(TypeError, match=r"`correct` is .*: must be True"):
        stairs.answer(correct)
    assert stairs.answers == []
    stairs.answer(np.True_)  # type: ignore[arg-type]
    assert stairs.answers == [(1.0, True)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "give either"),
        ({"ratio": 1.26, "minimum": 0}, "`minimum` is 0.0: must be above 0 with a `ratio`; or give `step`"),
        ({"ratio": 1.26, "maximum": -1}, "`maximum` is -1.0: must be above 0"),
        ({"ratio": 1.26, "maximum": 0.5}, "`start` is 1.0: must lie within `maximum` 0.5"),
        ({"step": 0.1, "minimum": 2}, "`start` is 1.0: must lie within"),
        ({"step": 0.1, "minimum": 1, "maximum": 1}, "are both 1.0: must differ"),
        ({"step": math.nan}, "`step` is nan: must be a finite number"),
        ({"ratio": math.inf}, "`ratio` is inf: must be a finite number"),
        ({"ratio": 1.26, "max_trials": 0}, "`max_trials` is 0: must be 1 or more"),
        ({"step": 1, "ratio": 2}, "give either"),
        ({"ratio": 0.5}, "must be above 1"),
        ({"step": 0}, "must be above 0"),
        ({"step": 1, "down": 0}, "`down` is 0"),
    ],
)
def test_bad_staircases_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Staircase(1.0, **options)  # type: ignore[arg-type]


def test_quest_plus_finds_the_threshold() -> None:
    pytest.importorskip("questplus")
    levels = [0.03 * 1.3**step for step in range(14)]
    found = []
    for seed in range(2):
        observer = SimulatedObserver(0.2, slope=3, seed=seed)
        quest = QuestPlus(levels, thresholds=levels[::2], slopes=(3.0,))
        for _ in range(40):
            quest.answer(observer.is_correct(quest.level))
        assert len(quest.answers) == 40
        found.append(quest.threshold)
    assert statistics.geometric_mean(found) == pytest.approx(0.2, rel=0.15)


def test_quest_plus_ends_and_tells_where_a_bound_holds_its_estimate() -> None:
    pytest.importorskip("questplus")
    levels = np.array([0.03 * 1.5**step for step in range(8)])
    for answer, bound in ((True, "minimum"), (False, "maximum")):
        quest = QuestPlus(levels, slopes=(3.0,))
        assert (quest.done, quest.at_bound, quest.problem) == (False, None, None)
        while not quest.done:
            quest.answer(answer)
        assert len(quest.answers) < 200
        assert quest.at_bound == bound
        with pytest.warns(UserWarning, match="the threshold may lie"):
            assert quest.threshold == pytest.approx(levels[0] if answer else levels[-1], rel=0.1)
    quest, guess = QuestPlus(levels, slopes=(3.0,), max_trials=40), guessing(1)
    while not quest.done:
        quest.answer(guess(quest.level))
    assert quest.at_bound == "maximum"
    short = QuestPlus(levels, slopes=(3.0,), max_trials=5)
    for correct in (True, True, False, True, False):
        assert not short.done
        short.answer(correct)
    assert short.done
    with pytest.raises(TypeError, match="`correct` is 'left'"):
        short.answer("left")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("levels", "options", "message"),
    [
        ([0.0, 1.0], {}, "`levels` is .*: must be 2 or more, all above 0"),
        ([], {}, "`levels` is .*: must be 2 or more"),
        ([0.5], {}, "`levels` is .*: must be 2 or more"),
        ([0.1, math.nan], {}, "`levels` is nan: must be a finite number"),
        ([0.1, 1.0], {"thresholds": []}, "`thresholds` is .*: must be 2 or more"),
        ([0.1, 1.0], {"guess": 1.0}, "`guess` is 1.0: must be from 0 to below 1"),
        ([0.1, 1.0], {"max_trials": 0}, "`max_trials` is 0"),
    ],
)
def test_bad_settings_of_quest_plus_are_refused(levels: list[float], options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        QuestPlus(levels, **options)


def test_the_standard_error_of_quest_plus_is_the_width_of_the_posterior() -> None:
    """Against a posterior that the test computes."""
    pytest.importorskip("questplus")
    levels = np.array([0.03 * 1.3**step for step in range(14)])
    quest, observer = QuestPlus(levels, slopes=(3.0,), max_trials=15), SimulatedObserver(0.2, slope=3, seed=1)
    while not quest.done:
        quest.answer(observer.is_correct(quest.level))
    shares = np.ones(len(levels))
    for level, correct in quest.answers:
        p_correct = 0.5 + 0.48 * (1 - np.exp(-((level / levels) ** 3)))
        shares *= p_correct if correct else 1 - p_correct
    shares /= shares.sum()
    mean = (shares * np.log(levels)).sum()
    error = math.sqrt((shares * (np.log(levels) - mean) ** 2).sum())
    assert quest.threshold == pytest.approx(math.exp(mean))
    assert quest.standard_error == pytest.approx(error * math.exp(mean))


def test_without_quest_plus_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "questplus", None)
    with pytest.raises(ImportError, match="pip install questplus"):
        QuestPlus([0.1, 0.2])


def test_a_simulated_observer_answers_by_its_function() -> None:
    observer = SimulatedObserver(0.2, slope=2, guess=0.5, lapse=0.02, seed=1)
    assert observer.p_correct(0.0) == 0.5
    assert observer.p_correct(10.0) == pytest.approx(0.98)
    assert observer.p_correct(observer.level_of(0.75)) == pytest.approx(0.75)
    share = statistics.mean(observer.is_correct(0.2) for _ in range(10_000))
    assert share == pytest.approx(observer.p_correct(0.2), abs=0.02)


def test_a_question_is_asked_until_it_is_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    typed = iter(["", "3", " 2 "])
    monkeypatch.setattr("builtins.input", lambda question: next(typed))
    assert ask("Which?") == "2"


def answers_of(session: meissner.Session) -> list[Any]:
    return [row["answer"] and (row["answer"]["response"], row["answer"]["factors"]) for row in session.plays]


def kept_answers() -> list[dict[str, Any]]:
    file = Path(os.environ["XDG_STATE_HOME"], "meissner", "answers.jsonl")
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


ODD = ["a\tb", "a\nb", "a\r\nb", "", " ", "\0", "\x1b[2J", '"', "n/a", "x" * 201, "é" * 500, "\u2028", "\udc80"]


def test_odd_answers_are_kept_as_they_are(m: meissner.Client, tmp_path: Path) -> None:
    expected = [text.encode("utf-8", "backslashreplace").decode() for text in ODD]
    before = kept_answers()
    with m.session("P07") as session:
        for number, text in enumerate(ODD, 1):
            m.play("pin-60", 0.02, trial=number).wait()
            session.answer(number, text, rt_ms=-3.0, level=math.nan, factors={"note": text, text + " of": number})
        assert answers_of(session) == [
            (text, {"note": text, text + " of": str(number)}) for number, text in enumerate(expected, 1)
        ]
        assert [row["answer"]["rt_ms"] for row in session.plays] == [-3.0] * len(ODD)
        assert session.answers() == []
    assert kept_answers() == before
    export = m.export_bids(session.id, tmp_path / "bids")
    lines = export.events.read_text(encoding="utf-8").split("\n")
    place = lines[0].split("\t").index("response")
    assert [line.split("\t")[place] for line in lines[1:-1]] == list(map(exact, expected))


def test_what_the_daemon_does_not_take_is_kept(m: meissner.Client) -> None:
    with m.session("P07") as session:
        play = m.play("pin-60", 0.05, trial=1)
        play.wait()
        refused: list[tuple[dict[str, Any], str]] = [
            ({"response": "x" * 9000}, "at most 8192 are kept"),
            ({"response": "left", "correct": "False"}, "must be True, False or None"),
            ({"response": "left", "level": math.inf}, "answer is kept in"),
        ]
        for given, why in refused:
            with pytest.raises((errors.MeissnerError, TypeError, ValueError), match=why):
                play.answer(**given)
            assert kept_answers()[-1]["response"] == given["response"]
        # NumPy's kinds of numbers.
        play.answer("left", correct=np.bool_(False), level=np.float32(0.5))
        m.play("pin-60", 0.05, trial=2).wait()
        assert answers_of(session) == [("left", {}), None]
        assert session.answers() == [(0.5, False)]
        with pytest.raises(errors.MeissnerError, match=r"nothing in trial 9.*the answer is kept in .*answers\.jsonl"):
            session.answer(9, "right", correct=True)
        kept = {"session": session.id, "trial": 9, "response": "right", "correct": True, "factors": {}}
        assert {**kept_answers()[-1], "time": 0} == {**kept, "time": 0}
        with pytest.raises(errors.ApiError, match=r"has an answer already.*the answer is kept in"):
            play.answer("again", level=np.float32(0.5))
        kept = {"session": session.id, "play": play.id, "response": "again", "level": "0.5"}
        assert {**kept_answers()[-1], "time": 0} == {**kept, "time": 0}
    assert os.stat(Path(os.environ["XDG_STATE_HOME"], "meissner", "answers.jsonl")).st_mode & 0o777 == 0o600


def test_an_answer_that_no_file_keeps_is_in_the_error(
    m: meissner.Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with m.session("P07") as session:
        with pytest.raises(errors.MeissnerError, match=r'write it down: \{.*"trial": 9, "response": "right"'):
            session.answer(9, "right")


def test_answers_without_a_level_are_no_points_of_a_procedure(m: meissner.Client) -> None:
    with m.session("P07") as session:
        for trial, level in ((1, None), (2, 0.5), (3, None)):
            m.play("pin-60", 0.05, trial=trial).wait()
            session.answer(trial, "yes", correct=True, level=level)
        assert session.answers() == [(0.5, True)]
        assert session.remaining([Trial(number, {}) for number in (1, 2, 3, 4)]) == [Trial(4, {})]


def test_levels_of_numpy_are_levels(m: meissner.Client) -> None:
    with m.session("P07") as session:
        for trial in constant_stimuli(np.array([20, 50]), repeats=1, seed=1, side=np.array(["left"])):
            m.play("pin-60", 0.05, trial=trial.number).wait()
            session.answer(trial, "felt", correct=np.True_)
        answers = [row["answer"] for row in session.plays]
        assert sorted(answer["level"] for answer in answers) == [20.0, 50.0]
        assert all(answer["factors"] == {"side": "left"} for answer in answers)
