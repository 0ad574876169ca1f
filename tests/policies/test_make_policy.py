"""Building policies by name, and what every policy offers."""

import dataclasses
import json

import pytest
import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.policies import POLICIES, Policy, make_policy, policy_from_config

NAMES = sorted(POLICIES)


def test_unknown_name_lists_the_known():
    with pytest.raises(ValueError, match="'grpd'"):
        make_policy("gprd", SCHEMA)


def test_unknown_option_lists_the_known_with_types_and_defaults():
    with pytest.raises(ValueError, match=r"unknown option 'hidden'(.|\n)*scalar_dim: int = 32"):
        make_policy("grpd", SCHEMA, hidden=3)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("scalar_dim", 2.5, "must be int"),
        ("num_layers", True, "must be int"),
        ("state_dependent_std", 1, "must be bool"),
        ("magnitude", "exp", "'sigmoid', 'softplus', 'relu'"),
        ("init_std", "0.5", "must be float"),
        ("scalar_dim", 0, "at least 1"),
        ("num_layers", -1, "negative"),
        ("max_degree", 3, "1 or 2"),
        ("max_local_degree", 0, "1 or 2"),
        ("decoder", "mlp", "'direction_magnitude', 'naive'"),
        ("decoders", "both", "'shared', 'independent'"),
        ("num_decoders", 0, "at least 1"),
        ("gripper", 1, "must be bool"),
        ("init_std", 5.0, "inside"),
    ],
)
def test_bad_option_values_are_refused(option, value, message):
    with pytest.raises(ValueError, match=message):
        make_policy("grpd", SCHEMA, **{option: value})


@pytest.mark.parametrize("name", NAMES)
def test_config_rebuilds_the_policy(name):
    """Through JSON, then the state dict, normaliser included: the same actions."""
    policy = make_policy(name, SCHEMA, init_std=0.25)
    graph = make_graph()
    policy.normalizer.update(graph)
    rebuilt = policy_from_config(json.loads(json.dumps(policy.config)))
    rebuilt.load_state_dict(policy.state_dict())
    assert rebuilt.config == policy.config
    assert isinstance(rebuilt.schema, GraphSchema)
    assert torch.equal(rebuilt.act(graph, deterministic=True), policy.act(graph, deterministic=True))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("nodes", "actuators"), [(1, 1), (7, 2), (60, 6)])
def test_any_number_of_nodes_and_actuators(name, nodes, actuators):
    policy = make_policy(name, SCHEMA)
    graph = make_graph(3, nodes, actuators)
    distribution, value = policy(graph)
    assert isinstance(policy, Policy)
    assert distribution.mean.shape == (3, actuators, 3)
    assert distribution.std.shape == (3, actuators, 1)
    assert distribution.mask.shape == (3, actuators)
    assert value.shape == (3,)


@pytest.mark.parametrize("name", NAMES)
def test_methods_agree_with_the_shared_pass(name):
    policy = make_policy(name, SCHEMA)
    graph = make_graph()
    distribution, value = policy(graph)
    assert torch.equal(policy.distribution(graph).mean, distribution.mean)
    assert torch.equal(policy.value(graph), value)
    assert torch.equal(policy.act(graph, deterministic=True), distribution.mode)


@pytest.mark.parametrize("name", NAMES)
def test_act_samples_float32_from_the_generator(name):
    policy = make_policy(name, SCHEMA).double()
    graph = make_graph(dtype=torch.float64)
    first, second = (policy.act(graph, generator=torch.Generator().manual_seed(1)) for _ in range(2))
    assert first.shape == (4, 9)
    assert first.dtype == torch.float32
    assert not first.requires_grad
    assert torch.equal(first, second)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, {"gripper": True}) for name in NAMES),
        *((name, {"decoders": "independent", "num_decoders": 3}) for name in NAMES),
        ("grpd", {"num_layers": 2, "max_degree": 2, "num_local_radial": 2}),
        ("grpd", {"state_dependent_std": False, "value_encoder": "separate", "magnitude": "relu"}),
        ("grpd", {"decoder": "naive", "max_local_degree": 2, "normalize_vectors": True}),
        ("empn", {"max_degree": 2, "normalize_vectors": True}),
    ],
    ids=str,
)
def test_gradient_reaches_all_parameters(name, options):
    policy = make_policy(name, SCHEMA, **options)
    graph = make_graph(16)
    distribution, value = policy(graph)
    action = distribution.sample()
    loss = distribution.log_prob(action).sum() + value.square().sum()
    loss.backward()
    silent = [
        name for name, parameter in policy.named_parameters() if parameter.grad is None or not parameter.grad.abs().sum() > 0
    ]
    assert not silent


