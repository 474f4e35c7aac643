"""Listen to the daemon while a play runs, with asyncio."""

import asyncio

import meissner


async def main() -> None:
    """Order a play, and print its events."""
    with meissner.Daemon() as daemon:
        async with await meissner.connect_async(daemon.socket) as m:
            await m.arm(assume_rest=True)
            events = m.events()
            print((await anext(events)).name)
            play = await m.play("pin-60", seconds=0.2)
            async for event in events:
                if event.name in ("queued", "began", "ended"):
                    print(event.name)
                if event.name == "ended" and event["receipt"]["id"] == play.id:
                    break
            await events.aclose()


asyncio.run(main())
