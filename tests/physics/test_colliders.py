"""Rigid obstacles: signed distances against trimesh, rest, friction, and no passing through at full speed."""

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from maniskill_grpd.physics import (
    RopeMaterial,
    Solver,
    box,
    capsule,
    cloth,
    cylinder,
    plane,
    prism,
    rope,
    sphere,
    square_outline,
    triangle_mesh,
)

TRIANGLE = np.array([[-0.1, -0.08], [0.1, -0.08], [0.0, 0.12]])
ICOSPHERE = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
# Each collider with its signed distance in its own frame: outside positive.
SHAPES = {
    "sphere": (sphere(0.1), lambda p: np.linalg.norm(p, axis=1) - 0.1),
    "capsule": (capsule(0.05, 0.1), lambda p: np.linalg.norm(p - np.clip(p, [0, 0, -0.1], [0, 0, 0.1]), axis=1) - 0.05),
    "box": (box(0.1, 0.06, 0.08), lambda p: _box_distance(p, np.array([0.1, 0.06, 0.08]))),
    "cylinder": (cylinder(0.08, 0.1), lambda p: _extruded_distance(np.linalg.norm(p[:, :2], axis=1) - 0.08, p[:, 2], 0.1)),
    "prism": (prism(TRIANGLE, 0.1), lambda p: _extruded_distance(_triangle_distance(p[:, :2]), p[:, 2], 0.1)),
    "mesh": (triangle_mesh(ICOSPHERE.vertices, ICOSPHERE.faces), lambda p: np.linalg.norm(p, axis=1) - 0.1),
    "plane": (plane(), lambda p: p[:, 2]),
}


def _box_distance(p, half):
    q = np.abs(p) - half
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def _extruded_distance(section, z, half_length):
    cap = np.abs(z) - half_length
    outside = np.hypot(np.maximum(section, 0.0), np.maximum(cap, 0.0))
    return outside + np.minimum(np.maximum(section, cap), 0.0)


def _triangle_distance(p):
    edges = np.roll(TRIANGLE, -1, axis=0) - TRIANGLE
    normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1, keepdims=True)
    heights = ((p[:, None] - TRIANGLE) * normals).sum(-1)
    t = np.clip(((p[:, None] - TRIANGLE) * edges).sum(-1) / (edges**2).sum(-1), 0, 1)
    gaps = np.linalg.norm(p[:, None] - TRIANGLE - t[..., None] * edges, axis=-1).min(axis=1)
    return np.where((heights < 0).all(axis=1), heights.max(axis=1), gaps)


def dust(positions: np.ndarray, collider, **options) -> Solver:
    """One world per point: the three nodes of a soft, weightless rope of 2 mm about it, without table."""
    model = rope([[0.0, 0.0, 0.0], [2e-4, 0.0, 0.0]], num_nodes=3, radius=0.005, material=RopeMaterial(bend_stiffness=0.0))
    solver = Solver(model, len(positions), 1, colliders=[collider], **options)
    solver.plane[:, 3] = -100.0
    solver.gravity.zero_()
    solver.reset(torch.arange(len(positions)), solver.positions + torch.as_tensor(positions, dtype=torch.float32)[:, None])
    return solver


@pytest.mark.parametrize("name", SHAPES)
def test_points_inside_are_pushed_to_the_surface_and_those_outside_left_alone(name):
    collider, distance = SHAPES[name]
    generator = np.random.default_rng(0)
    points = generator.uniform(-0.16, 0.16, (600, 3))
    rotation, shift = Rotation.random(random_state=1), np.array([0.3, -0.2, 0.4])
    solver = dust(points, collider, substeps=1)
    solver.positions.copy_(torch.as_tensor(rotation.apply(solver.positions.reshape(-1, 3)).reshape(600, 3, 3) + shift))
    solver.collider_positions.copy_(torch.as_tensor(shift).expand(600, 1, 3))
    x, y, z, w = rotation.as_quat()
    solver.collider_rotations.copy_(torch.tensor([w, x, y, z]).expand(600, 1, 4))
    before = rotation.inv().apply(solver.positions[:, 1].double().numpy() - shift)
    solver.step()
    after = rotation.inv().apply(solver.positions[:, 1].double().numpy() - shift)
    # Facets of the icosphere lie 1 - cos(edge / 2R) = 0.12 mm below the sphere at most; the 0.2 mm rope ties its nodes together.
    tolerance = 4e-4
    was, now = distance(before), distance(after)
    moved = np.linalg.norm(after - before, axis=1)
    assert (moved[was > 0.005 + tolerance] < tolerance).all()
    shallow = (was > -0.03) & (was < 0.004)
    assert np.count_nonzero(shallow) > 10
    np.testing.assert_allclose(now[shallow], 0.005, atol=tolerance)
    # Sharp inner edges aside, the nearest way out is taken.
    assert np.median(np.abs(moved[shallow] - (0.005 - was[shallow]))) < tolerance


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("speed", [0.6, 3.0, 12.0])
def test_nothing_passes_through_at_any_speed(name, speed):
    """A point is shot at the centre of the collider; 12 m/s is 30 mm per substep, twenty times the speed of a gripper."""
    collider, distance = SHAPES[name]
    generator = np.random.default_rng(0)
    directions = generator.normal(size=(20 if name == "mesh" else 100, 3))  # queries of the mesh are dear
    if name == "plane":
        directions[:, 2] = np.abs(directions[:, 2]) + 0.5
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    starts = 0.4 * directions
    solver = dust(starts, collider)
    solver.friction.fill_(1e3)  # sticks where it hits
    solver.velocities.copy_(torch.as_tensor(-speed * directions, dtype=torch.float32)[:, None])
    for _ in range(max(2, int(1.1 * 0.4 / speed / 0.05))):
        solver.step()
        points = solver.positions[:, 1].numpy()
        assert distance(points).min() > 0.005 - 4e-4
    # It did not come out on the other side. (At 12 m/s a point may cut a corner of a box and then fly past it.)
    if speed < 10.0:
        assert ((points * directions).sum(axis=1) > -0.05).all()