@pytest.mark.parametrize("state_dependent", [True, False])
def test_untrained_policy_moves_gently_and_explores_as_told(state_dependent):
    policy = make_policy("grpd", SCHEMA, init_std=0.3, state_dependent_std=state_dependent)
    graph = make_graph(64)
    policy.normalizer.update(graph)
    distribution = policy.distribution(graph)
    magnitude = distribution.mean.detach().norm(dim=-1)
    assert 0.05 < float(magnitude.mean()) < 0.2
    torch.testing.assert_close(distribution.std, torch.full_like(distribution.std, 0.3), rtol=0.05, atol=0)


@pytest.mark.parametrize(
    ("name", "options"),
    [*((name, {}) for name in NAMES), ("grpd", {"decoder": "naive"}), ("empn", {"decoder": "naive"})],
    ids=str,
)
def test_mean_actions_are_bounded_by_norm_unless_told_otherwise(name, options):
    """With weights a hundred times as large: 1.2 by default, whatever the decoder; far beyond with softplus."""
    lengths = {}
    for magnitude in ("sigmoid", "softplus"):
        torch.manual_seed(0)
        policy = make_policy(name, SCHEMA, magnitude=magnitude, **options)
        with torch.no_grad():
            for parameter in policy.mean.parameters():
                parameter.mul_(100.0)
            if hasattr(policy.mean, "length"):
                policy.mean.length.bias.abs_()
        lengths[magnitude] = policy.distribution(make_graph()).mean.norm(dim=-1).max().item()
    assert 0.6 < lengths["sigmoid"] <= 1.2 * (1 + 1e-6)
    assert lengths["softplus"] > 2.4


@pytest.mark.parametrize("name", NAMES)
def test_values_are_rescaled_without_touching_the_actions(name):
    policy, graph = make_policy(name, SCHEMA, value_encoder="separate").double(), make_graph(dtype=torch.float64)
    before, action = policy.value(graph).detach(), policy.act(graph, deterministic=True)
    policy.rescale_value(0.25, -3.0)
    torch.testing.assert_close(policy.value(graph).detach(), 0.25 * before - 3.0)
    assert torch.equal(policy.act(graph, deterministic=True), action)


@pytest.mark.parametrize("name", NAMES)
def test_traces_as_one_graph(name):
    """No control flow depends on data, so that torch.compile can fuse the whole pass."""
    policy = make_policy(name, SCHEMA, num_layers=1)
    graph = make_graph()
    compiled = torch.compile(lambda g: policy(g)[1], fullgraph=True, backend="eager")
    torch.testing.assert_close(compiled(graph), policy.value(graph))


@pytest.mark.parametrize("name", NAMES)
def test_all_tensors_follow_the_device_of_the_graph(name):
    """On the meta device, which refuses any tensor made on the CPU, forward and backward."""

    def to_meta(graph):
        return {k: to_meta(v) if isinstance(v, dict) else v.to("meta") for k, v in graph.items()}

    policy = make_policy(name, SCHEMA, gripper=True).to("meta")
    distribution, value = policy(to_meta(make_graph(nodes=20)))
    action = distribution.sample()
    loss = distribution.log_prob(action) + value + distribution.kl_parts(distribution).total
    (loss + distribution.entropy()).sum().backward()
    assert action.device.type == distribution.mode.device.type == "meta"


def num_parameters(policy):
    return sum(parameter.numel() for parameter in policy.parameters())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("options", [{}, {"gripper": True}, {"value_encoder": "separate"}], ids=str)
def test_policies_have_the_same_parameter_budget(name, options):
    """Within 10 % of `grpd`, so that a comparison is not one of sizes."""
    budget = num_parameters(make_policy("grpd", SCHEMA, **options))
    assert abs(num_parameters(make_policy(name, SCHEMA, **options)) / budget - 1.0) < 0.1


