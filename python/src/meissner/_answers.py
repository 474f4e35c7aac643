"""Answers to plays: what a play and a live play have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import _kept, _sessions
from . import _operations as ops
from ._arguments import hints
from ._bodies import Labels, Verdict
from ._plays import KnownPlay
from ._presses import Press
from .results import Receipt

if TYPE_CHECKING:
    from .client import Client


@hints
class Answerable(KnownPlay):
    """A play that takes an answer."""

    _client: Client

    def refresh(self) -> Receipt:
        """Ask for the receipt as it is now."""
        self._receipt = self._client.run(ops.receipt(self._client.core, self.id))
        return self._receipt

    def answer(
        self,
        response: object,
        *,
        correct: Verdict = None,
        rt_ms: float | None = None,
        level: float | None = None,
        factors: Labels = None,
    ) -> None:
        """Record what the participant answered: the text of `response`, whether it is right, the response time in ms.

        The play belongs to the running session and has begun; it takes one answer. `level` is that of the stimulus, such as a
        staircase's; `factors` are texts by name. Every export has them in the row of the play. A `Press` has its response time, from
        the onset of the play, and becomes the factors `response_tick` and `response_uncertainty_s`, too. What the daemon does not take
        is kept in a file of the user, which the error names.
        """
        with _kept.answer(play=self.id, response=response, correct=correct, rt_ms=rt_ms, level=level, factors=factors):
            if isinstance(response, Press) and (self._receipt is None or self._receipt.onset is None):
                self.refresh()
            onset = self.onset if isinstance(response, Press) else None
            order = _sessions.answer(self._client.core, self._accepted, onset, response, correct, rt_ms, level, factors)
            self._client.run(order)
