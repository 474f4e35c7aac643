#!/usr/bin/env bash
# Makes the patterns of the library again from targets/, and prints the time of each. The bytes are the same unless models,
# search or targets have changed. Usage: docs/library.sh [--paper|--rendered] [DIR]; without DIR it writes into patterns/. With --paper
# it makes those of the paper's objective, TARGET-paper.toml, without DIR into patterns/paper/; with --rendered those of objects/,
# OBJECT-rendered.toml, without DIR into patterns/rendered/
set -euo pipefail
cd "$(dirname "$0")/.."
if [ "${1:-}" = --rendered ]; then
    out=${2:-patterns/rendered}
    cargo build --release --quiet
    for object in objects/*.toml; do
        target/release/meissner render "$object" -o "$out/$(basename "$object" .toml)-rendered.toml"
    done
    exit
fi
paper=""
if [ "${1:-}" = --paper ]; then
    paper=-paper
    shift
fi
out=${1:-patterns${paper:+/paper}}
cargo build --release --quiet
begun=$SECONDS
for target in targets/*.toml; do
    name=$(basename "$target" .toml)$paper
    target/release/meissner optimise "$target" --robust ${paper:+--objective contrast --model membrane} -o "$out/$name.toml" --json | python3 -c '
import json, sys
made = json.load(sys.stdin)
first, second = made["models"]
print("%-16s value %7.3f contrast %6.1f (naive %6.1f) and %5.1f (%5.1f) under the second model, held out %6.1f  %5d evaluations %5.1f s" % (
    made["target"], made["value"], first["cost_hz"], first["baselines"][0]["cost_hz"], second["cost_hz"],
    second["baselines"][0]["cost_hz"], sum(made["robustness"]["held_out_hz"]) / len(made["robustness"]["held_out_hz"]),
    sum(made["evaluations"]), made["wall_s"]))'
done
echo "the whole library: $((SECONDS - begun)) s"
