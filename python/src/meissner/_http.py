"""Requests and answers without input or output: what every method of the client sends, and how it reads the answer."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .errors import ApiError, UnexpectedAnswer


@dataclass(frozen=True)
class Request:
    """What to send, and how."""

    method: str
    path: str
    content: bytes | None = None
    headers: dict[str, str] = field(default_factory=dict)
    timeout: float = 10.0
    """How long to wait for the answer, s."""
    fresh: bool = False
    """Whether to open a connection for this request alone, as an emergency stop does."""
    repeatable: bool = False
    """Whether it may be sent again although the daemon may have carried it out."""


@dataclass(frozen=True)
class Answer:
    """What came back, and when by the client's clock."""

    status: int
    body: bytes
    sent_ns: int = 0
    received_ns: int = 0

    def json(self) -> Any:
        """The answer's document; an error if the daemon refused the request."""
        try:
            document = json.loads(self.body)
        except ValueError as error:
            if self.status >= 400:
                raise ApiError(f"HTTP status {self.status} without a reason", status=self.status) from error
            raise UnexpectedAnswer(f"the answer is not JSON: {self.body[:60]!r}; is this a meissner daemon?") from error
        if self.status >= 400:
            raise ApiError.of(document if isinstance(document, dict) else {}, self.status)
        return document


def identity(client: str, token: str | None, session_token: str | None) -> dict[str, str]:
    """The headers that say who asks: the client's name, an access token (over the network), and a session's token."""
    named = {"Meissner-Client": client}
    access = {"Authorization": f"Bearer {token}"} if token else {}
    return {**named, **access, **({"Meissner-Session": session_token} if session_token else {})}


def get(path: str, *, timeout: float = 10.0) -> Request:
    """A request that changes nothing."""
    return Request("GET", path, timeout=timeout, repeatable=True)


def plain(value: Any) -> Any:
    """A NumPy number or array as JSON has it."""
    if hasattr(value, "tolist"):
        return value.tolist()
    kind = type(value).__name__
    raise TypeError(f"a request, a scene or an object cannot hold a {kind}: use numbers, texts, lists and dicts")


def encode(body: Any) -> bytes:
    """A document as JSON. It may hold NumPy values."""
    return json.dumps(body, default=plain, allow_nan=False).encode()


def check_json(name: str, value: Any) -> None:
    """Raises `TypeError` or `ValueError` for what a request cannot hold, with its place."""
    if isinstance(value, Mapping):
        for key, each in value.items():
            check_json(f"{name}.{key}", each)
    elif isinstance(value, (list, tuple)):
        for place, each in enumerate(value):
            check_json(f"{name}[{place}]", each)
    elif isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"`{name}` is {value}: must be a finite number")
    elif value is not None and not isinstance(value, (str, int, float)):
        if not hasattr(value, "tolist"):
            raise TypeError(f"`{name}` is {value!r}: must be a number, a text, a list or a dict")
        check_json(name, value.tolist())


def post(path: str, body: dict[str, Any] | None = None, *, timeout: float = 10.0) -> Request:
    """A command. Keys that are None are left out."""
    given = {key: value for key, value in (body or {}).items() if value is not None}
    try:
        content = encode(given)
    except (TypeError, ValueError):
        for key, value in given.items():
            check_json(key, value)
        raise
    return Request("POST", path, content, {"Content-Type": "application/json"}, timeout)
