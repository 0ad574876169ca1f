"""PPO against the formulas of CleanRL's ppo_continuous_action.py, written out in numpy.

Advantages (lines "bootstrap value if not done"), normalisation (numpy's ddof 0 there is torch's ddof
1), the clipped loss, half the squared value error, the entropy, their weighted sum, approx_kl and
clipfrac, on a fixed batch. What differs on purpose: values are regressed in units of their running
scale (identity here), and the value loss is not clipped (CleanRL's option clip_vloss, off in
ManiSkill).
"""

import dataclasses

import numpy as np
import pytest
import torch
from test_update import CONFIG, collect, make_learner
from toy_env import ToyPolicy

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.gae import generalized_advantages
from maniskill_grpd.learning.ppo import PPO
from maniskill_grpd.learning.update import update_policy

RNG = np.random.default_rng(0)


def test_advantages_are_those_of_the_loop_backwards_in_time():
    rewards, values = RNG.normal(size=(6, 3)), RNG.normal(size=(6, 3))
    next_value, dones = RNG.normal(size=3), RNG.random((6, 3)) < 0.3
    expected, last = np.zeros((6, 3)), 0.0
    for t in reversed(range(6)):
        # CleanRL's dones[t + 1] is the end of step t; its episodes end by termination only.
        going_on = 1.0 - dones[t]
        following = next_value if t == 5 else values[t + 1]
        delta = rewards[t] + 0.99 * following * going_on - values[t]
        expected[t] = last = delta + 0.99 * 0.95 * going_on * last
    advantages, returns = generalized_advantages(
        *(torch.tensor(x) for x in (rewards, values, next_value, dones)),
        torch.zeros(6, 3, dtype=torch.bool),
        torch.zeros(6, 3, dtype=torch.float64),
        gamma=0.99,
        gae_lambda=0.95,
    )
    np.testing.assert_allclose(advantages, expected, rtol=1e-12)
    np.testing.assert_allclose(returns, expected + values, rtol=1e-12)


def numpy_losses(mean, std, actions, old_log_probs, advantages, returns, values):
    """Return CleanRL's losses of a minibatch, (M, A, 3) means and (M, A, 1) deviations."""
    normal = -((actions - mean) ** 2) / (2 * std**2) - np.log(std) - 0.5 * np.log(2 * np.pi)
    log_probs = normal.sum((1, 2))
    log_ratio = log_probs - old_log_probs
    ratio = np.exp(log_ratio)
    advantages = (advantages - advantages.mean()) / (advantages.std(ddof=1) + 1e-8)
    pg_loss1 = -advantages * ratio
    pg_loss2 = -advantages * np.clip(ratio, 1 - 0.2, 1 + 0.2)
    entropy = (0.5 + 0.5 * np.log(2 * np.pi) + np.log(std * np.ones(3))).sum((1, 2)).mean()
    policy_loss = np.maximum(pg_loss1, pg_loss2).mean()
    value_loss = 0.5 * ((values - returns) ** 2).mean()
    return {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "clipfrac": (np.abs(ratio - 1.0) > 0.2).mean(),
        "loss": policy_loss - 0.01 * entropy + 0.5 * value_loss,
    }


def drifted_policy_and_rollout():
    """Return a policy that has left the one that collected, so that some ratios are clipped."""
    rollout, _ = collect(ToyPolicy())
    policy = ToyPolicy()
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape))
    return policy, rollout


