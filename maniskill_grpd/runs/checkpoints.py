"""The policy of a checkpoint, and whether it fits a task."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import torch

from maniskill_grpd.learning import CheckpointError, TrainConfig, load_checkpoint
from maniskill_grpd.learning.checkpoint import describe_differences, load_weights, reading
from maniskill_grpd.policies import Policy, policy_from_config
from maniskill_grpd.tasks.observation.observed_worlds import GRAPH_FEATURES
from maniskill_grpd.tasks.options.env_id import check_env_id


def load_policy(
    path: str | Path, device: str | torch.device = "cpu", *, allow_import: bool = False
) -> tuple[Policy, dict[str, Any]]:
    """Rebuild the policy of a checkpoint.

    Args:
        path: The checkpoint.
        device: Where the policy goes.
        allow_import: Whether the id of its task may name a module, which is imported when the task is made.

    Returns:
        The policy, and the other contents of the checkpoint.

    Raises:
        FileNotFoundError: If there is no such file.
        CheckpointError: If it is no checkpoint, or what it holds is damaged.
        ValueError: If the id of its task names a module and that is not allowed.
    """
    contents = load_checkpoint(path)
    check_env_id(contents["train_config"].get("env_id"), str(path), allow_import=allow_import)
    with reading(path, "train_config"):
        TrainConfig.from_dict(contents["train_config"])
    with reading(path, "policy"):
        policy = policy_from_config(contents["policy"])
    load_weights(policy, contents["weights"])
    return policy.to(device).eval(), contents


def check_schema(policy: Policy, env: gym.Env) -> None:
    """Refuse an environment whose observations mean something else than the policy was trained on.

    The number of nodes, of grippers and the size of the object may differ; the channels may not.

    Raises:
        CheckpointError: Naming the channels that differ.
    """
    trained, given = policy.schema.to_dict(), env.unwrapped.graph_schema.to_dict()
    parts = ("object", "actuator")
    differences = describe_differences({part: trained[part] for part in parts}, {part: given[part] for part in parts})
    if differences:
        raise CheckpointError(
            f"the policy was trained on other observations than this task gives{_graph_of(policy, env)}: "
            + "; ".join(differences)
        )


def _graph_of(policy: Policy, env: gym.Env) -> str:
    """Return which graph of the task the policy was trained on, if it is another one than this."""
    actuator, base = policy.schema.actuator, env.unwrapped
    told = {channel.name for channel in (*actuator.vectors, *actuator.scalars)}
    kinds = {features: {channel.name for channel in base.gripper_channels(features)} for features in GRAPH_FEATURES}
    fitting = [features for features, names in kinds.items() if names == told]
    if not fitting or base.graph_features in fitting:
        return ""
    return f" with graph_features={base.graph_features} (--env_kwargs graph_features={fitting[0]} gives what it knows)"
