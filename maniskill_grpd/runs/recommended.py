"""Training settings that tasks recommend."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from mani_skill.utils.registration import REGISTERED_ENVS

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.options import parse_options
from maniskill_grpd.runs.environments import import_tasks


def recommended_settings(env_id: str) -> Mapping[str, Any]:
    """Return what a task recommends in `TRAINING`, options of `TrainConfig` by name; nothing for a task that does not exist.

    Raises:
        ValueError: If it recommends something that is no option of a training, or the module of the task does not exist.
    """
    module, _, name = env_id.rpartition(":")
    if module:
        import_tasks(module)
    task = REGISTERED_ENVS.get(name)
    settings = getattr(task.cls, "TRAINING", {}) if task else {}
    unknown = sorted(set(settings) - {field.name for field in dataclasses.fields(TrainConfig)})
    if unknown:
        raise ValueError(f"{task.cls.__name__}.TRAINING names {', '.join(unknown)}, which `train` does not take")
    return settings


def complete_env_kwargs(given: tuple[str, ...], recommended: tuple[str, ...]) -> tuple[str, ...]:
    """Return options of a task as given, after those recommended ones whose names were not given."""
    names = parse_options("env_kwargs", given)
    return (*(pair for pair in recommended if pair.partition("=")[0] not in names), *given)


def describe_settings(config: TrainConfig) -> str:
    """Return in one line what a task recommends for trainings, and what a training has otherwise."""
    settings = recommended_settings(config.env_id)
    if not settings:
        return f"{config.env_id} recommends no settings for training"
    recommended = ", ".join(f"{name}={_shown(value)}" for name, value in settings.items())
    others = [name for name, value in settings.items() if not _is_followed(name, value, config)]
    taken = "; ".join(f"here {name}={_shown(getattr(config, name))}" for name in others) or "taken as they are"
    return f"{config.env_id} recommends {recommended}: {taken}"


def _is_followed(name: str, value: Any, config: TrainConfig) -> bool:
    used = getattr(config, name)
    return set(value) <= set(used) if name == "env_kwargs" else used == value


def _shown(value: Any) -> str:
    return " ".join(value) if isinstance(value, tuple) else str(value)
