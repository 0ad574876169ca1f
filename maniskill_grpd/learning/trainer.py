"""The training loop: collect, estimate advantages, update, log, checkpoint."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from maniskill_grpd.learning.algorithm import make_algorithm
from maniskill_grpd.learning.checkpoint import (
    CheckpointError,
    describe_differences,
    load_checkpoint,
    restore_policy,
    save_checkpoint,
)
from maniskill_grpd.learning.collector import Collector
from maniskill_grpd.learning.config import RESUMABLE_FIELDS, TrainConfig
from maniskill_grpd.learning.evaluate import evaluate_policy
from maniskill_grpd.learning.gae import generalized_advantages
from maniskill_grpd.learning.rollout import Rollout
from maniskill_grpd.learning.run_log import RunLog
from maniskill_grpd.learning.update import update_policy
from maniskill_grpd.learning.value_scale import ValueScale

FIRST_TRAINING_SEED = 2**30
"""Environments are trained on seeds from here up, so that no seed below is ever trained on."""

FIRST_EVAL_SEED = 500_000
"""Evaluations during training, which choose best_ckpt.pt, use the seeds from here on."""


class Trainer:
    """Trains a policy on a vector environment.

    Checkpoints in `run_dir`: `last.pt` every `checkpoint_freq` iterations, `best_ckpt.pt` after the
    evaluation with the highest (success_at_end, return), `final_ckpt.pt` at the end.

    A resumed run continues bit for bit (same machine, same thread count) as if it had never been
    broken. The state of the simulation is not stored for that: after every checkpoint, in broken
    and unbroken runs alike, all environments are reset with seeds that follow from (seed,
    iteration). With rollouts of whole episodes nothing is lost by it; otherwise episodes are cut
    there, and the value of their last observation stands for the rest.

    The normaliser of the policy is updated once before the first rollout, on a rollout that is
    thrown away, and then after each update: within an iteration the old and the new policy see the
    same scales.

    Args:
        config: Options.
        policy: See `maniskill_grpd.policies.make_policy`. Changed in place.
        envs: Vector environment with same-step reset and `config.num_envs` environments.
        eval_envs: Vector environment to evaluate in, None for no evaluation.
        run_dir: Folder for checkpoints and logs; made if missing.

    Raises:
        ValueError: If `envs` has another number of environments than the config.
    """

    def __init__(
        self,
        config: TrainConfig,
        policy: Any,
        envs: Any,
        eval_envs: Any | None = None,
        run_dir: str | Path = "runs/default",
    ) -> None:
        if envs.num_envs != config.num_envs:
            raise ValueError(f"num_envs is {config.num_envs} but envs has {envs.num_envs}")
        self.config = config
        self.policy = policy
        self.envs = envs
        self.eval_envs = eval_envs
        self.run_dir = Path(run_dir)
        self.iteration = 0
        self.best_score: list[float] | None = None
        self.last_evaluation: dict[str, float] = {}
        self._device = next(policy.parameters()).device
        self._algorithm = make_algorithm(config)
        self._optimizer = torch.optim.Adam(policy.parameters(), lr=config.learning_rate, eps=1e-5)
        self._value_scale = ValueScale()
        self._collector = Collector(envs, config.num_steps)
        self._generators = {
            "action": torch.Generator(self._device).manual_seed(config.seed),
            "minibatch": torch.Generator().manual_seed(config.seed),
        }
        self._is_resumed = False

    @property
    def global_step(self) -> int:
        """Environment steps trained on so far, over all environments."""
        return self.iteration * self.config.batch_size

    def train(self) -> dict[str, float]:
        """Train up to `total_timesteps`.

        Returns:
            The metrics of the last evaluation by tag ("eval/return", ...), empty if there was none.

        Raises:
            NonFiniteError: If an observation, reward or gradient is not finite.
            OSError: If a checkpoint cannot be written.
        """
        self._prepare()
        progress = tqdm(
            total=self.config.num_iterations * self.config.batch_size,
            initial=self.global_step,
            unit="step",
            dynamic_ncols=True,
            # In a log file every refresh is a line.
            mininterval=0.5 if sys.stderr.isatty() else 30.0,
        )
        try:
            while self.iteration < self.config.num_iterations:
                rollout, episodes = self._collect()
                self._estimate_advantages(rollout)
                losses = self._update(rollout)
                evaluation = self._log(rollout, episodes, losses, progress)
                self._checkpoint(evaluation)
        finally:
            progress.close()
            self._log_file.close()
        self._save("final_ckpt.pt")
        return self.last_evaluation

    def load(self, path: str | Path) -> None:
        """Continue from a checkpoint of a run with the same options.

        Args:
            path: `last.pt` of the run.

        Raises:
            FileNotFoundError: If there is no such file.
            CheckpointError: If it is not a usable checkpoint, or of a run with options that differ
                in more than what may change (`config.RESUMABLE_FIELDS`).
        """
        contents = load_checkpoint(path, self._device)
        stored, given = contents["train_config"], self.config.to_dict()
        fixed = [
            line
            for line in describe_differences(stored, given)
            if line.partition(":")[0] not in RESUMABLE_FIELDS | {"exp_name"}
        ]
        if fixed:
            raise CheckpointError(
                f"{path} cannot be resumed with other options: {'; '.join(fixed)}"
            )
        restore_policy(self.policy, contents)
        self._optimizer.load_state_dict(contents["optimizer"])
        self._value_scale.load_state_dict(contents["value_scale"])
        for name, generator in self._generators.items():
            generator.set_state(contents["generators"][name].cpu())
        self.iteration = contents["iteration"]
        self.best_score = contents["best_score"]
        self._is_resumed = True

    def load_weights(self, path: str | Path) -> None:
        """Start a new run from the weights of a checkpoint.

        Args:
            path: Any checkpoint of a policy with the same options.

        Raises:
            FileNotFoundError: If there is no such file.
            CheckpointError: If it is not a usable checkpoint of such a policy.
        """
        contents = load_checkpoint(path, self._device)
        restore_policy(self.policy, contents)
        self._value_scale.load_state_dict(contents["value_scale"])

    def _prepare(self) -> None:
        self.run_dir.mkdir(parents=True, exist_ok=True)
        torch.set_num_threads(self.config.torch_threads)
        tqdm.write(
            f"PyTorch uses {self.config.torch_threads} CPU thread(s) (--torch_threads): its "
            "operations here are small, and on busy cores several threads wait for each other"
        )
        self._log_file = RunLog(self.run_dir, self.config, self.iteration)
        self._times = dict.fromkeys(("rollout", "update", "eval"), 0.0)
        self._start = time.perf_counter()
        self._steps_this_session = 0
        self._reset_envs()
        if not self._is_resumed:
            rollout, _ = self._collector.collect(
                self.policy, self._value_scale, self._generators["action"], "while warming up"
            )
            self.policy.normalizer.update(rollout.flat_graph())
            self._reset_envs()

    def _reset_envs(self) -> None:
        self._collector.reset(episode_seeds(self.config, self.iteration))

    def _collect(self) -> tuple[Rollout, dict[str, float]]:
        start = time.perf_counter()
        collected = self._collector.collect(
            self.policy,
            self._value_scale,
            self._generators["action"],
            f"in iteration {self.iteration}",
        )
        self._times["rollout"] = time.perf_counter() - start
        return collected

    def _estimate_advantages(self, rollout: Rollout) -> None:
        rollout.advantages, rollout.returns = generalized_advantages(
            rollout.rewards,
            rollout.values,
            rollout.next_value,
            rollout.terminated,
            rollout.truncated,
            rollout.final_values,
            gamma=self.config.gamma,
            gae_lambda=self.config.gae_lambda,
        )

    def _update(self, rollout: Rollout) -> dict[str, float]:
        start = time.perf_counter()
        for group in self._optimizer.param_groups:
            group["lr"] = self._learning_rate()
        self._value_scale.update(rollout.returns)
        losses = update_policy(
            self.policy,
            self._optimizer,
            self._algorithm,
            rollout,
            self._value_scale,
            self.config,
            self._generators["minibatch"],
        )
        self._update_normalizer(rollout)
        self.iteration += 1
        self._times["update"] = time.perf_counter() - start
        return losses

    def _learning_rate(self) -> float:
        left = 1.0 - self.iteration / self.config.num_iterations if self.config.anneal_lr else 1.0
        return self.config.learning_rate * left

    def _update_normalizer(self, rollout: Rollout) -> None:
        freeze = self.config.normalizer_freeze_steps
        if freeze is None or self.global_step < freeze:
            self.policy.normalizer.update(rollout.flat_graph())

    def _log(
        self,
        rollout: Rollout,
        episodes: dict[str, float],
        losses: dict[str, float],
        progress: tqdm,
    ) -> dict[str, float] | None:
        """Write the metrics of the iteration; evaluate and write that too if it is time."""
        self._steps_this_session += self.config.batch_size
        elapsed = time.perf_counter() - self._start
        metrics = {
            **{f"train/{key}": value for key, value in episodes.items()},
            **{f"losses/{key}": value for key, value in losses.items()},
            **rollout_metrics(rollout),
            "charts/learning_rate": self._optimizer.param_groups[0]["lr"],
            "charts/SPS": self._steps_this_session / elapsed,
            "time/rollout_time": self._times["rollout"],
            "time/update_time": self._times["update"],
            "time/rollout_fps": self.config.batch_size / self._times["rollout"],
        }
        self._log_file.add("train", self.iteration, self.global_step, metrics)
        progress.update(self.config.batch_size)
        progress.set_postfix_str(_progress_text(metrics))
        is_due = self.config.eval_freq and (
            self.iteration % self.config.eval_freq == 0
            or self.iteration == self.config.num_iterations
        )
        return self._evaluate() if self.eval_envs is not None and is_due else None

    def _evaluate(self) -> dict[str, float]:
        start = time.perf_counter()
        seeds = range(FIRST_EVAL_SEED, FIRST_EVAL_SEED + self.config.num_eval_envs)
        episodes = evaluate_policy(self.policy, self.eval_envs, seeds)
        metrics = {f"eval/{k}": v.double().mean().item() for k, v in episodes.items()}
        metrics["time/eval_time"] = time.perf_counter() - start
        self._log_file.add("eval", self.iteration, self.global_step, metrics)
        text = ", ".join(f"{k[5:]}={v:.3g}" for k, v in metrics.items() if k.startswith("eval/"))
        tqdm.write(f"eval at step {self.global_step:,}: {text}")
        self.last_evaluation = metrics
        return metrics

    def _checkpoint(self, evaluation: dict[str, float] | None) -> None:
        """Save what is due; see the class docstring for why the environments are reset."""
        if evaluation is not None:
            score = [evaluation.get("eval/success_at_end", 0.0), evaluation["eval/return"]]
            if self.best_score is None or score > self.best_score:
                self.best_score = score
                self._save("best_ckpt.pt")
        is_last = self.iteration == self.config.num_iterations
        if self.iteration % self.config.checkpoint_freq == 0 or is_last:
            self._save("last.pt")
            self._reset_envs()

    def _save(self, name: str) -> None:
        if not self.config.save_model:
            return
        save_checkpoint(
            self.run_dir / name,
            {
                "policy": self.policy.config,
                "weights": self.policy.state_dict(),
                "optimizer": self._optimizer.state_dict(),
                "value_scale": self._value_scale.state_dict(),
                "generators": {key: g.get_state() for key, g in self._generators.items()},
                "train_config": self.config.to_dict(),
                "iteration": self.iteration,
                "global_step": self.global_step,
                "best_score": self.best_score,
            },
        )


def episode_seeds(config: TrainConfig, iteration: int) -> list[int]:
    """Return the seeds the environments are reset with at the start of an iteration.

    Independent for different (seed, iteration), and in [2^30, 2^31): disjoint from evaluation seeds.
    """
    state = np.random.SeedSequence([config.seed, iteration]).generate_state(config.num_envs)
    return (FIRST_TRAINING_SEED + state % FIRST_TRAINING_SEED).tolist()


def rollout_metrics(rollout: Rollout) -> dict[str, float]:
    """Return tags that describe a rollout: explained variance, size of the actions, mean value."""
    errors = rollout.returns - rollout.values
    variance = rollout.returns.var()
    # Returns without variance cannot be explained; zero keeps the plot free of gaps.
    explained = 1.0 - errors.var() / variance if variance > 0 else variance
    return {
        "losses/explained_variance": explained.item(),
        "charts/action_norm": _action_norm(rollout).item(),
        "charts/value": rollout.values.mean().item(),
    }


def _action_norm(rollout: Rollout) -> torch.Tensor:
    """Return the mean norm of an actuator's action before the controller limits it, dimensionless."""
    mask = rollout.graph["actuator"]["mask"]
    return rollout.actions.unflatten(-1, rollout.means.shape[-2:]).norm(dim=-1)[mask].mean()


def _progress_text(metrics: dict[str, float]) -> str:
    shown = {
        "return": "train/return",
        "success": "train/success_once",
        "distance": "train/mean_distance",
        "SPS": "charts/SPS",
    }
    found = {name: metrics[tag] for name, tag in shown.items() if tag in metrics}
    return ", ".join(f"{name}={value:.3g}" for name, value in found.items())
