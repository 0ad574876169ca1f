"""What is logged of a rollout."""

from __future__ import annotations

import torch

from maniskill_grpd.learning.rollout import Rollout
from maniskill_grpd.learning.workers import Workers


def rollout_metrics(rollout: Rollout, workers: Workers | None = None) -> dict[str, float]:
    """Return tags that describe a rollout: explained variance, size of the actions, mean value."""
    errors = rollout.returns - rollout.values
    variance = rollout.returns.var()
    # Returns without variance cannot be explained; zero keeps the plot free of gaps.
    explained = 1.0 - errors.var() / variance if variance > 0 else variance
    metrics = {
        "losses/explained_variance": explained,
        "charts/action_norm": _action_norm(rollout),
        "charts/value": rollout.values.mean(),
    }
    if rollout.distribution.gripper_logits is not None:
        metrics["charts/grip_closed"] = _grippers(rollout)[..., 3].mean()
    metrics = (workers or Workers()).average_metrics(metrics)
    return {name: value.item() for name, value in metrics.items()}


def _action_norm(rollout: Rollout) -> torch.Tensor:
    """Return the mean norm of an actuator's displacement before it is limited, dimensionless."""
    return _grippers(rollout)[..., :3].norm(dim=-1).mean()


def _grippers(rollout: Rollout) -> torch.Tensor:
    """Return the actions of the actuators that exist, (K, 3) or (K, 4)."""
    mask = rollout.distribution.mask
    return rollout.actions.unflatten(-1, (mask.shape[-1], -1))[mask]
