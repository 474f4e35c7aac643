"""Search a pattern beside a rule of thumb, from two starts, predict the afferents' response, and play the better one."""

import meissner

with meissner.demo() as m:
    found = {}
    for seed in (1, 2):
        design = m.design("dot", budget=200, seed=seed, name=f"dot-{seed}")
        found[design.summary["cost_hz"]] = design
        # The baseline without a search: all pins within reach, at 60 Hz in phase.
        reached, rule = design.summary["cost_hz"], design.summary["baselines"][0]["cost_hz"]
        print(f"{design.name}: on-target minus off-target {reached:.1f} impulses/s, rule of thumb {rule:.1f}")
    best = found[max(found)]
    drives = m.pattern(best.name)["pattern"]["drive"]
    moving = [drive for drive in drives if drive["amplitude_um"] > 0]
    answer = m.simulate({"duration_s": 0.5, "population": {"seed": 0}, "drives": moving}, rates_only=True)
    print(f"{len(answer.rates_hz)} afferents, the fastest {max(answer.rates_hz):.0f} impulses/s")
    print(m.play(best.name, seconds=0.2).wait().state)
