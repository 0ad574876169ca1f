"""Cloth models: geometry, node sets, material that does not depend on the mesh, and strength while dragged."""

import numpy as np
import pytest
import torch
from validation.corner_drag import drag

from maniskill_grpd.physics import (
    ClothMaterial,
    circle_outline,
    cloth,
    hexagon_outline,
    l_shape_outline,
    rectangle_outline,
    square_outline,
    triangle_outline,
)
from maniskill_grpd.physics.mesh.fit import quartic_coefficients

OUTLINES = {
    "square": (square_outline(0.4), circle_outline(0.06), 4),
    "rectangle": (rectangle_outline(0.6, 0.3), rectangle_outline(0.1, 0.1), 4),
    "triangle": (triangle_outline(0.5), circle_outline(0.05), 3),
    "hexagon": (hexagon_outline(0.25), circle_outline(0.06), 6),
    "circle": (circle_outline(0.25), hexagon_outline(0.08), 4),
    "l_shape": (l_shape_outline(0.5), circle_outline(0.04, (-0.12, -0.12)), 6),
}


def polygon_area(polygon):
    x, y = polygon.T
    return 0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("with_hole", [False, True])
@pytest.mark.parametrize("num_nodes", [49, 100, 400])
def test_mesh_covers_the_outline_and_not_the_hole(name, with_hole, num_nodes):
    outline, hole, num_corners = OUTLINES[name]
    model = cloth(outline, [hole] if with_hole else [], num_nodes=num_nodes, material=ClothMaterial(area_density=1.0))
    # Spacings fit a whole number of times into an edge, so the number of nodes is met to about one row.
    assert abs(model.num_nodes - num_nodes) <= 2.0 * np.sqrt(num_nodes)
    # Curved boundaries become chords; a hole of six chords covers 0.83 of its circle.
    expected = polygon_area(outline) - with_hole * polygon_area(hole)
    assert model.masses.sum() == pytest.approx(expected, rel=0.05)
    corners = model.rest_positions[model.faces]
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert areas.min() > 0.02 * areas.mean()
    euler = model.num_nodes - len(model.mesh_edges) + len(model.faces)
    assert euler == 1 - with_hole
    sets = model.node_sets
    assert len(sets["corners"]) == num_corners
    assert ("hole" in sets) == with_hole
    if with_hole:
        rim = model.rest_positions[sets["hole_0"]][:, :2] - hole.mean(axis=0)
        assert np.linalg.norm(rim, axis=1).max() <= np.linalg.norm(hole - hole.mean(axis=0), axis=1).max() + 1e-6


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("num_nodes", [49, 100, 400])
def test_springs_are_as_stiff_as_the_material_at_every_resolution(name, num_nodes):
    """Summed over the mesh, springs store 1/2 C_11 = 1/2 * 9/8 E per area at unit strain in all directions (nu = 1/3)."""
    model = cloth(OUTLINES[name][0], num_nodes=num_nodes, material=ClothMaterial(stretch_stiffness=100.0, area_density=1.0))
    vector = model.rest_positions[model.edges[:, 1]] - model.rest_positions[model.edges[:, 0]]
    form = np.column_stack([vector[:, :2] ** 2, vector[:, 0] * vector[:, 1]]) / model.rest_lengths[:, None]
    stiffness = (quartic_coefficients(form) / model.stretch_compliances[:, None]).sum(axis=0) / model.masses.sum()
    np.testing.assert_allclose(stiffness, [112.5, 0.0, 0.0, 0.0, 0.0], atol=0.05 * 112.5)
    if name in ("square", "triangle", "hexagon"):
        np.testing.assert_allclose(stiffness, [112.5, 0.0, 0.0, 0.0, 0.0], atol=1e-3 * 112.5)


@pytest.mark.parametrize("shear", [20.0, 37.5, 60.0])
def test_shear_stiffness_is_met_on_a_square_grid(shear):
    """Pulled along x and free along y the sheet has E; sheared by gamma it stores 1/2 G gamma^2."""
    material = ClothMaterial(stretch_stiffness=100.0, shear_stiffness=shear, area_density=1.0)
    model = cloth(square_outline(0.4), num_nodes=100, material=material)
    vector = (model.rest_positions[model.edges[:, 1]] - model.rest_positions[model.edges[:, 0]])[:, :2].astype(float)
    direction = vector / model.rest_lengths[:, None]
    weight = model.rest_lengths**2 / model.stretch_compliances / model.masses.sum()

    def stiffness(i, j, k, m):
        return (weight * direction[:, i] * direction[:, j] * direction[:, k] * direction[:, m]).sum()

    assert stiffness(0, 1, 0, 1) == pytest.approx(shear, rel=1e-3)
    assert stiffness(0, 0, 0, 0) - stiffness(0, 0, 1, 1) ** 2 / stiffness(1, 1, 1, 1) == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize(
    ("outline", "holes"),
    [
        (hexagon_outline(0.2), []),
        (hexagon_outline(0.2), [circle_outline(0.04)]),
        (square_outline(0.4), []),
        (l_shape_outline(0.4), []),
    ],
)
def test_bending_ignores_strain_and_is_as_stiff_as_the_material(outline, holes):
    model = cloth(outline, holes, num_nodes=225, material=ClothMaterial(bend_stiffness=2e-5))
    rest = model.rest_positions.astype(np.float64)
    sheared = rest @ np.random.default_rng(0).normal(size=(3, 3))
    strain = np.einsum("hk,hkd->hd", model.hinge_weights, sheared[model.hinges])
    assert np.abs(strain).max() < 1e-6
    energies = []
    for angle in np.linspace(0.0, np.pi, 7):
        along = rest[:, 0] * np.cos(angle) + rest[:, 1] * np.sin(angle)
        bent = rest + np.outer(0.5 * 0.1 * along**2, [0.0, 0.0, 1.0])  # curvature 0.1 / m
        curvature = np.einsum("hk,hkd->hd", model.hinge_weights, bent[model.hinges])
        energy = 0.5 * ((curvature**2).sum(axis=1) / model.hinge_compliances).sum()
        rows = bent[model.bends] * np.array([[1.0], [-2.0], [1.0]])
        energies.append(energy + 0.5 * ((rows.sum(axis=1) ** 2).sum(axis=1) / model.bend_compliances).sum())
    area = model.masses.sum() / ClothMaterial().area_density
    # Triangles at a free boundary lack one of their hinges: the rim of one spacing counts half.
    np.testing.assert_allclose(energies, 0.5 * 2e-5 * 0.1**2 * area, rtol=0.15)


