"""Record demonstrations of a task's expert in ManiSkill's format.

maniskill-grpd record --env_id ClothFolding-v1 --num_episodes 100

writes demos/ClothFolding-v1/trajectory.h5 and .json: graph observations, actions, rewards and the whole state of every step.
`maniskill-grpd replay --traj-path FILE --use-env-states -o state --save-traj` turns them into another observation mode,
`maniskill-grpd clone --demonstrations FILE` clones them.
"""

from __future__ import annotations

from collections.abc import Sequence

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.imitation.recording import RecordConfig, record


def record_and_report(config: RecordConfig) -> None:
    """Record, and say where and how many."""
    path, kept = record(config)
    print(f"{path}: {kept} of {config.num_episodes} episodes")


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(record_and_report, RecordConfig, arguments)
