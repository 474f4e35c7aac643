"""Client of meissner, the driver of a tactile display: plays with exact times, sessions, and experiments.

    import meissner

    with meissner.demo() as m:                # a simulated array; with a board: meissner.connect() and m.arm()
        play = m.play("edge-45", seconds=0.3)
        play.wait()
        print(play.onset.monotonic, play.offset.monotonic)

- `connect`: a client of a daemon, on this machine or over the network.
- `demo`: a daemon with the simulated array, and a client of it. `Daemon` is the daemon alone.
- `simulate`, `design`, `render`, `judge`, `displacement`: predicted spikes, a search for patterns, a pattern that feels like an object,
  how near it comes, and how far pins move, by the installed program.
- `experiment`: trial lists, staircases, QUEST+, keys and button boxes.
- `errors`: one class for each code of the API.
"""

from __future__ import annotations

import os
import re

from . import _estop
from ._arguments import hinted, text
from ._bodies import SequenceItem
from ._endpoint import Endpoint, endpoints
from ._live import Update
from ._operations import Core, begin
from ._sse import Event
from .arrays import Array
from .client import Client, Play, Session
from .clocks import ClientClock, Instant
from .errors import ApiError, MeissnerError, PlayStopped, Unreachable
from .live import Live
from .program import (
    Board,
    Daemon,
    Design,
    Displacement,
    Judgement,
    Rendering,
    Simulation,
    design,
    displacement,
    judge,
    render,
    simulate,
)
from .results import Item, LiveResult, PlanCheck, Receipt, Status

__all__ = [
    "ApiError",
    "Array",
    "Client",
    "Daemon",
    "Design",
    "Displacement",
    "Event",
    "Instant",
    "Item",
    "Judgement",
    "Live",
    "LiveResult",
    "MeissnerError",
    "PlanCheck",
    "Play",
    "PlayStopped",
    "Receipt",
    "Rendering",
    "SequenceItem",
    "Session",
    "Simulation",
    "Status",
    "Unreachable",
    "Update",
    "connect",
    "demo",
    "design",
    "displacement",
    "judge",
    "render",
    "simulate",
]
__version__ = "0.1.0"


def _core(endpoint: Endpoint, token: str | None, reconnect: float) -> Core:
    if token is not None and not re.fullmatch(r"[!-~]+", text("token", token)):
        raise ValueError(
            "`token` has characters that no token has: take the one that `meissner token create` has printed"
        )
    clock = ClientClock(same_machine=endpoint.same_machine)
    return Core(endpoint, clock, token or os.environ.get("MEISSNER_TOKEN"), reconnect)


def _nowhere(tried: list[Endpoint], errors: list[Unreachable]) -> Unreachable:
    if len(errors) == 1:
        return errors[0]
    places = ", nor at ".join(endpoint.name for endpoint in tried)
    return Unreachable(f"no daemon answers at {places}: start one with `meissner daemon`, or try `meissner.demo()`")


@hinted
def connect(
    address: str | os.PathLike[str] | None = None, *, token: str | None = None, reconnect: float = 10.0
) -> Client:
    """Connect to a daemon.

    `address` is the path of a Unix socket, or a URL such as `http://lab-pc:8765` with an access `token`. Without it:
    `$MEISSNER_URL` (and `$MEISSNER_TOKEN`), `$MEISSNER_SOCKET`, or the usual sockets. `reconnect`: for how long to look
    for a daemon that was there before, s.
    """
    tried, errors = endpoints(address), list[Unreachable]()
    for endpoint in tried:
        client = Client(_core(endpoint, token, 0.0))
        try:
            begin(client.core)
            _estop.check(endpoint)
        except Unreachable as error:
            client.close()
            errors.append(error)
        except BaseException:
            client.close()
            raise
        else:
            client.core.reconnect = reconnect
            return client
    raise _nowhere(tried, errors)


@hinted
def demo(*, arm: bool = True, config: str = "", board: Board = False) -> Client:
    """Start a daemon with the simulated array, and connect to it. Both end with the client.

    `arm`: whether to arm, as simulated pins are at rest. `config`: text for the daemon's configuration file. The simulated array has
    telemetry, which no board has. `board=True` is as a board is: without telemetry, so that pins drift, and plays end at the drift
    limit. `board="lower-stop"` is as a board with a lower stop. Pilot a study with the one that you will use.
    """
    daemon = Daemon(config, board=board)
    try:
        client = connect(daemon.socket)
    except BaseException:
        daemon.close()
        raise
    client.adopt(daemon)
    if arm:
        # No finger: a stall of a busy machine may last.
        # With a lower stop arming moves the pins down to it.
        client.arm(assume_rest=board != "lower-stop", silence=60.0)
    return client
