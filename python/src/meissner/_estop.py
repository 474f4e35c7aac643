"""The emergency stop: it goes to its own listener and to the API at once, and the first good answer counts.

The daemon's real-time thread serves the own listener, whatever the other clients do: `SOCKET.estop`, or the port above the API's.

Invariant: `estop` returns only after an answer that says that the lines are off.
"""

from __future__ import annotations

import http.client
import queue
import socket
import threading
from collections.abc import Callable
from contextlib import closing, suppress
from urllib.parse import urlsplit

from ._endpoint import Endpoint
from ._http import Answer, Request
from ._operations import Core
from ._unreached import warn
from .clocks import NS
from .errors import ApiError, MeissnerError, UnexpectedAnswer

_TIMEOUT = 5.0
"""How long an answer may take, s."""
_OTHER = 0.25
"""How long an answer waits for that to the other order, s."""
_CHECK_TIMEOUT = 2.0
"""How long a connection to the own port may take when the client connects, s."""


def estop(core: Core) -> None:
    """Switch all lines off at once and latch the fault. `reset()` clears it. It returns once the device has confirmed it."""
    begun = core.clock.now_ns()
    while (problem := _problem(core)) is not None:
        if isinstance(problem, ApiError) or core.clock.now_ns() - begun > core.reconnect * NS:
            raise problem
        core.link.pause(0.05)


def _problem(core: Core) -> BaseException | None:
    """Sends the order to both. None: one has confirmed it; else why the API has not."""
    problems = queue.SimpleQueue["tuple[bool, BaseException | None]"]()

    def order(is_api: bool, send: Callable[[Core], None]) -> None:
        try:
            send(core)
            problems.put((is_api, None))
        except BaseException as problem:
            problems.put((is_api, problem))

    for way in ((False, _to_own), (True, _to_api)):
        try:
            threading.Thread(target=order, args=way, name="meissner-estop", daemon=True).start()
        except RuntimeError:  # At its end Python starts no threads.
            order(*way)
    found = {}
    for left in (1, 0):
        is_api, problem = problems.get()
        if problem is None:
            # The other order must not arrive after a `reset()` that follows this one.
            with suppress(queue.Empty):
                problems.get(timeout=left * _OTHER)
            return None
        found[is_api] = problem
    return found[True]


def _to_api(core: Core) -> None:
    _confirmed(core.link.perform(Request("POST", "/v1/estop", b"{}", timeout=_TIMEOUT, fresh=True)))


def _to_own(core: Core) -> None:
    if core.endpoint.socket is not None:
        with socket.socket(socket.AF_UNIX) as stream:
            stream.settimeout(_TIMEOUT)
            stream.connect(f"{core.endpoint.socket}.estop")
            stream.sendall(b"!")
            line = stream.makefile(encoding="utf-8").readline()
        if not line.startswith("stopped"):
            raise UnexpectedAnswer(f"the emergency stop is not confirmed: {line.strip()}")
        return
    own = _own_port(core.endpoint)
    if own is None:
        raise MeissnerError("a proxy with TLS has no port for emergency stops")
    with closing(http.client.HTTPConnection(*own, timeout=_TIMEOUT)) as connection:
        # The token is the body.
        connection.request("POST", "/v1/estop", (core.token or "").encode(), {"Content-Type": "text/plain"})
        answer = connection.getresponse()
        _confirmed(Answer(answer.status, answer.read()))


def _confirmed(answer: Answer) -> None:
    status = answer.json()
    if not isinstance(status, dict) or status.get("state") != "faulted":
        raise UnexpectedAnswer("the answer does not say that the lines are off: use the switch of the supply")


def _own_port(endpoint: Endpoint) -> tuple[str, int] | None:
    """The host and the port for emergency stops. None: the daemon has no TLS, so a proxy stands before it."""
    url = urlsplit(endpoint.url)
    return None if endpoint.is_secure else (url.hostname or "", (url.port or 80) + 1)


def check(endpoint: Endpoint) -> None:
    """Warns if the own port cannot be reached over the network."""
    own = None if endpoint.socket is not None else _own_port(endpoint)
    if own is None:
        return
    try:
        socket.create_connection(own, _CHECK_TIMEOUT).close()
    except (OSError, OverflowError) as error:
        warn(
            f"the port for emergency stops, {own[1]} of {own[0]}, does not answer ({error}): open it in the firewall, or forward "
            f"it, too; until then `estop()` has port {own[1] - 1} alone"
        )
