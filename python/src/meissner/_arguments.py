"""Arguments of public calls: what is refused before anything is sent, in one line that says what to do.

`hinted` wraps a function, `hints` the public methods of a class: an argument that they do not have is told with the one that was meant.
"""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import numbers
import os
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
C = TypeVar("C", bound=type)

_MEANT = {
    "seconds": "duration dur length time",
    "scale": "amplitude intensity strength level volume gain factor",
    "isi": "gap pause interval iti",
    "at": "onset start delay when",
    "rt_ms": "rt reaction_time response_time latency",
    "participant": "subject subject_id participant_id name id",
    "pattern": "stimulus name",
    "timeout": "seconds duration max_wait",
    "repeats": "reps repetitions trials n",
    "ratio": "factor multiplier",
    "step": "step_size stepsize",
    "minimum": "min min_level lowest",
    "maximum": "max max_level highest",
    "max_trials": "trials n_trials ntrials",
    "start": "start_value start_level initial level",
    "down": "n_down ndown rule",
    "budget": "seconds duration time",
    "budget_s": "seconds duration",
    "correct": "right hit",
    "root": "path folder directory",
    "file": "path",
    "assume_rest": "rest at_rest level",
}
"""The names of arguments, and what they are taken for."""
_ELSEWHERE = {
    "gap": "pauses are those of `sequence(..., isi=0.5)`",
    "pause": "pauses are those of `sequence(..., isi=0.5)`",
    "frequency": "frequencies are those of drives: `drives=[{'motor': 9, 'frequency_hz': 60, 'amplitude_um': 40}]`",
    "frequency_hz": "frequencies are those of drives: `drives=[{'motor': 9, 'frequency_hz': 60, 'amplitude_um': 40}]`",
}


_PATHS = ("target", "object", "scene")


def meant(name: str, known: Collection[str]) -> str | None:
    """Which of the known names was meant."""
    for right, wrong in _MEANT.items():
        if right in known and name.lower() in wrong.split():
            return right
    if name in _ELSEWHERE:
        return None
    near = difflib.get_close_matches(name, known, 1)
    return near[0] if near else None


def _problem(function: Callable[..., Any], args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> str | None:
    """What is wrong with the arguments of a call."""
    of = inspect.signature(function).parameters
    bound = [name for name in of if name in ("self", "core", "client")][:1]
    own = {name: parameter for name, parameter in of.items() if name not in bound}
    name = function.__qualname__.split(".")[-2 if function.__name__ == "__init__" else -1]
    name = "live" if name == "start" and "core" in bound else name
    kinds = [parameter.kind for parameter in own.values()]
    unknown = [key for key in kwargs if key not in own and inspect.Parameter.VAR_KEYWORD not in kinds]
    if unknown:
        right = meant(unknown[0], [key for key in own if key not in kwargs])
        there = _ELSEWHERE.get(unknown[0], f"it has {', '.join(f'`{key}`' for key in own)}")
        return f"`{name}()` has no argument `{unknown[0]}`: {f'did you mean `{right}`?' if right else there}"
    positional = [key for key, parameter in own.items() if parameter.kind is parameter.POSITIONAL_OR_KEYWORD]
    given = args[len(bound) :]
    if len(given) > len(positional) and inspect.Parameter.VAR_POSITIONAL not in kinds:
        by_name = next((key for key in own if key not in positional), None)
        if by_name is None:
            return f"`{name}()` takes {' and '.join(f'`{key}`' for key in own) or 'no argument'}, and no more"
        most = f"takes {', '.join(f'`{key}`' for key in positional)} alone" if positional else "takes nothing"
        return f"`{name}()` {most} without a name: give the others by name, as `{by_name}=`"
    return None


def _no_path(function: Callable[..., Any], args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> str | None:
    """Which argument of a call should be a path, and is none."""
    signature = inspect.signature(function)
    for name, value in signature.bind(*args, **kwargs).arguments.items():
        kind = str(signature.parameters[name].annotation)
        is_path = name in _PATHS or "PathLike" in kind
        if is_path and not isinstance(value, (str, os.PathLike)) and (value is not None or "None" not in kind):
            return f"`{name}` is {value!r}: must be a name, or the path of a file"
    return None


def _meant(
    function: Callable[..., Any], error: TypeError, args: tuple[Any, ...], kwargs: Mapping[str, Any]
) -> TypeError:
    """The error to tell the caller."""
    # One of the call itself, and not from within, has the frame of `hinted` alone.
    is_own = error.__traceback__ is not None and error.__traceback__.tb_next is None
    problem = _problem(function, args, kwargs) if is_own else None
    if "os.PathLike" in str(error):
        problem = _no_path(function, args, kwargs)
    return error if problem is None else TypeError(problem)


def hinted(function: Callable[P, T]) -> Callable[P, T]:
    """The function, whose error for a wrong argument says which one was meant."""

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return function(*args, **kwargs)
        except TypeError as error:
            told = _meant(function, error, args, kwargs)
            raise told from (None if told is not error else error.__cause__)

    return call


def hints(of: C) -> C:
    """The class, whose public methods are `hinted`."""
    for name, value in list(vars(of).items()):
        if inspect.isfunction(value) and (name == "__init__" or not name.startswith("_")):
            setattr(of, name, hinted(value))
    return of


def plain(value: Any) -> Any:
    """A number of NumPy as one of Python."""
    return value.tolist() if hasattr(value, "tolist") else value


def number(name: str, value: object, such_as: str = "") -> float:
    """A finite number. Raises `TypeError` for what is none, `ValueError` for NaN and infinity."""
    value = plain(value)
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise TypeError(f"`{name}` is {value!r}: must be a number{such_as}")
    if not math.isfinite(value):
        raise ValueError(f"`{name}` is {value}: must be a finite number{such_as}")
    return float(value)


def whole(name: str, value: object, least: int) -> int:
    """A whole number."""
    value = plain(value)
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise TypeError(f"`{name}` is {value!r}: must be a whole number")
    if value < least:
        raise ValueError(f"`{name}` is {value}: must be {least} or more")
    return int(value)


def listed(name: str, values: Iterable[T], such_as: str) -> list[T]:
    """The values of a list. Raises `TypeError` for what is none, and for a text, which Python takes for a list of letters."""
    if (
        isinstance(values, (str, bytes, Mapping))
        or not isinstance(values, Iterable)
        or getattr(values, "shape", None) == ()
    ):
        raise TypeError(f"`{name}` is {values!r}: must be a list, such as {such_as}")
    return list(values)


def table(name: str, value: object, such_as: str) -> dict[str, Any]:
    """A dict."""
    if not isinstance(value, Mapping):
        raise TypeError(f"`{name}` is {value!r}: must be a dict, such as {such_as}")
    return dict(value)


def drive_list(drives: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Drives as dicts."""
    such_as = "{'motor': 9, 'frequency_hz': 60, 'amplitude_um': 40}"
    return [
        table(f"drives[{place}]", drive, such_as)
        for place, drive in enumerate(listed("drives", drives, f"[{such_as}]"))
    ]


def text(name: str, value: object) -> str:
    """A text."""
    if not isinstance(value, str):
        raise TypeError(f"`{name}` is {value!r}: must be a text")
    return value