@pytest.mark.parametrize("thickness", [0.0005, 0.004])
def test_cloth_does_not_fall_through_a_thin_plate(thickness):
    model = cloth(square_outline(0.2), num_nodes=49)
    solver = Solver(model, 2, 1, colliders=[box(0.3, 0.3, 0.5 * thickness)])
    solver.plane[:, 3] = -100.0
    start = solver.positions.clone()
    start[..., 2] += 0.05
    solver.reset(torch.arange(2), start)
    solver.velocities[1, :, 2] = -5.0
    for _ in range(20):
        solver.step()
        assert solver.positions[..., 2].min() > 0.5 * thickness + model.radius - 1e-5


@pytest.mark.parametrize(("friction", "slides"), [(0.5, True), (0.7, False)])
def test_coulomb_on_a_tilted_box(friction, slides):
    """Tan 31 degrees = 0.6: slides with g (sin - mu cos) below that coefficient, sticks above."""
    angle = np.deg2rad(31.0)
    model = rope([[0.0, -0.1, 0.0], [0.0, 0.1, 0.0]], num_nodes=11, material=RopeMaterial(friction=friction, damping=0.0))
    solver = Solver(model, 1, 1, colliders=[box(2.0, 0.5, 0.1)])
    solver.plane[:, 3] = -100.0
    solver.collider_rotations[0, 0] = torch.tensor([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])
    normal = torch.tensor([np.sin(angle), 0.0, np.cos(angle)], dtype=torch.float32)
    solver.reset(torch.tensor([0]), solver.positions + normal * (0.1 + model.radius))
    before = solver.positions.clone()
    for _ in range(10):
        solver.step()
    travelled = (solver.positions - before).mean(dim=1).norm().item()
    time, dt = 0.5, solver.control_dt / solver.substeps[0]
    expected = 0.5 * 9.81 * (np.sin(angle) - friction * np.cos(angle)) * time**2 if slides else 0.0
    # First-order integration is off by g t dt / 2; touching within 2 % of the radius counts as contact from the start.
    assert travelled == pytest.approx(expected, abs=9.81 * time * dt * np.sin(angle) + 1e-4)


def test_pose_size_and_switch_belong_to_one_world():
    model = rope([[-0.2, 0.0, 0.0], [0.2, 0.0, 0.0]], num_nodes=21)
    solver = Solver(model, 4, 1, colliders=[sphere(0.1)])
    alone = Solver(model, 1, 1)
    solver.collider_active[1] = False
    solver.collider_positions[2] = 5.0
    solver.collider_sizes[3] = 0.05
    start = model.rest_positions + np.array([0.0, 0.0, 0.3], dtype=np.float32)
    solver.reset(torch.arange(4), torch.as_tensor(start).expand(4, -1, -1))
    alone.reset(torch.tensor([0]), torch.as_tensor(start)[None])
    for _ in range(8):
        solver.step()
        alone.step()
    heights = solver.positions[:, 10, 2]
    assert heights[0] == pytest.approx(0.11, abs=2e-3)
    assert heights[3] == pytest.approx(0.06, abs=2e-3)
    torch.testing.assert_close(solver.positions[1], alone.positions[0], rtol=0.0, atol=1e-6)
    torch.testing.assert_close(solver.positions[2], alone.positions[0], rtol=0.0, atol=1e-6)


