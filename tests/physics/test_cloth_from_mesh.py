"""Cloth from any triangle mesh: flat ones as from an outline, curved ones that keep their shape, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from maniskill_grpd.physics import (
    ClothMaterial,
    Solver,
    circle_outline,
    cloth,
    cloth_from_file,
    cloth_from_mesh,
    hexagon_outline,
    l_shape_outline,
    square_outline,
)

TILT = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, -0.5])[:3, :3]
STIFF = ClothMaterial(bend_stiffness=1e-3)


def lattice(columns=16, rows=14, spacing=0.02):
    """Return the nodes (N, 2) and triangles (F, 3) of a lattice of equilateral triangles."""
    i, j = (index.ravel() for index in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    points = spacing * np.column_stack([i + 0.5 * (j % 2), np.sqrt(0.75) * j])
    faces = []
    for a in np.flatnonzero((i < columns - 1) & (j < rows - 1)):
        b, c, d = a + rows, a + 1, a + rows + 1
        faces += [[a, b, c], [b, d, c]] if j[a] % 2 == 0 else [[a, b, d], [a, d, c]]
    return points, np.array(faces)


def rolled(points, curvature, angle):
    """Bend a flat sheet (N, 2) isometrically to a cylinder about an axis in its plane, (N, 3)."""
    u, v = (
        points[:, 0] * np.cos(angle) + points[:, 1] * np.sin(angle),
        points[:, 1] * np.cos(angle) - points[:, 0] * np.sin(angle),
    )
    if curvature == 0.0:
        return np.column_stack([u, v, 0.0 * u])
    return np.column_stack([np.sin(curvature * u) / curvature, v, (1.0 - np.cos(curvature * u)) / curvature])


def tube(radius=0.1, height=0.3, around=16, rows=9):
    """Return the nodes and triangles of a cylinder without lids."""
    phi = 2.0 * np.pi * (np.arange(around) + 0.5 * (np.arange(rows)[:, None] % 2)) / around
    z = np.broadcast_to(np.linspace(0.0, height, rows)[:, None], phi.shape)
    points = np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=-1).reshape(-1, 3)
    faces = []
    for row in range(rows - 1):
        for k in range(around):
            a, b = row * around + k, row * around + (k + 1) % around
            c, d = a + around, b + around
            faces += [[a, b, c], [b, d, c]] if row % 2 == 0 else [[a, b, d], [a, d, c]]
    return points, np.array(faces)


def floating(model, num_worlds=1, **options):
    """Return worlds without gravity, far above their tables."""
    solver = Solver(model, num_worlds, 1, **options)
    solver.gravity.zero_()
    solver.plane[:, 3] = -100.0
    return solver


def run(solver, num_steps):
    for _ in range(num_steps):
        solver.step()
    return solver.positions[0].double().numpy()


def distortion(model, positions):
    """Return the largest change of any distance between two nodes [m]: zero for moved rigid shapes."""
    rest = model.rest_positions.astype(np.float64)
    return np.abs(np.linalg.norm(positions[:, None] - positions, axis=-1) - np.linalg.norm(rest[:, None] - rest, axis=-1)).max()


def fold_energy(model, positions):
    """Return the energy [J] of hinges and folds, from angles by arccos in place of the solver's half normals."""
    lines = np.einsum("hk,hkd->hd", model.hinge_weights.astype(np.float64), positions[model.hinges])
    energy = 0.5 * ((lines**2).sum(axis=1) / model.hinge_compliances).sum()
    x0, x1, x2, x3 = np.moveaxis(positions[model.folds], 1, 0)
    first, second = np.cross(x1 - x0, x2 - x0), np.cross(x3 - x0, x1 - x0)
    cosine = (first * second).sum(1) / np.linalg.norm(first, axis=1) / np.linalg.norm(second, axis=1)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0)) * np.sign((first * (x3 - x0)).sum(1))
    return energy + 0.5 * ((np.sin(0.5 * angle) - model.fold_sines) ** 2 / model.fold_compliances).sum()


@pytest.mark.parametrize(
    ("outline", "holes"), [(square_outline(0.4), []), (hexagon_outline(0.2), [circle_outline(0.05)]), (l_shape_outline(0.4), [])]
)
def test_a_flat_mesh_is_the_cloth_of_its_outline(outline, holes):
    expected = cloth(outline, holes, num_nodes=100)
    model = cloth_from_mesh(expected.rest_positions, expected.faces)
    assert len(model.folds) == 0
    for name in ("edges", "mesh_edges", "hinges", "bends", "rest_positions"):
        np.testing.assert_array_equal(getattr(model, name), getattr(expected, name))
    for name in ("masses", "rest_lengths", "stretch_compliances", "bend_compliances", "hinge_compliances", "geodesics"):
        np.testing.assert_allclose(getattr(model, name), getattr(expected, name), rtol=1e-3, atol=1e-6, err_msg=name)
    for name in ("corners", "boundary", "hole", "hole_0"):
        assert set(model.node_sets.get(name, ())) == set(expected.node_sets.get(name, ())), name
    edges = [sorted(len(nodes) for name, nodes in m.node_sets.items() if name.startswith("edge")) for m in (model, expected)]
    assert edges[0] == edges[1]


