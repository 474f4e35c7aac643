"""Modules of the package do not import each other in a circle, not even for types."""

from __future__ import annotations

import ast
from pathlib import Path

import meissner

ROOT = Path(meissner.__file__).parent


def modules() -> dict[tuple[str, ...], Path]:
    names = {path: path.relative_to(ROOT).with_suffix("").parts for path in ROOT.rglob("*.py")}
    return {parts[:-1] if parts[-1] == "__init__" else parts: path for path, parts in names.items()}


def imported(module: tuple[str, ...], path: Path, known: set[tuple[str, ...]]) -> set[tuple[str, ...]]:
    """The modules that this one names in its imports, wherever they stand."""
    package = module if path.name == "__init__.py" else module[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = (*package[: len(package) + 1 - node.level], *(node.module or "").split("."))
            base = tuple(part for part in base if part)
            found |= {(*base, alias.name) if (*base, alias.name) in known else base for alias in node.names}
    return found - {module}


def test_no_modules_import_each_other_in_a_circle() -> None:
    paths = modules()
    assert len(paths) > 40
    left = {module: imported(module, path, set(paths)) for module, path in paths.items()}
    assert ("errors",) in left["client",]
    # A module that imports none of the rest is in no circle.
    while ends := [module for module, others in left.items() if not others & set(left)]:
        for module in ends:
            del left[module]
    assert not left, "circles, and what imports them: " + ", ".join(".".join(module) for module in left)
