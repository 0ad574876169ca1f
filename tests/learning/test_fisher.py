"""Natural-gradient updates: Fisher products, conjugate gradients, line search on the true KL."""

import pytest
import torch
from test_update import CONFIG, collect, make_learner
from toy_env import ToyEnv, ToyPolicy

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.algorithm import ALGORITHMS
from maniskill_grpd.learning.fisher import conjugate_gradient, fisher_product, split_parameters

EVERY = torch.arange(56)


def fisher_config(**options):
    return TrainConfig.from_dict({**CONFIG.to_dict(), "trust_region": "fisher", **options})


def test_the_fisher_product_is_the_mean_outer_product_of_scores():
    policy = ToyPolicy().double()
    learner = make_learner(policy, fisher_config())
    rollout, _ = collect(ToyPolicy())
    batch = rollout.select(EVERY).map(lambda t: t.double() if t.is_floating_point() else t)
    actor, _ = split_parameters(learner, batch)
    log_probs = policy(batch.graph)[0].log_prob(batch.actions)
    scores = torch.stack(
        [torch.cat([g.reshape(-1) for g in torch.autograd.grad(p, actor, retain_graph=True)]) for p in log_probs]
    )
    vector = torch.randn(scores.shape[1], dtype=torch.float64)
    expected = scores.T @ (scores @ vector) / len(scores)
    torch.testing.assert_close(fisher_product(learner, batch, actor, vector), expected)


def test_conjugate_gradients_solve_a_positive_definite_system():
    torch.manual_seed(0)
    root = torch.randn(8, 8, dtype=torch.float64)
    matrix = root @ root.T + torch.eye(8, dtype=torch.float64)
    target = torch.randn(8, dtype=torch.float64)
    solution = conjugate_gradient(lambda v: matrix @ v, target)
    torch.testing.assert_close(solution, torch.linalg.solve(matrix, target), rtol=1e-3, atol=1e-5)


def test_only_weights_that_the_policy_does_not_use_are_left_to_the_value_function():
    policy = ToyPolicy()
    rollout, _ = collect(policy)
    learner = make_learner(policy, fisher_config())
    actor, critic = split_parameters(learner, rollout.select(EVERY))
    names = {id(parameter): name for name, parameter in policy.named_parameters()}
    assert {names[id(p)].split(".")[0] for p in critic} == {"critic"}
    assert {names[id(p)].split(".")[0] for p in actor} == {"trunk", "mean", "log_std"}


@pytest.mark.parametrize("gripper", [False, True])
@pytest.mark.parametrize("bound", [1e-4, 0.02, 10.0])
def test_the_step_honours_every_bound_on_the_true_kl(bound, gripper):
    """Also where the quadratic model is far off: a bound of 10 nats is no small step."""
    policy = ToyPolicy(gripper=gripper)
    rollout, _ = collect(policy, ToyEnv(8, max_steps=5, stagger=True, gripper=gripper))
    config = fisher_config(mean_bound=bound, cov_bound=bound / 10, gripper_bound=bound / 10)
    metrics = ALGORITHMS[config.algorithm].from_config(config).update(make_learner(policy, config), rollout)
    assert metrics["step_size"] > 0.0
    batch = rollout.select(EVERY)
    dist, _ = policy(batch.graph)
    parts = dist.kl_parts(batch.old)
    assert 0.0 < parts.total.mean().item() == pytest.approx(metrics["kl_raw"], rel=1e-3)
    assert parts.mean.mean() <= bound * 1.0001
    assert parts.cov.mean() <= bound / 10 * 1.0001
    assert parts.gripper.mean() <= bound / 10 * 1.0001
    ratio = (dist.log_prob(batch.actions) - batch.log_probs).exp()
    advantages = batch.advantages
    advantages = (advantages - advantages.mean()) / advantages.std()
    assert (ratio * advantages).mean() > 0.0


def test_without_an_improving_step_the_policy_stays_bitwise():
    policy = ToyPolicy()
    rollout, _ = collect(policy)
    rollout.advantages = torch.zeros(7, 8)
    config = fisher_config(norm_adv=False)
    before = {k: v.clone() for k, v in policy.state_dict().items() if not k.startswith("critic")}
    metrics = ALGORITHMS[config.algorithm].from_config(config).update(make_learner(policy, config), rollout)
    assert metrics["step_size"] == 0.0
    for name, value in before.items():
        assert torch.equal(policy.state_dict()[name], value), name
