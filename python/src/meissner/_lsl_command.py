"""The command `meissner-lsl`: a bridge to LSL beside any program."""

from __future__ import annotations

import argparse
import contextlib
import sys

from . import connect
from .errors import MeissnerError
from .lsl import Bridge, Trigger


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="meissner-lsl", description="Send markers and telemetry of a meissner daemon to LSL, until Ctrl-C."
    )
    parser.add_argument("--address", help="connect to this socket or URL [default: as meissner.connect() does]")
    parser.add_argument("--token", help="access token of a daemon on the network [default: $MEISSNER_TOKEN]")
    parser.add_argument(
        "--name", default="meissner", help="begin the names of the streams with NAME [default: meissner]"
    )
    parser.add_argument(
        "--telemetry-hz",
        type=float,
        default=10.0,
        metavar="F",
        help="send telemetry F times a second [default: 10; 0: not]",
    )
    parser.add_argument("--listen", metavar="STREAM", help="play on markers of the stream with this name")
    parser.add_argument(
        "--play",
        action="append",
        default=[],
        metavar="MARKER=PATTERN",
        help="play PATTERN on this marker; may be repeated",
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="play for S seconds")
    parser.add_argument(
        "--delay", type=float, metavar="S", help="begin S seconds after the marker's time [default: at once]"
    )
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Runs the command."""
    parser = _parser()
    asked = parser.parse_args(arguments)
    if bool(asked.listen) != bool(asked.play) or not all("=" in each for each in asked.play):
        parser.error("--listen STREAM and --play MARKER=PATTERN belong together")
    trigger = None
    if asked.listen:
        plays = dict(each.rsplit("=", 1) for each in asked.play)
        trigger = Trigger(asked.listen, plays, asked.seconds, asked.delay)

    def report(line: str) -> None:
        print(f"meissner-lsl: {line}", file=sys.stderr, flush=True)

    try:
        with connect(asked.address, token=asked.token) as m:
            bridge = Bridge(m, name=asked.name, telemetry_hz=asked.telemetry_hz, trigger=trigger, report=report)
            with bridge, contextlib.suppress(KeyboardInterrupt):
                print(
                    f"sending markers of {m.core.endpoint.name} as `{asked.name}-markers`; Ctrl-C ends it", flush=True
                )
                bridge.wait()
    except (MeissnerError, ImportError) as error:
        report(str(error))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