def test_cloth_pulled_over_a_peg_is_not_pierced():
    """A peg thinner than the mesh is wide: the middles of the edges hold the cloth where its nodes would let the peg through."""
    model = cloth(square_outline(0.4), num_nodes=100)
    solver = Solver(model, 1, 4, colliders=[capsule(0.015, 0.15)])
    solver.collider_positions[0, 0] = torch.tensor([0.0, 0.0, 0.15])
    start = solver.positions.clone()
    start[..., 2] += 0.36
    solver.reset(torch.tensor([0]), start, torch.as_tensor(model.node_sets["corners"]))
    for _ in range(6):
        solver.gripper_targets.copy_(solver.gripper_positions)
        solver.gripper_targets[..., 2] -= 0.026
        solver.gripper_targets[..., :2] *= 0.93  # as much towards the peg as a cloth needs that is not stretched
        solver.step()
    centre = solver.positions[0][(solver.positions[0, :, :2].norm(dim=-1) < 0.05)]
    assert centre[:, 2].max() > 0.3


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: sphere(0.0), "sphere"),
        (lambda: box(0.1, -1.0, 0.1), "box"),
        (lambda: cylinder(0.1, float("nan")), "cylinder"),
        (lambda: prism([[0, 0], [1, 0], [0.1, 0.1], [0, 1]], 0.1), "convex"),
        (lambda: prism(np.random.default_rng(0).normal(size=(2, 2)), 0.1), "polygon"),
        (lambda: triangle_mesh(np.zeros((3, 3)), [[0, 1, 3]]), "index"),
        (lambda: triangle_mesh(np.zeros((3, 3)), [[0.0, 1.0, 2.0]]), "whole numbers.*float64"),
    ],
)
def test_colliders_refuse_bad_input(build, message):
    with pytest.raises(ValueError, match=message):
        build()


BOX = trimesh.creation.box((0.2, 0.2, 0.2))


def test_a_mesh_with_reversed_faces_does_not_swallow_the_cloth():
    """It is refused, and the message names the remedy; the remedied one carries all of the cloth."""
    reversed_faces = BOX.faces[:, ::-1]
    with pytest.raises(ValueError, match=r"counter-clockwise.*part 0 of 1.*-0\.008 m\^3.*faces\[:, ::-1\]"):
        triangle_mesh(BOX.vertices, reversed_faces)
    solver = Solver(
        cloth(square_outline(0.3), num_nodes=100), 1, 1, colliders=[triangle_mesh(BOX.vertices, reversed_faces[:, ::-1])]
    )
    solver.collider_positions[0, 0, 2] = 0.1
    start = solver.positions.clone()
    start[..., 2] += 0.22
    solver.reset(torch.tensor([0]), start)
    for _ in range(40):
        solver.step()
    inside = (solver.positions[0, :, :2].abs() < 0.095).all(1) & (solver.positions[0, :, 2] < 0.19)
    assert inside.sum() == 0
    assert solver.positions[0, :, 2].max() > 0.19


def test_meshes_without_an_inside_are_refused_by_name():
    with pytest.raises(ValueError, match="12 of 12 have none, the first is face 0"):
        triangle_mesh(BOX.vertices, np.zeros_like(BOX.faces))
    with pytest.raises(ValueError, match="must be closed, 3 of 18 edges"):
        triangle_mesh(BOX.vertices, BOX.faces[1:])
    with pytest.raises(ValueError, match="same way round"):
        triangle_mesh(BOX.vertices, np.concatenate([BOX.faces[:1, ::-1], BOX.faces[1:]]))
    with pytest.raises(ValueError, match=r"signed volume 0 m\^3"):
        triangle_mesh(np.eye(3), [[0, 1, 2], [2, 1, 0]])


def test_each_part_of_a_mesh_is_judged_for_itself():
    beside, small = BOX.copy(), BOX.copy()
    beside.apply_translation([1.0, 0.0, 0.0])
    small.apply_scale(0.5)
    flipped = [trimesh.Trimesh(part.vertices, part.faces[:, ::-1], process=False) for part in (beside, small)]
    for parts in ([BOX, beside], [BOX, small], [BOX, flipped[1]]):  # two solids, a solid in a solid, a cavity
        both = trimesh.util.concatenate(parts)
        assert triangle_mesh(both.vertices, both.faces).faces.shape == (24, 3)
    both = trimesh.util.concatenate([BOX, flipped[0]])  # its whole volume is 0, as good as positive
    with pytest.raises(ValueError, match="part 1 of 2"):
        triangle_mesh(both.vertices, both.faces)


def test_vertices_of_a_mesh_may_be_repeated_for_each_face():
    soup = BOX.triangles.reshape(-1, 3)
    assert triangle_mesh(soup, np.arange(36).reshape(12, 3)).vertices.shape == (36, 3)
