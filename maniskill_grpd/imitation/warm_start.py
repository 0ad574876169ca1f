"""Training that starts from demonstrations."""

from __future__ import annotations

from pathlib import Path

import torch

from maniskill_grpd.imitation.clone_config import CloneConfig
from maniskill_grpd.imitation.demonstrations import Demonstrations, load_demonstrations
from maniskill_grpd.imitation.regression import train_policy
from maniskill_grpd.learning import Trainer
from maniskill_grpd.tasks import DeformableEnv
from maniskill_grpd.trajectory.recording import read_recording

EPOCHS = 12
"""Passes over the demonstrations."""


def start_from_demonstrations(trainer: Trainer, *, fit_values: bool = True) -> None:
    """Let the policy of a trainer clone the demonstrations that its options name.

    Its mean actions and its scales of observations are then those of the demonstrations; its standard deviation is what it was
    made with. Its values are the returns of the demonstrations, where their rewards were recorded: an untrained value function
    makes the first advantages noise, and the policy is led away from what it was taught, however small the steps.
    In every process the result is the same.

    Args:
        trainer: Has not been prepared yet.
        fit_values: Whether values are learned.

    Raises:
        FileNotFoundError: If there are no such demonstrations.
        ValueError: If they are of another task, of another control mode or of other graphs; says what to do.
    """
    config, policy = trainer.config, trainer.policy
    demonstrations = _read(Path(config.demonstrations), trainer.envs.unwrapped)
    device = next(policy.parameters()).device
    batch_size = min(CloneConfig.batch_size, len(demonstrations.episode))
    clone = CloneConfig(seed=config.seed, epochs=EPOCHS, batch_size=batch_size, torch_threads=config.torch_threads)
    values = _adopt_returns(trainer, demonstrations) if fit_values and demonstrations.rewards is not None else None
    result = train_policy(policy.to("cpu"), demonstrations, clone, values)
    policy.to(device)
    trainer.keep_scales()
    if trainer.workers.is_first:
        print(
            f"cloned {demonstrations.num_episodes} episodes of {config.demonstrations} in {result['cpu_seconds']:.0f} s: error "
            f"{result['validation_error']:.0%} of the actions' size on episodes that were held out"
        )


def _adopt_returns(trainer: Trainer, demonstrations: Demonstrations) -> torch.Tensor:
    """Scale values by the returns of the demonstrations; return what the value network is to give, (M,)."""
    returns, scale = demonstrations.returns(trainer.config.gamma), trainer.state.value_scale
    scale.update(returns)
    return scale.normalize(returns)


def _read(path: Path, env: DeformableEnv) -> Demonstrations:
    recording = read_recording(path, count=1, allow_import=True)
    given = {"task": env.spec.id, "control mode": env.control_mode, "graph_features": env.graph_features}
    recorded = {
        "task": recording.env_id.rpartition(":")[2],
        "control mode": recording.episodes[0].control_mode,
        "graph_features": recording.env_kwargs.get("graph_features", "paper"),
    }
    for name, value in given.items():
        if recorded[name] != value:
            raise ValueError(
                f"{path} was recorded with {name} {recorded[name]}, this training has {value}: record demonstrations of it, or "
                f"give --env_id {recording.env_id} and the --env_kwargs of the recording, {recording.env_kwargs}"
            )
    try:
        return load_demonstrations(path, env.graph_schema, has_grippers=env.control_mode.endswith("_grip"))
    except ValueError as error:
        raise ValueError(f"{path} cannot be learned from: {error}; record with the --env_kwargs of this training") from error
