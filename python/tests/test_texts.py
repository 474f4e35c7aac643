"""What the texts of the repository say of the package."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# `meissner-tactile` and its file `./meissner_tactile-*.whl` are ours.
FOREIGN = re.compile(
    r"\b(pip3?|pipx|uv|conda)[\"', ]+(install|add)(\s+[\"']?|[^\n;&|`#]*?[ \t\"'=,])meissner(?!-tactile)(?![\w/])"
    r"|[\"']meissner(\[\w+\])? ?[=<>~!]=?[ \d]"
)


def test_no_text_tells_to_install_the_package_of_another_project() -> None:
    """On PyPI `meissner` is another project."""
    assert FOREIGN.search("run pip install 'meissner[nwb]' first")
    assert FOREIGN.search("pip install --upgrade meissner")
    assert FOREIGN.search('["pip", "install", "meissner"]')
    assert FOREIGN.search("pipx install meissner-0.1.0.whl")
    assert FOREIGN.search("uv add meissner")
    assert FOREIGN.search('dependencies = ["meissner==0.1.0", "psychopy"]')
    assert not FOREIGN.search(
        "pip install ./meissner_tactile-*.whl; pip install meissner-tactile[nwb] './python[nwb]' ./meissner"
    )
    assert not FOREIGN.search('dependencies = ["meissner-tactile==0.1.0"]')
    listed = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("the repository's files are known in the repository only")
    found = []
    for name in listed.stdout.split("\0"):
        path = ROOT / name
        if not path.is_file() or path == Path(__file__).resolve():
            continue
        text = path.read_bytes().decode("utf-8", "replace")
        found += [f"{name}: {match[0]}" for match in FOREIGN.finditer(text)]
    assert found == []
