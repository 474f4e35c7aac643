"""Play the plays of a recorded session once more, with the same gaps to the tick: python replay.py SESSION

Patterns are played as they were, also if the library has other ones by now. What cannot be played again is told and left out.
It needs an armed daemon (`meissner arm`).
"""

import sys
from collections import deque
from typing import Any

import meissner

Row = dict[str, Any]


def item(row: Row) -> dict[str, Any]:
    """A recorded play, or an item of a recorded sequence, as an item of a sequence."""
    trigger = row["trigger"] and {key: row["trigger"][key] for key in ("code", "width_ms") if row["trigger"][key]}
    start = (row["planned_onset_ticks"] or 0) / row["tick_hz"]
    seconds = row["seconds"] if row["state"] in ("done", "played") else row["played_ms"] / 1000
    if not row["pattern_sha256"]:
        return {"pattern": None, "seconds": seconds, "start": start}
    keys = {key: row[key] for key in ("pattern", "pattern_sha256", "scale")}
    return {**keys, "seconds": seconds, "start": start, "trigger": trigger or False}


def why_not(play: Row, items: list[Row]) -> str | None:
    """Why a play cannot be played again."""
    if play["onset_tick"] is None:
        return "it never began"
    if play["live"] or (play["items_planned"] and not items):
        return "its record has no pattern: it was live, or cut before its first item ended"
    return None if all(row["pattern_kept"] for row in items or [play]) else "the text of its pattern is not kept"


def is_soon(play: Row, before: Row) -> bool:
    """Whether a play begins within a minute of another one."""
    return bool((play["onset_tick"] or 0) < before["onset_tick"] + 60 * before["tick_hz"])


def main(session: str) -> int:
    """Plays; if that fails, what was ordered must not go on."""
    with meissner.connect() as m:
        try:
            return replay(m, session)
        except BaseException:
            m.stop()
            raise


def replay(m: meissner.Client, session: str) -> int:
    """Plays, and compares each gap and each end with the record."""
    by_play: dict[int, list[Row]] = {}
    for row in m.session_plays(session)["plays"]:
        by_play.setdefault(row["play"], []).append(row)
    # Nothing is played for a moment: its onset is an instant of this device to count from.
    zero = m.sequence([None], seconds=0.1).wait().onset
    assert zero is not None
    first: Row | None = None
    running: deque[tuple[Row, int, meissner.Play]] = deque()
    differing = left_out = 0
    while by_play or running:
        number = next(iter(by_play), 0)
        # A play that is ordered long before outlasts a stall of this process. The daemon queues 16, for an hour at most.
        if by_play and (not running or (len(running) < 8 and is_soon(by_play[number][0], running[-1][0]))):
            play, *items = by_play.pop(number)
            items = [row for row in items if row["state"] in ("played", "incomplete")]
            if reason := why_not(play, items):
                left_out += 1
                print(f"play {number} is left out: {reason}")
                continue
            first = first or play
            if play["boot"] != first["boot"]:
                sys.exit(f"play {number} is of another start of the device: the gap before it is not known to the tick")
            gap = play["onset_tick"] - first["onset_tick"]
            try:
                again = m.sequence(
                    [item(row) for row in items or [play]],
                    at=zero.later(1.0 + gap / play["tick_hz"]),
                    name=play["pattern"],
                    trial=play["trial"],
                    labels=play["labels"],
                    late=play["late_policy"],
                    open_loop=play["open_loop"],
                )
            except meissner.errors.Empty:
                left_out += 1
                print(f"play {number} is left out: it was stopped before its first stroke had ended")
                continue
            running.append((play, gap, again))
            continue
        play, gap, again = running.popleft()
        receipt = again.wait(check=False)
        now = None if receipt.onset is None else receipt.onset.tick - zero.later(1.0).tick
        differs = now != gap or receipt.state != "done"
        differing += differs
        print(f"play {play['play']} ({play['pattern']}): {gap} ticks after the first, now {now}, {receipt.state}")
    print(f"{differing} differ, {left_out} left out")
    return differing + left_out > 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
