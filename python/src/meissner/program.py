"""The program `meissner` on this machine: a daemon with the simulated array, simulation of afferents, search for patterns.

The client has no calls for the daemon's renderings and previews, so `simulate`, `design` and `render` run the installed program. It is found by
`$MEISSNER_PROGRAM`, else in the wheel that was installed, else on the `PATH`. NumPy is used where it is installed.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Union

from . import _ending
from ._arguments import hinted, hints
from ._endpoint import has_unix_sockets
from ._http import check_json, plain
from .arrays import Array
from .errors import ProgramError

Scene = Union[str, "os.PathLike[str]", Mapping[str, Any]]
Object = Union[str, "os.PathLike[str]", Mapping[str, Any]]


def find_program() -> str:
    """The path of the program `meissner`."""
    named = os.environ.get("MEISSNER_PROGRAM")
    found = shutil.which(named) if named else _of_wheel() or shutil.which("meissner")
    if found is None:
        place = (
            f"MEISSNER_PROGRAM is `{named}`, which cannot be run"
            if named
            else "neither this package nor the PATH has the program `meissner`"
        )
        raise ProgramError(
            f"{place}: install the wheel that contains it, or set MEISSNER_PROGRAM to its path (docs/start.md)"
        )
    return found


def _of_wheel() -> str | None:
    """The program that was installed with this package, also where its folder is not on the PATH."""
    try:
        files = importlib.metadata.files("meissner-tactile") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    paths = (str(file.locate()) for file in files if file.name == "meissner" and file.parent.name == "bin")
    return next(filter(os.path.isfile, paths), None)


def _run(arguments: Sequence[str], stdin: str | None = None) -> Any:
    """Runs a command with `--json` and reads its document."""
    return json.loads(_output([*arguments, "--json"], stdin))


def _output(arguments: Sequence[str], stdin: str | None) -> str:
    """Runs a command."""
    command = [find_program(), *arguments]
    ended = subprocess.run(command, input=stdin, capture_output=True, text=True, encoding="utf-8", check=False)
    if ended.returncode != 0:
        lines = ended.stderr.strip().splitlines() or [f"exit code {ended.returncode}"]
        raise ProgramError(f"`meissner {arguments[0]}` failed: {lines[-1]}")
    return ended.stdout


def find_array(array: str | os.PathLike[str]) -> Array:
    """An array by its name, if the program ships it, or by the file of its description. Runs the installed program `meissner`."""
    return Array.of(_run(["array", "show", os.fspath(array)]))


def as_array(values: Any) -> Any:
    """A NumPy array, if NumPy is installed; else the list."""
    try:
        import numpy
    except ImportError:
        return values
    return numpy.asarray(values, dtype=float)


@dataclass(frozen=True)
class Displacement:
    """How far the pins of a play move, by the motor model."""

    rate_hz: float
    """Samples a second."""
    motors: tuple[int, ...]
    """The motors that move, in order."""
    um: Any
    """A row per sample with a column per motor, µm upwards: an array with NumPy, else lists."""


@hinted
def displacement(
    pattern: str | os.PathLike[str],
    seconds: float | None = None,
    *,
    scale: float = 1.0,
    fit: Literal["whole", "cover"] = "whole",
    rate_hz: float = 1000.0,
    array: str | os.PathLike[str] | None = None,
) -> Displacement:
    """Compute how far a play moves each pin by the motor model, from its onset until all pins rest again: as designed, without scatter.

    `pattern` is the name of a shipped pattern, the path of a pattern file, or its text. It runs the installed program `meissner`;
    no daemon is needed. `array`: the file of the array's description, for a pattern of an array that the program does not ship.
    """
    is_text = isinstance(pattern, str) and "\n" in pattern
    arguments = ["displacement", "-" if is_text else os.fspath(pattern)]
    arguments += [f"--rate-hz={rate_hz!r}", f"--scale={scale!r}", f"--fit={fit}"]
    if seconds is not None:
        arguments.append(f"--seconds={seconds!r}")
    if array is not None:
        arguments.append(f"--array={os.fspath(array)}")
    head, *lines = _output(arguments, str(pattern) if is_text else "").splitlines()
    motors = tuple(int(name.split("_")[1]) for name in head.split(",")[1:])
    return Displacement(rate_hz, motors, as_array([[float(cell) for cell in line.split(",")[1:]] for line in lines]))


@dataclass(frozen=True)
class Simulation:
    """Predicted spikes of a scene's afferents."""

    spikes_s: list[Any]
    """The times of each afferent's spikes, s: an array with NumPy, else a list. Empty lists with `rates_only`."""
    rates_hz: Any
    """The mean rate of each afferent, impulses/s: an array with NumPy, else a list."""
    raw: dict[str, Any] = field(repr=False)
    """The program's whole answer."""


