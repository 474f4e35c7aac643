"""A play belongs to its client's session or is refused: never to somebody else's session, and never to none."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

import meissner
from meissner import _http, errors
from meissner import _operations as ops
from network import Network

PATIENT = 120.0
DRIVES = [{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 40.0}]
ORDERS: dict[str, Callable[[meissner.Client], object]] = {
    "play": lambda m: m.play("pin-60", 0.05),
    "sequence": lambda m: m.sequence(["pin-60", "pin-60"], seconds=0.05, soa=0.2),
    "live": lambda m: m.live(drives=DRIVES),
}


def end(other: meissner.Client, session_id: str) -> None:
    """Ends somebody's session, as `meissner session end` does."""
    other.run(ops._document(other.core, _http.post(f"/v1/sessions/{session_id}/end")))


def plays(m: meissner.Client, session_id: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = m.session_plays(session_id)["plays"]
    return rows


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
    assert m.play("pin-60", 0.05).wait().raw["session"] is None


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
            assert m.play("pin-60", 0.05).wait().raw["session"] == session.id
        m.core.has_armed = False


def test_another_session_takes_the_place_of_one_that_is_over(m: meissner.Client, other: meissner.Client) -> None:
    over = m.session("P07")
    end(other, over.id)
    with m.session("P07", experiment="again") as session:
        over.end()  # It is not this one.
        play = m.play("pin-60", 0.05)
        play.wait()
    assert [row["play"] for row in plays(m, session.id)] == [play.id]
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
        print(m.play("pin-60", 0.05).wait().raw["session"])
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


def test_the_same_for_asyncio(daemon: meissner.Daemon, other: meissner.Client) -> None:
    async def main() -> None:
        async with await meissner.connect_async(daemon.socket) as m:
            await m.arm(assume_rest=True, checked="a test", silence=600)
            async with m.session("P07") as session:
                assert (await (await m.play("pin-60", 0.05)).wait()).raw["session"] == session.id
                end(other, session.id)
                following = other.session("P08")
                with pytest.raises(errors.SessionOver):
                    await m.play("pin-60", 0.05)
                with pytest.raises(errors.SessionOver):
                    await m.sequence(["pin-60"], seconds=0.05)
                with pytest.raises(errors.SessionOver):
                    await m.live(drives=DRIVES)
            following.end()
            assert plays(other, following.id) == []
            assert (await (await m.play("pin-60", 0.05)).wait()).raw["session"] is None

    asyncio.run(main())
