"""Dual ascent on the multipliers of the KL bounds."""

import pytest
import torch
from toy_env import ToyEnv, ToyPolicy

from maniskill_grpd.learning import TrainConfig, Trainer
from maniskill_grpd.learning.lagrangian import LagrangianBPP
from maniskill_grpd.learning.rollout import Batch
from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.learning.trust_region import Bounds
from maniskill_grpd.policies import ActionDistribution

BOUNDS = Bounds(mean=0.05, cov=0.005, gripper=0.01)


def make_algorithm(**options):
    return LagrangianBPP(**{"bounds": BOUNDS, "dual_step": 0.5, "max_multiplier": 50.0, "ent_coef": 0.0, **options})


def test_multipliers_stay_bounded_whatever_the_kl():
    algorithm = make_algorithm()
    for share, limit in ((1e6, 50.0), (0.0, 1 / 50.0)):
        for _ in range(100):
            algorithm.ascend("mean", share)
        assert algorithm.multipliers["mean"] == pytest.approx(limit)
    assert algorithm.multipliers["cov"] == 1.0


def test_a_multiplier_rests_where_the_kl_is_at_its_bound():
    algorithm = make_algorithm()
    algorithm.ascend("cov", 1.0)
    assert algorithm.multipliers["cov"] == 1.0


def test_the_kl_settles_at_its_bound_under_a_constant_pull():
    """The surrogate always pulls the mean the same way; without multipliers it would run off."""
    torch.manual_seed(0)
    mask = torch.ones(64, 1, dtype=torch.bool)
    old = ActionDistribution(torch.zeros(64, 1, 3), torch.full((64, 1, 1), 0.5), mask)
    actions = old.sample()
    advantages = actions[:, 0] / 0.5
    batch = Batch(graph={}, actions=actions, log_probs=old.log_prob(actions), old=old, advantages=advantages, returns=advantages)
    algorithm, shares = make_algorithm(), []
    for _ in range(60):
        shift = torch.zeros(3, requires_grad=True)
        optimizer = torch.optim.Adam([shift], lr=0.02)
        for _ in range(40):
            dist = ActionDistribution(old.mean + shift, old.std, mask)
            loss, _ = algorithm.policy_loss(dist, dist, batch)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        shares.append(dist.kl_parts(old).mean.mean().item() / BOUNDS.mean)
        algorithm.ascend("mean", shares[-1])
    assert shares[0] < 0.8  # started elsewhere
    assert sum(shares[-20:]) / 20 == pytest.approx(1.0, abs=0.1)


def test_multipliers_adapt_and_survive_a_checkpoint(tmp_path):
    config = TrainConfig(
        trust_region="lagrangian",
        num_envs=8,
        num_steps=10,
        num_minibatches=2,
        total_timesteps=8 * 10 * 6,
        eval_freq=0,
        checkpoint_freq=1,
    )
    trainer = Trainer(config, ToyPolicy(), ToyEnv(8), None, tmp_path)
    trainer.train()
    rows = read_rows(tmp_path / "metrics.jsonl", "train")
    assert len({row["losses/mean_multiplier"] for row in rows}) > 1
    other = Trainer(config, ToyPolicy(seed=3), ToyEnv(8), None, tmp_path)
    other.load(tmp_path / "last.pt")
    assert other.state.algorithm.multipliers == trainer.state.algorithm.multipliers
    assert other.state.algorithm.multipliers["mean"] != 1.0
