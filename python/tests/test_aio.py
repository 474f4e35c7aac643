"""The client for asyncio against a real daemon with the simulated array."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

import meissner
from meissner import errors
from meissner._endpoint import endpoints
from meissner.aio import AsyncClient
from network import Network
from patience import kept

HZ = 85_000


def run(socket: str, work: Callable[[AsyncClient], Awaitable[None]]) -> None:
    """Runs this with an armed client, whose signs of life are not among the requests."""

    async def main() -> None:
        async with await meissner.connect_async(socket) as m:
            await m.arm(assume_rest=True, checked="a test", stay_armed=True)
            await work(m)

    asyncio.run(main())


def test_plays_and_sequences(daemon: meissner.Daemon) -> None:
    async def ordered(m: AsyncClient) -> None:
        at = m.now() + 2.0
        play = await m.play("pin-60", seconds=0.1, at=at)
        state = (await play.refresh()).state
        assert (await play.wait()).state == "done"
        assert state in ("queued", "running")
        assert abs(play.onset.monotonic - at) <= play.onset.monotonic_uncertainty + 0.5 / HZ + 200e-6

    async def work(m: AsyncClient) -> None:
        pair = await m.sequence(["pin-60", "pin-60"], seconds=0.05, soa=0.1)
        await pair.wait()
        ticks = [item.onset.tick for item in pair.items if item.onset]
        assert ticks[1] - ticks[0] == HZ // 10
        endless = await m.play("pin-60", endless=True)
        await m.stop()
        assert (await pair.withdraw()).state == "done"
        with pytest.raises(meissner.PlayStopped):
            await endless.wait()
        assert (await endless.wait(check=False)).state == "stopped"
        with pytest.raises(errors.NotFound):
            await m.play("no-such")

    kept(lambda: run(daemon.socket, ordered))
    run(daemon.socket, work)
    with meissner.connect(daemon.socket) as watcher:
        watcher.wait_until_idle()
        assert watcher.status().state == "disarmed"


def test_events(daemon: meissner.Daemon) -> None:
    async def work(m: AsyncClient) -> None:
        events = m.events()
        assert (await anext(events)).name == "state"
        play = await m.play("pin-60", 0.05)
        seen = []
        async for event in events:
            if event.name in ("queued", "began", "ended"):
                seen.append(event.name)
            if event.name == "ended":
                assert event["receipt"]["id"] == play.id
                break
        assert seen == ["queued", "began", "ended"]
        await events.aclose()

    run(daemon.socket, work)


def test_a_session_survives_a_break() -> None:
    async def stays_the_owner(m: AsyncClient, other: meissner.Client) -> bool:
        async with m.session("P07", exclusive=True, seed=1) as session:
            await asyncio.sleep(4.5)
            try:
                other.play("pin-60", 0.05).wait(check=False)
            except errors.SessionExclusive:
                assert session.heartbeat_problem is None
                return True
            return False

    async def work(m: AsyncClient) -> None:
        with meissner.connect(m.core.endpoint.socket) as other:
            # A machine that stands still is silent, too. Without signs of life every round fails.
            for left in (2, 1, 0):
                if await stays_the_owner(m, other):
                    break
                assert left
            session = await m.session("P08")
            assert other.status().raw["session"]["id"] == session.id
            await session.end()
            await session.end()
            with pytest.raises(ZeroDivisionError):
                async with m.session("P09"):
                    _ = 1 / 0
            assert other.status().raw["session"] is None

    with meissner.Daemon("session_silence_s = 2\n") as daemon:
        run(daemon.socket, work)


def test_connections_are_made_again_and_commands_sent_once(network: Network) -> None:
    async def work(m: AsyncClient) -> None:
        network.cut()
        play = await m.play("pin-60", 0.05)
        await play.wait()
        network.requests.clear()
        network.lose_answers = 1
        with pytest.raises(errors.ConnectionLost):
            await m.play("pin-60", 0.05)
        assert [line for line in network.requests if "POST" in line] == ["POST /v1/play HTTP/1.1"]
        await m.wait_until_idle()
        events = m.events()
        await anext(events)
        network.cut()
        # What the daemon had sent before the cut comes first.
        names = [(await anext(events)).name]
        while names[-1] != "reconnected" and len(names) < 10:
            names.append((await anext(events)).name)
        assert (names[-1], (await anext(events)).name) == ("reconnected", "state")
        await events.aclose()
        events = m.events(reconnect=False)
        await anext(events)
        network.cut()
        with pytest.raises(errors.ConnectionLost):
            async for _ in events:
                pass
        assert (await m.estop()).state == "faulted"

    run(network.url, work)


def test_simulation_and_search_run_in_a_thread(daemon: meissner.Daemon) -> None:
    scene = {"duration_s": 0.1, "afferents": [{"x_mm": -1.45, "y_mm": 1.45}], "drives": []}

    async def work(m: AsyncClient) -> None:
        answer = await m.simulate(scene, rates_only=True)
        assert list(answer.rates_hz) == [0.0]
        found = await m.design("dot", budget=10, name="from-aio")
        assert (await m.pattern("from-aio"))["pattern"]["name"] == found.name
        await m.remove_pattern("from-aio")

    run(daemon.socket, work)


def test_without_a_daemon(tmp_path: Path) -> None:
    async def main() -> None:
        with pytest.raises(errors.Unreachable):
            await meissner.connect_async(tmp_path / "none.sock")
        with pytest.raises(errors.Unreachable):
            async for _ in AsyncClient(meissner._core(endpoints("http://127.0.0.1:9")[0], None, 0.0)).events():
                pass

    asyncio.run(main())


def test_a_daemon_that_goes_leaves_a_warning_and_no_wrong_error() -> None:
    async def main() -> None:
        daemon = meissner.Daemon("session_silence_s = 0.4\n")
        with pytest.raises(ZeroDivisionError), pytest.warns(UserWarning, match="may be armed still"):
            async with await meissner.connect_async(daemon.socket, reconnect=0.1) as m:
                await m.arm(assume_rest=True, checked="a test")
                session = await m.session("P07")
                daemon.close()
                deadline = time.monotonic() + 120
                while session.heartbeat_problem is None and time.monotonic() < deadline:
                    await asyncio.sleep(0.01)
                assert session.heartbeat_problem is not None
                _ = 1 / 0

    asyncio.run(main())