def test_distances_go_around_holes_and_corners():
    model = cloth(l_shape_outline(0.4), num_nodes=300)
    corners = model.node_sets["corners"]
    distances = model.geodesic_distances(corners)
    tip_a, tip_b, inner = corners[1], corners[5], corners[3]
    a, b, via = (model.rest_positions[node] for node in (tip_a, tip_b, inner))
    expected = np.linalg.norm(a - via) + np.linalg.norm(b - via)
    assert distances[tip_b, 1] == pytest.approx(expected, rel=1e-5)
    holed = cloth(square_outline(0.4), [circle_outline(0.1)], num_nodes=200)
    left, right = (np.linalg.norm(holed.rest_positions[:, :2] - p, axis=1).argmin() for p in ([-0.2, 0.0], [0.2, 0.0]))
    # Two tangents of length sqrt(d^2 - r^2) and the arc of angle pi - 2 acos(r / d) between them; the hole is a polygon.
    start = holed.rest_positions[left, :2]
    reach = np.linalg.norm(start)
    exact = 2 * np.sqrt(reach**2 - 0.01) + 0.1 * (np.pi - 2 * np.arccos(0.1 / reach))
    assert holed.geodesic_distances(np.array([left]))[right, 0] == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("gripped", [[0], [0, 1], [0, 1, 2, 3]])
def test_cloth_keeps_its_size_when_dragged_at_full_speed(gripped):
    strain = drag(100, 8, gripped).abs()
    assert torch.quantile(strain.flatten()[::3], 0.99) < 0.05


@pytest.mark.parametrize("gripped", [[0, 1, 2, 3]])
def test_fine_cloth_keeps_its_size_when_dragged_at_full_speed(gripped):
    strain = drag(1225, 1, gripped).abs()
    assert torch.quantile(strain.flatten()[::3], 0.99) < 0.10


@pytest.mark.parametrize(("num_nodes", "bound"), [(100, 0.05), (1225, 0.10)])
def test_corners_dragged_apart_do_not_stretch_the_cloth(num_nodes, bound):
    """Each corner goes its own way. Edges may become shorter, where the cloth wrinkles, but not longer."""
    strain = drag(num_nodes, 16 if num_nodes == 100 else 2, [0, 1, 2, 3], 40, apart=True)
    assert torch.quantile(strain.flatten()[::3], 0.99) < bound


def test_a_cloth_that_cannot_wrinkle_locks():
    """Negative control: a mesh that resists compression stretches where its corners approach in two directions."""
    strain = drag(100, 16, [0, 1, 2, 3], 40, apart=True, wrinkle_strain=np.inf)
    assert torch.quantile(strain.flatten()[::3], 0.99) > 0.05


@pytest.mark.parametrize(
    ("outline", "holes", "options", "message"),
    [
        ([[0, 0], [1, 1], [1, 0], [0, 1.0]], [], {}, "intersect itself|enclose an area"),
        ([[0, 0], [2, 1], [2, 0], [0, 1.5]], [], {}, "intersect itself"),
        ([[0, 0], [1, 0], [2, 0]], [], {}, "enclose an area"),
        ([[0, 0], [1, 0]], [], {}, "polygon"),
        ([[0, 0], [1, 0], [np.nan, 1]], [], {}, "finite"),
        (square_outline(0.4), [circle_outline(0.05, (0.19, 0.0))], {}, "hole 0 must lie inside"),
        (square_outline(0.4), [circle_outline(0.05, (1.0, 0.0))], {}, "hole 0 must lie inside"),
        (square_outline(0.4), [circle_outline(0.05), circle_outline(0.05, (0.05, 0.0))], {}, "overlap"),
        (square_outline(0.4), [], {"num_nodes": 5000}, r"num_nodes.*\[4, 2500\].*5000"),
        (square_outline(0.4), [], {"num_nodes": 1}, "num_nodes"),
        (square_outline(0.4), [], {"radius": -1.0}, "radius"),
    ],
)
def test_cloth_refuses_bad_geometry(outline, holes, options, message):
    with pytest.raises(ValueError, match=message):
        cloth(np.asarray(outline, dtype=float), holes, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"area_density": 0.0},
        {"stretch_stiffness": -1.0},
        {"shear_stiffness": 0.0},
        {"bend_stiffness": float("nan")},
        {"max_strain": -0.1},
        {"friction": -0.1},
    ],
)
def test_cloth_material_refuses_non_physical_values(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        ClothMaterial(**options)