@pytest.mark.parametrize("name", NAMES)
def test_policies_have_the_same_value_function(name):
    critics = [make_policy(n, SCHEMA).critic for n in ("grpd", name)]
    assert type(critics[0]) is type(critics[1])
    assert len(critics[0].inner) == len(critics[1].inner) == 2


@pytest.mark.parametrize("name", NAMES)
def test_gripper_adds_a_fourth_entry_per_actuator(name):
    """Order (x, y, z, g) per actuator; g is 0 or 1, sampled with the stated probability."""
    policy = make_policy(name, SCHEMA, gripper=True)
    graph = make_graph(5)
    distribution, value = policy(graph)
    assert value.shape == (5,)
    assert distribution.gripper_logits.shape == (5, 3)
    action = policy.act(graph, deterministic=True).view(5, 3, 4)
    assert torch.equal(action[..., :3], distribution.mean)
    assert torch.equal(action[..., 3], (distribution.gripper_logits > 0).float())
    sample = policy.act(graph).view(5, 3, 4)[..., 3]
    assert ((sample == 0) | (sample == 1)).all()
    assert distribution.log_prob(action.flatten(1)).shape == (5,)


@pytest.mark.parametrize("name", NAMES)
def test_independent_decoders_refuse_more_actuators_than_they_are(name):
    policy = make_policy(name, SCHEMA, decoders="independent", num_decoders=2)
    assert policy.act(make_graph(actuators=1)).shape == (4, 3)
    with pytest.raises(ValueError, match=r"decoders for 2 actuators .*num_decoders.* has 3"):
        policy.act(make_graph(actuators=3))


def test_a_config_names_every_option_and_rebuilds_the_policy():
    chosen = make_policy("grpd", SCHEMA, decoder="naive", gripper=True)
    assert set(chosen.config["options"]) == {field.name for field in dataclasses.fields(POLICIES["grpd"].Options)}
    assert chosen.config["options"]["decoder"] == "naive"
    rebuilt = policy_from_config(json.loads(json.dumps(chosen.config)))
    assert rebuilt.config == chosen.config
    rebuilt.load_state_dict(chosen.state_dict())


def test_heads_must_divide_the_width():
    with pytest.raises(ValueError, match=r"multiple of num_heads \(5\), got 48"):
        make_policy("transformer", SCHEMA, num_heads=5)


@pytest.mark.parametrize("name", NAMES)
def test_wrong_graph_is_refused_by_name(name):
    policy = make_policy(name, SCHEMA)
    graph = make_graph()
    graph["object"]["scalars"] = graph["object"]["scalars"][..., :2]
    with pytest.raises(ValueError, match=r"object.scalars must have shape \(4, 12, 4\), got \(4, 12, 2\)"):
        policy.value(graph)


def test_learns_to_point_at_the_goal_to_a_centimetre():
    """Regression on the clipped offset to the goal, over offsets from 1 cm to 1 m.

    The error is relative to the length of the target plus a tenth of the largest step, so that
    being right far away does not pay for being wrong near the goal.
    """
    torch.manual_seed(0)
    policy = make_policy("grpd", SCHEMA)
    optimizer = torch.optim.Adam(policy.parameters(), 5e-3)

    def batch(seed):
        graph = make_graph(64, 6, 2, seed=seed)
        size = 0.01 ** torch.rand(64, 1, 1, generator=torch.Generator().manual_seed(seed))
        offset = graph["actuator"]["vectors"][:, :, 1]
        offset.mul_(size / offset.norm(dim=-1, keepdim=True))
        return graph, offset / offset.norm(dim=-1, keepdim=True).clamp(min=0.03)

    def error(seed):
        graph, target = batch(seed)
        scale = target.norm(dim=-1) + 0.1
        return ((policy.distribution(graph).mean - target).norm(dim=-1) / scale).mean()

    policy.normalizer.update(batch(0)[0])
    for step in range(150):
        optimizer.zero_grad()
        error(step).backward()
        optimizer.step()
    with torch.no_grad():
        assert error(10_000) < 0.15
