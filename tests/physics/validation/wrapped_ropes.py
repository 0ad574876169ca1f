"""Ropes beside posts whose grippers are told to go anywhere: how far they are stretched."""

from __future__ import annotations

import torch

from maniskill_grpd.tasks.rope_wrapping import RopeWrappingEnv


def random_pulls(
    shape: str = "cylinder", *, num_worlds: int = 64, num_steps: int = 100, self_collision: bool = False
) -> tuple[float, float]:
    """Pull both ends of the ropes of RopeWrapping-v1 in random directions in space at full speed, each held for 20 steps.

    Every other direction points down, so that ropes that have been lifted come to lie over and around the post.

    Ropes may by default pass through themselves: what is measured then is the leash round the post alone.

    Returns:
        Largest length of a rope over its length at rest, and largest strain of an edge.
    """
    env = RopeWrappingEnv(num_envs=num_worlds, shapes=shape, obs_mode="none", sim_backend="cpu", self_collision=self_collision)
    env.reset(seed=0)
    generator = torch.Generator().manual_seed(1)
    rest_lengths = torch.as_tensor(env.solver.model.rest_lengths)
    longest = strained = 0.0
    for step in range(num_steps):
        if step % 20 == 0:
            pulls = torch.nn.functional.normalize(torch.randn(num_worlds, 2, 3, generator=generator), dim=-1)
            if step % 40 == 20:
                pulls[..., 2] = -pulls[..., 2].abs()
        env.step(pulls.flatten(1))
        lengths = env.solver.positions.diff(dim=1).norm(dim=-1)
        longest = max(longest, (lengths.sum(dim=1) / rest_lengths.sum()).max().item())
        strained = max(strained, (lengths / rest_lengths - 1.0).max().item())
    return longest, strained
