#!/usr/bin/env bash
# Prints the figures of docs/dev/measurements.md that need no benchmark, one line each. Usage: docs/measure.sh [demos|idle|cold]
#   demos  twenty demos on a quiet machine and twenty beside four busy loops
#   idle   processor time and memory of an idle daemon
#   cold   the README's two commands from an empty target directory, with the registry's crates downloaded
# Without an argument: demos and idle.
set -euo pipefail
cd "$(dirname "$0")/.."
case ${1-} in
    "" | demos | idle | cold) ;;
    *) sed -n 's/^# \{0,1\}//p' "$0" | sed -n '2,6p' >&2; exit 2 ;;
esac

seconds_of() { # COMMAND...: prints its wall time, s; its output goes to stderr
    local begun=$SECONDS
    "$@" >&2 || echo "exit code $?: $*" >&2
    echo $((SECONDS - begun))
}

cold() (
    dir=$(mktemp -d)
    trap 'rm -rf "$dir"' EXIT
    cargo fetch --locked
    export CARGO_TARGET_DIR=$dir
    demo=$(seconds_of cargo run --release -- demo)
    tests=$(seconds_of cargo test)
    echo "cold: cargo run --release -- demo $demo s, cargo test $tests s, together $((demo + tests)) s"
)

if [ "${1-}" = cold ]; then
    cold
    exit
fi
cargo build --release --quiet
meissner=${CARGO_TARGET_DIR:-target}/release/meissner

demos() { # LABEL
    local sum
    sum=$(for _ in $(seq 20); do "$meissner" demo --seconds 5 --json || true; done | python3 -c '
import json, sys
runs = [json.loads(line) for line in sys.stdin]
bursts = {key: sum(run["receipt"]["counts"]["bursts"][key] for run in runs) for key in ("planned", "played", "late")}
with_late = sum(run["receipt"]["counts"]["bursts"]["late"] > 0 for run in runs)
onset = max(run["receipt"]["onset"]["latency_ms"] for run in runs if run["receipt"]["onset"])
rest = max(run["rest_error_um"]["rms"] for run in runs)
print(len(runs), "demos:", bursts, "with late bursts:", with_late, "longest onset: %.1f ms" % onset,
      "rest error at most %.1f um rms" % rest)')
    echo "$1: $sum"
}

idle() {
    local dir pid before after
    dir=$(mktemp -d)
    XDG_DATA_HOME=$dir "$meissner" daemon --device mock --socket "$dir/m.sock" 2>/dev/null &
    pid=$!
    sleep 2
    before=$(awk '{print $14 + $15}' "/proc/$pid/stat")
    sleep 30
    after=$(awk '{print $14 + $15}' "/proc/$pid/stat")
    echo "idle daemon: $((after - before)) of 3000 clock ticks in 30 s, $(awk '/VmRSS/ {print $2}' "/proc/$pid/status") kB resident"
    kill "$pid"
    wait "$pid"
    rm -r "$dir"
}

if [ "${1-}" != idle ]; then
    demos "quiet machine"
    busy=()
    for _ in 1 2 3 4; do
        (while :; do :; done) &
        busy+=($!)
    done
    trap 'kill "${busy[@]}" 2>/dev/null || true' EXIT
    demos "beside four busy loops"
    kill "${busy[@]}"
    trap - EXIT
fi
if [ "${1-}" != demos ]; then
    idle
fi
