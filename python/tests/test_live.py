"""The blocking client against a real daemon with the simulated array."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy
import pytest

import meissner
from meissner import _transport, errors
from meissner._endpoint import endpoints
from meissner._http import Answer, Request
from meissner._live import Started
from meissner.live import Live
from meissner.program import find_program
from network import Network
from patience import kept

HZ = 85_000
PATTERN = """format = 1
name = "two-pins"
duration_s = 0.1
[[drive]]
motor = 9
frequency_hz = 60.0
amplitude_um = 40.0
"""


def test_a_play_has_its_times_on_every_clock(m: meissner.Client) -> None:

    def ordered() -> tuple[meissner.Play, float, float, meissner.Receipt]:
        at, wall = m.now() + 2.0, time.time()
        play = m.play("edge-45", seconds=0.3, at=at, scale=0.8, trigger=5, trial=3, labels={"block": 1})
        assert repr(play) == f"<play {play.id}: edge-45, accepted>"
        with pytest.raises(errors.NotKnownYet, match="no receipt yet"):
            _ = play.onset
        if play.refresh().is_over:
            play.wait()  # It may have missed its onset.
            pytest.fail("the receipt of a play that waits says that it is over")
        assert play.receipt.state in ("queued", "running")
        with pytest.raises(errors.NotKnownYet, match="call `wait"):
            _ = play.offset
        return play, at, wall, play.wait(timeout=200)

    play, at, wall, receipt = kept(ordered)
    onset, offset = play.onset, play.offset
    # Half a tick, what the daemon states about its device's clock, and what it took the clock for when the play was ordered.
    assert abs(onset.monotonic - at) <= onset.monotonic_uncertainty + 0.5 / HZ + 200e-6
    assert abs(onset.wall - wall - 2.0) < 60
    assert 0 < onset.monotonic_uncertainty <= onset.wall_uncertainty
    assert onset.tick_hz == HZ
    assert offset.tick - onset.tick == round(receipt.raw["duration_ms"]["played"] * HZ / 1000)
    (item,) = receipt.items
    assert (item.scale, item.raw["trigger"]["code"]) == (0.8, 5)
    assert (receipt.raw["order"]["trial"], receipt.raw["order"]["labels"]) == (3, {"block": "1"})
    assert play.ordered_s == 0.3
    assert repr(play) == f"<play {play.id}: edge-45, done>"
    assert m.receipt().id == play.id


def test_a_play_after_an_instant_is_exact_to_the_tick(m: meissner.Client) -> None:
    def ordered() -> tuple[meissner.Instant, meissner.Instant]:
        first = m.play("pin-60", 0.05)
        first.wait()
        second = m.play("pin-60", 0.05, at=first.onset.later(2.0))
        second.wait()
        return first.onset, second.onset

    first, second = kept(ordered)
    assert second.tick - first.tick == 2 * HZ
    assert second.boot == first.boot


def test_the_onsets_of_a_sequence_are_exact_to_the_tick(m: meissner.Client) -> None:
    items: list[meissner.SequenceItem] = ["pin-60", {"pattern": "edge-45", "scale": 0.5, "trigger": 7}, "pin-60"]

    def ordered() -> meissner.Play:
        play = m.sequence(items, seconds=0.05, isi=0.1, at=m.now() + 2.0, trial=1, labels={"a": "b"})
        play.wait()
        return play

    play = kept(ordered)
    ticks = [item.onset.tick for item in play.items if item.onset]
    assert [later - earlier for earlier, later in itertools.pairwise(ticks)] == [round(0.15 * HZ)] * 2
    assert [item.state for item in play.items] == ["played"] * 3
    assert [item.scale for item in play.items] == [1.0, 0.5, 1.0]
    play = m.sequence(["pin-60", "pin-60"], seconds=0.05, soa=0.125, name="pair")
    assert play.pattern == "pair"
    play.wait()
    ticks = [item.onset.tick for item in play.items if item.onset]
    assert ticks[1] - ticks[0] == round(0.125 * HZ)
    play = m.sequence([{"pattern": "pin-60", "gap": 0.01}, {"pattern": "pin-60", "start": 0.2}], seconds=0.05)
    play.wait()
    assert play.items[1].raw["planned_onset_ticks"] == round(0.2 * HZ)
    with pytest.raises(ValueError, match="not both"):
        m.sequence(["pin-60"], isi=1, soa=1)


def test_waiting_ends(m: meissner.Client) -> None:
    play = m.play("pin-60", endless=True)
    with pytest.raises(TimeoutError, match="wait longer"):
        play.wait(timeout=0.05)
    m.stop()
    with pytest.raises(errors.PlayStopped, match="was stopped: stop") as stopped:
        play.wait()
    assert stopped.value.receipt.cause == "stop"
    assert play.wait(check=False).state == "stopped"


def test_a_waiting_play_is_withdrawn(m: meissner.Client) -> None:
    running = m.play("pin-60", seconds=30.0)
    waiting = [m.play("edge-45", seconds=0.1) for _ in range(2)]
    assert (waiting[0].withdraw().state, waiting[0].receipt.cause) == ("stopped", "withdrawn")
    assert waiting[1].refresh().state == "queued"
    m.stop()
    assert running.wait(check=False).cause == "stop"


def test_refusals_have_classes(m: meissner.Client) -> None:
    with pytest.raises(errors.NotFound, match=r"no-such.*patterns\(\)"):
        m.play("no-such")
    with pytest.raises(errors.BadRequest, match="scale"):
        m.play("pin-60", 0.1, scale=7)
    with pytest.raises(errors.TooSoon):
        m.play("pin-60", 0.1, at=m.now() - 1)
    m.disarm()
    with pytest.raises(errors.Disarmed, match=r"call `arm\(\)`"):
        m.play("pin-60", 0.1)
    with pytest.raises(meissner.ApiError):
        m.home()


def test_an_emergency_stop_latches(m: meissner.Client) -> None:
    play = m.play("pin-60", endless=True)
    m.estop()
    assert m.status().state == "faulted"
    assert play.wait(check=False).cause == "estop"
    with pytest.raises(errors.Faulted):
        m.arm(assume_rest=True, checked="a test")
    assert m.reset(force=True).state == "disarmed"
    assert m.arm(assume_rest=True, checked="a test").state == "armed"


def test_the_doctor_says_what_to_do(m: meissner.Client) -> None:
    report = m.doctor()
    device = next(finding for finding in report["findings"] if finding["what"] == "device")
    assert report["ok"]
    assert (device["level"], device["found"].startswith("mock")) == ("warn", True)


def test_patterns_are_stored_and_removed(m: meissner.Client, tmp_path: Path) -> None:
    assert "edge-45" in [pattern["name"] for pattern in m.patterns()]
    file = tmp_path / "two-pins.toml"
    file.write_text(PATTERN)
    assert m.store_pattern("two-pins", file)["replaced_sha256"] is None
    with pytest.raises(errors.Exists):
        m.store_pattern("two-pins", PATTERN)
    first = m.store_pattern("two-pins", PATTERN, replace=True)["replaced_sha256"]
    # As Windows writes it, it is the same file.
    file.write_bytes(PATTERN.replace("\n", "\r\n").encode("utf-8-sig"))
    assert m.store_pattern("two-pins", file, replace=True)["replaced_sha256"] == first
    assert m.store_pattern("two-pins", PATTERN, replace=True)["replaced_sha256"] == first
    assert m.pattern("two-pins")["pattern"]["drive"][0]["motor"] == 9
    assert m.play("two-pins").wait().state == "done"
    m.remove_pattern("two-pins")
    with pytest.raises(errors.NotFound):
        m.pattern("two-pins")


def test_the_end_of_the_block_disarms(daemon: meissner.Daemon) -> None:
    with meissner.connect(daemon.socket) as watcher:
        with meissner.connect(daemon.socket) as m:
            m.arm(assume_rest=True, checked="a test")
            play = m.play("pin-60", endless=True)
        assert watcher.status().state in ("disarmed", "returning")
        watcher.wait_until_idle()
        assert watcher.receipt(play.id).state == "stopped"
        with pytest.raises(ZeroDivisionError), meissner.connect(daemon.socket) as m:
            m.arm(assume_rest=True, checked="a test")
            m.estop()
            _ = 1 / 0
        assert watcher.status().state == "faulted"
        watcher.reset(force=True)
        # A client that has not armed leaves the state alone.
        with meissner.connect(daemon.socket) as armed:
            armed.arm(assume_rest=True, checked="a test")
            with meissner.connect(daemon.socket) as other:
                other.status()
            assert watcher.status().state == "armed"
            armed.close()
            armed.close()


def test_a_session_belongs_to_its_owner(m: meissner.Client, daemon: meissner.Daemon) -> None:
    with (
        meissner.connect(daemon.socket) as other,
        m.session("P07", exclusive=True, experiment="edges", seed=4, labels={"block": 2}) as session,
    ):
        play = m.play("pin-60", 0.1)
        with pytest.raises(errors.SessionExclusive, match="P07"):
            other.play("pin-60", 0.05)
        with pytest.raises(errors.SessionRunning):
            m.session("P08")
        # The block waits for this play before it ends the session.
    assert play.refresh().state == "done"
    assert play.receipt.raw["order"]["session"] == session.id
    assert session.heartbeat_problem is None
    recorded = m.session_plays(session.id)
    assert [each["receipt"]["id"] for each in recorded["plays"]] == [play.id]
    assert session.id in [each["id"] for each in m.sessions()]
    with pytest.raises(ZeroDivisionError), m.session("P09"):
        endless = m.play("pin-60", endless=True)
        _ = 1 / 0
    assert endless.wait(check=False).state == "stopped"
    session = m.session("P10")
    session.end()
    session.end()


def test_an_owner_in_a_rest_break_stays_the_owner() -> None:
    """The daemon gives a session free after two seconds of silence; the break lasts more than twice as long.

    A machine that stands still is silent, too: one round of three without that is enough, and without signs of life there is none.
    """
    with (
        meissner.demo(config="session_silence_s = 2\n") as m,
        meissner.connect(m.status().raw["daemon"]["socket"]) as other,
    ):
        m.play("pin-60", 0.1).wait()
        assert m.home().state == "armed"
        released = threading.Event()

        def listen() -> None:
            for event in other.events(reconnect=False):
                if event.name == "session-released":
                    released.set()
                if event.name == "session-ended":
                    return

        def stays_the_owner() -> bool:
            released.clear()
            listener = threading.Thread(target=listen)
            listener.start()
            with m.session("P07", exclusive=True):
                is_released = released.wait(4.5)
                if not is_released:
                    try:
                        other.play("pin-60", 0.05).wait(check=False)
                        is_released = released.wait(120)
                        assert is_released, "somebody else has played in an exclusive session"
                    except errors.SessionExclusive:
                        m.play("pin-60", 0.1).wait()
            listener.join(120)
            assert not listener.is_alive()
            return not is_released

        assert any(stays_the_owner() for _ in range(3))


def test_events_tell_what_happens(m: meissner.Client) -> None:
    events = m.events()
    assert next(events).name == "state"
    play = m.play("pin-60", 0.05)
    seen = []
    for event in events:
        if event.name in ("queued", "began", "ended"):
            seen.append(event.name)
        if event.name == "ended":
            assert event["receipt"]["id"] == play.id
            break
    assert seen == ["queued", "began", "ended"]
    events.close()


def test_events_whose_connection_is_silent_are_asked_for_again(
    daemon: meissner.Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cable that is pulled says nothing. The daemon sends a comment every 15 s."""
    monkeypatch.setattr(_transport, "SILENCE", 0.2)
    with meissner.connect(daemon.socket) as m:
        events = m.events()
        # On a busy machine a connection may be silent before its first event.
        list(itertools.takewhile(lambda event: event.name != "reconnected", events))
        list(itertools.takewhile(lambda event: event.name != "state", events))
        events.close()


