"""Clone an expert: a fast check that a policy can represent a solution, and a warm start.

maniskill-grpd clone --policy grpd --env_id RopeShaping-v1 --num_episodes 200
maniskill-grpd clone --policy grpd empn hetero_gnn transformer --markdown FILE

Demonstrations come from the task's expert, at poses from `train_pose_range`, or from a file that ManiSkill's RecordEpisode wrote.
Every policy learns from the same ones and is then played on unseen seeds: at poses of that range; at such poses with the whole
scene turned, in orientations that no demonstration had; and at poses of `test_pose_range`. Each goes to
runs/{exp_name}/{policy}/: config.json, results.json and final_ckpt.pt, which `evaluate` plays and from which `train --checkpoint`
goes on.
"""

from __future__ import annotations

from collections.abc import Sequence

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.imitation.clone_config import CloneConfig
from maniskill_grpd.imitation.cloning import clone


def clone_and_report(config: CloneConfig) -> None:
    """Clone; the library says how each policy fares."""
    clone(config)


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(clone_and_report, CloneConfig, arguments)
