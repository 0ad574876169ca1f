"""Expert of ClothFolding-v1."""

from __future__ import annotations

import torch

from maniskill_grpd.agents.floating_grippers import STEP_SIZE
from maniskill_grpd.experts.expert import Expert
from maniskill_grpd.tasks import ClothFoldingEnv

SLACK = 0.65
"""How far the path departs from a circle, on which the cloth is taut, towards a diamond, on which it hangs straight down."""


class ClothFoldingExpert(Expert):
    r"""Carries the extreme points of the moving half over the crease, and lays the cloth down behind them.

    In the plane through gripper v across the crease, with x its distance beyond the crease and z its height above its goal's
    level, the path is

        (x, z) = d_v (1 - s + s / (|cos a| + |sin a|)) (cos a, sin a),   s = 0.65

    from the angle a = 0, where the gripper starts, at the distance d_v from the crease, to a = pi, its goal. With s = 0 it is a
    circle, on which the cloth stays taut and pulls the resting half along in the second quarter. With s = 1 it is a diamond, on
    which the cloth hangs straight down from the gripper and is laid down where it is (van den Berg, Miller, Goldberg and Abbeel,
    Gravity-based robotic cloth folding, WAFR 2010), but starts by pushing a cloth that is too stiff to bend at once.

    The angle is read from the present state, the mean over the grippers so that they move in step, and the target is the point
    of the path as far ahead as the outermost gripper gets in one step. At pi it stays: the gripper holds the fold.

    Limitations: a resting half that has been dragged away is not brought back. Cells of a coarse mesh hardly bend and keep the
    layers apart: with two grippers and 49 nodes 72 % of the folds succeed, with 64 nodes 99 % (100 unseen seeds each). At the
    default resolutions all shapes reach 98 to 100 %.

    Symmetry: equivariant under rigid motions of the scene with its table.
    """

    task = ClothFoldingEnv
    env: ClothFoldingEnv

    def act(self) -> torch.Tensor:
        """See `Expert.act`."""
        env = self.env
        goals = env.at_start_nodes(env.goal_positions)
        normal, up = env.crease_normal[:, None], env.solver.plane[:, None, :3]
        # The goal of what is held lies at -d along the normal, seen from the foot of its path on the crease.
        distance = ((env.crease_ends[:, :1] - goals) * normal).sum(-1, keepdim=True)
        foot = goals + distance * normal
        offset = env.solver.gripper_positions - foot
        angle = _angles(offset, normal, up).mean(dim=1, keepdim=True)
        ahead = (angle + STEP_SIZE / distance.amax(dim=1, keepdim=True)).clamp(max=torch.pi)
        radius = distance * _path_radius(ahead)
        target = radius * (ahead.cos() * normal + ahead.sin() * up)
        motion = (target - offset) / STEP_SIZE
        motion = motion / torch.linalg.vector_norm(motion, dim=-1, keepdim=True).clamp(min=1.0)
        return self._with_closed_grippers(motion)

    def _with_closed_grippers(self, motion: torch.Tensor) -> torch.Tensor:
        """Return actions (B, A * 3), or (B, A * 4) where they also close the grippers, from motions (B, A, 3)."""
        if self.env.grasp == "free":
            motion = torch.nn.functional.pad(motion, (0, 1), value=1.0)
        return motion.flatten(1)


def _angles(offset: torch.Tensor, normal: torch.Tensor, up: torch.Tensor) -> torch.Tensor:
    """Return the angles about the crease, 0 beyond it to pi on the other side, of offsets (B, A, 3) from it, (B, A, 1)."""
    along, height = (offset * normal).sum(-1, keepdim=True), (offset * up).sum(-1, keepdim=True)
    return torch.atan2(height.clamp(min=0.0), along)


def _path_radius(angle: torch.Tensor) -> torch.Tensor:
    """Return the distance of the path from the crease, as a share of that of its ends, by the angle [rad]."""
    return 1.0 - SLACK + SLACK / (angle.cos().abs() + angle.sin().abs())
