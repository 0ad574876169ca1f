"""What a task asks of the policy that acts in it."""

from __future__ import annotations

import json
from typing import Any

from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv


def fit_policy_options(options: dict[str, Any], envs: ManiSkillVectorEnv) -> dict[str, Any]:
    """Give the policy a gripper output exactly where the task takes one.

    Raises:
        ValueError: If the options say otherwise.
    """
    has_grippers = envs.unwrapped.control_mode == "pd_ee_delta_pos_grip"
    if options.get("gripper", has_grippers) != has_grippers:
        takes = "opens and closes grippers" if has_grippers else "has fixed grasps"
        raise ValueError(
            f"policy_kwargs says gripper={json.dumps(options['gripper'])} but the task {takes}; leave it out, or "
            "choose with --env_kwargs grasp=free (or grasp=fixed)"
        )
    return {**options, "gripper": has_grippers} if has_grippers else options
