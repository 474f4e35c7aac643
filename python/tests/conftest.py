"""What tests share: a daemon with the simulated array, and a network between client and daemon.

The program is found as `meissner.program.find_program` does: `MEISSNER_PROGRAM`, or the PATH.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

import meissner
from network import Network
from patience import LEAD, kept


@pytest.fixture(scope="session", autouse=True)
def _state(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The user's kept answers are none of the tests'."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


@pytest.fixture(scope="session")
def shared_daemon() -> Iterator[meissner.Daemon]:
    with meissner.Daemon(LEAD) as daemon:
        yield daemon


@pytest.fixture
def daemon(shared_daemon: meissner.Daemon) -> Iterator[meissner.Daemon]:
    """A daemon without plays, session or fault, disarmed."""
    yield shared_daemon
    with meissner.connect(shared_daemon.socket) as m:
        state = m.status()
        if state.state == "faulted":
            m.reset(force=True)
        m.disarm()
        m.wait_until_idle()
        assert state.raw["session"] is None, "a test has left its session"


@pytest.fixture
def m(daemon: meissner.Daemon) -> Iterator[meissner.Client]:
    """An armed client. A stall of a busy machine is no silence."""
    with meissner.connect(daemon.socket) as client:
        kept(lambda: client.arm(assume_rest=True, checked="a test", silence=60.0))
        yield client


@pytest.fixture
def network(daemon: meissner.Daemon) -> Iterator[Network]:
    """A network between client and daemon that can be slow, or lose connections."""
    with Network(daemon.socket) as network:
        yield network
