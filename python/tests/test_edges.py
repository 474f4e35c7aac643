"""Edges of the trigger input: plays that they start and stop, in receipts and exports."""

from __future__ import annotations

import time

import pytest

import meissner
from meissner import _rows, errors
from patience import kept
from test_bids_names import stimulus

DELAY_S = 2.0
"""What a busy machine may miss."""


def test_a_play_begins_its_delay_after_an_edge(m: meissner.Client) -> None:
    while True:
        play = m.play("pin-60", seconds=0.2, on_edge=DELAY_S)
        m.edge()
        receipt = play.wait(check=False)
        assert receipt.start_edge is not None
        if receipt.state == "done":
            break
        # The machine stood still for longer than the delay: nothing was played.
        assert receipt.cause == "the onset could not be kept"
        assert receipt.onset is None
    assert receipt.onset is not None
    assert receipt.onset.tick - receipt.start_edge.tick == round(DELAY_S * receipt.tick_hz)
    assert receipt.stop_edge is None
    assert receipt.raw["edges"]["start"]["number"] >= 1


def test_an_edge_stops_a_play(m: meissner.Client) -> None:
    play = m.play("pin-60", seconds=300, stop_on_edge=True)
    while m.status().playing != play.id:
        time.sleep(0.01)
    m.edge(after=0.01)
    with pytest.raises(errors.PlayStopped) as stopped:
        play.wait()
    receipt = stopped.value.receipt
    assert receipt.cause == "edge"
    assert receipt.stop_edge is not None
    assert receipt.start_edge is None


def test_mistakes_are_named(m: meissner.Client) -> None:
    onset = kept(lambda: m.play("pin-60", seconds=0.1).wait()).onset
    with pytest.raises(errors.TooSoon, match="at least"):
        m.play("pin-60", seconds=0.2, on_edge=0.001)
    with pytest.raises(ValueError, match="not both"):
        m.play("pin-60", seconds=0.2, on_edge=0.1, at=m.now() + 1)
    with pytest.raises(ValueError, match="not both"):
        m.edge(after=0.1, at=onset)
    for no_number in (True, "x", [0.1]):
        with pytest.raises(TypeError, match=r"`on_edge` is .*: must be a number of seconds"):
            m.play("pin-60", seconds=0.2, on_edge=no_number)  # type: ignore[arg-type]
        with pytest.raises(TypeError, match=r"`after` is .*: must be a number of seconds"):
            m.edge(after=no_number)  # type: ignore[arg-type]
    for endless in (float("nan"), float("inf")):
        with pytest.raises(ValueError, match=r"`on_edge` is .*: must be a finite number"):
            m.sequence(["pin-60"], seconds=0.2, on_edge=endless)
        with pytest.raises(ValueError, match=r"`after` is .*: must be a finite number"):
            m.edge(after=endless)
    waits = m.sequence(["pin-60"], seconds=0.2, on_edge=DELAY_S)
    assert waits.withdraw().state == "stopped"


def test_exports_name_the_edges() -> None:
    edge = {"number": 3, "tick": 99, "monotonic_ns": 1, "uncertainty_ns": 1}
    none = {"start_edge": None, "start_edge_tick": None, "stop_edge": None, "stop_edge_tick": None}
    play = stimulus()
    play["receipt"]["edges"]["start"] = edge
    row = _rows.of_play(play)
    assert {name: row[name] for name in none} == {**none, "start_edge": 3, "start_edge_tick": 99}
