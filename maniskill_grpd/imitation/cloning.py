"""Clone an expert: a fast check that a policy can represent a solution, and a warm start."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from maniskill_grpd.experts import make_expert
from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.imitation.clone_config import CloneConfig
from maniskill_grpd.imitation.cloning_page import summarize, to_markdown
from maniskill_grpd.imitation.demonstrations import Demonstrations, load_demonstrations, record_demonstrations
from maniskill_grpd.imitation.expert_actor import ExpertActor
from maniskill_grpd.imitation.regression import train_policy
from maniskill_grpd.imitation.turned_scene import TurnedScene
from maniskill_grpd.learning import TrainConfig, evaluate_policy, save_checkpoint
from maniskill_grpd.learning.value_scale import ValueScale
from maniskill_grpd.policies import Policy, make_policy
from maniskill_grpd.runs.environments import make_env
from maniskill_grpd.runs.fingerprint import describe_task
from maniskill_grpd.runs.folder import RUNS, check_name
from maniskill_grpd.runs.record import write_run_record
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED
from maniskill_grpd.tasks.measurement import Metric


def clone(config: CloneConfig) -> list[dict[str, Any]]:
    """Run behaviour cloning as configured.

    Returns:
        One dictionary of results per policy.

    Raises:
        ValueError: If a policy, an option or the demonstrations do not fit.
    """
    torch.set_num_threads(config.torch_threads)
    base = config.train_config(config.policy[0])
    task = describe_task(base)
    progress = Metric(**task["progress"])
    schema = _read_schema(base)
    # Before anything is recorded: a misspelt name should not cost a minute.
    policies = {name: _make_policy(config, name, schema) for name in config.policy}
    demonstrations = obtain_demonstrations(config, schema)
    run_name = check_name(config.exp_name or f"{config.env_id}__bc__{config.seed}__{int(time.time())}")
    results = []
    for name, policy in policies.items():
        run_dir = RUNS / run_name / name
        write_run_record(run_dir, config, torch.device("cpu"), task)
        results.append(_clone_one(policy, demonstrations, config, run_dir))
        print(f"{name}: {summarize(results[-1], progress)}\n  {run_dir / 'final_ckpt.pt'}")
    if config.markdown is not None:
        expert = play(lambda env: ExpertActor(make_expert(config.env_id, env)), config)
        config.markdown.parent.mkdir(parents=True, exist_ok=True)
        config.markdown.write_text(to_markdown(config, results, expert, demonstrations, progress), encoding="utf-8")
    return results


def _clone_one(policy: Policy, demonstrations: Demonstrations, config: CloneConfig, run_dir: Path) -> dict[str, Any]:
    """Train, save, then play: what playing meets cannot cost the training."""
    result = {"policy": policy.name, "num_parameters": _count_parameters(policy)}
    result |= train_policy(policy, demonstrations, config)
    save_clone(run_dir / "final_ckpt.pt", policy, config, len(demonstrations.episode))
    result["rollouts"] = play(lambda env: policy.to(env.unwrapped.device), config)
    (run_dir / "results.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def obtain_demonstrations(config: CloneConfig, schema: GraphSchema) -> Demonstrations:
    """Record or load what is to be learned."""
    if config.demonstrations is not None:
        return load_demonstrations(config.demonstrations, schema)
    num_envs = min(100, config.num_episodes)
    env = _make_posed_env(config, num_envs, config.train_pose_range)
    state = np.random.SeedSequence([config.seed, 0]).generate_state(config.num_episodes)
    demonstrations = record_demonstrations(
        env,
        config.env_id,
        (2**30 + state % 2**30).tolist(),
        num_steps=config.num_steps,
        action_noise=config.action_noise,
        generator=torch.Generator().manual_seed(config.seed),
    )
    env.close()
    return demonstrations


def play(make_actor: Callable[[gym.Env], Any], config: CloneConfig) -> dict[str, dict[str, float]]:
    """Play unseen seeds, at poses like those demonstrated, in turned scenes and at other poses.

    Args:
        make_actor: Takes the environment and returns what acts in it, as `evaluate_policy` asks.
        config: Names the task and the pose ranges.

    Returns:
        Means over the episodes, by the name of the poses.
    """
    if not config.num_test_episodes:
        return {}
    seeds = range(FIRST_TEST_SEED, FIRST_TEST_SEED + config.num_test_episodes)
    num_envs = min(50, config.num_test_episodes)
    poses = {
        config.train_pose_range: (config.train_pose_range, False),
        f"{config.train_pose_range} turned": (config.train_pose_range, True),
        config.test_pose_range: (config.test_pose_range, False),
    }
    means = {}
    for name, (pose_range, is_turned) in poses.items():
        env = _make_posed_env(config, num_envs, pose_range)
        env = TurnedScene(env) if is_turned else env
        episodes = evaluate_policy(make_actor(env), env, seeds)
        env.close()
        means[name] = {key: v.double().mean().item() for key, v in episodes.items()}
    return means


def _read_schema(task: TrainConfig) -> GraphSchema:
    env = make_env(task, 1)
    schema = env.unwrapped.graph_schema
    env.close()
    return schema


def _make_policy(config: CloneConfig, name: str, schema: GraphSchema) -> Policy:
    torch.manual_seed(config.seed)
    return make_policy(name, schema, **config.train_config(name).policy_options)


def _count_parameters(policy: Policy) -> int:
    return sum(parameter.numel() for parameter in policy.parameters())


def _make_posed_env(config: CloneConfig, num_envs: int, pose_range: str) -> gym.Env:
    return make_env(config.train_config(config.policy[0]), num_envs, pose_range=pose_range)


def save_clone(path: Path, policy: Policy, config: CloneConfig, num_observations: int) -> None:
    """Write a checkpoint of a policy that learned from so many observations; evaluation plays it, training starts from it."""
    contents = {
        "policy": policy.config,
        "weights": policy.state_dict(),
        # A training that starts from here has an optimizer and scales of returns of its own.
        "optimizer": {},
        "algorithm": {},
        "value_scale": ValueScale().state_dict(),
        "generators": {},
        "train_config": config.train_config(policy.name).to_dict(),
        "iteration": 0,
        "global_step": num_observations,
        "best_score": None,
    }
    save_checkpoint(path, contents)
