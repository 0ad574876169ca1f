"""What a trust region protects: BPP and PPO from the same cloned policy.

python examples/start_from_demonstrations.py [--seeds 1 2 3] [--total_timesteps N] --json docs/results/demonstrations.json

Records the expert of ClothHanging-v1, then trains from it with both algorithms: `train --demonstrations FILE --algorithm A
--seed N`. With one seed both start from the same policy. With --untrained_values the value function is left as it was made, so
that the first advantages are noise; --exploration large explores with three times the deviation, correlated. The file gets the
evaluations of every run, the first of them that of the clone; runs that it holds already are not repeated.
`python -m tools.docs` makes docs/results/demonstrations.md of it.
"""

from __future__ import annotations

import argparse
import itertools
import json
from functools import partial
from pathlib import Path
from typing import Any

from maniskill_grpd.commands.train import parse_train_options
from maniskill_grpd.imitation.recording import RecordConfig, record
from maniskill_grpd.imitation.warm_start import start_from_demonstrations
from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.runs.training import train

ENV_ID = "ClothHanging-v1"
ENV_KWARGS = ("resolution=64", "graph_nodes=25")
DEMONSTRATIONS = Path("demos/start_from_demonstrations")
ALGORITHMS = ("bpp", "ppo")
EXPLORATION = {"small": "", "large": "--noise_correlation 0.5 --noise_schedule linear --policy_kwargs init_std=0.15"}
SETTINGS = "--eval_freq 1 --num_eval_envs 20 --no_capture_video --checkpoint_freq 1000"


def demonstrate(num_episodes: int) -> Path:
    """Record the expert, unless that is done; return the file."""
    path = DEMONSTRATIONS / "trajectory.h5"
    if not path.exists():
        record(RecordConfig(env_id=ENV_ID, env_kwargs=ENV_KWARGS, num_episodes=num_episodes, output=DEMONSTRATIONS))
    return path


def train_from(
    path: Path, algorithm: str, seed: int, total_timesteps: int, *, exploration: str, fit_values: bool
) -> dict[str, Any]:
    """Train once; return what was run, the commit, and the evaluations by environment step."""
    choices = ["--algorithm", algorithm, "--seed", str(seed), "--total_timesteps", str(total_timesteps)]
    words = [
        "--env_id",
        ENV_ID,
        "--env_kwargs",
        *ENV_KWARGS,
        "--demonstrations",
        str(path),
        *choices,
        *SETTINGS.split(),
        *EXPLORATION[exploration].split(),
    ]
    run_dir = train(parse_train_options(words), warm_start=partial(start_from_demonstrations, fit_values=fit_values))
    rows = read_rows(run_dir / "metrics.jsonl")
    run = json.loads((run_dir / "config.json").read_text(encoding="utf-8"))
    names = ("success_at_end", "return")
    return {
        "algorithm": algorithm,
        "seed": seed,
        "exploration": exploration,
        "values": "fitted" if fit_values else "untrained",
        "command": "maniskill-grpd train " + " ".join(words),
        "commit": run["git"] and run["git"]["commit"],
        "evaluations": [
            {"step": row["global_step"], **{name: row[f"eval/{name}"] for name in names}} for row in rows if row["kind"] == "eval"
        ],
        "kl": [row["losses/kl_acting"] for row in rows if "losses/kl_acting" in row],
    }


def main() -> None:
    """Train what the file does not hold yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3], help="seeds of clone and training")
    parser.add_argument("--num_episodes", type=int, default=80, help="episodes that the expert demonstrates")
    parser.add_argument("--total_timesteps", type=int, default=6_400, help="environment steps of each training")
    parser.add_argument("--algorithms", nargs="+", default=list(ALGORITHMS), choices=ALGORITHMS, help="algorithms to train with")
    parser.add_argument("--exploration", default="small", choices=EXPLORATION, help="noise of the actions in training")
    parser.add_argument("--untrained_values", action="store_true", help="leave the value function as it was made")
    parser.add_argument("--json", type=Path, required=True, help="file of the runs")
    arguments = parser.parse_args()
    runs = json.loads(arguments.json.read_text(encoding="utf-8")) if arguments.json.exists() else []
    values = "untrained" if arguments.untrained_values else "fitted"
    known = {(run["algorithm"], run["seed"], run["values"], run["exploration"]) for run in runs}
    path = demonstrate(arguments.num_episodes)
    for seed, algorithm in itertools.product(arguments.seeds, arguments.algorithms):
        if (algorithm, seed, values, arguments.exploration) not in known:
            fitted = not arguments.untrained_values
            options = {"exploration": arguments.exploration, "fit_values": fitted}
            runs.append(train_from(path, algorithm, seed, arguments.total_timesteps, **options))
            arguments.json.write_text(json.dumps(runs, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
