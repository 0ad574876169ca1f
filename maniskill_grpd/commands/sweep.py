"""Train every combination of options as a job of its own, on this machine or on a Slurm cluster.

maniskill-grpd sweep --name rivals --grid algorithm=bpp,ppo seed=1,2,3 --jobs 2 -- --env_id RopeShaping-v1 --num_envs 32

What stands behind -- goes to `train` in every run; runs/rivals/ gets one folder per combination. The same command again goes on
where a stopped sweep was: finished runs are left alone, interrupted ones resume from their last checkpoint. On Slurm (--launcher
slurm --slurm slurm_partition=gpu gpus_per_node=1 timeout_min=600) jobs that are preempted or out of time are queued again and
resume, too; needs submitit: pip install 'maniskill-grpd[sweep]'
"""

from __future__ import annotations

from collections.abc import Sequence

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.commands.train import parse_train_options
from maniskill_grpd.experiments.sweep import SweepConfig, run_sweep


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    own, common = split(arguments)

    def sweep(config: SweepConfig) -> int:
        return int(bool(run_sweep(config, common, parse_train_options)))

    return run_command(sweep, SweepConfig, own)


def split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split a command line into the options of the sweep and those of `train` behind --."""
    words = [*arguments, "--"]
    place = words.index("--")
    return words[:place], words[place + 1 : -1]