def test_a_client_that_is_closed_ends_its_events(daemon: meissner.Daemon) -> None:
    m = meissner.connect(daemon.socket)
    events, ended = m.events(), threading.Event()

    def listen() -> None:
        with pytest.raises(errors.MeissnerError, match="the client is closed"):
            list(events)
        ended.set()

    next(events)
    threading.Thread(target=listen, daemon=True).start()
    m.close()
    # The daemon's next comment is 15 s away.
    assert ended.wait(120)


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_child_has_connections_of_its_own(network: Network) -> None:
    """Each would read the other's answers."""
    with meissner.connect(network.url) as m:
        m.status()
        before = network.connections
        child = os.fork()
        if child == 0:
            # A child that fails must not go on with the tests.
            try:
                os._exit(0 if m.status().state == "disarmed" and len(m.patterns()) > 0 else 1)
            finally:
                os._exit(2)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert network.connections == before + 1
        m.status()
        assert network.connections == before + 1


def test_times_are_numbers(m: meissner.Client) -> None:
    """What Python would multiply by 1000 without an error, or with another one."""
    orders: list[Callable[[Any], object]] = [
        lambda wrong: m.play("pin-60", 0.05, hold=wrong),
        lambda wrong: m.play("pin-60", 0.05, on_edge=wrong),
        lambda wrong: m.sequence(["pin-60", "pin-60"], seconds=0.05, isi=wrong),
        lambda wrong: m.sequence(["pin-60", "pin-60"], seconds=0.05, soa=wrong),
        lambda wrong: m.sequence(["pin-60", {"pattern": "pin-60", "gap": wrong}], seconds=0.05),
        lambda wrong: m.sequence(["pin-60", {"pattern": "pin-60", "start": wrong}], seconds=0.05),
        lambda wrong: m.live(drives=[], timeout=wrong),
    ]
    for order, wrong in itertools.product(orders, (True, "0.1", [0.1], numpy.array([0.1, 0.2]), numpy.True_)):
        with pytest.raises(TypeError, match="must be a number of seconds, such as"):
            order(wrong)
    with pytest.raises(ValueError, match="`isi` is nan: must be a finite number of seconds"):
        m.sequence(["pin-60", "pin-60"], seconds=0.05, isi=numpy.nan)
    items: list[Any] = ["pin-60", {"pattern": "pin-60", "gap": None}, {"pattern": "pin-60", "gap": numpy.array(0.2)}]
    receipt = m.sequence(items, seconds=numpy.array(0.05), isi=numpy.float32(0.1)).wait()
    first, second, third = [item.onset.tick for item in receipt.items if item.onset is not None]
    lasts = m.array.ticks(0.05)
    assert (second - first, third - second) == (lasts + m.array.ticks(0.1), lasts + m.array.ticks(0.2))


