"""A network for tests: a TCP port that passes bytes on to the daemon's socket, late or not at all. The port above it takes e-stops.

It counts requests, so that a test can see what was sent twice.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import ssl
import threading
from collections.abc import Coroutine
from typing import Any


class Network:
    """Runs in a thread of its own."""

    def __init__(self, socket: str, tls: ssl.SSLContext | None = None) -> None:
        """`tls`: it takes connections by TLS, with this certificate."""
        self.socket = socket
        self._tls = tls
        self.jitter_s = 0.0
        """Each piece of data is late by up to this long, in each direction."""
        self.lose_answers = 0
        """How many of the next answers are lost, with their connection."""
        self.requests: list[str] = []
        """The first line of each request."""
        self.estops: list[str] = []
        """The token of each order at the port for emergency stops."""
        self.connections = 0
        self._chance = random.Random(1)
        self._writers: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)

    def __enter__(self) -> Network:
        self._thread.start()
        self._servers = self._run(self._listen())
        self.url = f"{'https' if self._tls else 'http'}://127.0.0.1:{self._servers[0].sockets[0].getsockname()[1]}"
        return self

    async def _listen(self) -> list[asyncio.Server]:
        while True:
            server = await asyncio.start_server(self._serve, "127.0.0.1", 0, ssl=self._tls)
            with contextlib.suppress(OSError):
                own = server.sockets[0].getsockname()[1] + 1
                return [server, await asyncio.start_server(self._serve_estop, "127.0.0.1", own)]
            server.close()

    def block_estop(self) -> None:
        """Closes the port for emergency stops, as a firewall does. It returns when the port is closed."""

        async def close() -> None:
            # asyncio leaves a connection open that it has accepted and not yet begun to serve: these turns begin it.
            for _ in range(3):
                await asyncio.sleep(0)
            self._servers[1].close()

        self._run(close())

    def __exit__(self, *_: object) -> None:
        async def end() -> None:
            for server in self._servers:
                server.close()
            self._cut()
            tasks = asyncio.all_tasks() - {asyncio.current_task()}
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

        self._run(end())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _run(self, work: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(120)

    def _cut(self) -> None:
        for writer in self._writers:
            writer.close()

    def cut(self) -> None:
        """Closes all connections, as a daemon does with idle ones. It returns when both ends are closed."""

        async def cut() -> None:
            self._cut()
            for writer in list(self._writers):
                with contextlib.suppress(OSError):
                    await writer.wait_closed()
            self._writers.clear()

        self._run(cut())

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        with contextlib.suppress(OSError):
            there = await asyncio.open_unix_connection(self.socket)
            self._writers |= {writer, there[1]}
            await asyncio.gather(self._pass(reader, there[1], False), self._pass(there[0], writer, True))
        writer.close()

    async def _serve_estop(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            head = (await reader.readuntil(b"\r\n\r\n")).decode().lower()
            length = next(line for line in head.split("\r\n") if line.startswith("content-length:"))
            self.estops.append((await reader.readexactly(int(length.split(":")[1]))).decode())
            there = await asyncio.open_unix_connection(f"{self.socket}.estop")
            there[1].write(b"!")
            is_off = (await there[0].readline()).startswith(b"stopped")
            there[1].close()
            if self.lose_answers:
                self.lose_answers -= 1
            elif is_off:
                writer.write(b'HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n{"state": "faulted"}')
        writer.close()

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, answers: bool) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                if not answers and data.split(b" ")[0] in (b"GET", b"POST", b"PUT", b"DELETE"):
                    self.requests.append(data.split(b"\r\n")[0].decode())
                if answers and self.lose_answers:
                    self.lose_answers -= 1
                    break
                await asyncio.sleep(self._chance.uniform(0, self.jitter_s))
                writer.write(data)
                await writer.drain()
        writer.close()
