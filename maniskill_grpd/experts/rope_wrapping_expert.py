"""Expert of RopeWrapping-v1."""

from __future__ import annotations

import math

import torch

from maniskill_grpd.agents.floating_grippers import STEP_SIZE
from maniskill_grpd.experts.expert import Expert
from maniskill_grpd.tasks import RopeWrappingEnv

CIRCLE_RADIUS = 0.13
"""Distance from the post's axis at which the ends go around it and meet [m]."""
LOOK_AHEAD = 0.5
"""Angle about the axis by which the targets are ahead of the grippers at most [rad]."""


class RopeWrappingExpert(Expert):
    """Takes both ends around the post, each on its own side, until they meet behind it.

    What is left to wind is gamma = 2 pi (1 - |w|) for the winding number w of the rope. The ends share it: the target of each is
    on a circle of 0.13 m about the post's axis, on the table, by the angle min(gamma / 2, 0.5) further around, in the direction
    that increases |w|. At w = +-1 the ends are in the same direction, and meet there. It is full speed towards the target, or
    what is left of the way.

    Which way around to go is decided by the rope alone: the side of the post on which it lies. The action jumps where w changes
    its sign, in the states where the rope lies across the axis, and is continuous elsewhere.

    Limitations: the rope must be beside the post; one that lies on top of it is drawn together there.

    Symmetry: equivariant under translations of the plane, rotations about its normal, and reflections.
    """

    task = RopeWrappingEnv
    env: RopeWrappingEnv

    def act(self) -> torch.Tensor:
        """See `Expert.act`."""
        rotation = self.env.post_rotation
        motion = self._ways(rotation) @ rotation.mT / STEP_SIZE
        motion = motion / torch.linalg.vector_norm(motion, dim=-1, keepdim=True).clamp(min=1.0)
        if self.env.grasp == "free":
            motion = torch.nn.functional.pad(motion, (0, 1), value=1.0)  # stay closed
        return motion.flatten(1)

    def _ways(self, rotation: torch.Tensor) -> torch.Tensor:
        """Return the ways from the grippers to their targets, in the frame of the post, (B, 2, 3) [m]."""
        solver = self.env.solver
        grippers = self.env.in_post_frame(solver.gripper_positions, rotation)
        angle = torch.atan2(grippers[..., 1], grippers[..., 0]) + self._turns(rotation)
        on_table = torch.full_like(angle, solver.model.radius)
        targets = torch.stack([CIRCLE_RADIUS * angle.cos(), CIRCLE_RADIUS * angle.sin(), on_table], dim=-1)
        return targets - grippers

    def _turns(self, rotation: torch.Tensor) -> torch.Tensor:
        """Return the angles by which the targets are ahead of the grippers, counter-clockwise, (B, 2) [rad]."""
        winding = self.env.signed_winding(rotation)
        half = math.pi * (1.0 - winding.abs())
        ahead = torch.where(winding < 0.0, -1.0, 1.0) * half.clamp(-LOOK_AHEAD, LOOK_AHEAD)
        first, last = self.env.start_nodes.unbind(1)
        ahead = torch.where(first < last, ahead, -ahead)
        return torch.stack([-ahead, ahead], dim=1)
