"""However a script ends, its motors are off: real processes, judged by the daemon.

Nothing here depends on how fast a process is: a test waits until the daemon says so, for `PATIENT` s at most.
"""

from __future__ import annotations

import os
import signal
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import meissner
from meissner._endpoint import Endpoint
from meissner._transport import BlockingTransport, tls
from meissner.results import Status

PATIENT = 120.0
BEGIN = """
import asyncio, hashlib, multiprocessing, os, signal, subprocess, sys, threading, time
import meissner
for number in (signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_DFL)  # `nohup` has it ignored.
def ready():
    print("ready", flush=True)
def arm(m):
    m.arm(assume_rest=True, checked="a test", silence=SILENCE)
    return m
def armed():
    return arm(meissner.connect(sys.argv[1]))
def blocked():
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)  # A C call of some minutes, which no signal interrupts.
"""


@contextmanager
def script(
    code: str, *arguments: str, options: tuple[str, ...] = (), silence: float = 600.0
) -> Iterator[subprocess.Popen[str]]:
    """Runs this in a Python of its own until it prints `ready`."""
    # Coverage would handle SIGTERM itself.
    variables = {key: value for key, value in os.environ.items() if not key.startswith("COVERAGE")}
    child = subprocess.Popen(
        [sys.executable, *options, "-c", f"SILENCE = {silence}\n{BEGIN}{code}", *arguments],
        env=variables,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with child:
        try:
            assert child.stdout is not None
            line = child.stdout.readline()
            assert line == "ready\n", line + child.communicate()[1]
            yield child
        finally:
            child.kill()


def until(daemon: meissner.Daemon, is_so: Callable[[Status], bool]) -> Status:
    """The status of the daemon, as soon as this is so."""
    with meissner.connect(daemon.socket) as watcher:
        deadline = time.monotonic() + PATIENT
        while not is_so(state := watcher.status()):
            assert time.monotonic() < deadline, state
            time.sleep(0.02)
        return state


def is_off(state: Status) -> bool:
    return state.state == "disarmed"


def last_play(daemon: meissner.Daemon) -> str:
    with meissner.connect(daemon.socket) as watcher:
        watcher.wait_until_idle()
        return watcher.receipt().state


ASYNC = """
async def main():
    with armed() as m:
        {}
asyncio.run(main())
"""
PHASES = {
    "idle": "with armed() as m:\n ready()\n time.sleep(600)",
    "without with": "m = armed()\nready()\ntime.sleep(600)",
    "mid play": "m = armed()\nm.play('pin-60', endless=True)\nready()\ntime.sleep(600)",
    "in wait": "with armed() as m:\n play = m.play('pin-60', endless=True)\n ready()\n play.wait()",
    "in a session": "with armed() as m, m.session('P07', exclusive=True):\n"
    " m.play('pin-60', endless=True)\n ready()\n m.wait_until_idle()",
    "in a live play": "with armed() as m, m.live(drives=[{'motor': 9, 'frequency_hz': 60.0, 'amplitude_um': 40.0}], timeout=60):\n"
    " ready()\n time.sleep(600)",
    "in events": "with armed() as m:\n for event in m.events():\n  ready()",
    "in a thread's wait": "m = armed()\nthread = threading.Thread(target=m.play('pin-60', endless=True).wait, daemon=True)\n"
    "thread.start()\nready()\nthread.join()",
    "in input": "m = armed()\nready()\ninput()",
    "asyncio": ASYNC.format("ready(); await asyncio.sleep(600)"),
    "asyncio, in wait": ASYNC.format(
        "play = m.play('pin-60', endless=True); ready(); await asyncio.to_thread(play.wait)"
    ),
}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("phase", PHASES)
def test_a_signal_ends_a_script_in_good_order(daemon: meissner.Daemon, phase: str, number: signal.Signals) -> None:
    with script(PHASES[phase], daemon.socket) as child:
        until(daemon, lambda state: state.state == "armed")
        child.send_signal(number)
        _, errors = child.communicate(timeout=PATIENT)
    assert child.returncode == 128 + number, errors
    state = until(daemon, is_off)
    assert state.raw["session"] is None
    if "endless" in PHASES[phase] or "live" in PHASES[phase]:
        assert last_play(daemon) == "stopped"


KEEPS_GOING = {
    "a C call": "blocked()",
    "a handler of SystemExit": "try:\n time.sleep(600)\nexcept SystemExit:\n print('caught', flush=True)\ntime.sleep(600)",
    "a `finally` that goes on": "try:\n time.sleep(600)\nfinally:\n time.sleep(600)",
}


@pytest.mark.parametrize("why", KEEPS_GOING)
def test_the_motors_are_off_although_the_program_goes_on(daemon: meissner.Daemon, why: str) -> None:
    with script(f"m = armed()\nm.play('pin-60', endless=True)\nready()\n{KEEPS_GOING[why]}", daemon.socket) as child:
        until(daemon, lambda state: state.playing is not None)
        if why == "a C call":
            time.sleep(0.5)  # If the call has not begun by then, this test shows less.
        child.send_signal(signal.SIGTERM)
        until(daemon, is_off)
        assert last_play(daemon) == "stopped"
        assert child.poll() is None


def test_the_second_signal_does_not_cut_the_end(daemon: meissner.Daemon) -> None:
    """A terminal that is closed sends SIGHUP twice; what `finally` writes must be whole."""
    code = (
        "try:\n with armed() as m:\n  ready()\n  time.sleep(600)\nfinally:\n for line in range(20):\n"
        "  os.kill(os.getpid(), signal.SIGHUP); os.kill(os.getpid(), signal.SIGTERM); print(line, flush=True)"
    )
    with script(code, daemon.socket) as child:
        child.send_signal(signal.SIGHUP)
        out, errors = child.communicate(timeout=PATIENT)
    assert (child.returncode, out.split()) == (129, [str(line) for line in range(20)]), errors
    until(daemon, is_off)


def test_ctrl_c_in_the_middle_of_the_end_does_not_leave_the_motors_armed(daemon: meissner.Daemon) -> None:
    code = """
from meissner import _operations as ops
m = armed()
leave = ops.leave
def interrupted(core):
    ops.leave = leave
    raise KeyboardInterrupt
ops.leave = interrupted
ready()
with m:
    pass
"""
    with script(code, daemon.socket) as child:
        child.communicate(timeout=PATIENT)
    assert child.returncode in (1, 130, -signal.SIGINT)
    until(daemon, is_off)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_shell_as_before_with_the_motors_off(daemon: meissner.Daemon, number: signal.Signals) -> None:
    with script("m = armed()\nd = meissner.demo()\nready()", daemon.socket, options=("-i",)) as child:
        child.send_signal(number)
        child.communicate(timeout=PATIENT)
    assert child.returncode == -number
    until(daemon, is_off)


def test_a_signal_ends_the_programs_own_daemon() -> None:
    code = "m = meissner.demo()\nready()\nat = m.status().raw['daemon']\nprint(at['pid'], at['socket'], flush=True)\ntime.sleep(600)"
    with script(code) as child:
        assert child.stdout is not None
        pid, socket = child.stdout.readline().split()
        child.send_signal(signal.SIGTERM)
        _, errors = child.communicate(timeout=PATIENT)
    assert child.returncode == 143, errors
    assert not Path("/proc", pid).exists()
    assert not Path(socket).parent.exists()


OTHERS = """
told = []
def own(number, frame):
    told.append(number)
def handlers():
    return [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)]
default = [signal.SIG_DFL] * 2
"""


def test_handlers_of_the_program_stay_and_ours_go_with_the_last_client(daemon: meissner.Daemon) -> None:
    code = (
        OTHERS
        + """
with armed():
    assert handlers() != default
    with meissner.connect(sys.argv[1]):
        pass
    assert handlers() != default
assert handlers() == default, handlers()
assert signal.set_wakeup_fd(-1) == -1

signal.signal(signal.SIGTERM, own)
signal.signal(signal.SIGHUP, signal.SIG_IGN)
with armed() as m:
    assert handlers() == [own, signal.SIG_IGN]
    for number in (signal.SIGTERM, signal.SIGHUP):
        os.kill(os.getpid(), number)
    assert told == [signal.SIGTERM] and m.status().state == "armed"
assert handlers() == [own, signal.SIG_IGN]

signal.signal(signal.SIGTERM, signal.SIG_DFL)
with armed() as m:
    signal.signal(signal.SIGTERM, own)  # Later than the client.
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.2)
    assert told == [signal.SIGTERM] * 2 and m.status().state == "armed"
assert handlers() == [own, signal.SIG_IGN]

async def main():
    loop, asked = asyncio.get_running_loop(), asyncio.Event()
    with armed() as m:
        loop.add_signal_handler(signal.SIGTERM, asked.set)
        os.kill(os.getpid(), signal.SIGTERM)
        await asked.wait()
        assert m.status().state == "armed"
    loop.remove_signal_handler(signal.SIGTERM)
asyncio.run(main())

other = threading.Thread(target=lambda: armed().close())  # Python lets no other thread set handlers.
other.start(); other.join()
assert threading.active_count() < 10
ready()
"""
    )
    with script(code, daemon.socket) as child:
        _, errors = child.communicate(timeout=PATIENT)
    assert (child.returncode, errors) == (0, "")


def test_children_of_the_program_end_nothing_of_it(daemon: meissner.Daemon) -> None:
    """A forked child has a copy of the client, of its handlers and of the exit handlers."""
    code = (
        OTHERS
        + """
import warnings
warnings.simplefilter("ignore")  # Python 3.12 warns of a fork beside threads.
def job():
    time.sleep(600)
if __name__ == "__main__":
    own_daemon = meissner.demo()
    folder = os.path.dirname(own_daemon.status().raw["daemon"]["socket"])
    with armed() as m, m.session("P07") as session:
        child = os.fork()
        if child == 0:
            assert handlers() == default
            sys.exit(0)  # Its `with` blocks and exit handlers run.
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        for _ in range(20):  # The signal may come while Python forks.
            process = multiprocessing.get_context("fork").Process(target=job)
            process.start()
            process.terminate()
            process.join()
            assert process.exitcode == -signal.SIGTERM, process.exitcode
        assert m.status().state == "armed" and m.status().raw["session"]["id"] == session.id
        assert own_daemon.status().state == "armed" and os.path.exists(folder)
        m.play("pin-60", 0.05).wait()
    own_daemon.close()
    assert not os.path.exists(folder)
    ready()
"""
    )
    with script(code, daemon.socket) as child:
        _, errors = child.communicate(timeout=PATIENT)
    assert (child.returncode, errors) == (0, "")


def test_only_the_first_client_with_tls_reads_certificates(
    daemon: meissner.Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The end of a forked child sets back the file that another thread reads, as the one of the signs of life did."""
    read: list[ssl.SSLContext] = []
    load = ssl.SSLContext.load_verify_locations

    def counted(context: ssl.SSLContext, *arguments: str, **options: str) -> None:
        read.append(context)
        load(context, *arguments, **options)

    monkeypatch.setattr(ssl.SSLContext, "load_verify_locations", counted)
    tls.cache_clear()
    with meissner.connect(daemon.socket) as m, meissner.connect(daemon.socket) as other:
        m.arm(assume_rest=True, checked="a test", silence=600.0)
        assert other.status().state == "armed"
    assert read == []
    for _ in range(3):
        BlockingTransport(Endpoint("https://lab-pc"), dict, time.monotonic_ns).close()
    assert read == [tls()]


@pytest.mark.parametrize("phase", ["idle", "mid play", "in a session", "in a live play", "asyncio, in wait"])
def test_a_script_that_is_killed_leaves_the_motors_off(phase: str) -> None:
    """Nothing but silence tells the daemon: more of it than a stall of a busy machine lasts."""
    with (
        meissner.Daemon() as daemon,
        meissner.connect(daemon.socket) as watcher,
        script(PHASES[phase], daemon.socket, silence=8.0) as child,
    ):
        state = until(daemon, lambda state: state.state == "armed")
        assert state.raw["armed"]["silence_s"] == 8.0
        assert str(child.pid) in state.raw["armed"]["by"]
        child.kill()
        child.wait()
        until(daemon, is_off)
        watcher.wait_until_idle()
        if "endless" in PHASES[phase]:
            assert (watcher.receipt().state, watcher.receipt().cause) == ("stopped", "owner-silent")


BREAKS = {
    "a rest break": "m = armed()\nready()\ntime.sleep(600)",
    "a C call": "m = armed()\nready()\nblocked()",
    "asyncio, a blocked loop": ASYNC.format("ready(); time.sleep(600)"),
}


@pytest.mark.parametrize("what", BREAKS)
def test_a_program_that_lives_and_says_nothing_stays_armed(daemon: meissner.Daemon, what: str) -> None:
    """A sign of life is seen by the time that is left: it grows again and again."""
    with script(BREAKS[what], daemon.socket, silence=16.0), meissner.connect(daemon.socket) as watcher:
        deadline, grown, before = time.monotonic() + 2 * PATIENT, 0, 16.0
        while grown < 2:
            state = watcher.status()
            assert state.state == "armed"
            left = state.raw["armed"]["left_s"]
            grown += left > before
            before = left
            assert time.monotonic() < deadline
            time.sleep(0.1)


def test_motors_may_stay_armed_without_the_client_if_it_says_so(daemon: meissner.Daemon) -> None:
    code = "m = meissner.connect(sys.argv[1])\nm.arm(assume_rest=True, checked='a test', stay_armed=True)\nready()\ntime.sleep(600)"
    with script(code, daemon.socket) as child:
        child.kill()
        child.wait()
        state = until(daemon, lambda state: state.state == "armed")
        assert (state.raw["armed"]["silence_s"], state.raw["armed"]["left_s"]) == (None, None)
    # The end of a script disarms in any case.
    with script(code, daemon.socket) as child:
        child.terminate()
        child.wait()
        until(daemon, is_off)


@pytest.mark.parametrize("silence", [0.0, 0.9, 86_401.0, float("nan"), float("inf")])
def test_a_silence_that_means_nothing_is_refused(m: meissner.Client, silence: float) -> None:
    with pytest.raises(ValueError, match="1 to 86400"):
        m.arm(silence=silence)
    assert m.core.silence == 60.0