def test_a_flat_mesh_may_lie_anywhere_and_its_faces_either_way():
    points, faces = lattice()
    there = np.column_stack([points, np.zeros(len(points))]) @ TILT.T + [0.1, 0.2, 0.3]
    expected = cloth_from_mesh(np.column_stack([points, np.zeros(len(points))]), faces)
    model = cloth_from_mesh(there, faces[:, ::-1])
    np.testing.assert_allclose(model.rest_positions, there, atol=1e-6)
    np.testing.assert_allclose(model.geodesics, expected.geodesics, atol=1e-6)
    assert expected.geodesics[0, 2] == pytest.approx(2 * 0.02)  # tips of the zigzag at the side, seen around the node between
    for name in ("stretch_compliances", "hinge_compliances"):
        np.testing.assert_allclose(getattr(model, name), getattr(expected, name), rtol=1e-3)


@pytest.mark.parametrize("rest_curvature", [0.0, 4.0])
@pytest.mark.parametrize("angle", [0.0, 0.3, 0.5 * np.pi])
def test_bending_energy_on_a_triangular_lattice(rest_curvature, angle):
    """A strip curved at rest by kappa_0 and bent to kappa about the same axis stores B (kappa - kappa_0)^2 / 2 per area."""
    points, faces = lattice()
    material = ClothMaterial(bend_stiffness=2e-5)
    model = cloth_from_mesh(rolled(points, rest_curvature, angle), faces, material=material)
    assert (len(model.folds) > 0) == (rest_curvature > 0.0)
    area = model.masses.sum() / material.area_density
    for curvature in (-1.0, 1.0, 8.0):
        energy = fold_energy(model, rolled(points, curvature, angle))
        # Triangles at a free boundary lack one of their hinges: the rim of one spacing counts half, a seventh of this strip.
        assert energy / area == pytest.approx(0.5 * 2e-5 * (curvature - rest_curvature) ** 2, rel=0.15)


def test_a_tube_keeps_its_curved_rest_shape():
    model = cloth_from_mesh(*tube(), material=STIFF)
    assert distortion(model, run(floating(model), 40)) < 1e-5
    flattened = replace(model, fold_sines=np.zeros_like(model.fold_sines))
    assert distortion(model, run(floating(flattened), 40)) > 2e-4


def test_a_squashed_tube_springs_back():
    model = cloth_from_mesh(*tube(), material=STIFF)
    solver = floating(model)
    solver.positions *= torch.tensor([0.5, 1.2, 1.0])
    assert distortion(model, solver.positions[0].double().numpy()) > 0.05
    assert distortion(model, run(solver, 300)) < 1e-4


def test_a_seam_keeps_its_angle():
    """Two sheets at a right angle, joined at their shared vertices."""
    points, faces = lattice(8, 8)
    flat = np.column_stack([points, np.zeros(len(points))])
    upright = flat[:, [0, 2, 1]]
    model = cloth_from_mesh(np.concatenate([flat, upright]), np.concatenate([faces, faces + len(flat)]), material=STIFF)
    assert model.num_nodes == 2 * len(flat) - 8
    assert len(model.folds) == 7
    np.testing.assert_allclose(np.abs(model.fold_sines), np.sin(np.pi / 4), rtol=1e-5)
    solver = floating(model)
    solver.positions[..., 1] *= 0.6
    assert distortion(model, run(solver, 200)) < 1e-4


def test_folds_conserve_momentum_and_angular_momentum():
    """From rest, forces without a sum and without a torque bring no momentum: the first substep goes along their gradients."""
    points, faces = tube()
    points[:, 2] += 0.5 * points[:, 0]  # so that heights do not meet edges in their middles
    material = ClothMaterial(bend_stiffness=1e-3, stretch_stiffness=1e-3, damping=0.0, max_strain=np.inf)
    solver = floating(cloth_from_mesh(points, faces, material=material), substeps=1, control_dt=2.5e-3)
    generator = torch.Generator().manual_seed(0)
    solver.positions += 5e-3 * torch.randn(1, solver.num_nodes, 3, generator=generator)
    solver.step()
    x, p = solver.positions[0].double(), solver.velocities[0].double() / solver.inverse_masses[0, :, None].double()
    assert p.sum(0).norm() < 1e-5 * p.norm(dim=-1).sum()
    assert torch.linalg.cross(x, p).sum(0).norm() < 5e-4 * ((x - x.mean(0)).norm(dim=-1) @ p.norm(dim=-1))


