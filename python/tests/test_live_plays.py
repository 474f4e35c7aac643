"""Live plays against a real daemon, and against one that does not read or answer."""

from __future__ import annotations

import gc
import json
import math
import shutil
import socket
import ssl
import subprocess
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.server import ServerConnection, unix_serve

import meissner
from meissner import _live, errors, live
from meissner._endpoint import Endpoint
from meissner._live import WINDOW, Started, Updates
from meissner._operations import Accepted
from meissner._transport import tls
from network import Network

HZ = 85_000
PATIENT = 20.0
"""A stall of a busy machine must not end a play, s."""


@pytest.fixture(scope="module")
def shared_daemon() -> Iterator[meissner.Daemon]:
    """With a shorter lead than that of other tests: the line carries the updates of a live object."""
    with meissner.Daemon() as daemon:
        yield daemon


def drive(amplitude_um: float, motor: int = 9) -> dict[str, Any]:
    return {"motor": motor, "frequency_hz": 60.0, "amplitude_um": amplitude_um}


DRIVES = [drive(40.0)]


def until_refused(call: Callable[[], object]) -> None:
    """Calls until that raises. The daemon's word comes by another thread."""
    deadline = time.monotonic() + PATIENT
    while time.monotonic() < deadline:
        call()
        time.sleep(0.005)


def test_pins_follow_an_object(m: meissner.Client) -> None:
    bar = {"kind": "object", "name": "bar", "shape": "bar", "length_mm": 12, "width_mm": 0.8}
    with m.live(object={**bar, "touch": {"press": {"depth_um": 500}}}, timeout=PATIENT, open_loop=True) as play:
        pressed = play.pose(y_mm=0.8).wait(PATIENT)
        assert None not in pressed.ticks
        with pytest.raises(errors.BadRequest, match=r"28\.3 mm from the array's middle"):
            play.pose(20.0, 20.0).wait(PATIENT)
        assert play.pose(y_mm=0.8, depth_um=0).wait(PATIENT).state == "applied"
    assert play.receipt is not None
    assert play.receipt.raw["live"]["applied"] == 2
    assert len(play.receipt.raw["pins"]["moved"]) > 3


def test_drives_follow_and_say_when(m: meissner.Client) -> None:
    # A machine that stands still makes strokes late: then again.
    assert 0 in (late_strokes_of_drives_that_follow(m) for _ in range(5))


def late_strokes_of_drives_that_follow(m: meissner.Client) -> int:
    with m.live(drives=DRIVES, timeout=PATIENT, trial=4, labels={"what": "knob"}) as play:
        assert (play.pattern, play.ordered_s) == ("live", None)
        update = play.set(9, frequency_hz=60, amplitude_um=60)
        first = update.wait(PATIENT)
        assert (first.state, first.merged_into, update.is_answered) == ("applied", None, True)
        assert repr(update) == "<update 1: applied>"
        assert first.onset is not None
        assert first.ticks == (None,) * 9 + (first.onset.tick,) + (None,) * 14
        assert abs(first.onset.monotonic - m.now()) < PATIENT
        second = play.send(drives=[drive(30), drive(20, motor=10)], scale=0.5).wait(PATIENT)
        assert [motor for motor, tick in enumerate(second.ticks) if tick] == [9, 10]
        assert play.scale(0.4).wait(PATIENT).onset is not None
        assert play.drives([drive(25.0)]).wait(PATIENT).onset is not None
        kept = play.keep().wait(PATIENT)
        assert (kept.state, kept.onset, any(kept.ticks)) == ("applied", None, False)
        assert play.refresh().state == "running"
    receipt = play.receipt
    assert (receipt.state, receipt.cause) == ("stopped", "stop")
    assert (receipt.raw["live"]["updates"], receipt.raw["live"]["applied"]) == (5, 5)
    assert (receipt.raw["order"]["trial"], receipt.raw["order"]["labels"]) == (4, {"what": "knob"})
    assert play.wait() == receipt
    # The tick of an update and that of the onset become times by different ways.
    apart = (first.onset.tick - play.onset.tick) / HZ
    uncertainty = first.onset.monotonic_uncertainty + play.onset.monotonic_uncertainty
    assert abs(first.onset.monotonic - play.onset.monotonic - apart) <= uncertainty + apart * 200e-6 + 200e-6
    assert first.onset.boot == play.onset.boot
    assert m.status().state == "armed"
    return receipt.late


