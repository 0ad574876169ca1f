"""Expert of RopeWrapping-v1."""

from __future__ import annotations

import math

import torch

from maniskill_grpd.agents.floating_grippers import STEP_SIZE
from maniskill_grpd.experts.expert import Expert
from maniskill_grpd.tasks import RopeWrappingEnv
from maniskill_grpd.tasks.winding import arms_from_axis

CIRCLE_RADIUS = 0.13
"""Distance from the post's axis at which the ends go around it and meet [m]."""
LOOK_AHEAD = 0.5
"""Angle about the axis by which the targets are ahead of the grippers at most [rad]."""


class RopeWrappingExpert(Expert):
    """Takes both ends around the post, each on its own side, until they meet behind it.

    What is left to wind is gamma = 2 pi (1 - |w|) for the winding number w of the rope. The ends share it: the target of each is on
    a circle of 0.13 m about the post's axis, on the table, by the angle min(gamma / 2, 0.5) further around, in the direction that
    increases |w|. At w = +-1 the ends are in the same direction, and meet there. It is full speed towards the target, or what is
    left of the way.

    Which way around to go is decided by the rope alone: the side of the post on which it lies. The action jumps where w changes its
    sign, in the states where the rope lies across the axis, and is continuous elsewhere.

    Limitations: the rope must be beside the post; one that lies on top of it is drawn together there.

    Symmetry: equivariant under translations of the plane, rotations about its normal, and reflections.
    """

    task = RopeWrappingEnv
    env: RopeWrappingEnv

    def act(self) -> torch.Tensor:
        """See `Expert.act`."""
        motion = self._ways() / STEP_SIZE
        motion = motion / torch.linalg.vector_norm(motion, dim=-1, keepdim=True).clamp(min=1.0)
        if self.env.grasp == "free":
            motion = torch.nn.functional.pad(motion, (0, 1), value=1.0)  # stay closed
        return motion.flatten(1)

    def _ways(self) -> torch.Tensor:
        """Return the ways from the grippers to their targets, (B, 2, 3) [m]."""
        solver, axis = self.env.solver, self.env.post_axis
        arms = arms_from_axis(solver.gripper_positions, self.env.post_origin, axis)
        outward = torch.nn.functional.normalize(arms, dim=-1)
        sideways = torch.linalg.cross(axis[:, None].expand_as(outward), outward)
        angle = self._turns()[..., None]
        targets = CIRCLE_RADIUS * (angle.cos() * outward + angle.sin() * sideways)
        normal, offset = solver.plane[:, None, :3], solver.plane[:, 3:]
        height = (solver.gripper_positions * normal).sum(-1) - offset
        return targets - arms + (solver.model.radius - height)[..., None] * normal

    def _turns(self) -> torch.Tensor:
        """Return the angles by which the targets are ahead of the grippers, counter-clockwise, (B, 2) [rad]."""
        winding = self.env.winding
        half = math.pi * (1.0 - winding.abs())
        ahead = torch.where(winding < 0.0, -1.0, 1.0) * half.clamp(-LOOK_AHEAD, LOOK_AHEAD)
        return torch.stack([-ahead, ahead], dim=1)
