"""Where policies look, on influences and features that are known."""

import json

import gymnasium as gym
import pytest
import torch

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import main
from maniskill_grpd.imitation.clone_config import CloneConfig
from maniskill_grpd.imitation.cloning import save_clone
from maniskill_grpd.policies import make_policy
from maniskill_grpd.runs.interpretation import alikeness, look, node_groups, relative_share

OPTIONS = {"graph_nodes": 16, "resolution": 49}


@pytest.fixture(scope="module")
def fold():
    """Return schema and first graph of a cloth that is to be folded."""
    env = gym.make("ClothFolding-v1", num_envs=1, obs_mode="graph", sim_backend="cpu", render_backend="none", **OPTIONS)
    obs, _ = env.reset(seed=0)
    env.close()
    return env.unwrapped.graph_schema, obs["graph"]


def test_a_share_is_that_of_a_node_over_an_average_node():
    influence = torch.tensor([[4.0, 2.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
    members = torch.tensor([[True, True, False, False], [False, False, True, True]])
    # (4 + 2) / 2 over (8 / 4), and 1 over 1
    assert relative_share(influence, members) == pytest.approx((1.5 + 1.0) / 2)


def test_clusters_are_closer_to_each_other_than_to_the_rest():
    features = torch.randn(40, 5, generator=torch.Generator().manual_seed(0))
    members = torch.arange(40) < 10
    assert alikeness(features, members) == pytest.approx(1.0, abs=0.15)  # drawn alike
    features[members] += 5.0
    assert alikeness(features, members) < 0.5


def test_groups_of_a_cloth_are_where_they_should_be(fold):
    schema, graph = fold
    groups = node_groups(schema, graph)
    assert set(groups) == {"corners", "held", "fold line", "near the gripper"}
    position, tools = graph["object"]["position"][0], graph["actuator"]["position"][0]
    assert groups["held"].sum(dim=1).tolist() == [2, 2]
    for gripper, tool in enumerate(tools):
        distance = (position - tool).norm(dim=-1)
        near = groups["near the gripper"][gripper]
        assert int(near.sum()) == 4
        assert distance[near].max() <= distance[~near].min()
    # Nodes along the crease are nearer to it than the farthest others: their offset across it is small.
    line = groups["fold line"][0]
    assert 2 <= int(line.sum()) < len(line)
    moving = graph["object"]["scalars"][0, :, [channel.name for channel in schema.object.scalars].index("is_moving")] > 0.5
    assert bool(moving[line].any())
    assert bool((~moving[line]).any())


def test_a_policy_that_does_not_hear_the_object_looks_nowhere(fold):
    schema, graph = fold
    torch.manual_seed(0)
    deaf, hearing = (look(make_policy("grpd", schema, object_messages=is_heard), graph) for is_heard in (False, True))
    assert all(shares["sensitivity"] == 0.0 for shares in deaf.shares.values())
    assert all(shares["sensitivity"] > 0.0 for shares in hearing.shares.values())
    assert 1.0 < hearing.effective_nodes <= hearing.nodes == 16


def test_a_page_with_pictures_comes_out(fold, tmp_path, capsys):
    schema, _ = fold
    torch.manual_seed(0)
    config = CloneConfig(env_id="ClothFolding-v1", env_kwargs=tuple(f"{k}={v}" for k, v in OPTIONS.items()))
    save_clone(tmp_path / "fold.pt", make_policy("grpd", schema), config, num_observations=1)
    words = ["--checkpoint", str(tmp_path / "fold.pt"), "--output", str(tmp_path), "--num_episodes", "1", "--steps", "0", "3"]
    assert main(["interpret", *words]) == 0
    text = (tmp_path / "interpretation.md").read_text()
    assert "| fold line | " in text
    rows = json.loads((tmp_path / "interpretation.json").read_text())
    assert [row["weights"] for row in rows] == ["trained", "untrained"]
    for kind in ("sensitivity", "contribution", "embedding"):
        assert (tmp_path / "interpretation_fold" / f"{kind}.png").exists()
    assert "page: " in capsys.readouterr().out


def test_nothing_to_look_at_is_refused(tmp_path, capsys):
    assert main(["interpret", "--checkpoint", "a.pt", "--steps", "-1"]) == 2
    assert "steps >= 0" in capsys.readouterr().err
