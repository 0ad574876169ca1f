"""Rollouts and the update phase."""

import copy

import pytest
import torch
from toy_env import ToyEnv, ToyPolicy

from maniskill_grpd.learning import NonFiniteError, TrainConfig
from maniskill_grpd.learning.algorithm import ALGORITHMS
from maniskill_grpd.learning.collector import Collector
from maniskill_grpd.learning.rollout import graph_items
from maniskill_grpd.learning.update import FirstOrderAlgorithm, Learner, autocast_policy
from maniskill_grpd.learning.value_scale import ValueScale

CONFIG = TrainConfig(num_envs=8, num_steps=7, num_minibatches=4, total_timesteps=56, update_epochs=1)


def collect(policy, env=None, scale=None):
    collector = Collector(env or ToyEnv(8, max_steps=5, stagger=True), 7)
    collector.reset(list(range(8)))
    generator = torch.Generator().manual_seed(0)
    rollout, episodes = collector.collect(policy, scale or ValueScale(), generator, "in a test")
    rollout.advantages = torch.randn(7, 8, generator=generator)
    rollout.returns = torch.randn(7, 8, generator=generator)
    return rollout, episodes


def make_learner(policy, config=CONFIG):
    return Learner(
        policy=policy,
        optimizer=torch.optim.Adam(policy.parameters(), lr=1e-3),
        value_scale=ValueScale(),
        config=config,
        generator=torch.Generator().manual_seed(0),
    )


def run_update(policy, rollout, config=CONFIG, algorithm=None):
    return (algorithm or ALGORITHMS[config.algorithm].from_config(config)).update(make_learner(policy, config), rollout)


def test_a_rollout_holds_what_the_environment_gave():
    """Replaying the stored actions gives the stored observations, rewards and ends."""
    policy = ToyPolicy()
    rollout, _ = collect(policy)
    env = ToyEnv(8, max_steps=5, stagger=True)
    obs, _ = env.reset(list(range(8)))
    for step in range(7):
        for name, stored in graph_items(rollout.graph):
            assert torch.equal(stored[step], dict(graph_items(obs["graph"]))[name]), name
        dist, value = policy(obs["graph"])
        assert torch.equal(rollout.distribution.mean[step], dist.mean)
        assert torch.equal(rollout.values[step], value)
        obs, reward, _, truncated, info = env.step(rollout.actions[step])
        assert torch.equal(rollout.rewards[step], reward)
        assert torch.equal(rollout.truncated[step], truncated)
        if truncated.any():
            final = policy.value(info["final_observation"]["graph"])
            torch.testing.assert_close(rollout.final_values[step][truncated], final[truncated])
    assert torch.equal(rollout.next_value, policy.value(obs["graph"]))


def test_episode_metrics_are_means_over_ended_episodes():
    _, episodes = collect(ToyPolicy())
    assert episodes["episode_len"] == 5.0
    assert set(episodes) >= {"return", "success_once", "success_at_end", "mean_distance"}


def test_select_gathers_matching_rows():
    rollout, _ = collect(ToyPolicy())
    batch = rollout.select(torch.tensor([9, 0]))  # (step 1, env 1) and (step 0, env 0)
    assert torch.equal(batch.actions, torch.stack([rollout.actions[1, 1], rollout.actions[0, 0]]))
    assert torch.equal(batch.graph["object"]["vectors"][0], rollout.graph["object"]["vectors"][1, 1])
    assert torch.equal(batch.graph["object"]["neighbors"][0], rollout.graph["object"]["neighbors"][1, 1])


def test_a_graph_that_changes_its_shape_is_refused():
    rollout, _ = collect(ToyPolicy())
    graph = ToyEnv(8, num_actuators=3).reset(list(range(8)))[0]["graph"]
    with pytest.raises(ValueError, match=r"object.position must stay \(8, 2, 3\), got \(8, 3, 3\)"):
        rollout.store_graph(0, graph)


class RatioProbe(FirstOrderAlgorithm):
    """An algorithm that notes the probability ratio of every minibatch and leaves the policy alone."""

    def __init__(self):
        super().__init__(ent_coef=0.0)
        self.ratios = []

    @classmethod
    def from_config(cls, config):
        """Not built from a config."""
        raise NotImplementedError

    def diagnose(self, dist, projected, batch):
        """Report nothing more."""
        return {}

    def policy_loss(self, dist, projected, batch):
        """Note the ratios."""
        self.ratios.append((dist.log_prob(batch.actions) - batch.log_probs).exp().detach())
        zero = 0.0 * dist.mean.sum()
        return zero, {"policy_loss": zero.detach()}


def test_a_probe_sees_every_transition_once_per_epoch_with_ratio_one():
    policy = ToyPolicy()
    rollout, _ = collect(policy)
    probe = RatioProbe()
    config = TrainConfig(**{**CONFIG.to_dict(), "vf_coef": 0.0, "update_epochs": 1, "env_kwargs": ()})
    run_update(policy, rollout, config, probe)
    ratios = torch.cat(probe.ratios)
    assert ratios.shape == (56,)
    torch.testing.assert_close(ratios, torch.ones(56), rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["bpp", "ppo"])