@hinted
def simulate(scene: Scene, *, model: str | None = None, rates_only: bool = False) -> Simulation:
    """Predict the spikes of a scene's afferents.

    `scene` is the path of a scene file, or a dict with its keys: see `docs/reference/scene.md`. A dict may hold NumPy values.
    `model`: `membrane` or `afferents`. Runs the installed program `meissner`; no daemon is needed.
    """
    arguments = ["simulate"]
    if isinstance(scene, Mapping):
        arguments.append("-")
        check_json("scene", scene)
        text = json.dumps(scene, default=plain)
    else:
        arguments.append(os.fspath(scene))
        text = None
    if model is not None:
        arguments += ["--model", model]
    if rates_only:
        arguments.append("--rates-only")
    raw = _run(arguments, text)
    spikes = [as_array(times) for times in raw.get("spikes_s") or []]
    return Simulation(spikes, as_array(raw["rates_hz"]), raw)


@dataclass(frozen=True)
class Design:
    """A pattern that a search has found."""

    name: str
    toml: str
    """The pattern file."""
    summary: dict[str, Any] = field(repr=False)
    """What the program says. Of a search: rates, and what two rules of thumb reach (`baselines`)."""


@hinted
def design(
    target: str,
    *,
    seed: int | None = None,
    setting: str | None = None,
    budget: int | str | None = None,
    robust: bool = False,
    name: str | None = None,
    array: str | os.PathLike[str] | None = None,
) -> Design:
    """Find a pattern for a target shape: the name of a shipped object, or the path of an object file.

    It runs `meissner optimise` on this machine. `setting` is as there. `budget` is a number of evaluations or seconds as in `"20s"`; without it the search goes on until
    nothing improves. `name`: the pattern's; without it `TARGET-found`. `array`: the name of a shipped array, or the file of a
    description; without it the target's.
    """
    name = name or f"{Path(target).stem}-found"
    options = {"seed": seed, "setting": setting, "budget": budget}
    arguments = ["optimise", target, *([] if array is None else ["--array", os.fspath(array)])]
    for key, value in options.items():
        if value is not None:
            arguments += [f"--{key}", str(value)]
    if robust:
        arguments.append("--robust")
    with tempfile.TemporaryDirectory(prefix="meissner-") as folder:
        file = Path(folder) / f"{name}.toml"
        summary = _run([*arguments, "-o", str(file)])
        return Design(name, file.read_text(encoding="utf-8"), summary)


