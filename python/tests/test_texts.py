"""What the texts of the repository say of the package."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# A file (`./meissner-*.whl`) and `meissner-tactile` are ours.
FOREIGN = re.compile(
    r"pip3?[\"', ]+install(\s+[\"']?|[^\n;&|`#]*?[ \t\"'=,])meissner(?![\w.*-]*\.whl)(?!-tactile)(?![\w/-])"
)


def test_no_text_tells_to_install_the_package_of_another_project() -> None:
    """On PyPI `meissner` is another project."""
    assert FOREIGN.search("run pip install 'meissner[nwb]' first")
    assert FOREIGN.search("pip install --upgrade meissner")
    assert FOREIGN.search('["pip", "install", "meissner"]')
    assert not FOREIGN.search(
        "pip install ./meissner-*.whl; pip install meissner-tactile[nwb] './python[nwb]' ./meissner"
    )
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