def test_the_losses_of_a_minibatch_are_cleanrls():
    policy, rollout = drifted_policy_and_rollout()
    batch = rollout.select(torch.arange(56))
    learner = make_learner(policy)
    raw = batch.advantages.double().numpy().copy()
    dist, values = policy(batch.graph)
    expected = numpy_losses(
        dist.mean.detach().double().numpy(),
        dist.std.detach().double().numpy(),
        batch.actions.double().numpy().reshape(56, 2, 3),
        batch.log_probs.double().numpy(),
        raw,
        batch.returns.double().numpy(),
        values.detach().double().numpy(),
    )
    algorithm = PPO(clip_coef=0.2, ent_coef=0.01)
    loss, metrics = algorithm.policy_loss(dist, dist, learner.normalize_advantages(batch))
    value_loss = learner.value_loss(values, batch)
    found = {**metrics, "value_loss": value_loss, "loss": loss + 0.5 * value_loss}
    assert 0.0 < expected["clipfrac"] < 1.0
    for name, value in expected.items():
        np.testing.assert_allclose(found[name].item(), value, rtol=1e-4, err_msg=name)


def test_a_gradient_step_is_clipped_and_taken_like_cleanrls():
    """One minibatch: the step of Adam on the gradient of the summed loss, its norm clipped to 0.5."""
    policy, rollout = drifted_policy_and_rollout()
    fields = {"num_minibatches": 1, "max_grad_norm": 0.5, "algorithm": "ppo", "chunk_size": 56}
    config = TrainConfig.from_dict({**CONFIG.to_dict(), **fields})
    twin = ToyPolicy()
    twin.load_state_dict(policy.state_dict())
    learner = make_learner(policy, config)
    update_policy(learner, PPO(clip_coef=0.2, ent_coef=0.01), rollout)

    batch = rollout.select(torch.arange(56))
    dist, values = twin(batch.graph)
    ratio = (dist.log_prob(batch.actions) - batch.log_probs).exp()
    advantages = (batch.advantages - batch.advantages.mean()) / (batch.advantages.std() + 1e-8)
    pg_loss = torch.max(-advantages * ratio, -advantages * ratio.clamp(0.8, 1.2)).mean()
    v_loss = 0.5 * ((values - batch.returns) ** 2).mean()
    loss = pg_loss - 0.01 * dist.entropy().mean() + v_loss * 0.5
    optimizer = torch.optim.Adam(twin.parameters(), lr=1e-3)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(twin.parameters(), 0.5)
    optimizer.step()
    torch.testing.assert_close(policy.state_dict(), twin.state_dict(), rtol=1e-5, atol=1e-6)


def test_clipping_is_adapted_to_the_size_of_the_steps():
    """KL grows about as the square of the clipping: four times too much is answered by half, as far as 1.5 goes."""
    ppo = PPO(clip_coef=0.2, clip_kl=0.04, ent_coef=0.0)
    ppo.adapt(0.0484)
    assert ppo.clip_coef == pytest.approx(0.2 / 1.1)
    ppo.adapt(0.64)
    assert ppo.clip_coef == pytest.approx(0.2 / 1.1 / 1.5)
    for _ in range(20):
        ppo.adapt(0.0)
    assert ppo.clip_coef == 5.0
    resumed = PPO(clip_coef=0.2, clip_kl=0.04, ent_coef=0.0)
    resumed.load_state_dict(ppo.state_dict())
    assert resumed.clip_coef == 5.0


def test_adapted_clipping_brings_the_kl_to_its_goal():
    """From either side; without adaptation it stays where the clipping puts it."""
    kls = {}
    for clip_coef in (0.05, 1.0):
        torch.manual_seed(0)
        policy = ToyPolicy()
        ppo = PPO(clip_coef=clip_coef, clip_kl=0.02, ent_coef=0.0)
        learner = make_learner(policy, dataclasses.replace(CONFIG, update_epochs=4))
        found = [ppo.update(learner, collect(policy)[0])["kl_raw"] for _ in range(25)]
        kls[clip_coef] = np.mean(found[-8:])
    assert all(0.01 < kl < 0.04 for kl in kls.values()), kls


def test_clipping_that_stays_has_no_state_and_is_no_option_of_bpp():
    assert PPO(clip_coef=0.2, ent_coef=0.0).state_dict() == {}
    with pytest.raises(ValueError, match="--clip_kl belongs to --algorithm ppo"):
        TrainConfig(algorithm="bpp", clip_kl=0.05)
