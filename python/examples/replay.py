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
    """The items of a recorded play, as those of a sequence. One that was cut lasts as long as the play did; of several it is left out."""
    made = []
    for item in receipt["items"] or []:
        is_cut = item["state"] == "cut"
        if item["state"] == "not-begun" or (is_cut and receipt["order"]["items"] > 1):
            continue
        start = item["planned_onset_ticks"] / receipt["device"]["tick_hz"]
        seconds = receipt["duration_ms"]["played"] / 1000 - start if is_cut else item["ordered_ms"] / 1000
        trigger = item["trigger"] and {key: known for key, known in item["trigger"].items() if known and key != "tick"}
        keys = ("pattern", "pattern_sha256", "scale") if item["pattern_sha256"] else ()
        pattern = {"pattern": None, **{key: item[key] for key in keys}}
        made.append({**pattern, "seconds": seconds, "start": start, "trigger": trigger or False})
    return made


def why_not(play: dict[str, Any]) -> str | None:
    """Why a play cannot be played again."""
    if play["receipt"]["onset"] is None:
        return "it never began"
    if not play["patterns_kept"]:
        return "the text of its pattern is not kept, as of a live play"
    return None if items_of(play["receipt"]) else "it was cut before its first item ended"


def is_soon(play: Receipt, before: Receipt) -> bool:
    """Whether a play begins within a minute of another one."""
    last: int = before["onset"]["actual_tick"] + 60 * before["device"]["tick_hz"]
    return play["onset"] is None or play["onset"]["actual_tick"] < last


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
