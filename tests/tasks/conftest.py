"""Environments for tests."""

import gc

import gymnasium as gym
import mani_skill.envs  # noqa: F401
import pytest
import torch

import maniskill_grpd  # noqa: F401  (registers)


@pytest.fixture
def make_env(monkeypatch, request):
    """Return a function that makes the module's `ENV_ID`, by default RopeShaping-v1, on the CPU, reset with seed 0."""
    env_id = getattr(request.module, "ENV_ID", "RopeShaping-v1")
    # ManiSkill collects garbage whenever it builds or closes a scene: most of the tests' time.
    monkeypatch.setattr(gc, "collect", lambda: 0)
    made = []

    def make(num_envs=3, **options):
        settings = {"sim_backend": "cpu", "render_backend": "none", **options}
        made.append(gym.make(env_id, num_envs=num_envs, **settings))
        made[-1].reset(seed=0)
        return made[-1]

    yield make
    for env in made:
        env.close()


@pytest.fixture
def draw_actions():
    """Return a function that draws actions (num_steps, B, 3 A), many longer than allowed."""

    def draw(num_steps, num_envs, num_grippers=4, seed=0):
        generator = torch.Generator().manual_seed(seed)
        return torch.randn(num_steps, num_envs, 3 * num_grippers, generator=generator)

    return draw
