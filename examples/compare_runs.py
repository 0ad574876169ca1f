"""Compare trainings of two algorithms on the same task: return, spread over seeds, size of updates, collapses.

cd docs/results/earlier
python ../../../examples/compare_runs.py rope_wrapping_bpp_*.jsonl --against rope_wrapping_ppo_*.jsonl

Each file is the metrics.jsonl of one run. Printed for both sides: the mean of the return over the last tenth of the
training with its 95 % t interval, its standard deviation over seeds, the variance of the return over seeds (mean over all
iterations), the largest KL of any state in any iteration, and the share of iterations whose return is over 20 % below that of
the one before.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from maniskill_grpd.experiments import estimate
from maniskill_grpd.learning.run_log import read_rows

COLLAPSE = 0.8
"""An iteration collapses when its return is below this share of the previous one."""


def describe(paths: list[Path]) -> dict[str, str]:
    """Return the figures of one side."""
    logs = [[row for row in read_rows(path) if row["kind"] == "train"] for path in paths]
    length = min(len(rows) for rows in logs)
    returns = np.array([[row["train/return"] for row in rows[:length]] for rows in logs])  # (seeds, iterations)
    final = returns[:, -max(1, returns.shape[1] // 10) :].mean(axis=1)
    mean = estimate(final)
    low, high = mean.interval()
    collapses = returns[:, 1:] < COLLAPSE * returns[:, :-1]
    largest = max(row["losses/kl_raw_max"] for rows in logs for row in rows if "losses/kl_raw_max" in row)
    return {
        "seeds": f"{len(paths)}",
        "final return (mean, 95 %)": f"{mean.value:.1f} ({low:.1f} to {high:.1f})",
        "standard deviation of it over seeds": f"{final.std(ddof=1):.1f}",
        "variance over seeds, mean over training": f"{returns.var(axis=0, ddof=1).mean():.0f}",
        "largest KL of an update at a state [nats]": f"{largest:.1f}",
        "iterations whose return collapses": f"{collapses.mean():.1%}",
    }


def main() -> None:
    """Parse the command line and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="logs of one side")
    parser.add_argument("--against", type=Path, nargs="+", required=True, help="logs of the other side")
    arguments = parser.parse_args()
    ours, theirs = describe(arguments.runs), describe(arguments.against)
    print("| | first | second |\n|---|--:|--:|")
    for name, value in ours.items():
        print(f"| {name} | {value} | {theirs[name]} |")


if __name__ == "__main__":
    main()
