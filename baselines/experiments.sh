#!/bin/sh
# All experiments of docs/experiments.md, one after another; the same command goes on after a stop, and skips what is finished.
#
#   sh baselines/experiments.sh                # everything: weeks on two cores
#   sh baselines/experiments.sh --dry_run      # what would run, and about how long each study takes
#   PILOT=1 sh baselines/experiments.sh        # two seeds, a tenth of the steps: to be read before the rest is started
#
# Start it from a checkout that does not change meanwhile: git worktree add ../frozen. BUDGET: environment steps of a training.
BUDGET=${BUDGET:-200000}
SEEDS=10
FEW_SEEDS=5
OUTPUT=docs/results
if [ -n "$PILOT" ]; then
    BUDGET=$((BUDGET / 10)) SEEDS=2 FEW_SEEDS=2 OUTPUT=runs/ablate/pilot
fi
options="$*"

run() {
    # shellcheck disable=SC2086 (options are words)
    python -m maniskill_grpd study --output "$OUTPUT" --study "$@" $options || echo "study $1 has failed runs; the others go on" >&2
}

for policy in grpd empn hetero_gnn transformer hepi; do
    run "tuning_$policy" --budget "$((BUDGET / 2))" --seeds 2
done
for study in main equivariance heterogeneity bpp_vs_ppo pose_range unseen_poses unseen_shapes bar; do
    run "$study" --budget "$BUDGET" --seeds "$SEEDS"
done
for study in noise resolution grippers; do
    run "$study" --budget "$BUDGET" --seeds "$SEEDS"
done
for study in decoder features architecture hepi; do
    run "$study" --budget "$BUDGET" --seeds "$FEW_SEEDS"
done
run cost --seeds 5
