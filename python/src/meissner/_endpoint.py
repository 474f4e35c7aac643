"""Where a daemon listens: the path of a Unix socket, or the URL of a PC on the network."""

from __future__ import annotations

import contextlib
import os
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
        return Endpoint(address.rstrip("/"))
    if not has_unix_sockets():
        raise Unreachable(
            f"Python has no Unix sockets on this system, so `{address}` cannot be opened: give the URL of the daemon's PC, "
            "as in connect('http://lab-pc:8765', token=...)"
        )
    return Endpoint("http://meissner", address)