def test_a_refusal_reaches_who_waits_else_the_next_call(m: meissner.Client) -> None:
    with m.live(drives=DRIVES, timeout=PATIENT) as play:
        update = play.set(9, frequency_hz=100, amplitude_um=40)
        with pytest.raises(errors.BadRequest, match="at most 60 Hz"):
            update.wait(PATIENT)
        with pytest.raises(errors.BadRequest):
            update.wait()
        assert repr(update) == "<update 1: failed>"
        # Waited for: no call repeats it.
        with pytest.raises(errors.BadRequest, match="500"):
            play.set(9, frequency_hz=60, amplitude_um=500).wait(PATIENT)
        assert play.keep().wait(PATIENT).state == "applied"
        # Not waited for: a later call raises it, once.
        play.pose(1.0)
        with pytest.raises(errors.BadRequest, match="`pose` is that of an object"):
            until_refused(play.keep)
        assert play.keep().wait(PATIENT).state == "applied"
        # What is no JSON is not sent.
        with pytest.raises(ValueError, match="must be a finite number"):
            play.scale(math.nan)
        with pytest.raises(TypeError):
            play.drives([{"motor": object()}])
        assert play.scale(0.5).wait(PATIENT).state == "applied"
    with pytest.raises(errors.BadRequest, match="object"):
        with m.live(drives=DRIVES, timeout=PATIENT) as play:
            play.pose(1.0)
    assert play.receipt.cause == "stop"


def test_starts_that_are_refused(m: meissner.Client) -> None:
    for arguments, kind in [
        ({"object": "no-such"}, errors.NotFound),
        ({"object": "edge-45", "drives": DRIVES}, errors.BadRequest),
        ({"timeout": 0.01}, errors.BadRequest),
        ({"drives": [drive(500)]}, errors.BadRequest),
    ]:
        with pytest.raises(kind):
            m.live(**arguments)  # type: ignore[arg-type]
    accepted = Accepted(1, "live", None, None)
    with pytest.raises(errors.NotFound, match="no live play has this key"):
        live.Live(m.core, Started(accepted, "/v1/live/0123"))
    m.disarm()
    with pytest.raises(errors.Disarmed):
        m.live(drives=DRIVES)


def test_silence_ends_it(m: meissner.Client) -> None:
    """No thread shows that the program is alive: only its own calls do."""
    with pytest.raises(meissner.PlayStopped, match="client-silent"):
        with m.live(drives=DRIVES, timeout=0.2) as play:
            play.keep()
            with pytest.raises(meissner.PlayStopped) as stopped:
                play.wait(PATIENT)
            assert stopped.value.receipt.cause == "client-silent"
            assert play.wait(check=False).cause == "client-silent"
            for _ in range(2):
                with pytest.raises(meissner.PlayStopped, match="client-silent"):
                    play.keep()
    # It has begun nothing: nobody called.
    with pytest.raises(meissner.PlayStopped):
        m.live(drives=DRIVES, timeout=0.1).wait(PATIENT)


def test_calls_keep_it_alive(m: meissner.Client) -> None:
    with m.live(drives=DRIVES, timeout=5.0) as play:
        with pytest.raises(TimeoutError, match="call `end"):
            play.wait(0.01)
        until = time.monotonic() + 8.0
        while time.monotonic() < until:
            play.keep()
            time.sleep(0.05)
    assert play.receipt.cause == "stop"


def test_an_emergency_stop_in_mid_play(m: meissner.Client, daemon: meissner.Daemon) -> None:
    with meissner.connect(daemon.socket) as other, pytest.raises(meissner.PlayStopped, match="estop") as stopped:
        with m.live(drives=DRIVES, timeout=PATIENT) as play:
            play.keep().wait(PATIENT)
            other.estop()
            until_refused(lambda: play.scale(0.5))
    assert stopped.value.receipt.cause == "estop"
    assert play.receipt.cause == "estop"
    with pytest.raises(meissner.PlayStopped):
        play.end()
    assert m.status().state == "faulted"


def test_a_stop_from_elsewhere_is_raised_at_the_end_at_the_latest(m: meissner.Client, daemon: meissner.Daemon) -> None:
    with meissner.connect(daemon.socket) as other, pytest.raises(meissner.PlayStopped):
        with m.live(drives=DRIVES, timeout=PATIENT) as play:
            other.stop()
            play.wait(PATIENT, check=False)
    with pytest.raises(meissner.PlayStopped):
        play.wait()


