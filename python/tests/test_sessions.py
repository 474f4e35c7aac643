"""A play belongs to its client's session or is refused: never to somebody else's session, and never to none."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import meissner
from meissner import _http, errors
from meissner import _operations as ops
from network import Network
from patience import LEAD

PATIENT = 120.0
DRIVES = [{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 40.0}]
ORDERS: dict[str, Callable[[meissner.Client], object]] = {
    "play": lambda m: m.play("pin-60", 0.05),
    "sequence": lambda m: m.sequence(["pin-60", "pin-60"], seconds=0.05, soa=0.2),
    "live": lambda m: m.live(drives=DRIVES),
}


def end(other: meissner.Client, session_id: str) -> None:
    """Ends somebody's session, as `meissner session end` does."""
    ops.document(other.core, _http.post(f"/v1/sessions/{session_id}/end"))


def plays(m: meissner.Client, session_id: str) -> list[dict[str, Any]]:
    recorded: list[dict[str, Any]] = m.session_plays(session_id)["plays"]
    return recorded


def session_of(play: meissner.Play) -> str | None:
    """The session that a play belongs to, once it is over."""
    session: str | None = play.wait().raw["order"].get("session")
    return session


def answers(played: list[dict[str, Any]], key: str) -> list[tuple[int, Any]]:
    """The trials of recorded plays, and this key of their answers."""
    return [(play["receipt"]["order"]["trial"], play["answer"][key]) for play in played]


@pytest.fixture
def other(daemon: meissner.Daemon) -> Iterator[meissner.Client]:
    """Somebody else."""
    with meissner.connect(daemon.socket) as other:
        yield other


@contextmanager
def restarted(config: str = "") -> Iterator[tuple[meissner.Client, Callable[[], meissner.Client]]]:
    """A client, and a function that puts another daemon, armed by somebody else, in the place of its daemon."""
    with (
        meissner.Daemon(config) as first,
        meissner.Daemon(config) as second,
        Network(first.socket) as network,
        meissner.connect(network.url) as m,
        meissner.connect(second.socket) as other,
    ):

        def restart() -> meissner.Client:
            first.close()
            network.socket = second.socket
            network.cut()
            other.arm(assume_rest=True, checked="a test", silence=600)
            return other

        yield m, restart


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("next_one", [True, False])
def test_after_its_session_was_ended_nothing_plays(
    m: meissner.Client, other: meissner.Client, order: str, next_one: bool
) -> None:
    session = m.session("P07")
    end(other, session.id)
    following = other.session("P08") if next_one else None
    with pytest.raises(errors.SessionOver, match=rf"session {session.id} is over.*`end\(\)`") as refused:
        ORDERS[order](m)
    assert isinstance(refused.value, errors.SessionRunning)
    assert other.status().playing is None
    if following is not None:
        following.end()
        assert plays(other, following.id) == []
    # Left, it plays again: here outside of a session.
    session.end()
    assert session_of(m.play("pin-60", 0.05)) is None


@pytest.mark.parametrize("order", ORDERS)
def test_after_a_restart_of_the_daemon_nothing_plays_without_the_session(order: str) -> None:
    with restarted() as (m, restart):
        m.arm(assume_rest=True, checked="a test", silence=600)
        with pytest.raises(errors.SessionOver), m.session("P07"):
            m.play("pin-60", 0.05).wait()
            other = restart()
            for _ in range(2):
                with pytest.raises(errors.SessionOver):
                    ORDERS[order](m)
            ORDERS[order](m)
        assert other.status().raw["session"] is None
        with m.session("P07") as session:
            assert session_of(m.play("pin-60", 0.05)) == session.id
        m.core.has_armed = False


def test_another_session_takes_the_place_of_one_that_is_over(m: meissner.Client, other: meissner.Client) -> None:
    over = m.session("P07")
    end(other, over.id)
    with m.session("P07", experiment="again") as session:
        over.end()  # It is not this one.
        play = m.play("pin-60", 0.05)
        play.wait()
    assert [each["receipt"]["id"] for each in plays(m, session.id)] == [play.id]
    assert plays(m, over.id) == []


def test_leaving_a_session_that_is_over_touches_no_other_one(m: meissner.Client, other: meissner.Client) -> None:
    """Neither `stop` nor `end` reaches the session of somebody else, also after an error."""
    with pytest.raises(ZeroDivisionError), m.session("P07") as session:
        end(other, session.id)
        following = other.session("P08")
        play = other.play("pin-60", endless=True)
        _ = 1 / 0
    # The play begins some milliseconds after the daemon has accepted it.
    while (state := other.status()).raw["queued"]:
        pass
    assert (state.playing, state.raw["session"]["id"]) == (play.id, following.id)
    other.stop()
    following.end()


