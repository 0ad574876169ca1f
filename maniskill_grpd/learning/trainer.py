"""The training loop: collect, estimate advantages, update, log, checkpoint."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from tqdm import tqdm

from maniskill_grpd.learning.acting_policy import PolicySnapshot, confine
from maniskill_grpd.learning.checkpoint import save_checkpoint
from maniskill_grpd.learning.collector import Collector
from maniskill_grpd.learning.config import TrainConfig
from maniskill_grpd.learning.episode_seeds import FIRST_EVAL_SEED, episode_seeds
from maniskill_grpd.learning.evaluate import evaluate_policy
from maniskill_grpd.learning.gae import generalized_advantages
from maniskill_grpd.learning.normalizer_update import update_normalizer
from maniskill_grpd.learning.observation_noise import ObservationNoise
from maniskill_grpd.learning.protocols import ActorCritic, GraphVecEnv
from maniskill_grpd.learning.rollout import Rollout
from maniskill_grpd.learning.rollout_metrics import rollout_metrics
from maniskill_grpd.learning.run_log import RunLog
from maniskill_grpd.learning.stopping import TrainingStoppedError, never
from maniskill_grpd.learning.training_state import TrainingState
from maniskill_grpd.learning.update import Learner
from maniskill_grpd.learning.workers import Workers


class Trainer:
    """Trains a policy on a vector environment.

    Checkpoints in `run_dir`: `last.pt` every `checkpoint_freq` iterations, `best_ckpt.pt` after the
    evaluation with the highest (best_metric, return), `final_ckpt.pt` at the end.

    A resumed run continues bit for bit (same machine, same thread count) as if it had never been
    interrupted. The state of the simulation is not stored for that: after every checkpoint, in interrupted
    and uninterrupted runs alike, all environments are reset with seeds that follow from (seed,
    iteration). With rollouts of whole episodes nothing is lost by it; otherwise episodes are cut
    there, and the value of their last observation stands for the rest. A run that is asked to stop saves
    `last.pt` at the end of the iteration as well, where an uninterrupted one would not have reset its
    environments unless a checkpoint was due: such a run goes on from other poses.

    The normaliser of the policy is updated once before the first rollout, on a rollout that is
    thrown away, and then after each update: within an iteration the old and the new policy see the
    same scales.

    Args:
        config: Options.
        policy: See `maniskill_grpd.policies.make_policy`. Changed in place.
        envs: Vector environment with same-step reset and this process's share of
            `config.num_envs` environments.
        eval_envs: Vector environment to evaluate in, None for no evaluation; only the first process
            evaluates.
        run_dir: Folder for checkpoints and logs; made if missing.
        workers: The processes that train together; by default this one.
        should_stop: Asked after each iteration whether to stop there; one process that says so stops all.

    Attributes:
        state: What a checkpoint holds.
        times: Seconds by phase of the last iteration: rollout, env (its share of the rollout), update,
            eval, checkpoint; what did not happen is missing.
        last_evaluation: Metrics of the last evaluation by tag.

    Raises:
        ValueError: If `envs` has another number of environments than the config, sizes cannot be
            shared evenly among the processes, or the device lacks what the config asks for.
    """

    def __init__(
        self,
        config: TrainConfig,
        policy: ActorCritic,
        envs: GraphVecEnv,
        eval_envs: GraphVecEnv | None = None,
        run_dir: str | Path = "runs/default",
        workers: Workers | None = None,
        should_stop: Callable[[], bool] = never,
    ) -> None:
        self.config = config
        self.policy = policy
        self.envs = envs
        self.eval_envs = eval_envs
        self.run_dir = Path(run_dir)
        self.workers = workers or Workers()
        self._should_stop = should_stop
        self.last_evaluation: dict[str, float] = {}
        self._check_fit()
        self.state = TrainingState.fresh(config, policy, self.workers)
        self._learner = Learner(
            policy=policy,
            optimizer=self.state.optimizer,
            value_scale=self.state.value_scale,
            config=config,
            generator=self.state.generators["minibatch"],
            workers=self.workers,
        )
        noise = config.position_noise, config.velocity_noise
        disturb = None
        if any(noise):
            disturb = ObservationNoise(schema=policy.schema, position_std=noise[0], velocity_std=noise[1])
        self._collector = Collector(envs, config.num_steps, disturb, self.workers, config.amp)
        self.times: dict[str, float] = {}
        self._has_scales = False

    def train(self) -> dict[str, float]:
        """Train up to `total_timesteps`.

        Returns:
            The metrics of the last evaluation by tag ("eval/return", ...), empty if there was none.

        Raises:
            NonFiniteError: If an observation, reward or gradient is not finite.
            OSError: If a checkpoint cannot be written.
            TrainingStoppedError: If it was asked to stop before the last iteration; `last.pt` is that of the last one done.
        """
        self.prepare()
        try:
            self._evaluate_start()
            while self.state.iteration < self.config.num_iterations:
                self.run_iteration()
                self._stop_if_asked()
        finally:
            self.close()
        self._save("final_ckpt.pt")
        return self.last_evaluation

    def load(self, path: str | Path) -> None:
        """Continue from a checkpoint of a run with the same options; see `TrainingState.restore`."""
        self.state.restore(path)
        self._has_scales = True

    def keep_scales(self) -> None:
        """Start with the scales of observations that the policy was taught, in place of those of a first rollout."""
        self._has_scales = True

    def load_weights(self, path: str | Path) -> None:
        """Start a new run from the weights of a checkpoint; see `TrainingState.restore_weights`."""
        self.state.restore_weights(path)

    def _check_fit(self) -> None:
        config, size = self.config, self.workers.size
        local = self.workers.share("num_envs", config.num_envs)
        if self.envs.num_envs != local:
            of = f" for {size} processes, {local} each," if size > 1 else ""
            raise ValueError(f"num_envs is {config.num_envs}{of} but envs has {self.envs.num_envs}")
        if local * config.num_steps % config.num_minibatches:
            raise ValueError(
                f"the {local} * {config.num_steps} transitions of each of {size} processes must be "
                f"divisible by num_minibatches = {config.num_minibatches}"
            )
        if config.amp and next(self.policy.parameters()).device.type != "cuda":
            raise ValueError("--amp needs a CUDA device; on a CPU leave it out")

    def prepare(self) -> None:
        """Open the logs, reset the environments and, in a new run, scale the observations."""
        torch.set_num_threads(self.config.torch_threads)
        self._log_file = None
        if self.workers.is_first:
            self.run_dir.mkdir(parents=True, exist_ok=True)
            tqdm.write(
                f"PyTorch uses {self.config.torch_threads} CPU thread(s) (--torch_threads) in each of "
                f"{self.workers.size} process(es): its operations here are small, and on busy cores "
                "several threads wait for each other"
            )
            self._log_file = RunLog(self.run_dir, self.config, self.state.iteration)
        self._progress = tqdm(
            total=self.config.num_iterations * self.config.batch_size,
            initial=self.state.global_step,
            unit="step",
            dynamic_ncols=True,
            disable=not self.workers.is_first,
            # In a log file every refresh is a line.
            mininterval=0.5 if sys.stderr.isatty() else 30.0,
        )
        self._start = time.perf_counter()
        self._steps_this_session = 0
        self.start_episodes()

    def start_episodes(self) -> None:
        """Reset the environments and, in a new run, scale the observations."""
        self._reset_envs()
        if not self._has_scales:
            rollout, _ = self._collect("while warming up")
            update_normalizer(self.policy.normalizer, rollout.flat_graph(), self.workers)
            self._reset_envs()

    def run_iteration(self) -> None:
        """Collect, learn, log, evaluate and save once; `times` then tells how long each took."""
        self._log(*self.collect_and_learn())
        is_best = self._evaluate() if self._is_evaluation_due() else False
        self._checkpoint(is_best)

    def collect_and_learn(self) -> tuple[Rollout, dict[str, float], dict[str, float]]:
        """Collect and learn once; return the rollout, means over the episodes that ended in it, and metrics of the update."""
        self.times.clear()
        with self._timed("rollout"):
            rollout, episodes = self._collect(f"in iteration {self.state.iteration}")
        self.times["env"] = self._collector.env_seconds
        with self._timed("update"):
            self._estimate_advantages(rollout)
            losses = self._update(rollout)
        return rollout, episodes, losses

    def close(self) -> None:
        """Close the logs."""
        self._progress.close()
        if self._log_file is not None:
            self._log_file.close()

    def _reset_envs(self) -> None:
        seeds = episode_seeds(self.config, self.state.iteration)
        start = self.workers.rank * self.envs.num_envs
        self._collector.reset(seeds[start : start + self.envs.num_envs])

    def _collect(self, where: str) -> tuple[Rollout, dict[str, float]]:
        generator = self.state.generators["action"]
        now = self.config.coefficients(self.state.iteration)
        self._collector.noise.correlation = now.noise_correlation
        return self._collector.collect(self.policy, self.state.value_scale, generator, where)

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
        state = self.state
        now = self.config.coefficients(state.iteration)
        for group in state.optimizer.param_groups:
            group["lr"] = now.learning_rate
        state.algorithm.adopt(now)
        if self.config.popart:
            state.value_scale.adapt(self.policy, rollout.returns, self.workers)
        else:
            state.value_scale.update(rollout.returns, self.workers)
        before = PolicySnapshot.of(self.policy)
        losses = state.algorithm.update(self._learner, rollout)
        freeze = self.config.normalizer_freeze_steps
        if freeze is None or state.global_step < freeze:
            update_normalizer(self.policy.normalizer, rollout.flat_graph(), self.workers)
        delta, per_actuator = state.algorithm.acting_bound(rollout.distribution)
        losses |= confine(self._learner, rollout, before, delta, per_actuator=per_actuator)
        state.iteration += 1
        return losses

    def _log(self, rollout: Rollout, episodes: dict[str, float], losses: dict[str, float]) -> None:
        """Write the metrics of the iteration."""
        batch_size = self.config.batch_size
        self._steps_this_session += batch_size
        elapsed = time.perf_counter() - self._start
        now = self.config.coefficients(self.state.iteration - 1)
        metrics = {
            **{f"train/{key}": value for key, value in episodes.items()},
            **{f"losses/{key}": value for key, value in losses.items()},
            **rollout_metrics(rollout, self.workers),
            "charts/learning_rate": now.learning_rate,
            "charts/ent_coef": now.ent_coef,
            "charts/noise_correlation": now.noise_correlation,
            "charts/SPS": self._steps_this_session / elapsed,
            **{f"time/{name}_time": seconds for name, seconds in self.times.items()},
            "time/rollout_fps": batch_size / self.times["rollout"],
        }
        if now.entropy_floor is not None:
            metrics["charts/entropy_floor"] = now.entropy_floor
        if self._log_file is not None:
            self._log_file.add("train", self.state.iteration, self.state.global_step, metrics)
        self._progress.update(batch_size)
        self._progress.set_postfix_str(_progress_text(metrics, self.envs.unwrapped.PROGRESS.name))

    def _evaluate_start(self) -> None:
        """Evaluate a policy that was taught before its first step: curves begin with what it was taught."""
        if self._has_scales and not self.state.iteration and self.config.eval_freq and self._evaluate():
            self._save("best_ckpt.pt")

    def _is_evaluation_due(self) -> bool:
        iteration, config = self.state.iteration, self.config
        is_last = iteration == config.num_iterations
        return bool(config.eval_freq) and (iteration % config.eval_freq == 0 or is_last)

    def _evaluate(self) -> bool:
        """Evaluate in the first process, log it, and tell all whether it was the best so far."""
        is_best = False
        if self.eval_envs is not None and self._log_file is not None:
            seeds = range(FIRST_EVAL_SEED, FIRST_EVAL_SEED + self.config.num_eval_envs)
            with self._timed("eval"):
                episodes = evaluate_policy(self.policy, self.eval_envs, seeds)
            metrics = {f"eval/{k}": v.double().mean().item() for k, v in episodes.items()}
            metrics["time/eval_time"] = self.times["eval"]
            self._log_file.add("eval", self.state.iteration, self.state.global_step, metrics)
            text = ", ".join(f"{k[5:]}={v:.3g}" for k, v in metrics.items() if k.startswith("eval/"))
            tqdm.write(f"eval at step {self.state.global_step:,}: {text}")
            self.last_evaluation = metrics
            score = [self._best_metric(metrics), metrics["eval/return"]]
            is_best = self.state.best_score is None or score > self.state.best_score
            self.state.best_score = score if is_best else self.state.best_score
        return self.workers.gather(is_best)[0]

    def _best_metric(self, metrics: dict[str, float]) -> float:
        name = self.config.best_metric
        if f"eval/{name}" not in metrics:
            raise ValueError(
                f"the task does not report {name}, by which the best checkpoint is chosen; choose "
                "another with --best_metric, return for example"
            )
        return metrics[f"eval/{name}"]

    def _checkpoint(self, is_best: bool) -> None:
        """Save what is due; see the class docstring for why the environments are reset."""
        if is_best:
            self._save("best_ckpt.pt")
        iteration = self.state.iteration
        if iteration % self.config.checkpoint_freq == 0 or iteration == self.config.num_iterations:
            with self._timed("checkpoint"):
                self._save("last.pt")
                self._reset_envs()

    def _stop_if_asked(self) -> None:
        done, of = self.state.iteration, self.config.num_iterations
        if done < of and any(self.workers.gather(self._should_stop())):
            self._save("last.pt")
            raise TrainingStoppedError(self.run_dir, done, of, is_saved=self.config.save_model)

    def _save(self, name: str) -> None:
        if not self.config.save_model:
            return
        contents = self.state.to_checkpoint()
        if self.workers.is_first:
            save_checkpoint(self.run_dir / name, contents)

    @contextmanager
    def _timed(self, phase: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.times[phase] = time.perf_counter() - start


def _progress_text(metrics: dict[str, float], progress: str) -> str:
    shown = {"return": "train/return", "success": "train/success_once", progress: f"train/{progress}", "SPS": "charts/SPS"}
    found = {name: metrics[tag] for name, tag in shown.items() if tag in metrics}
    return ", ".join(f"{name}={value:.3g}" for name, value in found.items())
