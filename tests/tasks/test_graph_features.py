"""What grippers tell: themselves alone, as in the paper, or the goal and summaries too."""

import gc

import gymnasium as gym
import pytest
import torch

from maniskill_grpd.learning import CheckpointError
from maniskill_grpd.policies import make_policy
from maniskill_grpd.runs.checkpoints import check_schema

GOALS = {
    "RopeWrapping-v1": lambda base: [base.solver.collider_positions, base.solver.collider_rotations],
    "RopeShaping-v1": lambda base: [base.goal_positions],
    "ClothFolding-v1": lambda base: [base.goal_positions, base.crease_normal],
    "ClothHanging-v1": lambda base: [base.hanger_point, base.hanger_axis],
}
"""The tensors that hold the goal of a world, by task."""


@pytest.fixture
def make_task(monkeypatch):
    """Return a function that makes a task of four worlds after their reset; closes all of them."""
    monkeypatch.setattr(gc, "collect", lambda: 0)
    made = []

    def make(env_id, **options):
        env = gym.make(env_id, num_envs=4, sim_backend="cpu", render_backend="none", **options)
        env.reset(seed=0)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()


def graphs_of_two_goals(base, move_goals):
    """The graph of a scene, and of the same scene in which every world has the goal of another."""
    before = base.get_obs()["graph"]
    for goal in move_goals(base):
        goal.copy_(goal.roll(1, dims=0))
    base.forget_measurement()
    return before, base.get_obs()["graph"]


def actions(env_id, env, graphs, *, masked):
    """Mean actions of one untrained policy on several graphs, with all object nodes masked or with none."""
    torch.manual_seed(0)
    policy = make_policy("grpd", env.unwrapped.graph_schema)
    policy.normalizer.update(graphs[0])
    seen = [{**graph, "object": graph["object"] | {"mask": graph["object"]["mask"] & (not masked)}} for graph in graphs]
    with torch.no_grad():
        return [policy.distribution(graph).mean for graph in seen]


@pytest.mark.parametrize("env_id", GOALS)
def test_the_goal_reaches_the_action_through_object_nodes_alone(env_id, make_task):
    """Without them the action is bitwise the same for another goal; with them, or with rich features, it is not."""
    for features, masked in (("paper", True), ("paper", False), ("rich", True)):
        env = make_task(env_id, graph_features=features)
        graphs = graphs_of_two_goals(env.unwrapped, GOALS[env_id])
        first, second = actions(env_id, env, graphs, masked=masked)
        if (features, masked) == ("paper", True):
            assert torch.equal(first, second)
        else:
            assert ((first - second).norm(dim=(1, 2)) > 1e-4).all(), (features, masked)


@pytest.mark.parametrize("env_id", GOALS)
def test_grippers_of_the_paper_tell_velocity_and_status(env_id, make_task):
    """Eq. 43: position and type are there without a channel. The rich graph differs in the grippers alone."""
    paper, rich = (make_task(env_id, graph_features=features).unwrapped.graph_schema for features in ("paper", "rich"))
    assert [channel.name for channel in paper.actuator.vectors] == ["velocity"]
    assert [channel.name for channel in paper.actuator.scalars] == ["gripper_status"]
    assert paper.object == rich.object
    assert set(paper.actuator.vectors) < set(rich.actuator.vectors)
    assert make_task(env_id).unwrapped.graph_schema == paper


def test_a_policy_of_one_graph_is_refused_the_other(make_task):
    policies = {}
    for features in ("paper", "rich"):
        policies[features] = make_policy("grpd", make_task("ClothHanging-v1", graph_features=features).unwrapped.graph_schema)
    for features, other in (("paper", "rich"), ("rich", "paper")):
        env = make_task("ClothHanging-v1", graph_features=features)
        check_schema(policies[features], env)
        with pytest.raises(CheckpointError, match=rf"--env_kwargs graph_features={other}"):
            check_schema(policies[other], env)


def test_unknown_features_are_refused(make_task):
    with pytest.raises(ValueError, match=r"graph_features must be one of \['paper', 'rich'\], got 'poor'"):
        make_task("RopeShaping-v1", graph_features="poor")


def test_the_seat_faces_along_the_peg(make_task):
    """The faces of a cloth are one symmetry: of its two normals the one along the axis, whichever face that is."""
    base = make_task("ClothHanging-v1", graph_features="rich").unwrapped
    place = [channel.name for channel in base.graph_schema.actuator.vectors].index("seat_normal")

    def normals():
        base.forget_measurement()
        return base.get_obs()["graph"]["actuator"]["vectors"][:, 0, place]

    before = normals()
    assert ((before * base.hanger_axis).sum(-1) >= 0.0).all()
    # Seen from the other side, the rim of the hole is gone round the other way.
    base.seat_nodes.copy_(base.seat_nodes.flip(1))
    torch.testing.assert_close(normals(), before)
