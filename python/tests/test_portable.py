"""The package on a system without Unix sockets and Unix modules, as Windows is: they are hidden here."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from network import Network

SCRIPT = """
import asyncio, builtins, importlib, os, pkgutil, socket, sys
UNIX = {"fcntl", "grp", "posix", "pty", "pwd", "readline", "resource", "syslog", "termios", "tty"}
imported = builtins.__import__
def without_unix(name, globals=None, *rest, **more):
    if name.split(".")[0] in UNIX and (globals or {}).get("__name__", "").startswith("meissner"):
        raise ImportError(f"no module named {name}: it is hidden")
    return imported(name, globals, *rest, **more)
builtins.__import__ = without_unix
unix, pair = socket.AF_UNIX, socket.socketpair
socket.socketpair = lambda: pair(unix)  # Windows has pairs, by TCP.
del socket.AF_UNIX
for name in ("getsid", "getuid", "getpgid", "fork", "setsid", "killpg"):
    delattr(os, name)
import meissner
names = [module.name for module in pkgutil.walk_packages(meissner.__path__, "meissner.")]
for name in names:
    importlib.import_module(name)
try:
    meissner.connect("/run/meissner/meissner.sock")
except meissner.Unreachable as error:
    print(error)
try:
    meissner.demo()
except meissner.MeissnerError as error:
    print(error)
with meissner.connect(sys.argv[1]) as m:
    m.arm(assume_rest=True, checked="a test")
    print(m.play("pin-60", 0.05).wait().state, len(names))
    with m.live(drives=[{"motor": 9, "frequency_hz": 60, "amplitude_um": 40}], timeout=20) as live:
        print(live.scale(0.5).wait(20).state)
"""


def test_everything_works_over_the_network_without_unix_modules(network: Network) -> None:
    command = [sys.executable, "-c", SCRIPT, network.url]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    socket, demo, play, *live = ended.stdout.splitlines()
    assert "no Unix sockets" in socket
    assert "http://lab-pc:8765" in socket
    assert "Linux only" in demo
    assert play.startswith("done ")
    assert int(play.split()[1]) >= 15
    assert live == ["applied"]


def test_the_import_is_light() -> None:
    """Importing loads neither httpx nor websockets nor NumPy: a program that draws stimuli should begin at once."""
    code = "import sys, meissner; print([name for name in ('httpx', 'websockets', 'asyncio', 'numpy', 'questplus') if name in sys.modules])"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["LICENSE-APACHE", "LICENSE-MIT"])
@pytest.mark.parametrize("folder", ["", "psychopy"])
def test_each_package_has_the_licences_of_the_repository(folder: str, name: str) -> None:
    package = Path(__file__).parents[1]
    own, repository = package / folder / name, package.parent / name
    if not repository.exists():
        pytest.skip("the package is not in the repository")
    assert own.read_bytes() == repository.read_bytes()
