"""What the scripts of this folder share: environments, policies and the record of how a run was made."""

from __future__ import annotations

import dataclasses
import json
import platform
import subprocess
import sys
import time
from collections.abc import Mapping
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv

import maniskill_grpd  # registers the tasks
from maniskill_grpd.learning import CheckpointError, TrainConfig, load_checkpoint
from maniskill_grpd.learning.checkpoint import describe_differences
from maniskill_grpd.policies import Policy, policy_from_config
from maniskill_grpd.processor import processor_name
from maniskill_grpd.tasks.options.env_id import check_env_id

_PACKAGES = ("mani-skill", "sapien", "warp-lang", "torch", "gymnasium", "numpy")


def make_env(config: TrainConfig, num_envs: int, **options: Any) -> gym.Env:
    """Make the task of a run as a plain batched ManiSkill environment.

    Args:
        config: Names the task, its options and the simulation backend.
        num_envs: Number of environments.
        **options: Further options of the task, which replace those of the config.
    """
    given = {"obs_mode": "graph", **config.env_options, **options}
    return gym.make(
        config.env_id,
        num_envs=num_envs,
        sim_backend=config.sim_backend,
        # Resets that happen by themselves must follow from the seeds too, or no run can be repeated.
        enhanced_determinism=True,
        **given,
    )


def make_vector_env(config: TrainConfig, num_envs: int, *, partial_reset: bool) -> ManiSkillVectorEnv:
    """Make the task of a run as a vector environment that resets itself.

    Args:
        config: Names the task, its options and the simulation backend.
        num_envs: Number of environments.
        partial_reset: Whether an episode ends when its environment terminates.
    """
    env = make_env(config, num_envs)
    return ManiSkillVectorEnv(env, num_envs, ignore_terminations=not partial_reset, record_metrics=True)


def load_policy(
    path: str | Path, device: str | torch.device = "cpu", *, allow_import: bool = False
) -> tuple[Policy, dict[str, Any]]:
    """Rebuild the policy of a checkpoint.

    Args:
        path: The checkpoint.
        device: Where the policy goes.
        allow_import: Whether the id of its task may name a module, which is imported when the task is made.

    Returns:
        The policy, and the other contents of the checkpoint.

    Raises:
        ValueError: If the id of its task names a module and that is not allowed.
    """
    contents = load_checkpoint(path)
    check_env_id(contents["train_config"].get("env_id"), str(path), allow_import=allow_import)
    policy = policy_from_config(contents["policy"])
    policy.load_state_dict(contents["weights"])
    return policy.to(device).eval(), contents


def check_schema(policy: Policy, env: gym.Env) -> None:
    """Refuse an environment whose observations mean something else than the policy was trained on.

    The number of nodes, of grippers and the size of the object may differ; the channels may not.

    Raises:
        CheckpointError: Naming the channels that differ.
    """
    trained, given = policy.schema.to_dict(), env.unwrapped.graph_schema.to_dict()
    parts = ("object", "actuator")
    differences = describe_differences({part: trained[part] for part in parts}, {part: given[part] for part in parts})
    if differences:
        raise CheckpointError("the policy was trained on other observations than this task gives: " + "; ".join(differences))


def make_run_name(config: TrainConfig) -> str:
    """Return `exp_name`, or a name that tells task, policy, algorithm, seed and time."""
    if config.exp_name is not None:
        return config.exp_name
    return f"{config.env_id}__{config.policy}_{config.algorithm}__{config.seed}__{int(time.time())}"


def to_arguments(config: TrainConfig) -> list[str]:
    """Return the command line that gives the options that are not at their defaults."""
    arguments = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if value == field.default:
            continue
        if isinstance(value, bool):
            arguments.append(f"--{field.name}" if value else f"--no-{field.name}")
        else:
            arguments += [f"--{field.name}", *(map(str, value) if isinstance(value, tuple) else [str(value)])]
    return arguments


def write_run_record(run_dir: Path, config: TrainConfig, device: torch.device, num_processes: int = 1) -> None:
    """Write config.json: options, versions, commit, machine; enough to make the run again."""
    record = {
        "config": config.to_dict(),
        "command": sys.argv,
        "num_processes": num_processes,
        "device": str(device),
        "device_name": torch.cuda.get_device_name(device) if device.type == "cuda" else processor_name(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": {"maniskill_grpd": maniskill_grpd.__version__, **_package_versions()},
        "git": _git_state(),
    }
    run_dir.mkdir(parents=True, exist_ok=True)
    (run_dir / "config.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def read_run_config(run_dir: Path, *, allow_import: bool = False) -> TrainConfig:
    """Read the options of a run back from its config.json.

    Args:
        run_dir: Folder of the run.
        allow_import: Whether the id of its task may name a module, which is imported when the task is made.

    Raises:
        FileNotFoundError: If the folder is not one of a run.
        ValueError: If the id of its task names a module and that is not allowed.
    """
    path = run_dir / "config.json"
    if not path.is_file():
        raise FileNotFoundError(f"{run_dir} is not the folder of a run: it has no config.json")
    config = TrainConfig.from_dict(json.loads(path.read_text(encoding="utf-8"))["config"])
    check_env_id(config.env_id, str(path), allow_import=allow_import)
    return config


def describe_episodes(episodes: Mapping[str, torch.Tensor]) -> str:
    """Return a table of per-episode results: rates for yes/no, mean and quantiles for numbers."""
    lines = [f"{'':<18}{'mean':>11}{'5 %':>11}{'25 %':>11}{'median':>11}{'75 %':>11}{'95 %':>11}"]
    quantiles = torch.tensor([0.05, 0.25, 0.5, 0.75, 0.95], dtype=torch.float64)
    for name, values in episodes.items():
        cells = [values.double().mean()]
        if values.dtype != torch.bool:
            cells += torch.quantile(values.double(), quantiles)
        lines.append(f"{name:<18}" + "".join(f"{cell.item():>11.4g}" for cell in cells))
    return "\n".join(lines)


def _package_versions() -> dict[str, str]:
    installed = {item.metadata["Name"].replace("_", "-"): item.version for item in distributions()}
    return {name: installed.get(name, "not installed") for name in _PACKAGES}


def _git_state() -> dict[str, Any] | None:
    """Return commit and whether files differ from it; None outside a git checkout."""
    folder = Path(__file__).parent
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        return {"commit": commit, "dirty": bool(_git(folder, "status", "--porcelain"))}
    except (OSError, subprocess.CalledProcessError):
        return None


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
