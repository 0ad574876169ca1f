"""Replay trajectories of our tasks with ManiSkill's tool: it does not know them by itself.

    python -m maniskill_grpd.trajectory.replay --traj-path trajectory.h5 --save-traj -o state

Flags and output are those of `python -m mani_skill.trajectory.replay_trajectory`. With `-n 16` sixteen episodes are replayed side
by side in one process, on the CPU as well: the worlds of these tasks are batched there too.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from mani_skill.trajectory import replay_trajectory

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.tasks.options.compute_device import choose_compute_device


def replay(arguments: Sequence[str]) -> None:
    """Replay as the command line says.

    Raises:
        FileNotFoundError: If there is no trajectory, or not the .json file beside it.
        ValueError: If the backend does not exist here.
    """
    args = replay_trajectory.parse_args(list(arguments))
    path = Path(args.traj_path)
    record = path.with_suffix(".json")
    for file in (path, record):
        if not file.is_file():
            raise FileNotFoundError(f"no recorded trajectory: {file} is missing")
    recorded = json.loads(record.read_text(encoding="utf-8"))["env_info"]["env_kwargs"].get("sim_backend", "auto")
    # Under the name "cpu" ManiSkill would replay one world at a time.
    args.sim_backend = f"warp_{choose_compute_device(args.sim_backend or recorded).type}"
    replay_trajectory.main(args)


if __name__ == "__main__":
    try:
        replay(sys.argv[1:])
    except (FileNotFoundError, ValueError) as error:
        sys.exit(f"error: {error}")