def test_a_world_with_folds_is_bitwise_the_same_alone():
    model = cloth_from_mesh(*tube(rows=4, around=9), material=STIFF)
    batch, alone = Solver(model, 17, 1, num_threads=1), Solver(model, 1, 1)
    start = 0.5 * torch.rand(17, model.num_nodes, 3, generator=torch.Generator().manual_seed(1))
    batch.positions += 0.02 * start
    alone.positions += 0.02 * start[5:6]
    for solver in (batch, alone):
        run(solver, 10)
    assert torch.equal(batch.positions[5], alone.positions[0])
    assert not torch.equal(batch.positions[4], alone.positions[0])


def test_a_closed_mesh_is_cloth():
    sphere = trimesh.creation.icosphere(2, 0.1)
    model = cloth_from_mesh(sphere.vertices, sphere.faces)
    assert model.node_sets == {}
    assert model.masses.sum() == pytest.approx(sphere.area * ClothMaterial().area_density, rel=1e-5)
    angle = np.arccos(np.clip(sphere.vertices @ sphere.vertices.T / 0.01, -1.0, 1.0))
    far = angle > 0.5
    ratio = model.geodesics[far] / (0.1 * angle[far])
    assert ratio.min() > 0.97  # chords are shorter than arcs
    assert ratio.max() < 1.05
    solver = Solver(model, 1, 1, self_collision=True)
    solver.positions[..., 2] += 0.15
    assert np.isfinite(run(solver, 20)).all()
    assert not solver.frozen.any()


def pierced_slab():
    """Return the triangles (F, 3, 3) around a slab of 7 x 3 cubes, two of which are missing: a closed surface of genus 2."""
    cubes = {(i, j, 0) for i in range(7) for j in range(3)} - {(1, 1, 0), (5, 1, 0)}
    quads = []
    for cube in cubes:
        for axis in range(3):
            for side in (-1, 1):
                if tuple(np.add(cube, side * np.eye(3, dtype=int)[axis])) not in cubes:
                    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
                    quads.append(np.insert(corners, axis, (side + 1) // 2, axis=1) + cube)
    return 0.03 * np.concatenate([np.array(quads)[:, [0, 1, 2]], np.array(quads)[:, [0, 2, 3]]])


def test_a_cloth_may_have_more_than_two_faces_for_each_node():
    """There is room for the contacts of all triangles."""
    triangles = pierced_slab()
    model = cloth_from_mesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    assert len(model.faces) == 2 * model.num_nodes + 4
    solver = Solver(model, 3, 1, self_collision=True)
    assert np.isfinite(run(solver, 10)).all()
    assert not solver.frozen.any()


def test_node_sets_follow_merged_vertices():
    points, faces = tube()
    soup = points[faces].reshape(-1, 3)
    model = cloth_from_mesh(soup, np.arange(len(soup)).reshape(-1, 3), node_sets={"chosen": [4, 5]})
    assert model.num_nodes == len(points)
    np.testing.assert_allclose(model.rest_positions[model.node_sets["chosen"]], soup[4:6], atol=1e-6)
    assert [len(model.node_sets[name]) for name in ("boundary", "loop_0", "loop_1")] == [32, 16, 16]


def test_a_file_gives_the_cloth_of_its_mesh(tmp_path):
    points, faces = tube()
    path = tmp_path / "tube.stl"
    trimesh.Trimesh(1000.0 * points, faces).export(path)
    model = cloth_from_file(path, scale=1e-3)
    assert model.num_nodes == len(points)
    assert model.masses.sum() == pytest.approx(cloth_from_mesh(points, faces).masses.sum(), rel=1e-5)
    with pytest.raises(FileNotFoundError, match="there is no file"):
        cloth_from_file(tmp_path / "nothing.stl")
    with pytest.raises(ValueError, match="scale must be finite and > 0, got 0"):
        cloth_from_file(path, scale=0.0)
    trimesh.PointCloud(points).export(tmp_path / "cloud.ply")
    with pytest.raises(ValueError, match="holds no triangles"):
        cloth_from_file(tmp_path / "cloud.ply")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"radius": 0.0}, "radius of a cloth must be finite and > 0 m, got 0"),
        ({"material": ClothMaterial(shear_stiffness=10.0)}, "shear_stiffness must be None, got 10"),
        ({"node_sets": {"hem": [0, 200]}}, r"node_sets\['hem'\] must index vertices 0 to 143"),
        ({"node_sets": {"hem": []}}, r"node_sets\['hem'\] must be vertex indices"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        cloth_from_mesh(*tube(), **options)


def test_meshes_without_room_are_refused():
    points, faces = tube(around=60, rows=60)
    with pytest.raises(ValueError, match="a cloth has 4 to 2500 nodes, the mesh has 3600"):
        cloth_from_mesh(points, faces)
    with pytest.raises(ValueError, match="the mesh has 3"):
        cloth_from_mesh(np.eye(3), [[0, 1, 2]])
