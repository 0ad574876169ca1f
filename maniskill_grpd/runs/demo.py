"""The demonstration behind `make demo`: train GRPD with BPP on RopeShaping-v1 for a few minutes and show what it learned.

Writes runs/demo/: learning_curve.png, policy.mp4 (or .gif), metrics.json, final_ckpt.pt.
"""

from __future__ import annotations

import json
import shutil
import time
from dataclasses import dataclass, replace

import torch

from maniskill_grpd.learning import TrainConfig, evaluate_policy
from maniskill_grpd.runs.environments import make_vector_env
from maniskill_grpd.runs.episodes import describe_episodes
from maniskill_grpd.runs.fingerprint import describe_training
from maniskill_grpd.runs.folder import RUNS
from maniskill_grpd.runs.learning_curve import plot_learning_curve
from maniskill_grpd.runs.record import write_run_record
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED
from maniskill_grpd.runs.training import make_trainer
from maniskill_grpd.runs.video import record_video

RUN_DIR = RUNS / "demo"


SIZES = {
    False: {"total_timesteps": 64_000, "num_episodes": 64, "num_videos": 4},
    True: {"total_timesteps": 12_800, "num_episodes": 16, "num_videos": 1},
}
"""What the options are where the command line is silent, without and with `--quick`."""


@dataclass(frozen=True, kw_only=True)
class DemoConfig:
    """Options of the demonstration."""

    quick: bool = False
    """take about a minute: a fifth of the steps, fewer episodes and pictures"""
    total_timesteps: int | None = None
    """environment steps to train for: 64,000, or 12,800 if quick"""
    num_episodes: int | None = None
    """episodes, on unseen seeds, of the evaluations before and after: 64, or 16 if quick"""
    num_videos: int | None = None
    """episodes in the video: 4, or 1 if quick"""
    seed: int = 1
    """seed of the training"""

    def with_sizes(self) -> DemoConfig:
        """Return these options with all sizes filled in."""
        return replace(self, **{name: size for name, size in SIZES[self.quick].items() if getattr(self, name) is None})


def demonstrate(config: DemoConfig) -> dict[str, float]:
    """Evaluate, train, evaluate on the same unseen seeds, and write pictures and numbers.

    Returns:
        The summary that metrics.json holds.
    """
    start = time.perf_counter()
    config = config.with_sizes()
    # The folder is this script's own; a curve of two runs on top of each other would mislead.
    shutil.rmtree(RUN_DIR, ignore_errors=True)
    options = TrainConfig(
        exp_name=RUN_DIR.name,
        seed=config.seed,
        total_timesteps=config.total_timesteps,
        eval_freq=5,
        # The policy sees every other node; the rope is simulated in full. Half the nodes are half the time.
        env_kwargs=("graph_nodes=21",),
    )
    trainer = make_trainer(options, RUN_DIR)
    write_run_record(RUN_DIR, options, trainer.envs.device, describe_training(options))

    seeds = range(FIRST_TEST_SEED, FIRST_TEST_SEED + config.num_episodes)
    test_env = make_vector_env(options, min(64, config.num_episodes), partial_reset=False)
    before = evaluate_policy(trainer.policy, test_env, seeds)
    print(f"\nbefore training, {config.num_episodes} unseen start and goal poses:\n{describe_episodes(before)}\n")
    trainer.train()
    after = evaluate_policy(trainer.policy, test_env, seeds)
    print(f"\nafter training, the same poses:\n{describe_episodes(after)}\n")

    summary = summarize(before, after)
    summary["seconds"] = time.perf_counter() - start
    summary["total_timesteps"] = trainer.state.global_step
    (RUN_DIR / "metrics.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    curve = plot_learning_curve(RUN_DIR)
    video = record_video(trainer.policy, options, seeds[: config.num_videos], RUN_DIR / "policy.mp4")
    print(
        f"mean rope-goal distance at the end: {summary['mean_distance_before']:.3f} m before, "
        f"{summary['mean_distance_after']:.3f} m after ({summary['improvement']:.1f} times closer), "
        f"success {summary['success_after']:.0%}\nlook at {curve} and {video}"
    )
    return summary


def summarize(before: dict[str, torch.Tensor], after: dict[str, torch.Tensor]) -> dict[str, float]:
    """Return the numbers that show what training changed."""

    def mean(episodes: dict[str, torch.Tensor], key: str) -> float:
        return episodes[key].double().mean().item()

    distances = mean(before, "mean_distance"), mean(after, "mean_distance")
    return {
        "mean_distance_before": distances[0],
        "mean_distance_after": distances[1],
        "improvement": distances[0] / max(distances[1], 1e-9),
        "return_before": mean(before, "return"),
        "return_after": mean(after, "return"),
        "success_before": mean(before, "success_once"),
        "success_after": mean(after, "success_once"),
        "success_at_end_after": mean(after, "success_at_end"),
    }
