"""Leashes: how far two grippers that hold one object can be apart."""

from __future__ import annotations

import numpy as np
import torch

from maniskill_grpd.physics.model import Model

# Distance [m] of grippers that hold nothing together: further apart than any world is wide.
NO_LEASH = 1.0e6
# How much longer than its strain at the strength of a gripper an object can be pulled: what is beyond must be felt.
EXCESS_FORCE, EXCESS_STRAIN = 2.0, 0.01


def leash_stretch(model: Model, grip_strength: float | None) -> float:
    """Return how far grippers of a strength [N] can pull an object apart, as a factor on its length.

    Unlimited grippers (None) do not stretch it: 1. Others must be able to feel more than they can hold, so leashes end where the
    tension of a rope is twice that, and where a cloth has locked.
    """
    if grip_strength is None:
        return 1.0
    if np.isfinite(model.max_strain):
        return 1.0 + model.max_strain + EXCESS_STRAIN
    return 1.0 + EXCESS_FORCE * grip_strength * float(np.max(model.stretch_compliances / model.rest_lengths))


def direct_leashes(geodesics: torch.Tensor, variants: torch.Tensor, gripper_nodes: torch.Tensor) -> torch.Tensor:
    """Return the lengths of the object between grippers with no third one on the way, `NO_LEASH` for the other pairs.

    A pair with a third gripper in between is limited by the two shorter leashes already; limiting it again would overcorrect.

    Args:
        geodesics: Distances through each variant from every node to every other, (M, N, N) [m].
        variants: Variant of each world, (b,) int64.
        gripper_nodes: Node that each gripper holds, -1 for none, (b, A) int64.

    Returns:
        (b, A, A) [m].
    """
    holds = gripper_nodes >= 0
    nodes = gripper_nodes.clamp(min=0)
    lengths = geodesics[variants[:, None, None], nodes[:, None, :], nodes[:, :, None]]
    both_hold = holds[:, :, None] & holds[:, None, :]
    lengths = torch.where(both_hold, lengths, NO_LEASH)
    detours = lengths[:, :, :, None] + lengths[:, None, :, :]  # (b, a, via, c)
    via_an_end = torch.eye(nodes.shape[1], dtype=torch.bool, device=nodes.device)
    detours = detours.masked_fill(via_an_end[:, :, None] | via_an_end[None, :, :], torch.inf)
    is_direct = lengths < detours.amin(dim=2) * (1.0 - 1e-6)
    return torch.where(is_direct, lengths, NO_LEASH)
