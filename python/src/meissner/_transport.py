"""Connections by httpx: the only module that imports it, and only once a client connects.

They turn httpx's errors into `Unreachable` (the request was not sent) and `ConnectionLost` (the daemon may have acted).
"""

from __future__ import annotations

import functools
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from ._endpoint import Endpoint
from ._http import Answer, Request
from .errors import ConnectionLost, MeissnerError, Unreachable

if TYPE_CHECKING:
    import ssl

    import httpx

SILENCE = 60.0
"""A stream of events is lost when nothing came for so long, s: the daemon sends a comment every 15 s."""

Headers = Callable[[], dict[str, str]]
Now = Callable[[], int]


def _failure(error: Exception, endpoint: Endpoint) -> MeissnerError:
    import httpx

    reason = str(error) or type(error).__name__
    if isinstance(error, (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout, httpx.UnsupportedProtocol)):
        return Unreachable(f"no daemon answers at {endpoint.name} ({reason}): start one with `meissner daemon`")
    return ConnectionLost(
        f"the connection to {endpoint.name} ended before the answer came ({reason}): look at `status()` before you repeat"
    )


def _closed() -> MeissnerError:
    return MeissnerError("the client is closed: work inside its `with` block, or connect again")


class BlockingTransport:
    """Sends requests and waits for the answers. Threads may share one."""

    def __init__(self, endpoint: Endpoint, headers: Headers, now_ns: Now) -> None:
        self._endpoint, self._headers, self._now_ns = endpoint, headers, now_ns
        self._client, self._process = self._open(), os.getpid()
        self._streams = set[socket.socket]()

    def _open(self, fresh: bool = False) -> httpx.Client:
        import httpx

        # Idle connections stay: httpx would close them after 5 s, and it notices by itself when the daemon has closed one.
        kept = httpx.Limits(max_connections=32, max_keepalive_connections=0 if fresh else 8, keepalive_expiry=None)
        # Without TLS, httpx would read the certificates of authorities all the same.
        trusted = tls() if self._endpoint.is_secure else False
        transport = httpx.HTTPTransport(uds=self._endpoint.socket, verify=trusted, limits=kept)
        # No proxies: a proxy of the environment cannot reach the lab's PC.
        return httpx.Client(transport=transport, base_url=self._endpoint.url, trust_env=False)

    def perform(self, request: Request) -> Answer:
        """Sends one request."""
        if self._client.is_closed:
            raise _closed()
        if request.fresh:
            with self._open(fresh=True) as client:
                return self._send(client, request)
        if self._process != os.getpid():
            # Of connections that a forked child shares with its parent, each would read the other's answers.
            self._client, self._process = self._open(), os.getpid()
        return self._send(self._client, request)

    def _send(self, client: httpx.Client, request: Request) -> Answer:
        import httpx

        headers = {**self._headers(), **request.headers}
        sent = self._now_ns()
        try:
            response = client.request(
                request.method, request.path, content=request.content, headers=headers, timeout=request.timeout
            )
        except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
            raise _failure(error, self._endpoint) from None
        return Answer(response.status_code, response.content, sent, self._now_ns())

    @contextmanager
    def stream(self, path: str) -> Iterator[Iterator[bytes]]:
        """Opens a stream on a connection of its own. It ends when the transport is closed, by whichever thread."""
        import httpx

        if self._client.is_closed:
            raise _closed()
        with self._open(fresh=True) as client:
            try:
                with client.stream(
                    "GET", path, headers=self._headers(), timeout=httpx.Timeout(10.0, read=SILENCE)
                ) as response:
                    if response.status_code >= 400:
                        Answer(response.status_code, response.read()).json()
                    opened = response.extensions["network_stream"].get_extra_info("socket")
                    self._streams.add(opened)
                    try:
                        # `close` may have looked before.
                        if self._client.is_closed:
                            raise _closed()
                        yield response.iter_raw()
                    finally:
                        self._streams.discard(opened)
            except (httpx.HTTPError, OSError) as error:
                raise _failure(error, self._endpoint) from None

    def pause(self, seconds: float) -> None:
        """Waits."""
        time.sleep(seconds)

    def close(self) -> None:
        """Closes all connections."""
        self._client.close()
        for opened in list(self._streams):
            with suppress(OSError):
                opened.shutdown(socket.SHUT_RDWR)


@functools.cache
def tls() -> ssl.SSLContext:
    """What the connections of this package trust: what httpx does, which is certifi's list or `$SSL_CERT_FILE`.

    The first client reads the list, for all: when a forked child ends, the C library may set back the file that another thread
    of its parent reads, and that thread fails with "PEM lib".
    """
    import httpx

    context = httpx.create_ssl_context()
    context.set_alpn_protocols(["http/1.1"])
    return context
