"""Flat meshes as shapes of the cloth tasks."""

import gymnasium as gym
import numpy as np
import pytest
import trimesh

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.physics import circle_outline, cloth, hexagon_outline, square_outline
from maniskill_grpd.tasks.cloth_folding import CLOTH_AREA
from maniskill_grpd.tasks.geometry.cloth_shapes import check_cloth_shapes, cloth_outline

PENTAGON = 0.15 * np.array([[0.0, -1.0], [1.0, -0.3], [0.6, 0.8], [-0.6, 0.8], [-1.0, -0.3]])
FLAT = cloth(PENTAGON, num_nodes=100)
TURN = trimesh.transformations.rotation_matrix(0.6, [1.0, 1.0, 0.0])[:3, :3]


def mesh_of(outline, holes=()):
    model = cloth(outline, holes)
    return model.rest_positions, model.faces


def sorted_sides(outline):
    return np.sort(np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1))


@pytest.mark.parametrize("as_trimesh", [False, True])
@pytest.mark.parametrize("turn", [np.eye(3), TURN])
def test_a_flat_mesh_has_the_outline_it_was_made_of(as_trimesh, turn):
    vertices = FLAT.rest_positions @ turn.T
    mesh = trimesh.Trimesh(vertices, FLAT.faces) if as_trimesh else (vertices, FLAT.faces)
    for given in (mesh, ["square", mesh], [mesh]):
        shape = check_cloth_shapes(given, CLOTH_AREA)[-1]
        np.testing.assert_allclose(sorted_sides(cloth_outline(shape, CLOTH_AREA)), sorted_sides(PENTAGON), atol=1e-5)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (trimesh.creation.icosphere(1, 0.1), "shapes must be a flat mesh, got a closed one"),
        ((FLAT.rest_positions + [0.0, 0.0, 1.0] * FLAT.rest_positions[:, :1] ** 2, FLAT.faces), "curved or lies on itself"),
        (mesh_of(hexagon_outline(0.2), [circle_outline(0.05)]), "one rim, got 2: cut holes by the task's own options"),
        ((FLAT.rest_positions, np.concatenate([FLAT.faces, FLAT.faces[:1]])), "faces must differ"),
        (mesh_of(square_outline(2.0)), "must be 0.05 to 0.36 m"),
    ],
)
def test_meshes_that_tasks_cannot_lay_are_refused_with_the_reason(mesh, message):
    with pytest.raises(ValueError, match=message):
        check_cloth_shapes(mesh, CLOTH_AREA)


def test_two_polygons_are_not_taken_for_a_mesh():
    assert len(check_cloth_shapes([square_outline(0.2), PENTAGON], CLOTH_AREA)) == 2


def test_a_task_takes_a_mesh():
    env = gym.make(
        "ClothFolding-v1", num_envs=1, shapes=(FLAT.rest_positions, FLAT.faces), obs_mode="none", render_backend="none"
    )
    env.reset(seed=0)
    assert len(env.unwrapped.models[0].node_sets["corners"]) == 5
    env.close()