def test_an_exception_in_the_block_ends_it_and_is_not_hidden(m: meissner.Client) -> None:
    with pytest.raises(ZeroDivisionError):
        with m.live(drives=DRIVES, timeout=PATIENT) as play:
            play.pose(1.0)
            _ = 1 / 0
    assert (play.receipt.state, play.receipt.cause) == ("stopped", "stop")
    m.wait_until_idle()


def test_one_live_play_at_a_time_and_each_once(m: meissner.Client) -> None:
    with m.live(drives=DRIVES, timeout=PATIENT) as play:
        with pytest.raises(errors.Playing):
            m.live(drives=DRIVES)
        assert play.keep().wait(PATIENT).state == "applied"
        play.end()
        play.end()
        with pytest.raises(ValueError, match="start another one"):
            play.keep()
    with pytest.raises(ValueError, match="start another one"), play:
        pass
    with pytest.raises(meissner.PlayStopped, match="stop"):
        with (
            m.live(drives=DRIVES, timeout=PATIENT) as first,
            m.live(drives=DRIVES, timeout=PATIENT, replace=True) as second,
        ):
            assert second.keep().wait(PATIENT).state == "applied"
            assert first.wait(PATIENT, check=False).state == "stopped"
    assert second.receipt.cause == "stop"


def test_nothing_stays_when_nobody_waits(m: meissner.Client) -> None:
    with m.live(drives=DRIVES, timeout=PATIENT) as play:
        refs, most = [], 0
        for number in range(1500):
            refs.append(weakref.ref(play.set(9, frequency_hz=60, amplitude_um=number % 80)))
            most = max(most, len(play._updates.under_way))
            if number % 10 == 0:
                play.keep().wait(PATIENT)
        play.keep().wait(PATIENT)
        deadline = time.monotonic() + PATIENT
        while play._updates.under_way and time.monotonic() < deadline:
            time.sleep(0.01)
        gc.collect()
        assert [ref for ref in refs if ref() is not None] == []
        assert most <= WINDOW
    assert play._updates.under_way == {}


