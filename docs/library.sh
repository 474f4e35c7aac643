#!/usr/bin/env bash
# Makes the patterns of the library again from targets/, and prints the time of each. The bytes are the same unless models,
# search or targets have changed. Usage: docs/library.sh [DIR]; without DIR it writes into patterns/
set -euo pipefail
cd "$(dirname "$0")/.."
out=${1:-patterns}
cargo build --release --quiet
begun=$SECONDS
for target in targets/*.toml; do
    name=$(basename "$target")
    target/release/meissner optimise "$target" --robust -o "$out/$name" --json | python3 -c '
import json, sys
made = json.load(sys.stdin)
print("%-16s cost %6.1f held out %6.1f  %5d evaluations %5.1f s" % (
    made["target"], made["cost_hz"], sum(made["robustness"]["held_out_hz"]) / len(made["robustness"]["held_out_hz"]),
    sum(made["evaluations"]), made["wall_s"]))'
done
echo "the whole library: $((SECONDS - begun)) s"
