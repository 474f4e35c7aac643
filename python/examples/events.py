"""Listen to the daemon while a play runs."""

import meissner

with meissner.demo() as m:
    events = m.events()
    print(next(events).name)
    play = m.play("pin-60", seconds=0.2)
    for event in events:
        if event.name in ("queued", "began", "ended"):
            print(event.name)
        if event.name == "ended" and event["receipt"]["id"] == play.id:
            break
    events.close()