def test_the_signs_of_life_say_that_the_session_is_over(m: meissner.Client, other: meissner.Client) -> None:
    session = m.session("P07")
    assert session.heartbeat_problem is None
    end(other, session.id)
    m.alive.begin()
    deadline = time.monotonic() + PATIENT
    while session.heartbeat_problem is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert isinstance(session.heartbeat_problem, errors.SessionOver)
    session.end()


ASLEEP = """
import sys, meissner
with meissner.connect(sys.argv[1]) as m:
    m.arm(assume_rest=True, checked="a test", silence=600)
    session = m.session("P07", exclusive=True)
    print(session.id, flush=True)
    input()
    try:
        print(m.play("pin-60", 0.05).wait().raw["order"])
    except meissner.errors.SessionOver as error:
        print("over")
"""


@pytest.mark.parametrize("exclusive", [True, False])
def test_a_laptop_that_slept_plays_nothing_under_the_next_participant(exclusive: bool) -> None:
    with meissner.Daemon("session_silence_s = 0.5\n") as daemon, meissner.connect(daemon.socket) as other:
        sleeper = subprocess.Popen(
            [sys.executable, "-c", ASLEEP, daemon.socket],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        with sleeper:
            assert sleeper.stdout is not None
            session_id = sleeper.stdout.readline().strip()
            os.kill(sleeper.pid, signal.SIGSTOP)
            deadline = time.monotonic() + PATIENT
            while True:
                try:
                    end(other, session_id)
                    break
                except errors.SessionExclusive:
                    assert time.monotonic() < deadline
                    time.sleep(0.05)
            following = other.session("P08", exclusive=exclusive)
            os.kill(sleeper.pid, signal.SIGCONT)
            out, problem = sleeper.communicate("\n", timeout=PATIENT)
        assert out == "over\n", problem
        following.end()
        assert plays(other, following.id) == []


STUDY = """
import sys, meissner
from meissner.experiment import Staircase, trials
with meissner.connect() as m, m.session("P07", resume=True) as session:
    m.arm(assume_rest=True, checked="a test", silence=60.0)
    stairs = Staircase(0.9, ratio=1.2, down=1, minimum=0.1)
    stairs.resume(session.answers(side="left"))
    print(session.resumed, len(stairs.answers), [trial.number for trial in session.remaining(trials(repeats=4, seed=1))], flush=True)
    for trial in session.remaining(trials(repeats=4, seed=1)):
        play = m.play("pin-60", 0.05, scale=stairs.level, trial=trial.number)
        play.wait()
        session.answer(trial, "felt", correct=True, level=stairs.level, factors={"side": "left"})
        stairs.answer(True)
        print(trial.number, flush=True)
        if sys.argv[1:] == [str(trial.number)]:
            sys.stdin.read()
    print(stairs.level, flush=True)
"""


def study(daemon: meissner.Daemon, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", STUDY, *arguments]
    environment = {**os.environ, "MEISSNER_SOCKET": daemon.socket}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, stderr=pipe, text=True)


def test_a_study_that_was_killed_goes_on(
    daemon: meissner.Daemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    first = study(daemon, "2")
    assert first.stdout is not None
    said = [first.stdout.readline().strip() for _ in range(3)]
    assert said == ["False 0 [1, 2, 3, 4]", "1", "2"]
    (file,) = (tmp_path / "meissner").iterdir()
    assert file.stat().st_mode & 0o777 == 0o600
    second = study(daemon)
    _, errors_of_second = second.communicate()
    assert "SessionRunning" in errors_of_second
    assert "the program that has started it runs, too" in errors_of_second
    with meissner.connect(daemon.socket) as m, pytest.raises(errors.SessionRunning, match="`P07` runs: end it with"):
        m.session("P08", resume=True)
    first.kill()
    first.communicate()
    third = study(daemon)
    out, problem = third.communicate()
    assert problem == ""
    first_line, *numbers, level = out.split("\n")[:-1]
    assert (first_line, numbers) == ("True 2 [3, 4]", ["3", "4"])
    # Four right answers of one staircase: each step is twice `ratio` until it has turned.
    assert float(level) == pytest.approx(0.9 / 1.2**8)
    assert list((tmp_path / "meissner").iterdir()) == []
    with meissner.connect(daemon.socket) as m:
        session = m.sessions()[-1] if m.sessions()[-1]["participant"] == "P07" else m.sessions()[0]
        assert answers(plays(m, session["id"]), "response") == [(n, "felt") for n in (1, 2, 3, 4)]


def test_a_session_that_resumes_goes_on_after_an_error(
    m: meissner.Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(ZeroDivisionError), m.session("P07", resume=True) as session:
        m.play("pin-60", 0.05, trial=7).wait()
        session.answer(7, "left", correct=True, rt_ms=300)
        _ = 1 / 0
    with m.session("P07", resume=True) as again:
        assert (again.resumed, again.id) == (True, session.id)
        assert answers(again.plays, "rt_ms") == [(7, 300.0)]
        with pytest.raises(errors.MeissnerError, match="has played nothing in trial 8"):
            again.answer(8, "left")
    with m.session("P07", resume=True) as fresh:
        assert not fresh.resumed
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.delenv("HOME")
    with m.session("P07") as lost, meissner.connect(m.core.endpoint.name) as other:
        with pytest.raises(errors.SessionRunning, match="its token is not kept"):
            other.session("P07", resume=True)
        assert lost.plays == []


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_child_does_not_take_over_a_session(
    daemon: meissner.Daemon, m: meissner.Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with m.session("P07", resume=True) as session:
        child = os.fork()
        if child == 0:
            # A child that fails must not go on with the tests.
            try:
                with meissner.connect(daemon.socket) as other:
                    other.session("P07", resume=True)
            except errors.SessionRunning as error:
                os._exit(0 if "the program that has started it runs, too" in str(error) else 1)
            finally:
                os._exit(2)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        m.play("pin-60", 0.05).wait()
        assert len(session.plays) == 1


def test_live_plays_take_answers(daemon: meissner.Daemon, m: meissner.Client) -> None:
    """The method of adjustment: the participant sets what the play ends with."""
    with m.session("P07") as session:
        with m.live(drives=DRIVES, timeout=60.0, trial=1) as live:
            live.scale(0.5).wait(PATIENT)
        session.answer(1, "as strong", level=0.5)
        with m.live(drives=DRIVES, timeout=60.0, trial=2) as live:
            live.keep().wait(PATIENT)
        live.answer("weaker")
        assert answers(session.plays, "response") == [(1, "as strong"), (2, "weaker")]


def test_the_end_of_one_client_does_not_disarm_another(m: meissner.Client, daemon: meissner.Daemon) -> None:
    with meissner.connect(daemon.socket) as second:
        second.arm(silence=60.0)
        cut = second.play("pin-60", endless=True)
    assert m.receipt(cut.id).state in ("running", "stopped")
    m.wait_until_idle()
    assert m.receipt(cut.id).cause == "disarm"
    assert m.status().state == "armed"
    m.play("pin-60", 0.05).wait()
    with meissner.connect(daemon.socket) as second:
        second.arm(silence=60.0)
        m.close()
        second.play("pin-60", 0.05).wait()
    with meissner.connect(daemon.socket) as third:
        third.wait_until_idle()
        assert third.status().state == "disarmed"


@contextmanager
def unrecorded() -> Iterator[tuple[meissner.Daemon, Callable[[], None]]]:
    """A daemon, and a function that puts a file into the place of its record's directory."""
    with meissner.Daemon(LEAD) as daemon:
        record = Path(daemon.socket).parent / "record"

        def damage() -> None:
            record.rename(record.with_name("away"))
            record.touch()

        yield daemon, damage


def test_while_the_record_fails_plays_and_answers_are_errors_and_so_is_the_end_of_the_session() -> None:
    with unrecorded() as (daemon, damage), meissner.connect(daemon.socket) as m:
        m.arm(assume_rest=True, checked="a test", silence=600)
        with (
            pytest.raises(errors.IncompleteSession, match=r"its record has lost \d+ entries"),
            m.session("P07") as session,
        ):
            m.play("pin-60", 0.05, trial=1).wait()
            damage()
            for _ in range(2):
                with pytest.raises(
                    errors.StoreError, match="the answer to play 1 is not recorded: the session record cannot"
                ):
                    session.answer(1, "left")
            with pytest.raises(errors.StoreError, match=f"session {session.id} takes no plays: the session record"):
                m.play("pin-60", 0.05)
        assert m.status().raw["session"] is None
        with pytest.warns(UserWarning, match="the session record cannot be written"):
            assert session_of(m.play("pin-60", 0.05)) is None
        # Now none starts that needs a record.
        with pytest.raises(errors.StoreError, match="no session was started: the session record cannot"):
            m.session("P08")
    with unrecorded() as (daemon, damage), meissner.connect(daemon.socket) as m:
        m.arm(assume_rest=True, checked="a test", silence=600)
        with pytest.warns(UserWarning, match="its record has lost"), pytest.raises(ZeroDivisionError):
            with m.session("P08", record="optional"):
                damage()
                with pytest.warns(UserWarning, match="the session record cannot be written"):
                    assert m.play("pin-60", 0.05).wait().state == "done"
                # An error of the block goes first.
                _ = 1 / 0


def test_a_session_whose_file_is_gone_is_told() -> None:
    with meissner.Daemon(LEAD) as daemon, meissner.connect(daemon.socket) as m:
        with m.session("P07") as first:
            pass
        assert [each["id"] for each in m.sessions()] == [first.id]
        (Path(daemon.socket).parent / "record" / "sessions" / f"{first.id}.jsonl").unlink()
        with pytest.warns(UserWarning, match=first.id):
            assert m.sessions() == []
