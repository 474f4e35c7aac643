#!/usr/bin/env bash
# Makes the patterns of the library again, and prints the time of each. The bytes are the same unless the model, the
# search or objects have changed. Usage: docs/library.sh [--rendered] [DIR]. It makes OBJECT-paper.toml, without DIR in
# library/patterns/paper/; with --rendered OBJECT-rendered.toml, without DIR in library/patterns/rendered/.
set -euo pipefail
cd "$(dirname "$0")/.."
if [ "${1:-}" = --rendered ]; then
    out=${2:-library/patterns/rendered}
    cargo build --release --quiet
    for object in library/objects/*.toml; do
        target/release/meissner render "$object" -o "$out/$(basename "$object" .toml)-rendered.toml"
    done
    exit
fi
out=${1:-library/patterns/paper}
cargo build --release --quiet
begun=$SECONDS
for object in library/objects/*.toml; do
    target/release/meissner optimise "$object" --robust -o "$out/$(basename "$object" .toml)-paper.toml" --json | python3 -c '
import json, sys
made = json.load(sys.stdin)
print("%-16s contrast %6.1f (naive %6.1f), held out %6.1f  %5d evaluations %5.1f s" % (
    made["target"], made["cost_hz"], made["baselines"][0]["cost_hz"],
    sum(made["robustness"]["held_out_hz"]) / len(made["robustness"]["held_out_hz"]), sum(made["evaluations"]), made["wall_s"]))'
done
echo "all of library/objects/: $((SECONDS - begun)) s"
