#!/usr/bin/env bash
# Runs the sweep of the library (docs/sweeps/library.toml) and takes the drawings of the book from its page.
# Usage: docs/sweep.sh DIR; DIR holds the sweep and can be taken up again.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --quiet
target/release/meissner sweep docs/sweeps/library.toml --out "$1"
target/release/meissner sweep --merge "$1"
python3 docs/sweeps/figures.py "$1"
