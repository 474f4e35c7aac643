"""Play a session on a simulated array, and export it to BIDS and, if pynwb is installed, to NWB."""

import importlib.util

import meissner

with meissner.demo() as m:
    with m.session(participant="P07", experiment="edges") as session:
        for trial, angle in enumerate((0, 45, 90), 1):
            m.play(f"edge-{angle}", seconds=0.2, trial=trial).wait()
    dataset = m.export_bids(session.id, "dataset")
    print(dataset.events, *dataset.left_out, sep="\n")
    if importlib.util.find_spec("pynwb"):
        file = m.export_nwb(session.id, f"{session.id}.nwb", subject={"age": "P30Y", "sex": "F"})
        print(file.file, *file.left_out, sep="\n")
