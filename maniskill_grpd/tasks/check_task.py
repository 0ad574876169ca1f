"""A check of tasks, in the manner of gymnasium's `check_env`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import gymnasium as gym
import torch
from gymnasium import spaces
from mani_skill.utils.geometry.rotation_conversions import quaternion_to_matrix, random_quaternions

from maniskill_grpd.tasks.deformable_env import DeformableEnv

NUM_STEPS = 4
"""Random actions that each check plays."""
TOLERANCE = 1e-3
"""How far channels and rewards of a moved scene may differ by rounding, in their units."""


def check_task(env: gym.Env, *, seed: int = 0) -> None:
    """Check that a task keeps what the package promises of every task.

    Graphs fit their schema and are finite; grippers start at candidate nodes; rewards are in [0, 1] and the progress metric is in
    `info`; an episode depends on the seed of its own world alone; resetting some worlds leaves the others bitwise unchanged; a
    restored state goes on bitwise as before; nothing but vectors notices when the whole scene is moved; every world can be drawn.

    Args:
        env: The task with at least two worlds, plain or wrapped; it is reset several times, and at the end.
        seed: Seed of the first world; the others follow.

    Raises:
        TypeError: If it is no `DeformableEnv`.
        ValueError: Naming the first promise that is broken, and usually why.
    """
    base = env.unwrapped
    if not isinstance(base, DeformableEnv):
        raise TypeError(f"check_task checks a DeformableEnv, got {type(base).__name__}")
    if base.num_envs < 2 or not isinstance(base.action_space, spaces.Box):
        raise ValueError("check_task needs at least two worlds, num_envs >= 2, and one agent that drives all grippers")
    seeds = list(range(seed, seed + base.num_envs))
    for check in (_check_start, _check_steps, _check_seeds, _check_partial_reset, _check_restoring, _check_frame, _check_drawing):
        base.reset(seed=seeds)
        check(base, seeds)
    base.reset(seed=seeds)


def _play(env: DeformableEnv, num_steps: int = NUM_STEPS, seed: int = 0) -> Iterator[tuple]:
    generator = torch.Generator().manual_seed(seed)
    for _ in range(num_steps):
        yield env.step(0.6 * torch.randn(env.action_space.shape, generator=generator))


def _check_start(env: DeformableEnv, seeds: list[int]) -> None:
    for world, nodes in enumerate(env.start_nodes.tolist()):
        allowed = env.candidate_gripper_nodes(env.model_of(world)).tolist()
        _expect(
            set(nodes) <= set(allowed), f"grippers start at {nodes} in world {world}, candidate_gripper_nodes() says {allowed}"
        )
    _expect(not bool(env.measurement.fail.any()), "an episode has failed before its first step")
    _check_observation(env)


def _check_steps(env: DeformableEnv, seeds: list[int]) -> None:
    for _, _, _, _, info in _play(env):
        _check_observation(env)
        progress, reward = info[env.PROGRESS.name], env.compute_dense_reward(None, None, info)
        _expect(progress.dtype.is_floating_point, f"the metric of PROGRESS, {env.PROGRESS.name!r}, must be float")
        _expect(info["success"].dtype == torch.bool, f"success must be bool, got {info['success'].dtype}")
        for name, value in info.items():
            _expect(bool(torch.isfinite(value.float()).all()), f"{name!r} in info must be finite")
        is_fine = bool(((reward >= 0.0) & (reward <= 1.0)).all())  # false for NaN
        _expect(is_fine, f"rewards must be in [0, 1], got {reward.min().item():g} to {reward.max().item():g}")


def _check_observation(env: DeformableEnv) -> None:
    env.graph_schema.validate(env._get_obs_graph(), values=True)
    for name, value in env.goal_observations().items():
        is_fine = value.ndim == 2 and len(value) == env.num_envs and bool(torch.isfinite(value.float()).all())
        _expect(is_fine, f"goal_observations()[{name!r}] must be ({env.num_envs}, D) and finite, got {tuple(value.shape)}")


def _check_seeds(env: DeformableEnv, seeds: list[int]) -> None:
    first = env.get_state_dict()
    env.reset(seed=[seeds[0], *(other + 1000 for other in seeds[1:])])
    _expect_equal(first, env.get_state_dict(), [0], "an episode must depend on the seed of its own world alone: use draw_uniform")


def _check_partial_reset(env: DeformableEnv, seeds: list[int]) -> None:
    list(_play(env))
    before = env.get_state_dict(), env._get_obs_graph()
    env.reset(options={"env_idx": torch.tensor([0])})
    others, message = list(range(1, env.num_envs)), "resetting world 0 must leave the others unchanged: write to [worlds] only"
    for tree, now in zip(before, (env.get_state_dict(), env._get_obs_graph()), strict=True):
        _expect_equal(tree, now, others, message)


def _check_restoring(env: DeformableEnv, seeds: list[int]) -> None:
    list(_play(env))
    state, worlds = env.get_state_dict(), list(range(env.num_envs))
    expected = [_reward_and_graph(env) for _ in _play(env, 2, seed=1)]
    env.reset(seed=[seed + 1000 for seed in seeds])
    env.set_state_dict(state)
    for then, _ in zip(expected, _play(env, 2, seed=1), strict=True):
        message = "a restored state must go on as before: keep what an episode needs in episode_tensor"
        _expect_equal(then, _reward_and_graph(env), worlds, message)


def _reward_and_graph(env: DeformableEnv) -> dict[str, Any]:
    return {"reward": env.compute_dense_reward(None, None, {}), "graph": env._get_obs_graph()}


def _check_frame(env: DeformableEnv, seeds: list[int]) -> None:
    list(_play(env))
    rotation = quaternion_to_matrix(random_quaternions(1, device=env.device))[0]
    reward, success, graph = env.compute_dense_reward(None, None, {}), env.measurement.success, env._get_obs_graph()
    env.move_worlds(rotation, torch.tensor([0.3, -0.2, 0.1], device=env.device))
    why = "read directions from solver.gravity, solver.plane and episode tensors, and give these their kind"
    moved = env.compute_dense_reward(None, None, {})
    _expect(torch.allclose(moved, reward, atol=TOLERANCE, rtol=0), f"rewards must not depend on the frame of the scene: {why}")
    _expect(torch.equal(env.measurement.success, success), f"success must not depend on the frame of the scene: {why}")
    there = env._get_obs_graph()
    for node_type in ("object", "actuator"):
        node, here, mask = env.graph_schema.node(node_type), graph[node_type], graph[node_type]["mask"]
        turned = {"vectors": here["vectors"] @ rotation.T, "scalars": here["scalars"]}
        for key, channels in (("vectors", node.vectors), ("scalars", node.scalars)):
            is_wrong = ((there[node_type][key] - turned[key]).abs() > TOLERANCE)[mask]
            wrong = [channel.name for place, channel in enumerate(channels) if is_wrong[:, place].any()]
            _expect(not wrong, f"{key} of the {node_type}, {wrong}, do not move with the scene: {why}")


def _check_drawing(env: DeformableEnv, seeds: list[int]) -> None:
    for world in range(env.num_envs):
        env.checked_drawing(world)


def _expect(is_kept: bool, message: str) -> None:
    if not is_kept:
        raise ValueError(message)


def _expect_equal(tree: Mapping[str, Any], other: Mapping[str, Any], rows: list[int], message: str, path: str = "") -> None:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            _expect_equal(value, other[key], rows, message, f"{path}{key}/")
        else:
            _expect(torch.equal(value[rows], other[key][rows]), f"{message}; {path}{key} differs")
