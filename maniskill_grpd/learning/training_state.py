"""Everything a run continues from: what a checkpoint holds."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from maniskill_grpd.learning.algorithm import ALGORITHMS
from maniskill_grpd.learning.checkpoint import CheckpointError, describe_differences, load_checkpoint, reading, restore_policy
from maniskill_grpd.learning.config import RESUMABLE_FIELDS, TrainConfig
from maniskill_grpd.learning.protocols import ActorCritic
from maniskill_grpd.learning.update import Algorithm
from maniskill_grpd.learning.value_scale import ValueScale
from maniskill_grpd.learning.workers import Workers


@dataclass(kw_only=True)
class TrainingState:
    """Weights, optimizer, statistics, random generators and counters of a run.

    Attributes:
        config: Options.
        policy: The policy.
        optimizer: Its optimizer.
        algorithm: The algorithm, which may have a state of its own.
        value_scale: Statistics of the returns.
        generators: "action" on the device of the policy, "minibatch" on the CPU.
        workers: The processes; each has generators of its own.
        iteration: Finished iterations.
        best_score: [best_metric, return] of best_ckpt.pt, None before the first evaluation.
    """

    config: TrainConfig
    policy: ActorCritic
    optimizer: torch.optim.Optimizer
    algorithm: Algorithm
    value_scale: ValueScale = field(default_factory=ValueScale)
    generators: dict[str, torch.Generator]
    workers: Workers
    iteration: int = 0
    best_score: list[float] | None = None

    @classmethod
    def fresh(cls, config: TrainConfig, policy: ActorCritic, workers: Workers) -> TrainingState:
        """Return the state before the first iteration; all processes get the weights of the first."""
        device = next(policy.parameters()).device
        workers.broadcast(policy.state_dict().values())
        seed = generator_seed(config.seed, workers.rank)
        return cls(
            config=config,
            policy=policy,
            # Fused: one pass over all weights instead of a dozen per tensor.
            optimizer=torch.optim.Adam(policy.parameters(), lr=config.learning_rate, eps=1e-5, fused=True),
            algorithm=ALGORITHMS[config.algorithm].from_config(config),
            generators={"action": torch.Generator(device).manual_seed(seed), "minibatch": torch.Generator().manual_seed(seed)},
            workers=workers,
        )

    @property
    def global_step(self) -> int:
        """Environment steps trained on so far, over all environments."""
        return self.iteration * self.config.batch_size

    def to_checkpoint(self) -> dict[str, Any]:
        """Return the entries of a checkpoint. All processes must call this together."""
        states = self.workers.gather({name: g.get_state().cpu() for name, g in self.generators.items()})
        return {
            "policy": self.policy.config,
            "weights": self.policy.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "algorithm": self.algorithm.state_dict(),
            "value_scale": self.value_scale.state_dict(),
            "generators": {
                _generator_key(name, rank): state for rank, process in enumerate(states) for name, state in process.items()
            },
            "train_config": self.config.to_dict(),
            "iteration": self.iteration,
            "global_step": self.global_step,
            "best_score": self.best_score,
        }

    def restore(self, path: str | Path) -> None:
        """Continue from a checkpoint of a run with the same options.

        Args:
            path: `last.pt` of the run.

        Raises:
            FileNotFoundError: If there is no such file.
            CheckpointError: If it is not a usable checkpoint, or of a run with another number of
                processes or with options that differ in more than what may change
                (`config.RESUMABLE_FIELDS`).
        """
        contents = load_checkpoint(path, next(self.policy.parameters()).device)
        self._check_origin(path, contents)
        restore_policy(self.policy, contents)
        with reading(path, "optimizer"):
            self.optimizer.load_state_dict(contents["optimizer"])
            _check_moments(self.optimizer)
        with reading(path, "algorithm"):
            self.algorithm.load_state_dict(contents["algorithm"])
        with reading(path, "value_scale"):
            self.value_scale.load_state_dict(contents["value_scale"])
        with reading(path, "generators"):
            for name, generator in self.generators.items():
                generator.set_state(contents["generators"][_generator_key(name, self.workers.rank)].cpu())
        with reading(path, "best_score"):
            self.best_score = None if contents["best_score"] is None else [float(score) for score in contents["best_score"]]
        self.iteration = contents["iteration"]

    def restore_weights(self, path: str | Path) -> None:
        """Take over the weights of a checkpoint, and the scale of its values, for a new run.

        Args:
            path: Any checkpoint of a policy with the same options.

        Raises:
            FileNotFoundError: If there is no such file.
            CheckpointError: If it is not a usable checkpoint of such a policy.
        """
        contents = load_checkpoint(path, next(self.policy.parameters()).device)
        restore_policy(self.policy, contents)
        with reading(path, "value_scale"):
            self.value_scale.load_state_dict(contents["value_scale"])

    def _check_origin(self, path: str | Path, contents: dict[str, Any]) -> None:
        """Refuse a checkpoint of a run that this one would not continue."""
        fixed = [
            line
            for line in describe_differences(contents["train_config"], self.config.to_dict())
            if line.partition(":")[0] not in RESUMABLE_FIELDS | {"exp_name"}
        ]
        if fixed:
            raise CheckpointError(f"{path} cannot be resumed with other options: {'; '.join(fixed)}")
        size = len(contents["generators"]) // len(self.generators)
        if size != self.workers.size:
            raise CheckpointError(
                f"{path} was written by {size} process(es), here there are {self.workers.size}; "
                f"resume it with torchrun --nproc_per_node={size}"
                if size > 1
                else f"{path} was written by one process; resume it without torchrun"
            )


def _check_moments(optimizer: torch.optim.Optimizer) -> None:
    """Refuse moments that are not those of the weights; the optimizer would trip over them in its first step.

    Raises:
        ValueError: Naming the first.
    """
    for parameter, state in optimizer.state.items():
        for name, value in state.items():
            expected = () if name == "step" else tuple(parameter.shape)
            if not isinstance(value, torch.Tensor) or value.shape != expected or not torch.isfinite(value).all():
                raise ValueError(f"{name} must be a finite tensor of shape {expected}")


def generator_seed(seed: int, rank: int) -> int:
    """Return the seed of a process's generators: the run's own in the first."""
    if rank == 0:
        return seed
    return int(np.random.SeedSequence([seed, rank]).generate_state(1, np.uint64)[0] >> 1)


def _generator_key(name: str, rank: int) -> str:
    return name if rank == 0 else f"{name}.{rank}"