def test_threads_may_share_it(m: meissner.Client) -> None:
    with m.live(drives=DRIVES, timeout=PATIENT) as play:
        states: list[str] = []

        def move(motor: int) -> None:
            for step in range(20):
                states.append(play.drives([drive(step, motor)]).wait(PATIENT).state)

        threads = [threading.Thread(target=move, args=(motor,)) for motor in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(4 * PATIENT)
    assert len(states) == 80
    assert set(states) <= {"applied", "merged"}


def test_in_a_session(m: meissner.Client) -> None:
    with m.session("P07", exclusive=True) as session:
        with m.live(drives=DRIVES, timeout=PATIENT) as play:
            assert play.keep().wait(PATIENT).state == "applied"
    assert play.receipt.raw["order"]["session"] == session.id


def certificate(folder: Path) -> tuple[ssl.SSLContext, Path]:
    """What a server shows, and the file of what its client has to trust."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    key, made = folder / "key.pem", folder / "certificate.pem"
    options = "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost -addext subjectAltName=IP:127.0.0.1"
    command = ["openssl", *options.split(), "-keyout", str(key), "-out", str(made)]
    subprocess.run(command, check=True, capture_output=True)
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(made, key)
    return server, made


@pytest.fixture
def fresh_trust() -> Iterator[None]:
    """What the clients of the other tests trust has been read, and is not used here."""
    tls.cache_clear()
    yield
    tls.cache_clear()


def test_over_tls(daemon: meissner.Daemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fresh_trust: None) -> None:
    """The daemon's PC may have a proxy with TLS, and an authority that only the lab trusts."""
    server, trusted = certificate(tmp_path)
    with Network(daemon.socket, tls=server) as network:
        with pytest.raises(errors.Unreachable, match="certificate"):
            meissner.connect(network.url)
        tls.cache_clear()
        monkeypatch.setenv("SSL_CERT_FILE", str(trusted))
        with meissner.connect(network.url) as m:
            m.arm(assume_rest=True, checked="a test")
            with m.live(drives=DRIVES, timeout=PATIENT) as play:
                updates = [play.set(9, frequency_hz=60, amplitude_um=number % 80) for number in range(200)]
                assert {update.wait(PATIENT).state for update in updates} <= {"applied", "merged"}
            assert play.receipt.cause == "stop"


def is_lost(error: BaseException) -> bool:
    """Whether the connection is why: the daemon may have had time to say what became of the play, or not."""
    return isinstance(error, errors.ConnectionLost) or isinstance(error.__cause__, errors.ConnectionLost)


def test_a_lost_connection_ends_it(network: Network) -> None:
    with meissner.connect(network.url) as m:
        m.arm(assume_rest=True, checked="a test")
        with pytest.raises((meissner.PlayStopped, errors.ConnectionLost)) as stopped:
            with m.live(drives=DRIVES, timeout=PATIENT) as play:
                play.keep().wait(PATIENT)
                network.cut()
                until_refused(play.keep)
        assert is_lost(stopped.value)
        assert play.wait(PATIENT, check=False).cause == "stop"


def test_a_daemon_that_shuts_down(tmp_path: Path) -> None:
    daemon = meissner.Daemon()
    with pytest.raises(errors.MeissnerError), pytest.warns(UserWarning, match="may be armed still"):
        with meissner.connect(daemon.socket, reconnect=0.1) as m:
            m.arm(assume_rest=True, checked="a test")
            with m.live(drives=DRIVES, timeout=PATIENT) as play:
                play.keep().wait(PATIENT)
                daemon.close()
                until_refused(play.keep)


def test_a_client_that_is_closed_first(daemon: meissner.Daemon) -> None:
    m = meissner.connect(daemon.socket)
    m.arm(assume_rest=True, checked="a test")
    play = m.live(drives=DRIVES, timeout=PATIENT)
    m.close()
    with pytest.raises(errors.MeissnerError):
        until_refused(play.keep)


def live_at(m: meissner.Client, endpoint: Endpoint) -> live.Live:
    """Opens the connection of a live play elsewhere."""
    own, m.core.endpoint = m.core.endpoint, endpoint
    try:
        return live.Live(m.core, Started(Accepted(999_999, "live", None, None), "/v1/live/0123"))
    finally:
        m.core.endpoint = own


class Deaf:
    """A daemon that takes a live play's connection, and then reads and answers only when it is told to."""

    def __init__(self, folder: Path) -> None:
        self._path = str(folder / "deaf.sock")
        self._taken, self._over = threading.Event(), threading.Event()
        self._server = unix_serve(self._take, self._path)
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _take(self, connection: ServerConnection) -> None:
        self.connection = connection
        self._taken.set()
        self._over.wait()

    def read(self) -> Any:
        return json.loads(self.connection.recv(PATIENT))

    def say(self, **answer: Any) -> None:
        self.connection.send(json.dumps(answer))

    def live(self, m: meissner.Client) -> live.Live:
        play = live_at(m, Endpoint("http://meissner", self._path))
        assert self._taken.wait(PATIENT)
        return play

    def close(self) -> None:
        self._over.set()
        self._server.shutdown()


APPLIED = {"received_tick": 1, "from_tick": 2, "ticks": [None] * 24, "repeats": 0}


def test_a_daemon_that_does_not_read_keeps_a_program_waiting_for_a_bounded_time(
    m: meissner.Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deaf = Deaf(tmp_path)
    play = deaf.live(m)
    drives = [drive(79.123456789, motor) for motor in range(24)]
    for _ in range(WINDOW):
        update = play.drives(drives)
    with pytest.raises(TimeoutError, match="wait longer"):
        update.wait(0.01)
    monkeypatch.setattr(live, "END_TIMEOUT", 0.1)
    with pytest.raises(errors.ConnectionLost, match="has not answered live play 999999"):
        play.keep()
    for number in range(WINDOW):
        message = deaf.read()
        assert (message["seq"], len(message["drives"])) == (number + 1, 24)
    monkeypatch.setattr(live, "END_TIMEOUT", PATIENT)
    deaf.say(seq=2, applied=APPLIED)
    newest = play.scale(0.5)
    assert deaf.read() == {"seq": newest.seq, "scale": 0.5}
    deaf.say(seq=WINDOW, merged_into=newest.seq)
    assert update.wait(PATIENT).state == "merged"
    sent = [play.keep()]
    deaf.close()
    with pytest.raises(errors.ConnectionLost):
        until_refused(lambda: sent.append(play.keep()))
    for unanswered in (newest, sent[-1]):
        with pytest.raises(errors.ConnectionLost):
            unanswered.wait(PATIENT)


def test_a_daemon_that_does_not_end_it(m: meissner.Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "END_TIMEOUT", 0.1)
    deaf = Deaf(tmp_path)
    with pytest.raises(errors.ConnectionLost, match="has not ended live play 999999"), deaf.live(m):
        pass
    assert deaf.read() == {"seq": 1, "end": True}
    deaf.close()


@pytest.mark.parametrize("said", ["nonsense", '{"seq": 1, "problem": {}}', "[]"])
def test_answers_that_cannot_be_read_end_it(m: meissner.Client, tmp_path: Path, said: str) -> None:
    deaf = Deaf(tmp_path)
    play = deaf.live(m)
    deaf.connection.send(said)
    with pytest.raises(errors.ConnectionLost, match="cannot be read"):
        until_refused(play.keep)
    deaf.close()


@pytest.mark.parametrize(
    ("head", "kind"),
    [
        (b"HTTP/1.1 404 Not Found\r\ncontent-length: 21\r\n\r\n" + b'{"code": "not-found"}', errors.NotFound),
        (b"HTTP/1.1 502 Bad Gateway\r\n\r\n", errors.ApiError),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}", errors.UnexpectedAnswer),
        (b"SSH-2.0-OpenSSH\r\n\r\n", errors.UnexpectedAnswer),
        (b"x" * 70_000, errors.UnexpectedAnswer),
        (b"HTTP/1.1 101 Switching Protocols\r\n\r\n", errors.UnexpectedAnswer),
        (b"", errors.ConnectionLost),
    ],
)
def test_a_connection_that_is_not_upgraded(
    m: meissner.Client, tmp_path: Path, head: bytes, kind: type[Exception]
) -> None:
    path = str(tmp_path / "other.sock")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(path)
        server.listen()

        def answer() -> None:
            with server.accept()[0] as connection:
                while not connection.recv(65536).endswith(b"\r\n\r\n"):
                    pass
                connection.sendall(head)

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(kind):
            live_at(m, Endpoint("http://meissner", path))
        thread.join()


def test_where_no_daemon_is(m: meissner.Client, tmp_path: Path) -> None:
    for endpoint in (Endpoint("http://meissner", str(tmp_path / "none.sock")), Endpoint("http://127.0.0.1:9")):
        with pytest.raises(errors.Unreachable, match="start one"):
            live_at(m, endpoint)


def test_the_address_keeps_host_and_path() -> None:
    there = Endpoint("https://user@lab-pc:8765/display")
    assert _live.address(there, "/v1/live/0123") == "wss://lab-pc:8765/display/v1/live/0123"


def test_a_refusal_belongs_to_its_message() -> None:
    updates = Updates(7, None, lambda update, timeout: pytest.fail("nobody waits by a connection"))

    def take(**answer: Any) -> None:
        updates.take(json.dumps(answer))

    def refusal(detail: str) -> dict[str, Any]:
        return {"code": "bad-request", "status": 400, "detail": detail}

    one, first, second = (updates.message(None, None, scale)[0] for scale in (0.5, 4.0, 5.0))
    updates.wait_begins(first)
    take(seq=2, problem=refusal("4 is too much"))
    take(seq=3, problem=refusal("5 is too much"))
    take(seq=1, applied=APPLIED)
    assert updates.answer(one)["applied"] == APPLIED
    with pytest.raises(errors.BadRequest, match="4 is too much"):
        updates.answer(first)
    # Nobody waited for the other one: the next message raises it, once.
    with pytest.raises(errors.BadRequest, match="5 is too much"):
        updates.message(None, None, None)
    with pytest.raises(errors.BadRequest, match="5 is too much"):
        updates.answer(second)
    late, message = updates.message(None, None, None)
    assert message == '{"seq": 4}'
    # What came too late for the play is no problem of its own.
    take(seq=4, problem={"code": "not-found", "status": 404, "detail": "the live play is over"})
    take(seq=None, ended="stop")
    updates.raise_problem()
    assert not late.is_answered
    updates.over(None)
    with pytest.raises(errors.NotFound, match="is over"):
        updates.answer(late)
    # The daemon has given up on the connection.
    with pytest.raises(errors.ApiError, match="has given up"):
        take(seq=None, problem={"code": "bad-request", "status": 400, "detail": "has given up"})
