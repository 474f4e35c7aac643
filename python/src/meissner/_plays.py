"""What blocking and asynchronous plays have in common: the receipt that is known so far, and ends that hide no error."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Generator
from typing import Any

from ._operations import Accepted
from .clocks import Instant
from .errors import MeissnerError, NotKnownYet
from .results import Item, Receipt


class KnownPlay:
    """A play that the daemon has taken, and what is known of it."""

    def __init__(self, accepted: Accepted) -> None:
        self._accepted = accepted
        self._receipt: Receipt | None = None

    @property
    def id(self) -> int:
        """The play's number since the daemon's start."""
        return self._accepted.id

    @property
    def pattern(self) -> str:
        """The pattern's name, or the sequence's."""
        return self._accepted.pattern

    @property
    def ordered_s(self) -> float | None:
        """Duration as ordered, s; None: without end."""
        return self._accepted.ordered_s

    @property
    def motions(self) -> tuple[dict[str, Any], ...]:
        """How each motor follows its motions, computed before they are played: `error_um`, `error_share`, `too_slow_from_s` and more."""
        return self._accepted.motions

    @property
    def receipt(self) -> Receipt:
        """The newest receipt."""
        if self._receipt is None:
            raise NotKnownYet(f"play {self.id} has no receipt yet: call `wait()` or `refresh()` first")
        return self._receipt

    @property
    def onset(self) -> Instant:
        """When it began, on every clock."""
        if self.receipt.onset is None:
            raise NotKnownYet(f"play {self.id} had not begun ({self.receipt.state}): call `wait()` first")
        return self.receipt.onset

    @property
    def offset(self) -> Instant:
        """When its last pulse was over, on every clock."""
        if self.receipt.offset is None:
            raise NotKnownYet(f"play {self.id} has no end yet ({self.receipt.state}): call `wait()` first")
        return self.receipt.offset

    @property
    def items(self) -> tuple[Item, ...]:
        """The items of a sequence."""
        return self.receipt.items

    def __repr__(self) -> str:
        state = self._receipt.state if self._receipt else "accepted"
        return f"<play {self.id}: {self.pattern}, {state}>"


@contextlib.contextmanager
def quietly(what: str, failed: bool) -> Generator[None]:
    """Turns an error into a warning if another error is on its way, so that it does not hide that one."""
    try:
        yield
    except MeissnerError as error:
        if not failed:
            raise
        warnings.warn(f"{what}: {error}", stacklevel=4)