def test_a_connection_that_has_died_in_a_break_is_made_again(network: Network) -> None:
    with meissner.connect(network.url) as m:
        m.arm(assume_rest=True, checked="a test")
        network.cut()
        assert m.play("pin-60", 0.05).wait().state == "done"
        events = m.events()
        assert next(events).name == "state"
        network.cut()
        # What the daemon had sent before the cut comes first.
        names = itertools.takewhile(lambda name: name != "reconnected", (event.name for event in events))
        assert len(list(itertools.islice(names, 10))) < 10
        assert next(events).name == "state"
        events = m.events(reconnect=False)
        next(events)
        network.cut()
        with pytest.raises(errors.ConnectionLost):
            for _ in events:
                pass


def test_a_command_is_sent_once_and_a_question_again(network: Network) -> None:
    with meissner.connect(network.url) as m:
        # Signs of life would be among the requests.
        m.arm(assume_rest=True, checked="a test", stay_armed=True)
        network.lose_answers = 1
        assert m.status().state == "armed"
        network.requests.clear()
        network.lose_answers = 1
        with pytest.raises(errors.ConnectionLost, match="before you repeat"):
            m.play("pin-60", 0.05)
        assert [line for line in network.requests if "POST" in line] == ["POST /v1/play HTTP/1.1"]
        m.wait_until_idle()
        network.requests.clear()
        network.lose_answers = 2
        m.estop()
        assert m.status().state == "faulted"
        assert network.requests.count("POST /v1/estop HTTP/1.1") + len(network.estops) >= 3


