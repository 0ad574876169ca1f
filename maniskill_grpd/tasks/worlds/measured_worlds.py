"""Worlds that are measured once per step."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Any

import torch
from mani_skill.envs.sapien_env import BaseEnv

from maniskill_grpd.physics import Solver
from maniskill_grpd.tasks.measurement import Measurement, Metric


class MeasuredWorlds(BaseEnv):
    """The part of an environment that knows how its episodes stand.

    `measurement` is made once per step; `info`, reward, observation, pictures and experts read it. ManiSkill's `evaluate` and
    `compute_dense_reward` are views of it.
    """

    PROGRESS: Metric
    """The number in `info` that tells best how near a task is to being done, for curves and summaries."""

    solver: Solver
    _measurement: Measurement | None = None

    @abstractmethod
    def measure(self) -> Measurement:
        """Measure all worlds, from the state of `solver` and the tensors of the episodes alone."""

    @abstractmethod
    def reward(self, measurement: Measurement) -> torch.Tensor:
        """Return the rewards of a measurement, in [0, 1], (B,); those of failed episodes are set to 0 by the caller."""

    @property
    def measurement(self) -> Measurement:
        """What `measure` says of the present state, with diverged worlds as failures, which do not succeed.

        It is kept until the worlds advance, are reset, restored or moved. Who writes into the tensors of `solver` calls
        `evaluate`, which measures anew.
        """
        if self._measurement is None:
            self._measurement = self._with_failures(self.measure())
        return self._measurement

    def forget_measurement(self) -> None:
        """Let `measurement` be made anew when it is next asked for."""
        self._measurement = None

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Measure the worlds anew and return what `info` tells of them: success, fail and the task's metrics, as copies."""
        self.forget_measurement()
        measured = self.measurement
        return {
            name: value.clone()
            for name, value in {"success": measured.success, "fail": measured.fail, **measured.metrics}.items()
        }

    def compute_dense_reward(self, obs: Any, action: torch.Tensor, info: dict) -> torch.Tensor:
        """Return the rewards of the present state, (B,) in [0, 1]; 0 after a failure.

        The arguments are ManiSkill's; everything is in `measurement`.
        """
        measured = self.measurement
        reward = self.reward(measured)
        self._check_per_world("the result of reward()", reward)
        return reward * ~measured.fail

    def compute_normalized_dense_reward(self, obs: Any, action: torch.Tensor, info: dict) -> torch.Tensor:
        """Return the dense reward, which is in [0, 1] in all tasks."""
        return self.compute_dense_reward(obs=obs, action=action, info=info)

    def _with_failures(self, measured: Measurement) -> Measurement:
        if not isinstance(measured, Measurement):
            raise TypeError(f"{type(self).__name__}.measure() must return a Measurement, got {type(measured).__name__}")
        if self.PROGRESS.name not in measured.metrics:
            raise ValueError(
                f"{type(self).__name__}.PROGRESS names {self.PROGRESS.name!r}, which is not among the metrics of measure(): "
                f"{list(measured.metrics)}"
            )
        for name, value in {"success": measured.success, **measured.metrics}.items():
            self._check_per_world(f"{name!r} of measure()", value)
        fail = self.solver.frozen.clone() if measured.fail is None else self.solver.frozen | measured.fail
        return replace(measured, success=measured.success & ~fail, fail=fail)

    def _check_per_world(self, what: str, value: torch.Tensor) -> None:
        if tuple(value.shape) != (self.num_envs,):
            raise ValueError(f"{what} of {type(self).__name__} must be ({self.num_envs},), got {tuple(value.shape)}")
