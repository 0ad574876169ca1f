"""Pictures of what policies look at, from fresh checkpoints."""

import gymnasium as gym
import imageio.v2 as imageio
import pytest
import torch

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import inspect
from maniskill_grpd.imitation.clone_config import CloneConfig
from maniskill_grpd.imitation.cloning import save_clone
from maniskill_grpd.policies import POLICIES, make_policy
from maniskill_grpd.runs.inspection import describe_spread, node_contribution, node_sensitivity, principal_components

OPTIONS = {"graph_nodes": 7, "resolution": 20, "num_grippers": 2}


@pytest.fixture(scope="module")
def scene():
    """Return the schema and a graph of the task, half way through a motion."""
    env = gym.make("RopeShaping-v1", num_envs=1, sim_backend="cpu", render_backend="none", **OPTIONS)
    env.reset(seed=0)
    for _ in range(5):
        obs, *_ = env.step(torch.tensor([[0.0, 0.5, 0.5, 0.5, 0.0, 0.0]]))
    env.close()
    return env.unwrapped.graph_schema, obs["graph"]


def fresh(name, schema):
    """An untrained policy whose decoder is not almost zero."""
    torch.manual_seed(0)
    return make_policy(name, schema)


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_pictures_of_a_fresh_checkpoint(name, scene, tmp_path, capsys):
    schema, _ = scene
    config = CloneConfig(env_kwargs=tuple(f"{k}={v}" for k, v in OPTIONS.items()))
    save_clone(tmp_path / "a.pt", fresh(name, schema), config, num_observations=1)
    arguments = ["--checkpoint", str(tmp_path / "a.pt"), "--steps", "0", "500"]
    assert inspect.main([*arguments, "--output", str(tmp_path / "pictures")]) == 0
    printed = capsys.readouterr().out
    assert "step   0" in printed
    assert "step  99" in printed  # the last one, for want of a step 500
    for picture in ("sensitivity", "contribution", "embedding"):
        image = imageio.imread(tmp_path / "pictures" / f"{picture}.png")
        assert image.std() > 5.0


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_sensitivity_is_the_slope_of_the_action(name, scene):
    """Central differences, the node moved and its goal left where it is."""
    schema, graph = scene
    policy, graph = fresh(name, schema).double(), _double(graph)
    sensitivity = node_sensitivity(policy, graph)
    node, step = 2, 1e-6
    columns = []
    for axis in range(3):
        means = []
        for sign in (1.0, -1.0):
            position = graph["object"]["position"].clone()
            position[0, node, axis] += sign * step
            goal = graph["object"]["position"] + graph["object"]["vectors"][:, :, 1]
            vectors, scalars = (graph["object"][key].clone() for key in ("vectors", "scalars"))
            vectors[:, :, 1] = goal - position
            scalars[:, :, 0] = (goal - position).norm(dim=-1)
            nodes = {"position": position, "vectors": vectors, "scalars": scalars}
            moved = {**graph, "object": {**graph["object"], **nodes}}
            means.append(policy.distribution(moved).mean[0])
        columns.append((means[0] - means[1]) / (2.0 * step))
    expected = torch.stack(columns).square().sum(dim=(0, 2)).sqrt()
    torch.testing.assert_close(sensitivity[:, node], expected.detach(), rtol=1e-4, atol=1e-9)


def test_channels_the_test_relies_on(scene):
    schema, _ = scene
    assert schema.object.vectors[1].name == "goal_offset"
    assert schema.object.scalars[0].name == "goal_distance"


def test_contribution_is_the_change_without_the_node(scene):
    schema, graph = scene
    policy = fresh("grpd", schema)
    contribution = node_contribution(policy, graph)
    mask = graph["object"]["mask"].clone()
    mask[0, 3] = False
    without = policy.distribution({**graph, "object": {**graph["object"], "mask": mask}}).mean
    expected = (without - policy.distribution(graph).mean)[0].norm(dim=-1)
    torch.testing.assert_close(contribution[:, 3], expected.detach(), rtol=1e-4, atol=1e-7)


def test_every_node_counts_for_grpd(scene):
    """Complete edges from objects to actuators (eq. 11, 47)."""
    schema, graph = scene
    policy = fresh("grpd", schema)
    assert (node_sensitivity(policy, graph) > 0.0).all()
    assert (node_contribution(policy, graph) > 0.0).all()


def test_a_masked_node_has_no_influence(scene):
    """Negative control of both measures."""
    schema, graph = scene
    mask = graph["object"]["mask"].clone()
    mask[0, 3] = False
    masked = {**graph, "object": {**graph["object"], "mask": mask}}
    policy = fresh("grpd", schema)
    assert (node_sensitivity(policy, masked)[:, 3] == 0.0).all()
    assert (node_contribution(policy, masked)[:, 3] < 1e-6).all()


def test_principal_components_of_a_plane():
    """Points of a plane in 5 dimensions: two components hold everything, distances are kept."""
    generator = torch.Generator().manual_seed(0)
    frame = torch.linalg.qr(torch.randn(5, 2, generator=generator, dtype=torch.float64))[0]
    plane = torch.randn(30, 2, generator=generator, dtype=torch.float64) * torch.tensor([3.0, 1.0])
    points, share = principal_components(plane @ frame.T + 1.0)
    assert share.sum().item() == pytest.approx(1.0)
    torch.testing.assert_close(torch.cdist(points, points), torch.cdist(plane, plane))


def test_influence_of_one_node_is_described():
    spread = describe_spread(torch.eye(4)[:1], torch.ones(1, 4))
    assert "sensitivity: 1.0 of 4" in spread
    assert "contribution: 4.0 of 4" in spread


def test_mistakes_are_one_line(capsys):
    assert inspect.main(["--checkpoint", "none.pt"]) == 1
    assert "no checkpoint at none.pt" in capsys.readouterr().err
    assert inspect.main(["--checkpoint", "none.pt", "--steps", "-1"]) == 2
    assert "steps must be" in capsys.readouterr().err


def _double(tree):
    if isinstance(tree, dict):
        return {key: _double(value) for key, value in tree.items()}
    return tree.double() if tree.is_floating_point() else tree
