"""The environments of a run, from its options."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
from mani_skill.utils.registration import REGISTERED_ENVS
from mani_skill.utils.wrappers.flatten import FlattenActionSpaceWrapper
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.tasks import DeformableEnv

NAMED = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
"""Kinds of parameters that are options."""


def make_env(config: TrainConfig, num_envs: int, **options: Any) -> gym.Env:
    """Make the task of a run as a plain batched ManiSkill environment.

    Actions are one row per environment also where several agents share the grippers: theirs side by side, in their order.

    Args:
        config: Names the task, its options and the simulation backend.
        num_envs: Number of environments.
        **options: Further options of the task, which replace those of the config.

    Raises:
        ValueError: If there is no such task, or it does not take the options.
    """
    given = {"obs_mode": "graph", **config.env_options, **options}
    check_task(config.env_id, given)
    env = gym.make(
        config.env_id,
        num_envs=num_envs,
        sim_backend=config.sim_backend,
        # Resets that happen by themselves must follow from the seeds too, or no run can be repeated.
        enhanced_determinism=True,
        **given,
    )
    return join_actions(env)


def join_actions(env: gym.Env) -> gym.Env:
    """Let an environment take the actions of several agents side by side, in their order; others are returned as they are."""
    return FlattenActionSpaceWrapper(env) if isinstance(env.action_space, gym.spaces.Dict) else env


def make_vector_env(config: TrainConfig, num_envs: int, *, partial_reset: bool, **options: Any) -> ManiSkillVectorEnv:
    """Make the task of a run as a vector environment that resets itself.

    Args:
        config: Names the task, its options and the simulation backend.
        num_envs: Number of environments.
        partial_reset: Whether an episode ends when its environment terminates.
        **options: Further options of the task, which replace those of the config.
    """
    env = make_env(config, num_envs, **options)
    return ManiSkillVectorEnv(env, num_envs, ignore_terminations=not partial_reset, record_metrics=True)


def check_task(env_id: str, options: Mapping[str, Any]) -> None:
    """Refuse a task that does not exist, options it does not take, and observations that no policy understands.

    A task of the form module:id is looked for in that module, which is imported.

    Raises:
        ValueError: Naming what is allowed.
    """
    obs_mode = options.get("obs_mode", "graph")
    if "graph" not in str(obs_mode).split("+"):
        raise ValueError(f"policies act on graphs: obs_mode must be graph, or others joined with it, got {obs_mode!r}")
    known = known_options(find_task(env_id))
    unknown = sorted(set(options) - known)
    if unknown:
        name = env_id.rpartition(":")[2]
        raise ValueError(f"{name} does not take the option(s) {', '.join(unknown)}; it takes {', '.join(sorted(known))}")


def registered_tasks() -> dict[str, type[DeformableEnv]]:
    """Return the tasks of deformable objects by id."""
    return {name: spec.cls for name, spec in REGISTERED_ENVS.items() if issubclass(spec.cls, DeformableEnv)}


def find_task(env_id: str) -> type[DeformableEnv]:
    """Return a task by its id; one of the form module:id is looked for in that module, which is imported.

    Raises:
        ValueError: If there is no such module or task, listing the tasks there are.
    """
    module, _, name = env_id.rpartition(":")
    if module:
        import_tasks(module)
    tasks = registered_tasks()
    if name not in tasks:
        raise ValueError(f"there is no task {name!r} of deformable objects; there are {', '.join(sorted(tasks))}")
    return tasks[name]


def import_tasks(module: str) -> None:
    """Import a module that registers tasks; ValueError if there is none."""
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name not in (module, module.partition(".")[0]):
            raise  # what the module itself imports is missing
        raise ValueError(
            f"there is no module {module!r} with tasks; install it, or run `python -m maniskill_grpd` in its folder, "
            "which Python then searches"
        ) from error


def known_options(task: type[DeformableEnv]) -> set[str]:
    """Return the names of the options of a task: those of its class and of the classes it hands the others on to."""
    names = {"max_episode_steps"}
    for base in (cls for cls in task.__mro__ if "__init__" in vars(cls)):
        parameters = inspect.signature(base.__init__).parameters.values()
        names |= {parameter.name for parameter in parameters if parameter.kind in NAMED}
        if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
            break
    return names - {"self", "num_envs", "sim_backend"}
