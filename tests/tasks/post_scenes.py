"""Ropes and posts of RopeWrapping-v1 as tests see them."""

import math

import torch
from scipy.spatial.transform import Rotation

from maniskill_grpd.tasks.geometry.posts import POST_HEIGHT

ALL_SHAPES = ("cylinder", "box", "prism")


def post_base(base):
    """Return the middle of the base of each post, (B, 1, 3)."""
    return (base.solver.collider_positions[:, 0] - POST_HEIGHT / 2 * base.post_rotation[:, :, 2])[:, None]


def arms(base, points):
    """Return the vectors from the axis of each post to points (B, n, 3)."""
    offsets, axis = points - post_base(base), base.post_rotation[:, None, :, 2]
    return offsets - (offsets * axis).sum(-1, keepdim=True) * axis


def winding(base):
    return base.signed_winding(base.post_rotation)


def ring(*, radius=0.12, turns=1.0, height=0.01, centre=(0.0, 0.0), num_nodes=41):
    """Return a rope on an arc about a post, relative to the middle of its base, (N, 3)."""
    angle = 2 * math.pi * turns * torch.linspace(0.0, 1.0, num_nodes)
    return torch.stack(
        [radius * angle.cos() + centre[0], radius * angle.sin() + centre[1], torch.full((num_nodes,), height)], dim=-1
    )


def normalized(vectors):
    return torch.nn.functional.normalize(vectors, dim=-1)


def straight_on(base):
    """Return actions (B, 6) that push both ends at full speed in the direction from the rope to the post."""
    return normalized(-arms(base, base.solver.positions).mean(dim=1)).repeat(1, 2)


def rotation_of(seed):
    return torch.as_tensor(Rotation.random(random_state=seed).as_matrix(), dtype=torch.float32)
