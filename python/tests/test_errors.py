"""Every code of the API has a class, and messages say what to do."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from meissner import _operations as ops
from meissner import errors
from meissner._endpoint import Endpoint
from meissner._http import Answer
from meissner._sse import EventParser
from meissner.clocks import ClientClock
from meissner.errors import ApiError
from meissner.program import find_program


def test_every_code_of_the_api_has_a_class(tmp_path: Path) -> None:
    subprocess.run([find_program(), "manual", tmp_path], check=True, capture_output=True)
    document = json.loads((tmp_path / "openapi.json").read_text(encoding="utf-8"))
    codes = document["components"]["schemas"]["Problem"]["properties"]["code"]["enum"]
    assert len(codes) > 30
    assert set(codes) == set(ApiError.by_code), "errors.py and the API's codes differ"


@pytest.mark.parametrize("code", sorted(ApiError.by_code))
def test_an_error_has_its_code_and_an_advice(code: str) -> None:
    error = ApiError.of({"code": code, "detail": "what and where", "title": "t"}, 409)
    assert (error.code, error.status, error.detail) == (code, 409, "what and where")
    assert type(error) is not ApiError
    assert str(error) == f"what and where [{code}: {error.advice}]"
    assert error.advice


def test_an_unknown_code_is_an_api_error() -> None:
    error = ApiError.of({"code": "new", "detail": "what"}, 409)
    assert (type(error), error.code, str(error)) == (ApiError, "new", "what [new]")
    assert str(ApiError.of({}, 401)).startswith("HTTP status 401")


def test_an_answer_that_is_no_daemons() -> None:
    with pytest.raises(errors.UnexpectedAnswer, match="is this a meissner daemon"):
        Answer(200, b"<html>").json()
    with pytest.raises(ApiError, match="HTTP status 502 without a reason"):
        Answer(502, b"<html>").json()
    core = ops.Core(Endpoint("http://pc"), ClientClock())
    for body in (b"{}", b"[]"):
        link: Any = SimpleNamespace(perform=lambda request, body=body: Answer(200, body))
        core.link = link
        with pytest.raises(errors.UnexpectedAnswer, match="http://pc does not answer as a meissner daemon"):
            ops.status(core)
    with pytest.raises(ApiError, match="HTTP status 500"):
        Answer(500, b"[]").json()


def test_events_come_whole_from_any_pieces() -> None:
    text = b': hello\n\nevent: queued\r\ndata: {"id": 7}\r\n\r\ndata: {"event": "lost",\ndata: "notices": 3}\n\n'
    for size in (1, 3, 1000):
        parser = EventParser()
        events = [event for at in range(0, len(text), size) for event in parser.feed(text[at : at + size])]
        assert [(event.name, event.data) for event in events] == [
            ("queued", {"id": 7}),
            ("lost", {"event": "lost", "notices": 3}),
        ]
    assert events[0]["id"] == 7
