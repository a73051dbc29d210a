#!/usr/bin/env bash
# The same run on 1, 2, ... processes: how much faster does it become here?
#
#   demos/cluster/scaling.sh [LARGEST NUMBER OF PROCESSES] [OPTIONS OF opticcup run]...
set -euo pipefail
cd "$(dirname "$0")/../.."

largest=${1:-2}
shift || true
for ((ranks = 1; ranks <= largest; ranks *= 2)); do
    begin=$EPOCHREALTIME
    docker/run mpirun -n "$ranks" opticcup run demos/chick.toml --out "results/scaling/$ranks" \
        --set run.t_end=0.05 --set output.picture=false --quiet "$@" >/dev/null
    awk -v ranks="$ranks" -v begin="$begin" -v end="$EPOCHREALTIME" \
        'BEGIN { printf "%d processes: %.1f s\n", ranks, end - begin }'
done
