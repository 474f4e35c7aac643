"""Play the plays of a recorded session once more, with the same gaps to the tick: python replay.py SESSION

Patterns are played as they were, also if the library has other ones by now. What cannot be played again is told and left out.
It needs an armed daemon (`meissner arm`).
"""

import sys
from collections import deque
from typing import Any

import meissner

Receipt = dict[str, Any]


def items_of(receipt: Receipt) -> list[dict[str, Any]]:
    """The items of a recorded play, as those of a sequence: without the cut one of several."""
    is_one = receipt["order"]["items"] == 1
    return [
        item(record, receipt)
        for record in receipt["items"] or []
        if record["state"] in ("played", "incomplete") or (is_one and record["state"] == "cut")
    ]


def item(record: dict[str, Any], receipt: Receipt) -> dict[str, Any]:
    """An item of a recorded play, as an item of a sequence."""
    trigger = record["trigger"] and {
        key: record["trigger"][key] for key in ("code", "width_ms") if record["trigger"][key]
    }
    start = record["planned_onset_ticks"] / receipt["device"]["tick_hz"]
    seconds = (
        record["ordered_ms"] / 1000 if record["state"] != "cut" else receipt["duration_ms"]["played"] / 1000 - start
    )
    if not record["pattern_sha256"]:
        return {"pattern": None, "seconds": seconds, "start": start}
    keys = {key: record[key] for key in ("pattern", "pattern_sha256", "scale")}
    return {**keys, "seconds": seconds, "start": start, "trigger": trigger or False}


def why_not(play: dict[str, Any]) -> str | None:
    """Why a play cannot be played again."""
    receipt = play["receipt"]
    if receipt["onset"] is None:
        return "it never began"
    if receipt["live"] or not items_of(receipt):
        return "its record has no pattern: it was live, or cut before its first item ended"
    return None if play["patterns_kept"] else "the text of its pattern is not kept"


def is_soon(play: Receipt, before: Receipt) -> bool:
    """Whether a play begins within a minute of another one."""
    last = before["onset"]["actual_tick"] + 60 * before["device"]["tick_hz"]
    return play["onset"] is None or bool(play["onset"]["actual_tick"] < last)


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
    plays = deque(m.session_plays(session)["plays"])
    # Nothing is played for a moment: its onset is an instant of this device to count from.
    zero = m.sequence([None], seconds=0.1).wait().onset
    assert zero is not None
    first: Receipt | None = None
    running: deque[tuple[Receipt, int, meissner.Play]] = deque()
    differing = left_out = 0
    while plays or running:
        # A play that is ordered long before outlasts a stall of this process. The daemon queues 16, for an hour at most.
        if plays and (not running or (len(running) < 8 and is_soon(plays[0]["receipt"], running[-1][0]))):
            play = plays.popleft()
            receipt, order = play["receipt"], play["receipt"]["order"]
            number = receipt["id"]
            if reason := why_not(play):
                left_out += 1
                print(f"play {number} is left out: {reason}")
                continue
            first = first or receipt
            if receipt["device"]["boot"] != first["device"]["boot"]:
                sys.exit(f"play {number} is of another start of the device: the gap before it is not known to the tick")
            gap = receipt["onset"]["actual_tick"] - first["onset"]["actual_tick"]
            try:
                again = m.sequence(
                    items_of(receipt),
                    at=zero.later(1.0 + gap / receipt["device"]["tick_hz"]),
                    name=receipt["name"],
                    trial=order.get("trial"),
                    labels=order.get("labels"),
                    late=order["late"],
                    open_loop=order["open_loop"],
                )
            except meissner.errors.Empty:
                left_out += 1
                print(f"play {number} is left out: it was stopped before its first stroke had ended")
                continue
            running.append((receipt, gap, again))
            continue
        before, gap, again = running.popleft()
        ended = again.wait(check=False)
        now = None if ended.onset is None else ended.onset.tick - zero.later(1.0).tick
        differs = now != gap or ended.state != "done"
        differing += differs
        print(f"play {before['id']} ({before['name']}): {gap} ticks after the first, now {now}, {ended.state}")
    print(f"{differing} differ, {left_out} left out")
    return differing + left_out > 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
