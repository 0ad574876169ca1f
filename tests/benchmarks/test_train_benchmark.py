"""The training benchmark: its stock learner learns, its rows add up."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

pytest.importorskip("mani_skill")

from stock_ppo import StockPPO

# By path: baselines has a train.py, too.
SPEC = importlib.util.spec_from_file_location("train_benchmark", Path(__file__).parents[2] / "benchmarks" / "train.py")
benchmark = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(benchmark)


class PointEnv:
    """Rewards actions close to the observation; episodes end after five steps by a time limit."""

    single_action_space = SimpleNamespace(shape=(2,))

    def reset(self, seed):
        """Start anew."""
        self.elapsed, self.obs = 0, torch.randn(32, 2)
        return self.obs, {}

    def step(self, action):
        """Pay and draw the next observation."""
        reward = -(action - self.obs).square().sum(-1)
        self.elapsed, self.obs = self.elapsed + 1, torch.randn(32, 2)
        truncated = torch.full((32,), self.elapsed % 5 == 0)
        info = {"final_observation": self.obs}
        return self.obs, reward, torch.zeros(32, dtype=torch.bool), truncated, info


def test_the_stock_learner_learns():
    learner = StockPPO(PointEnv(), num_steps=20)

    def error():
        obs = torch.randn(500, 2)
        return (learner.actor(obs) - obs).square().sum(-1).mean().item()

    before = error()
    for _ in range(6):
        learner.run_iteration()
    assert error() < 0.8 * before
    assert set(learner.times) == {"rollout", "env", "update"}


def test_shares_of_the_phases_add_up_to_one():
    times = [{"rollout": 2.0, "env": 0.5, "update": 6.0}, {"rollout": 2.0, "env": 1.5, "update": 2.0}]
    row = benchmark.summarize("ours", times, steps=1000)
    assert row["env_steps_per_s"] == pytest.approx((1000 / 8 + 1000 / 4) / 2)
    shares = [row[f"share_{phase}"] for phase in ("simulation", "policy", "update")]
    assert shares == pytest.approx([2 / 12, 2 / 12, 8 / 12])
    assert "| ours | 188 | 125 - 250 | 17% | 17% | 67% | 0.50 |" in benchmark.to_markdown([{**row, "ratio": 0.5}])