def test_chunks_change_the_memory_not_the_update(name):
    results = []
    for chunk_size in (0, 3):
        policy = ToyPolicy()
        rollout, _ = collect(policy)
        fields = {**CONFIG.to_dict(), "chunk_size": chunk_size, "algorithm": name}
        metrics = run_update(policy, rollout, TrainConfig.from_dict(fields))
        results.append((policy.state_dict(), metrics))
    torch.testing.assert_close(results[0][0], results[1][0], rtol=1e-4, atol=1e-6)
    for key, value in results[0][1].items():
        assert results[1][1][key] == pytest.approx(value, rel=1e-3, abs=1e-5), key


def test_an_update_stops_at_target_kl():
    policy = ToyPolicy()
    rollout, _ = collect(policy)
    fields = {**CONFIG.to_dict(), "target_kl": 1e-9, "update_epochs": 50}
    before = policy.log_std.item()
    run_update(policy, rollout, TrainConfig.from_dict(fields))
    # Adam moves by its step size per minibatch: the KL is 0 in the first and seen in the second.
    assert abs(policy.log_std.item() - before) < 3e-3


def test_a_non_finite_gradient_stops_before_the_step():
    policy = ToyPolicy()
    rollout, _ = collect(policy)
    rollout.returns[3, 3] = torch.inf
    before = {key: value.clone() for key, value in policy.state_dict().items()}
    fields = {**CONFIG.to_dict(), "num_minibatches": 1}
    with pytest.raises(NonFiniteError, match=r"minibatch 0: non-finite losses \['value_loss'\]"):
        run_update(policy, rollout, TrainConfig.from_dict(fields))
    torch.testing.assert_close(policy.state_dict(), before, rtol=0, atol=0)


def test_value_scale_follows_recent_returns():
    scale = ValueScale(decay=0.5)
    assert (scale.mean, scale.std) == (0.0, 1.0)
    scale.update(torch.tensor([1.0, 3.0]))
    assert (scale.mean, scale.std) == pytest.approx((2.0, 1.0))
    for _ in range(60):
        scale.update(torch.tensor([40.0, 60.0]))
    assert (scale.mean, scale.std) == pytest.approx((50.0, 10.0))
    values = torch.randn(5)
    torch.testing.assert_close(scale.normalize(scale.denormalize(values)), values)
    restored = ValueScale(decay=0.5)
    restored.load_state_dict(scale.state_dict())
    assert (restored.mean, restored.std) == (scale.mean, scale.std)


def test_values_stay_what_they_are_when_their_scale_moves():
    """PopArt: the network's outputs change, what they stand for does not; without the correction values move by nats of std."""
    policy, scale = ToyPolicy(), ValueScale(decay=0.5)
    rollout, _ = collect(policy)
    graph = rollout.flat_graph()
    scale.adapt(policy, torch.tensor([1.0, 3.0]))
    before = scale.denormalize(policy.value(graph)).detach()
    other, uncorrected = copy.deepcopy(policy), copy.deepcopy(scale)
    scale.adapt(policy, torch.tensor([40.0, 60.0]))
    uncorrected.update(torch.tensor([40.0, 60.0]))
    assert scale.mean == uncorrected.mean > 20.0
    torch.testing.assert_close(scale.denormalize(policy.value(graph)).detach(), before, rtol=1e-5, atol=1e-4)
    assert (uncorrected.denormalize(other.value(graph)) - before).abs().min() > 10.0


def test_value_scale_of_constant_returns_is_finite():
    scale = ValueScale()
    scale.update(torch.full((10,), 3.0))
    assert torch.isfinite(scale.normalize(torch.tensor([3.0, 4.0]))).all()


@pytest.mark.slow
def test_a_compiled_policy_learns_the_same():
    results = []
    for compile_policy in (False, True):
        policy = ToyPolicy()
        rollout, _ = collect(policy)
        fields = {**CONFIG.to_dict(), "compile": compile_policy, "update_epochs": 2}
        run_update(policy, rollout, TrainConfig.from_dict(fields))
        results.append(policy.state_dict())
    torch.testing.assert_close(results[0], results[1], rtol=1e-4, atol=1e-6)


def test_bfloat16_products_leave_float32_results_and_ratios_near_one():
    """What CUDA does with --amp, on the processor: its results are float32, its errors those of bfloat16."""
    policy = ToyPolicy(gripper=True)
    rollout, _ = collect(policy, ToyEnv(8, max_steps=5, stagger=True, gripper=True))
    batch = rollout.select(torch.arange(56))
    exact, _ = policy(batch.graph)
    dist, values = autocast_policy(policy, batch.graph, enabled=True)
    assert {t.dtype for t in (dist.mean, dist.std, dist.gripper_logits, values)} == {torch.float32}
    assert not torch.equal(dist.gripper_logits, exact.gripper_logits)
    torch.testing.assert_close(dist.log_prob(batch.actions), batch.log_probs, rtol=0.02, atol=0.05)


def test_preparing_once_and_in_every_pass_gives_the_same_update(monkeypatch):
    """Rollouts too large to keep prepared are prepared chunk by chunk, with the same weights in the end."""
    weights = []
    for limit in (2**29, 0):
        monkeypatch.setattr("maniskill_grpd.learning.update._LARGEST_PREPARED", limit)
        policy = ToyPolicy()
        rollout, _ = collect(policy)
        assert make_learner(policy).prepare(rollout).is_prepared == (limit > 0)
        run_update(policy, rollout)
        weights.append(policy.state_dict())
    assert all(torch.equal(tensor, weights[1][name]) for name, tensor in weights[0].items())
