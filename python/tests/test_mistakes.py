"""The usual mistakes at public calls: each error is one line that names what is wrong and what to do."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner import experiment
from meissner.errors import MeissnerError
from meissner.experiment import Interleaved, QuestPlus, SimulatedObserver, Staircase, Trial

Call = Callable[[Any], Any]

OF_A_CLIENT: list[tuple[str, Call, str]] = [
    # An argument of another name.
    ("play", lambda m: m.play("pin-60", duration=0.1), "has no argument `duration`: did you mean `seconds`?"),
    ("play", lambda m: m.play("pin-60", secnds=0.1), "has no argument `secnds`: did you mean `seconds`?"),
    ("play", lambda m: m.play("pin-60", 0.1, gap=0.5), r"`gap`: pauses are those of `sequence\(..., isi=0.5\)`"),
    ("play", lambda m: m.play("pin-60", 0.1, frequency=60), "`frequency`: frequencies are those of drives"),
    ("sequence", lambda m: m.sequence(["pin-60"], 0.1), "takes `items` alone without a name: .* as `isi=`"),
    ("live", lambda m: m.live("edge", duration=1), r"`live\(\)` has no argument `duration`: did you mean `timeout`?"),
    ("arm", lambda m: m.arm(True), r"`arm\(\)` takes nothing without a name: .* as `assume_rest=`"),
    ("reset", lambda m: m.reset(hard=True), r"`reset\(\)` has no argument `hard`: it has `force`"),
    # A value of another kind.
    ("play", lambda m: m.play("pin-60", math.nan), "`seconds` is nan: must be a finite number"),
    ("play", lambda m: m.play(5), "`pattern` is 5: must be a pattern's name"),
    ("play", lambda m: m.play(), "give `pattern`, or `samples` with `rate`, or `drives`"),
    (
        "play",
        lambda m: m.play({"drive": [{"motor": {1, 2}}]}),
        r"`pattern.drive\[0\].motor` is {1, 2}: must be a number",
    ),
    (
        "play",
        lambda m: m.play("pin-60", 0.1, trial=Trial(3, {})),
        "`trial` is Trial.*: must be its number, `trial.number`",
    ),
    ("play", lambda m: m.play("pin-60", 0.1, labels=["a"]), r"`labels` is \['a'\]: must be a dict, such as"),
    ("play", lambda m: m.play("pin-60", 0.1, trigger="1"), "`trigger` is '1': must be a dict, such as"),
    ("play", lambda m: m.play("pin-60", 0.1, at="now"), "`at` is 'now': must be a number of seconds, such as `m.now"),
    ("play", lambda m: m.play("pin-60", 0.1, hold="x"), "`hold` is 'x': must be a number of seconds"),
    ("play", lambda m: m.play(samples={9: [0, 1]}), "`samples` need `rate`"),
    ("play", lambda m: m.play(samples=[0, 1, 2], rate=10), "`samples` are one row of values: must be {9:"),
    ("play", lambda m: m.play(samples=5, rate=10), "`samples` is 5: must be a list, such as"),
    ("play", lambda m: m.play(samples={9: ["a", "b"]}, rate=10), r"`samples\[9\]` has values that are no numbers"),
    ("play", lambda m: m.play(samples={"a": [0, 1]}, rate=10), "`motor` is 'a': must be a whole number"),
    ("play", lambda m: m.play(drives=[9]), r"`drives\[0\]` is 9: must be a dict, such as"),
    ("sequence", lambda m: m.sequence("pin-60", seconds=0.1), "`items` is 'pin-60': must be a list, such as"),
    ("sequence", lambda m: m.sequence([("pin-60", 0.1)]), r"`items\[0\]` is .*: must be a pattern's name, a dict"),
    ("sequence", lambda m: m.sequence(["pin-60"], seconds=0.1, isi="1"), "`isi` is '1': must be a number of seconds"),
    ("arm", lambda m: m.arm(silence="5"), "`silence` is '5': must be a number of seconds"),
    ("edge", lambda m: m.edge(at=2.0), "`at` is 2.0: must be an instant, such as"),
    (
        "store_pattern",
        lambda m: m.store_pattern("x", "x.toml"),
        r"`toml` is 'x.toml': .* as `pathlib.Path\('x.toml'\)`",
    ),
    ("remove_pattern", lambda m: m.remove_pattern("pin-60"), "removed.*exists: the library stays as it is"),
    ("session_plays", lambda m: m.session_plays(None), "`session_id` is None: must be a text"),
]


def problem_of(call: Callable[[], Any]) -> str:
    with pytest.raises((MeissnerError, TypeError, ValueError, KeyError)) as error:
        call()
    said = str(error.value)
    assert "\n" not in said
    return said


@pytest.mark.parametrize(("name", "call", "message"), OF_A_CLIENT)
def test_a_mistake_at_a_client_is_told_in_a_line(m: meissner.Client, name: str, call: Call, message: str) -> None:
    assert re.search(message, problem_of(lambda: call(m)))


def test_mistakes_at_plays_and_answers(m: meissner.Client) -> None:
    with m.session("P07") as session:
        play: Any = m.play("pin-60", 0.05, trial=1)
        any_session: Any = session
        play.wait()
        told: list[tuple[Callable[[], Any], str]] = [
            (lambda: play.wait("5"), "`timeout` is '5': must be a number of seconds"),
            (lambda: play.wait(seconds=1), r"`wait\(\)` has no argument `seconds`: did you mean `timeout`?"),
            (lambda: play.answer("a", rt=5), "did you mean `rt_ms`?"),
            (lambda: play.answer("a", correct="yes"), "`correct` is 'yes': must be True, False or None"),
            (lambda: play.answer("a", rt_ms="5"), "`rt_ms` is '5': must be a number"),
            (lambda: any_session.answer(99, "a"), "has played nothing in trial 99: play with `trial=99` first"),
            (lambda: any_session.answer("1", "a"), "`trial` is '1': must be a `Trial`"),
            (lambda: any_session.remaining([1]), r"`trials\[0\]` is 1: must be a `Trial`"),
        ]
        for call, message in told:
            assert re.search(message, problem_of(call))
        play.answer("a")
        said = problem_of(lambda: play.answer("b"))
        assert (
            "has an answer already: a play has one at most [exists: the first one counts]; the answer is kept" in said
        )
        # An answer without a level is no answer to a level.
        assert session.answers() == []
    alone = m.play("pin-60", 0.05)
    alone.wait()
    assert "play it in the block of `with m.session(...)`" in problem_of(lambda: alone.answer("a"))


def test_a_session_exports_itself(m: meissner.Client, tmp_path: Path) -> None:
    with m.session("P07", experiment="own") as session:
        m.play("pin-60", 0.05).wait()
    export = session.export_bids(tmp_path / "own")
    same = m.export_bids(session.id, tmp_path / "same")
    assert export.events.read_bytes() == same.events.read_bytes()
    pytest.importorskip("pynwb")
    assert session.export_nwb(tmp_path / "own.nwb").file.exists()


def test_a_closed_client_says_so(m: meissner.Client) -> None:
    client = meissner.connect(m.core.endpoint.name)
    client.close()
    for call in (client.status, client.arm, lambda: client.play("pin-60", 0.1), lambda: next(client.events())):
        assert problem_of(call) == "the client is closed: work inside its `with` block, or connect again"


def test_mistakes_at_a_live_play_and_at_instants(m: meissner.Client) -> None:
    play: Any = m.play("pin-60", 0.05)
    play.wait()
    array: Any = m.array
    with m.live(drives=[], timeout=20.0) as started:
        live: Any = started
        told: list[tuple[Callable[[], Any], str]] = [
            (lambda: live.set(9, 60, 30), r"`set\(\)` takes `motor` alone without a name: .* as `frequency_hz=`"),
            (lambda: live.set(9, frequency_hz="60", amplitude_um=3), "`frequency_hz` is '60': must be a number"),
            (lambda: live.scale(math.nan), "`scale` is nan: must be a finite number"),
            (lambda: live.keep(1), r"`keep\(\)` takes no argument, and no more"),
            (lambda: play.onset.later("1"), "`seconds` is '1': must be a number"),
            (lambda: array.ticks("a"), "`seconds` is 'a': must be a number"),
        ]
        for call, message in told:
            assert re.search(message, problem_of(call))


stairs: Any = Staircase
OF_THE_PACKAGE: list[tuple[Callable[[], Any], str]] = [
    (lambda: meissner.connect(5), "`address` is 5: must be the path of a socket, or a URL"),  # type: ignore[arg-type]
    (lambda: meissner.connect("localhost:8765"), "must be a URL such as 'http://localhost:8765'"),
    (lambda: meissner.connect("http://a b"), "must be a URL such as"),
    (lambda: meissner.connect("http://localhost:1", token="\u00e4\n"), "`token` has characters that no token has"),
    (
        lambda: meissner.connect("/none/x.sock"),
        "no daemon answers at /none/x.sock .*: start one with `meissner daemon`",
    ),
    (lambda: meissner.demo(bord=True), "has no argument `bord`: did you mean `board`?"),  # type: ignore[call-arg]
    (lambda: meissner.demo(board="x"), "`board` is 'x': must be True, False or 'lower-stop'"),  # type: ignore[arg-type]
    (lambda: stairs(1, ratio=2, down=1.5), "`down` is 1.5: must be a whole number"),
    (lambda: stairs(1, ratio=2, reversals=4), "`reversals` is 4: must be above `coarse`, 4"),
    (lambda: stairs(1, ratio=2).resume([1]), r"`answers\[0\]` is 1: must be a level and whether"),
    (lambda: QuestPlus([1, 2], slopes=3), "`slopes` is 3: must be a list"),  # type: ignore[arg-type]
    (lambda: QuestPlus([1, 2]).answer(True, level=0), "`level` is 0: must be above 0"),
    (lambda: SimulatedObserver(0), "`threshold` is 0: must be above 0"),
    (lambda: SimulatedObserver(0.2).level_of(0.4), "`p_correct` is 0.4: must be above `guess`"),
    (lambda: Interleaved([1], seed=1), r"`procedures` is \[1\]: must be a dict"),  # type: ignore[arg-type]
    (lambda: experiment.trials(seed=1, hand="left"), "`hand` is 'left': must be a list"),
    (
        lambda: experiment.two_afc([1], repeats=2, seed=1, level=[1]),
        "`level` twice|the factor `level` is this list's own",
    ),
    (lambda: experiment.counterbalanced([], 0), "`conditions` is empty"),
    (lambda: experiment.counterbalanced(["a"], -1), "`participant` is -1: must be 0 or more"),
    (lambda: Trial(1, {"a": 1})["b"], "trial 1 has no factor `b`: it has `a`"),
    (lambda: Trial(1, {"a": 1}).intervals(1, 2), "trial 1 has no factor `interval`: it has `a`"),
    (lambda: meissner.simulate(None), "`scene` is None: must be a name, or the path of a file"),  # type: ignore[arg-type]
    (lambda: meissner.simulate({"duration_s": math.nan}), "`scene.duration_s` is nan: must be a finite number"),
]


@pytest.mark.parametrize(("call", "message"), OF_THE_PACKAGE)
def test_a_mistake_at_the_package_is_told_in_a_line(call: Callable[[], Any], message: str) -> None:
    assert re.search(message, problem_of(call))
