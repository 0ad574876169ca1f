"""Parts of a scene are where the worlds of the solver are, and mice pull what they point at."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from maniskill_grpd.rendering import palette
from maniskill_grpd.tasks.pictures.dragging import REACH, Dragging
from maniskill_grpd.tasks.pictures.world_parts import WorldParts
from maniskill_grpd.viewer.drag import Drag
from maniskill_grpd.viewer.parts import Copies, Shell


@pytest.fixture
def folding():
    env = gym.make("ClothFolding-v1", num_envs=3, obs_mode="graph", resolution=64, sim_backend="cpu")
    env.reset(seed=[1, 2, 3])
    yield env.unwrapped
    env.close()


@pytest.fixture
def hanging():
    env = gym.make("ClothHanging-v1", num_envs=2, obs_mode="graph", resolution=64, grasp="free", sim_backend="cpu")
    env.reset(seed=[1, 2])
    yield env.unwrapped
    env.close()


def drag(client: int, phase: str, hit: np.ndarray, pointer: np.ndarray) -> Drag:
    return Drag(client, phase, np.asarray(hit, dtype=float), np.asarray(pointer, dtype=float))


def test_worlds_stand_side_by_side_and_a_point_of_the_scene_leads_back_to_its_node(folding):
    parts = WorldParts(folding, range(3))
    cloths = parts.parts()["object"].vertices.reshape(3, 64, 3)
    gaps = np.linalg.norm(parts.offsets[:, None] - parts.offsets[None], axis=-1)[~np.eye(3, dtype=bool)]
    assert gaps.min() > 1.6  # the side of a table
    for world in range(3):
        np.testing.assert_allclose(cloths[world] - parts.offset_of(world), folding.solver.positions[world], atol=1e-6)
        found, point = parts.locate(cloths[world, 17])
        assert found == world
        np.testing.assert_allclose(point, folding.solver.positions[world, 17], atol=1e-6)


def test_one_world_alone_stands_at_its_own_place(folding):
    parts = WorldParts(folding, [2])
    np.testing.assert_allclose(parts.parts()["object"].vertices, folding.solver.positions[2], atol=1e-7)
    assert parts.locate(np.array([0.3, 0.0, 0.0]))[0] == 2


def test_what_has_not_changed_is_the_same_object_and_what_has_moved_is_not(folding):
    parts = WorldParts(folding, range(3))
    before = parts.parts()
    folding.step(torch.full((3, 6), 0.5))
    after = parts.parts()
    assert {name for name in before if after[name] is not before[name]} == {"object", "grippers/closed"}
    folding.reset(seed=[4, 5, 6])
    assert parts.parts()["goal/open"] is not before["goal/open"]


def test_faces_of_all_worlds_join_nodes_of_their_own_world(folding):
    cloth = WorldParts(folding, range(3)).parts()["object"]
    owners = cloth.faces // 64
    assert (owners == owners[:, :1]).all()
    assert set(owners[:, 0].tolist()) == {0, 1, 2}


def test_obstacles_that_move_are_the_same_mesh_elsewhere(hanging):
    parts = WorldParts(hanging, [0])
    first = parts.parts()
    name = next(name for name in first if name.startswith("solids/"))
    hanging.reset(seed=[7, 8])
    second = parts.parts()
    assert isinstance(second[name], Copies)
    assert second[name].vertices is first[name].vertices
    assert {second[name].look.front for name in second if name.startswith("solids/")} == {palette.SOLID}
    for index, solid in enumerate(hanging.checked_drawing(0).solids):
        part = second[f"solids/0/{index}"]
        middle, half_turn = part.rotations[0, 1:], part.rotations[0, 0]
        spun = part.vertices + 2.0 * np.cross(middle, np.cross(middle, part.vertices) + half_turn * part.vertices)
        gaps = np.linalg.norm((spun + part.positions[0])[:, None] - solid.vertices[None], axis=-1)
        assert gaps.min(axis=1).max() < 1e-4


def test_open_and_closed_grippers_are_told_apart(hanging):
    parts = WorldParts(hanging, range(2))
    assert len(parts.parts()["grippers/closed"].positions) == 8
    action = torch.zeros(2, 4, 4)
    action[..., 3] = 1.0
    action[1, 2, 3] = -1.0
    hanging.step(action.flatten(1))
    shown = parts.parts()
    assert len(shown["grippers/closed"].positions) == 7
    np.testing.assert_allclose(
        shown["grippers/open"].positions[0] - parts.offset_of(1), hanging.solver.gripper_positions[1, 2], atol=1e-6
    )


def test_ropes_are_tubes_about_their_nodes():
    env = gym.make("RopeShaping-v1", num_envs=2, obs_mode="graph", sim_backend="cpu")
    env.reset(seed=[1, 2])
    base = env.unwrapped
    parts = WorldParts(base, range(2))
    rope = parts.parts()["object"]
    assert isinstance(rope, Shell)
    points = base.solver.positions[1].numpy() + parts.offset_of(1)
    gaps = np.linalg.norm(rope.vertices[len(rope.vertices) // 2 :, None] - points[None], axis=-1).min(axis=1)
    assert gaps.max() == pytest.approx(base.models[0].radius, rel=1e-3)
    env.close()


def test_a_mouse_pulls_the_node_it_points_at_by_the_point_it_took(folding):
    parts = WorldParts(folding, range(3))
    dragging, solver = Dragging(parts), folding.solver
    node = solver.positions[1, 20].numpy() + parts.offset_of(1)
    aside = np.array([0.004, 0.0, 0.0])
    assert dragging.follow([drag(5, "start", node + aside, node + aside)]) == []
    assert solver.tug_nodes.tolist() == [-1, 20, -1]
    np.testing.assert_allclose(solver.tug_targets[1], solver.positions[1, 20], atol=1e-6)
    dragging.follow([drag(5, "update", node, node + aside + [0.0, 0.0, 0.1])])
    np.testing.assert_allclose(solver.tug_targets[1], solver.positions[1, 20] + torch.tensor([0.0, 0.0, 0.1]), atol=1e-6)
    dragging.follow([drag(5, "end", node, node)])
    assert solver.tug_nodes.tolist() == [-1, -1, -1]


def test_one_world_is_held_by_the_last_client_and_each_lets_go_of_its_own(folding):
    parts = WorldParts(folding, range(3))
    dragging, solver = Dragging(parts), folding.solver
    places = [solver.positions[world, 9].numpy() + parts.offset_of(world) for world in range(3)]
    dragging.follow([drag(1, "start", places[0], places[0]), drag(2, "start", places[2], places[2])])
    assert solver.tug_nodes.tolist() == [9, -1, 9]
    dragging.follow([drag(3, "start", places[0], places[0]), drag(1, "end", places[0], places[0])])
    assert solver.tug_nodes.tolist() == [9, -1, 9]
    dragging.let_go()
    assert solver.tug_nodes.tolist() == [-1, -1, -1]


def test_who_pulls_out_of_the_world_is_held_back_and_told(folding):
    parts = WorldParts(folding, [0])
    dragging, solver = Dragging(parts), folding.solver
    place = solver.positions[0, 9].numpy()
    (message,) = dragging.follow([drag(1, "start", place, place), drag(1, "update", place, [1e9, 0.0, 0.0])])
    assert "1.5 m" in message
    assert solver.tug_targets[0].norm() <= REACH * 1.0001
    (message,) = dragging.follow([drag(2, "start", [np.nan, 0.0, 0.0], place)])
    assert "not finite" in message
    for _ in range(5):
        folding.step(torch.zeros(3, 6))
    assert torch.isfinite(solver.positions).all()
    assert not solver.frozen.any()