@contextlib.contextmanager
def described(array: Array, options: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Options with an `array`, else with the file of this description: this machine's program may not know the name."""
    if "array" in options:
        yield dict(options)
    else:
        with tempfile.TemporaryDirectory(prefix="meissner-") as folder:
            file = Path(folder) / "array.toml"
            file.write_text(array.raw["toml"], encoding="utf-8")
            yield {**options, "array": file}


@dataclass(frozen=True)
class Rendering(Design):
    """A pattern that gives a finger the response that an object gives. `summary`: `duration_s`, `motors`, `highest_um`, `method`, times, and as
    `choice` what `auto` has taken and how near each answer comes.
    """


@hinted
def render(
    object: Object,
    *,
    touch: Mapping[str, Any] | None = None,
    method: str | None = None,
    name: str | None = None,
    array: str | os.PathLike[str] | None = None,
) -> Rendering:
    """Render an object's touch: a dict with the keys of an object file, the path of one, or the name of a shipped one.

    It runs `meissner render` on this machine. `touch` is the object's `[touch]`, such as `{"press": {"depth_um": 500}}`, for a dict
    that has none. A dict may hold NumPy values; the files that it names are found from the working directory. `method` is `auto`,
    `trace`, `field`, `rate`, `rule` or `stroke`. `name`: the pattern's; without it `NAME-rendered`. `array` as for `design`.
    """
    with tempfile.TemporaryDirectory(prefix="meissner-") as folder:
        if isinstance(object, Mapping):
            object = {**object, **({} if touch is None else {"touch": touch})}
            stem = str(object.get("name", "object"))
        elif touch is not None:
            raise ValueError("`touch` goes with an object that is a dict: a file has its own")
        else:
            stem = Path(object).stem
        source = _object_file(object, folder)
        name = name or f"{stem}-rendered"
        arguments = ["render", source, *([] if array is None else ["--array", os.fspath(array)])]
        if method is not None:
            arguments += ["--method", method]
        file = Path(folder) / f"{name}.toml"
        summary = _run([*arguments, "-o", str(file)])
        return Rendering(name, file.read_text(encoding="utf-8"), summary)


def _object_file(object: Object, folder: str) -> str:
    """An object as the program names it; a dict is written into the folder."""
    if not isinstance(object, Mapping):
        return os.fspath(object)
    file = Path(folder) / "object.toml"
    file.write_text(_toml(_with_paths({"kind": "object", "name": "object", **object})), encoding="utf-8")
    return str(file)


@dataclass(frozen=True)
class Judgement:
    """How near fingers' responses to patterns come to those to the real object."""

    lines: dict[str, dict[str, Any]]
    """By name: the judged pattern, the object felt again, methods of rendering, plain rules. `r`, `error`, and both by class."""
    felt: dict[str, Any]
    """Of the first finger: `afferents`, and their spikes, s: `object_spikes_s`, `pattern_spikes_s`."""
    raw: dict[str, Any] = field(repr=False)
    """The program's whole answer."""


@hinted
def judge(
    pattern: str | os.PathLike[str],
    object: Object,
    *,
    fingers: int = 5,
    seed: int = 0,
    array: str | os.PathLike[str] | None = None,
) -> Judgement:
    """Compare what fingers feel of a pattern with what they feel of the real object.

    `pattern` is a name of the library, the path of a pattern file, or its text. `object` as for `render`; a dict needs its `touch`.
    """
    with tempfile.TemporaryDirectory(prefix="meissner-") as folder:
        if isinstance(pattern, str) and "\n" in pattern:
            file = Path(folder) / "pattern.toml"
            file.write_text(pattern, encoding="utf-8")
            pattern = file
        arguments = ["judge", os.fspath(pattern), f"--object={_object_file(object, folder)}"]
        arguments += [
            f"--fingers={fingers}",
            f"--seed={seed}",
            *([] if array is None else ["--array", os.fspath(array)]),
        ]
        raw = _run(arguments)
    return Judgement({line["name"]: line for line in raw["lines"]}, raw["felt"], raw)


def _with_paths(keys: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of an object, in which every `file` is an absolute path."""
    return {
        key: os.path.abspath(value) if key == "file" else _with_paths(value) if isinstance(value, Mapping) else value
        for key, value in keys.items()
    }


def _toml(keys: Mapping[str, Any]) -> str:
    """Keys as a TOML document, with inline tables."""
    return "".join(f"{json.dumps(key)} = {toml_value(value)}\n" for key, value in keys.items())


def toml_value(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, Mapping):
        pairs = (f"{json.dumps(key)} = {toml_value(of)}" for key, of in value.items())
        return f"{{ {', '.join(pairs)} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, (str, bool, int)):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, float):
        # TOML has `inf` and `nan`, as Python; the program refuses them by their keys.
        return repr(float(value))
    return toml_value(plain(value))


_PATIENT = {"lead_ms": 500, "lease_ms": 5000}
"""A long lead and host watchdog timeout: a simulated array on a busy machine should outlast its stalls.

With a lead of 1 s the line would not carry the 50 updates per second of a live object.
"""


Board = Union[bool, Literal["lower-stop"]]
"""Whether the simulated array is as a board is: without telemetry, so that pins drift, and on a line as fast as USB; with a lower stop, which
keeps them at rest, or without one."""


@hints
class Daemon:
    """A daemon with the simulated array, for a script or a test. It keeps its files in a folder that goes with it."""

    def __init__(self, config: str = "", *, board: Board = False) -> None:
        """Starts it. `config` is text for its configuration file, such as `session_silence_s = 5`. `board`: whether the simulated array is as
        a board is; `"lower-stop"`: as one whose array has a lower stop.
        """
        if board not in (True, False, "lower-stop"):
            raise ValueError(f"`board` is {board!r}: must be True, False or 'lower-stop'")
        program = find_program()
        if not has_unix_sockets():
            raise ProgramError("the daemon runs on Linux only: connect to the URL of a PC where it runs")
        # A `TemporaryDirectory` would also go with a forked child.
        folder = self._folder = Path(tempfile.mkdtemp(prefix="meissner-"))
        self._owner = os.getpid()
        self.socket = str(folder / "meissner.sock")
        """The socket to connect to."""
        (folder / "patterns").mkdir()
        paths = f"patterns_dir = '{folder / 'patterns'}'\nlogbook_dir = '{folder / 'record'}'\n"
        paths += f"calibration = '{folder / 'calibration.toml'}'\n"
        patient = [f"{key} = {value}\n" for key, value in _PATIENT.items() if key not in config]
        (folder / "meissner.toml").write_text("".join([paths, *patient, config]), encoding="utf-8")
        self._log = folder / "log"
        with self._log.open("wb") as log:
            command = [
                program,
                "daemon",
                "--device",
                {False: "mock", True: "mock:board", "lower-stop": "mock:board,lower-stop"}[board],
                "--socket",
                self.socket,
                "--config",
                str(folder / "meissner.toml"),
            ]
            self._process = subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        _ending.opened(self)
        try:
            self._wait_until_it_listens()
        except BaseException:
            self.close()
            raise

    def _wait_until_it_listens(self) -> None:
        deadline = time.monotonic() + 120.0
        while True:
            self.check()
            with socket.socket(socket.AF_UNIX) as trial:
                try:
                    trial.connect(self.socket)
                    return
                except OSError as error:
                    if time.monotonic() > deadline:
                        raise ProgramError(f"the daemon does not listen after 120 s: {error}") from error
            time.sleep(0.01)

    @property
    def pid(self) -> int:
        """Its process."""
        return self._process.pid

    @property
    def runs(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def check(self) -> None:
        """Raises an error if it has ended."""
        if self._process.poll() is not None:
            lines = self._log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            raise ProgramError(f"the daemon has ended: {lines[-1] if lines else 'without a message'}")

    def close(self) -> None:
        """Ends it: pins returned, motors off."""
        _ending.closed(self)
        if self._owner != os.getpid():
            return
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(10)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    def end(self) -> None:
        """Ends it as Python ends."""
        self.close()

    def release(self, last: bool) -> None:
        """Ends it if the program dies, by another thread."""
        if last:
            self.close()

    def __enter__(self) -> Daemon:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
