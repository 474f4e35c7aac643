"""The command `meissner-lsl`: a bridge to LSL beside any program."""

from __future__ import annotations

import argparse
import contextlib
import sys

from . import connect
from .errors import MeissnerError
from .lsl import Bridge


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="meissner-lsl", description="Send markers of a meissner daemon to LSL, until Ctrl-C."
    )
    parser.add_argument("--address", help="connect to this socket or URL [default: as meissner.connect() does]")
    parser.add_argument("--token", help="access token of a daemon on the network [default: $MEISSNER_TOKEN]")
    parser.add_argument("--name", default="meissner", help="begin the name of the stream with NAME [default: meissner]")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Runs the command."""
    asked = _parser().parse_args(arguments)

    def report(line: str) -> None:
        print(f"meissner-lsl: {line}", file=sys.stderr, flush=True)

    try:
        with connect(asked.address, token=asked.token) as m:
            bridge = Bridge(m, name=asked.name, report=report)
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
