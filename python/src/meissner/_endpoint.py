"""Where a daemon listens: the path of a Unix socket, or the URL of a PC on the network."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import stat
from dataclasses import dataclass
from urllib.parse import urlsplit

from .errors import Unreachable

SERVICE_SOCKET = "/run/meissner/meissner.sock"


@dataclass(frozen=True)
class Endpoint:
    """One place to connect to: `socket` is a path, or None and `url` counts."""

    url: str
    socket: str | None = None

    @property
    def name(self) -> str:
        """The place in messages."""
        return self.socket or self.url

    @property
    def is_secure(self) -> bool:
        """Whether connections use TLS."""
        return self.url.startswith("https:")

    @property
    def same_machine(self) -> bool:
        """Whether the daemon seems to run on this machine. A tunnel looks the same, so the clock checks it."""
        return self.socket is not None or urlsplit(self.url).hostname in ("localhost", "127.0.0.1", "::1")


def has_unix_sockets() -> bool:
    """Whether Python has Unix sockets here. On Windows it has none."""
    return hasattr(socket, "AF_UNIX")


def endpoints(address: str | os.PathLike[str] | None) -> list[Endpoint]:
    """The places to try, in order.

    Without an address: `$MEISSNER_URL`, `$MEISSNER_SOCKET`, the user's own socket, and that of the installed service.
    """
    if address is not None:
        if not isinstance(address, (str, os.PathLike)):
            raise TypeError(
                f"`address` is {address!r}: must be the path of a socket, or a URL such as 'http://lab-pc:8765'"
            )
        return [_endpoint(os.fspath(address))]
    for variable in ("MEISSNER_URL", "MEISSNER_SOCKET"):
        if os.environ.get(variable):
            return [_endpoint(os.environ[variable])]
    runtime = os.environ.get("XDG_RUNTIME_DIR") or users_directory()
    paths = [os.path.join(runtime, "meissner.sock")] if runtime else []
    return [_endpoint(path) for path in [*paths, SERVICE_SOCKET]]


def users_directory(root: str = "/") -> str | None:
    """The directory of a user's own socket where no login has set `XDG_RUNTIME_DIR`, as the program looks for it."""
    if not has_unix_sockets():
        return None
    uid = os.getuid()
    for path in (f"run/user/{uid}", f"tmp/meissner-{uid}"):
        directory = os.path.join(root, path)
        with contextlib.suppress(OSError):
            found = os.lstat(directory)
            # Nobody else can have put a socket there.
            if stat.S_ISDIR(found.st_mode) and found.st_uid == uid and not found.st_mode & 0o022:
                return directory
    return None


def _endpoint(address: str) -> Endpoint:
    if address.startswith(("http://", "https://")):
        try:
            parts = urlsplit(address)
            is_whole = bool(parts.hostname) and not re.search(r"\s", address) and (parts.port is None or parts.port > 0)
        except ValueError:
            is_whole = False
        if not is_whole:
            raise ValueError(f"`address` is {address!r}: must be a URL such as 'http://lab-pc:8765'")
        return Endpoint(address.rstrip("/"))
    if re.fullmatch(r"[a-z]+://.*|[\w.-]+:\d+", address) and not os.path.exists(address):
        host = address.split("://")[-1]
        raise ValueError(f"`address` is {address!r}: must be a URL such as 'http://{host}', or the path of a socket")
    if not has_unix_sockets():
        raise Unreachable(
            f"Python has no Unix sockets on this system, so `{address}` cannot be opened: give the URL of the daemon's PC, "
            "as in connect('http://lab-pc:8765', token=...)"
        )
    return Endpoint("http://meissner", address)
