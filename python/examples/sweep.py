"""Sweep over objects: render each, judge the pattern and simulate its spikes, a row each, here or on a cluster with Slurm.

python sweep.py results.csv                     on this machine, one cell per core at a time
python sweep.py results.csv --cluster slurm     as a job array; the folder `jobs` must be on a disk that all nodes share

What the table has is not computed again: after a kill or a failed cell, give the same command. A table `results.parquet` needs pyarrow.
"""

import argparse
import itertools
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import pandas
import submitit

import meissner

GRID: dict[str, list[float]] = {"width_mm": [0.8, 2.0], "angle_deg": [0.0, 45.0], "depth_um": [300.0, 500.0]}


def cell(width_mm: float, angle_deg: float, depth_um: float) -> dict[str, Any]:
    """The results of a cell: one number or word for each column."""
    shape = {"shape": "bar", "length_mm": 12.0, "width_mm": width_mm, "angle_deg": angle_deg}
    bar = {**shape, "touch": {"press": {"depth_um": depth_um}}}
    with tempfile.TemporaryDirectory() as folder:
        pattern = Path(folder) / "bar.toml"
        pattern.write_text(meissner.render(bar, name="bar").toml)
        judged = meissner.judge(pattern, bar, fingers=2)
        spikes = meissner.simulate(pattern, model="afferents", rates_only=True)
    row = {key: judged.lines["bar"][key] for key in ("r", "error", "r_in_space")}
    return row | {f"{of['class']}_hz": of["mean_hz"] for of in spikes.raw["classes"]}


def main() -> int:
    """Computes the cells that the table does not have."""
    parser = argparse.ArgumentParser(description="Render, judge and simulate bars")
    parser.add_argument("table", type=Path)
    parser.add_argument("--cluster", default="local", choices=["local", "slurm", "debug"])
    asked = parser.parse_args()
    write, read = (
        (pandas.DataFrame.to_parquet, pandas.read_parquet)
        if asked.table.suffix == ".parquet"
        else (pandas.DataFrame.to_csv, pandas.read_csv)
    )
    cells = list(itertools.product(*GRID.values()))
    names = list(GRID)
    rows = read(asked.table).to_dict("records") if asked.table.exists() else []
    done = {tuple(row[name] for name in names) for row in rows}
    missing = [values for values in cells if values not in done]

    executor = submitit.AutoExecutor("jobs", cluster=asked.cluster)
    executor.update_parameters(timeout_min=60, slurm_array_parallelism=200)
    # Slurm queues jobs; on this machine all that are submitted run at once.
    size = len(missing) if asked.cluster == "slurm" else os.cpu_count() or 1
    failed = 0
    for some in (missing[begin : begin + size] for begin in range(0, len(missing), max(size, 1))):
        for values, job in zip(some, executor.map_array(cell, *zip(*some, strict=True)), strict=True):
            of = dict(zip(names, values, strict=True))
            if (error := job.exception()) is not None:
                failed += 1
                print(f"{of}: {error}", file=sys.stderr)
                continue
            rows.append(of | job.result())
            half = asked.table.with_name(f"half-{asked.table.name}")
            write(pandas.DataFrame(rows).sort_values(names), half, index=False)
            half.replace(asked.table)
    print(f"{len(missing) - failed} cells computed, {failed} failed, {len(rows)} of {len(cells)} in {asked.table}")
    return failed > 0


if __name__ == "__main__":
    sys.exit(main())