def test_an_emergency_stop_goes_both_ways_and_the_first_good_answer_counts(
    network: Network, daemon: meissner.Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(request: Request) -> Answer:
        raise errors.ConnectionLost("the API is blocked")

    for place in (network.url, daemon.socket):
        with meissner.connect(place, reconnect=0.0) as m:
            with monkeypatch.context() as patch:
                patch.setattr(m.core, "token", "mst_00")
                patch.setattr(m.core.link, "perform", lost)
                m.estop()
            assert m.status().state == "faulted"
            m.reset(force=True)
    assert network.estops == ["mst_00"]
    with meissner.connect(network.url, reconnect=0.0) as m:
        network.block_estop()
        m.estop()
        assert m.reset(force=True).state == "disarmed"
        monkeypatch.setattr(m.core.link, "perform", lost)
        with pytest.raises(errors.ConnectionLost, match="the API is blocked"):
            m.estop()
    own = int(network.url.rpartition(":")[2]) + 1
    with pytest.warns(UserWarning, match=f"the port for emergency stops, {own} of 127.0.0.1, does not answer") as told:
        meissner.connect(network.url).close()
    assert len(told) == 1
    assert told[0].filename == __file__


def test_with_jitter_and_a_skewed_clock_no_onset_errs_by_more_than_stated(network: Network) -> None:
    """The client's clock is another one: shifted by minutes, and 100 ppm fast. Both clocks are read on one machine."""
    network.jitter_s = 0.02

    def client_at(host_ns: int) -> int:
        return host_ns + host_ns // 10_000 + 321_000_000_000

    core = meissner._core(endpoints(network.url)[0], None, 10.0)
    core.clock._monotonic_ns = lambda: client_at(time.monotonic_ns())
    with meissner.Client(core) as m:
        m.synchronise()
        assert not core.clock.is_shared
        m.arm(assume_rest=True, checked="a test")

        def ten() -> list[tuple[float, meissner.Instant]]:
            m.stop()  # What a try before has left.
            m.wait_until_idle()
            first = m.now() + 5.0
            ordered = [(at, m.play("pin-60", 0.02, at=at)) for at in (first + 0.1 * n for n in range(10))]
            for _, play in ordered:
                play.wait()
            return [(at, play.onset) for at, play in ordered]

        plays = kept(ten) + kept(ten)
        ticks_ns = []
        for at, onset in plays:
            truth = client_at(onset.host_ns)
            error = abs(onset.monotonic_ns - truth) / 1e9
            assert error <= onset.monotonic_uncertainty
            assert onset.monotonic_uncertainty < 0.025
            assert abs(onset.monotonic - at) <= 0.025
            ticks_ns.append((onset.host_ns - onset.tick * 1_000_000_000 / HZ, onset.host_uncertainty * 1e9))
        # The simulated device counts exactly 85 000 ticks per second of the daemon's clock from an unknown instant on:
        # one such instant must fit all onsets. The daemon's uncertainty is that of its shortest round trip to the device, and it
        # takes round trips that waited 20 us longer, too: so each may err by some more than that on a busy machine.
        low = max(start - width for start, width in ticks_ns)
        high = min(start + width for start, width in ticks_ns)
        assert low <= high + 200_000


def test_a_daemon_that_was_restarted_is_noticed(tmp_path: Path) -> None:
    with meissner.Daemon() as first, Network(first.socket) as network, meissner.connect(network.url) as m:
        m.arm(assume_rest=True, checked="a test")
        play = m.play("pin-60", 0.05)
        play.wait()
        with meissner.Daemon() as second:
            network.socket = second.socket
            network.cut()
            with pytest.raises(errors.DaemonRestarted, match="arm again"):
                play.wait()
            assert m.status().raw["daemon"]["pid"] == second.pid
            with meissner.connect(second.socket) as other:
                other.arm(assume_rest=True, checked="a test")
                repeated = other.play("pin-60", 0.05)
                repeated.wait()
            assert repeated.id == play.id
            with pytest.raises(errors.DaemonRestarted):
                play.wait()
            m.core.has_armed = False


def test_numbers_may_be_those_of_numpy(m: meissner.Client) -> None:
    given: dict[str, Any] = {
        "seconds": numpy.float32(0.1),
        "scale": numpy.float32(0.5),
        "trigger": numpy.int64(5),
        "trial": numpy.int32(3),
        "strict": numpy.bool_(True),
        "hold": numpy.float32(0.5),
    }
    receipt = kept(lambda: m.play("pin-60", at=numpy.float64(m.now() + 2.0), **given).wait())
    (item_of,) = receipt.raw["items"]
    assert (receipt.raw["order"]["trial"], item_of["scale"], item_of["trigger"]["code"]) == (3, 0.5, 5)
    item: meissner.SequenceItem = {"pattern": "pin-60", "scale": numpy.float32(0.5), "trigger": numpy.uint8(2)}
    items = m.sequence([item, item], seconds=numpy.float32(0.05), isi=numpy.float64(0.1)).wait().items
    assert [of.scale for of in items] == [0.5, 0.5]
    drives = [{"motor": numpy.int64(9), "frequency_hz": numpy.float32(60), "amplitude_um": numpy.int16(40)}]
    given = {"drives": drives, "seconds": numpy.float64(0.1), "trigger": numpy.False_}
    assert m.play(**given).wait().items[0].raw["trigger"] is None
    with pytest.raises(TypeError, match="`seconds` is 1j: must be a number"):
        m.play("pin-60", 1j)  # type: ignore[arg-type]


def test_an_onset_by_another_clock_is_refused(m: meissner.Client) -> None:
    for at, name in [
        (time.time() + 0.5, r"time\.time\(\)"),
        (time.time_ns(), r"time\.time_ns\(\)"),
        (time.monotonic_ns() + 500_000_000, r"time\.monotonic_ns\(\)"),
    ]:
        with pytest.raises(ValueError, match=rf"is a time of `{name}`: give seconds of `time\.monotonic\(\)`"):
            m.play("pin-60", 0.1, at=at)


def test_without_a_daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(errors.Unreachable, match="start one with `meissner daemon`") as raised:
        meissner.connect(tmp_path / "none.sock")
    assert "\n" not in str(raised.value)
    assert len([line for line in traceback.format_exception(raised.value) if line.startswith("Traceback")]) == 1
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for variable in ("MEISSNER_SOCKET", "MEISSNER_URL"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr("meissner._endpoint.SERVICE_SOCKET", str(tmp_path / "service.sock"))
    with pytest.raises(errors.Unreachable, match=r"meissner\.sock, nor at .*service\.sock.*demo"):
        meissner.connect()
    monkeypatch.setenv("MEISSNER_SOCKET", str(tmp_path / "named.sock"))
    with pytest.raises(errors.Unreachable, match=r"at .*named\.sock \("):
        meissner.connect()
    monkeypatch.setenv("MEISSNER_URL", "http://127.0.0.1:9")
    with pytest.raises(errors.Unreachable, match=r"http://127\.0\.0\.1:9"):
        meissner.connect()


def test_a_daemon_that_goes_leaves_a_warning_and_no_wrong_error() -> None:
    # A sign of life every second: of a session that is open to others it is one in half a minute.
    daemon = meissner.Daemon("session_silence_s = 4\n")
    with pytest.raises(ZeroDivisionError), pytest.warns(UserWarning, match="may be armed still"):
        with meissner.connect(daemon.socket, reconnect=0.1) as m:
            m.arm(assume_rest=True, checked="a test")
            session = m.session("P07", exclusive=True)
            os.kill(daemon.pid, signal.SIGKILL)
            daemon._process.wait()
            deadline = time.monotonic() + 120
            while session.heartbeat_problem is None and time.monotonic() < deadline:
                time.sleep(0.01)
            assert session.heartbeat_problem is not None
            _ = 1 / 0
    with pytest.raises(errors.ProgramError, match="has ended"):
        daemon.check()
    daemon.close()


def test_over_tcp_with_tokens() -> None:
    with meissner.Daemon('listen = "127.0.0.1:0"\nlisten_token = "always"\n') as daemon:
        with meissner.connect(daemon.socket) as watcher:
            url = watcher.status().raw["daemon"]["network"]["address"]

        def token(role: str) -> str:
            command = [
                find_program(),
                "token",
                "create",
                "--role",
                role,
                "--name",
                role,
                "--json",
                "--socket",
                daemon.socket,
            ]
            made = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
            return str(made["token"])

        with pytest.raises(errors.Unauthorized, match="token=") as refused:
            meissner.connect(f"http://{url}")
        assert refused.value.status == 401
        with meissner.connect(f"http://{url}", token=token("observe")) as reader:
            with pytest.raises(errors.Forbidden, match="operate"):
                reader.arm()
            with meissner.connect(f"http://{url}", token=token("operate")) as m:
                assert m.core.clock.is_shared
                m.arm(assume_rest=True)
                with m.session("P07", exclusive=True):
                    assert m.play("pin-60", 0.05).wait().state == "done"
                    with m.live(drives=[], timeout=20.0) as live:
                        assert live.keep().wait(20.0).state == "applied"
                        m.core.token, own = None, m.core.token
                        with pytest.raises(errors.Unauthorized):
                            Live(m.core, Started(live._accepted, "/v1/live/0123"))
                        m.core.token = own
                    with meissner.connect(daemon.socket) as other, pytest.raises(errors.SessionExclusive):
                        other.play("pin-60", 0.05)
                    m.estop()
                    assert m.status().state == "faulted"
