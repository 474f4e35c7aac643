"""The OpenAPI document is valid, and its examples are as it says: a program that is not ours judges."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from openapi_spec_validator import OpenAPIV31SpecValidator
from referencing import Registry
from referencing.jsonschema import DRAFT202012

from meissner.program import find_program


def examples(part: Any) -> Iterator[tuple[Any, Any]]:
    """Schemas and their examples."""
    if isinstance(part, dict):
        if "schema" in part and "example" in part:
            yield part["schema"], part["example"]
        for example in part["examples"] if isinstance(part.get("examples"), list) else []:
            yield part, example
        # An event stream is text; its schema is that of the events in it.
        yield from (found for key, below in part.items() if key != "text/event-stream" for found in examples(below))
    elif isinstance(part, list):
        yield from (found for below in part for found in examples(below))


def test_the_document_and_its_examples_are_valid(tmp_path: Path) -> None:
    subprocess.run([find_program(), "manual", tmp_path], check=True, capture_output=True)
    text = (tmp_path / "openapi.json").read_text(encoding="utf-8")
    assert [str(error) for error in OpenAPIV31SpecValidator(json.loads(text)).iter_errors()] == []
    document = json.loads(text.replace('"#/components', '"urn:document#/components'))
    registry = Registry().with_resource("urn:document", DRAFT202012.create_resource(document))
    wrong, found = [], 0
    for schema, example in examples(document):
        found += 1
        validator = Draft202012Validator(schema, registry=registry)
        wrong += [f"{schema}: {error.message}" for error in validator.iter_errors(example)]
    assert not wrong
    assert found > 100
