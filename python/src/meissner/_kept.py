"""What is kept in files of the user: the tokens of running sessions, so that the next run of a program that has crashed can go on, and
answers that the daemon has not taken.

Each session has a file beside those of the command line. Its owner holds a lock on it, which the system releases when the process
ends, however it ends.

Invariant: only the user may read a file, and no other process takes a token whose owner still runs. An answer is on the disk, or in
the error's text.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # Windows: sessions are not resumed there.
    fcntl = None  # type: ignore[assignment]

_held: dict[str, int] = {}
"""The open files, by session."""

if hasattr(os, "register_at_fork"):
    # A forked child has no lock.
    os.register_at_fork(after_in_child=_held.clear)


def _file(session_id: str) -> Path | None:
    runtime, home = os.environ.get("XDG_RUNTIME_DIR"), os.environ.get("HOME")
    base = Path(runtime) if runtime else Path(home, ".local", "state") if home else None
    if base is None or fcntl is None or not re.fullmatch(r"[\w-]{1,100}", session_id, re.ASCII):
        return None
    return base / "meissner" / f"session-{session_id}.token"


def keep(session_id: str, token: str) -> None:
    """Keeps a token. Where no file can hold it, the session is not resumed."""
    path = _file(session_id)
    if path is None:
        return
    with contextlib.suppress(OSError):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        _held[session_id] = file
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.write(file, f"{token}\n{session_id}\n".encode())


def take(session_id: str) -> str | None:
    """The kept token, for this process from now on; None: there is none. `BlockingIOError` if its owner still runs."""
    path = _file(session_id)
    if path is None:
        return None
    if session_id not in _held:
        try:
            file = os.open(path, os.O_RDWR)
        except OSError:
            return None
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(file)
            raise BlockingIOError(f"{path} is locked") from error
        _held[session_id] = file
    found = re.match(rb"([0-9a-f]{1,64})\n", os.pread(_held[session_id], 100, 0))
    return found[1].decode() if found else None


def let_go(session_id: str, *, forget: bool) -> None:
    """Leaves a session to the next run, or forgets its token."""
    path, file = _file(session_id), _held.pop(session_id, None)
    if forget and path is not None:
        with contextlib.suppress(OSError):
            path.unlink()
    if file is not None:
        os.close(file)


@contextlib.contextmanager
def answer(**given: Any) -> Iterator[None]:
    """Keeps an answer that the daemon does not take, and says so in the error."""
    try:
        yield
    except BaseException as error:
        given["time"] = datetime.now().astimezone().isoformat(timespec="milliseconds")
        line = json.dumps({key: value for key, value in given.items() if value is not None}, default=str)
        try:
            where = f"the answer is kept in {_add_answer(line)}"
        except (OSError, RuntimeError) as why:
            where = f"no file keeps the answer ({why}), write it down: {line}"
        error.args = (f"{error.args[0] if error.args else type(error).__name__}; {where}", *error.args[1:])
        raise


def _add_answer(line: str) -> Path:
    """Adds an answer to the user's file of answers that no session has."""
    path = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state", "meissner", "answers.jsonl")
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    try:
        os.write(file, f"{line}\n".encode())
        os.fsync(file)
    finally:
        os.close(file)
    return path
