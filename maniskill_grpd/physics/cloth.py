"""Cloth: an elastic sheet with bending stiffness, built from any polygon with holes or any triangle mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import trimesh

from maniskill_grpd.physics.mesh.distances import distances_in_sheet, distances_on_surface
from maniskill_grpd.physics.mesh.flattening import flatten
from maniskill_grpd.physics.mesh.hinges import Bending, fit_bending
from maniskill_grpd.physics.mesh.outlines import check_holes, check_polygon
from maniskill_grpd.physics.mesh.sewing import sew
from maniskill_grpd.physics.mesh.springs import fit_springs
from maniskill_grpd.physics.mesh.surface import Surface, curved_surface, flat_surface
from maniskill_grpd.physics.mesh.triangulation import PlanarMesh, triangulate
from maniskill_grpd.physics.model import Model

MIN_NODES, MAX_NODES = 4, 2500
# Hinges that are folded by less than this, as sin(theta / 2), are flat: their constraint is linear in the positions.
FLAT_SINE = 1e-4
# A sweep over the lines of a mesh leaves errors that grow with the square of its nodes in a row and of the substep.
MIN_SUBSTEPS, SUBSTEPS_PER_NODE_ROW = 24, 2.4


@dataclass(frozen=True, kw_only=True)
class ClothMaterial:
    """Material of a cloth in SI units. The defaults are those of a woven cotton."""

    area_density: float = 0.2
    """Mass per area [kg/m^2], > 0."""
    stretch_stiffness: float = 1000.0
    """Force per width and strain of a strip that is pulled with free sides [N/m], > 0 (Young's modulus times thickness)."""
    shear_stiffness: float | None = None
    """Force per width and shear angle [N/m], > 0. None is isotropic, 3/8 of the stretch stiffness (Poisson's ratio 1/3). A square
    grid meets any value; triangular lattices are isotropic by nature and come as near as they can."""
    bend_stiffness: float = 1e-5
    """Bending moment per width and curvature [N m], >= 0 (flexural rigidity)."""
    damping: float = 1.0
    """Decay rate of velocities in air [1/s], >= 0."""
    friction: float = 0.5
    """Coefficient of Coulomb friction, >= 0."""
    max_strain: float = 0.03
    """Strain at which the weave locks, >= 0: nodes stay within (1 + max_strain) of their distance from every held node through
    the cloth. Infinity leaves stretching to the stretch stiffness alone."""
    wrinkle_strain: float = 0.04
    """Compression at which the cloth wrinkles, >= 0: edges that are shorter have 1/100 of their stiffness, since real cloth
    folds more finely than its mesh. With infinity a mesh locks, and stretches elsewhere, where held nodes come closer."""

    def __post_init__(self) -> None:
        positive = ("area_density", "stretch_stiffness", "shear_stiffness")
        for entry in fields(self):
            value = getattr(self, entry.name)
            if value is None and entry.name == "shear_stiffness":
                continue
            finite = np.isfinite(value) or (entry.name in ("max_strain", "wrinkle_strain") and value == np.inf)
            if not finite or value < 0.0 or (entry.name in positive and value == 0.0):
                bound = "> 0" if entry.name in positive else ">= 0"
                raise ValueError(f"ClothMaterial.{entry.name} must be finite and {bound}, got {value}")


def cloth(
    outline: np.ndarray,
    holes: Sequence[np.ndarray] = (),
    *,
    num_nodes: int = 100,
    radius: float = 0.003,
    material: ClothMaterial | None = None,
) -> Model:
    """Build a cloth that lies flat in the plane z = 0.

    Masses are lumped, a third of each triangle's mass to each of its nodes. Stretch springs and bending hinges are fitted to the
    material on this mesh (see `mesh.fit`), so a finer mesh is the same cloth.

    Node sets: "corners" in the order of the outline (the four extreme points of a smooth one), "boundary", "edge_0" ... between
    successive corners, "hole" (the boundaries of all holes), "hole_0" ...

    Args:
        outline: Closed polygon without a repeated last point, (P, 2) [m], in either direction.
        holes: Polygons inside the outline that do not overlap, each (P, 2) [m].
        num_nodes: Wanted number of nodes, 4 to 2500; the mesh has about as many. A square gets a square grid.
        radius: Half the cloth's thickness [m], > 0: the distance its nodes keep from surfaces.
        material: Material constants, `ClothMaterial()` by default.

    Raises:
        ValueError: If a polygon is not simple, a hole is not inside, a number is out of its range, or the mesh is too coarse.
    """
    material = material or ClothMaterial()
    if not MIN_NODES <= num_nodes <= MAX_NODES:
        raise ValueError(f"num_nodes of a cloth must be in [{MIN_NODES}, {MAX_NODES}], got {num_nodes}")
    _check_radius(radius)
    outline = check_polygon(outline, "the outline")
    holes = [check_polygon(hole, f"hole {index}") for index, hole in enumerate(holes)]
    check_holes(outline, holes)
    mesh = triangulate(outline, holes, num_nodes)
    return _build_flat(mesh, np.column_stack([mesh.points, np.zeros(len(mesh.points))]), radius, material)


def cloth_from_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    *,
    radius: float = 0.003,
    material: ClothMaterial | None = None,
    node_sets: Mapping[str, Sequence[int]] | None = None,
) -> Model:
    """Build a cloth from any triangle mesh: open or closed, flat or curved, of one layer or of several that are sewn together.

    Vertices at the same place are one node, so that layers that share vertices are sewn there. The mesh is the shape at rest:
    edges keep their lengths and triangles the angles between them. A flat mesh is the cloth that `cloth` makes of such a mesh;
    on a curved one distances through the material run along the mesh (see `distances_on_surface`).

    Node sets: "boundary" and "loop_0", "loop_1", ... (each rim in order, the one with the most nodes first) of an open mesh,
    those of `cloth` besides if it is flat, and those that are given.

    Args:
        vertices: (V, 3) [m].
        faces: Vertex indices of the triangles, in either direction, (F, 3).
        radius: Half the cloth's thickness [m], > 0. Layers that are not to touch at rest are two radii apart.
        material: Material constants, `ClothMaterial()` by default. A curved cloth has no direction of its threads, and so no
            `shear_stiffness` of its own.
        node_sets: Further sets of nodes by name, given by the indices of their vertices.

    Raises:
        ValueError: If the mesh cannot be cloth, saying what is wrong with which vertices or faces, or a number is out of its
            range.
    """
    material = material or ClothMaterial()
    _check_radius(radius)
    points, nodes, node_of_vertex = sew(vertices, faces)
    if not MIN_NODES <= len(points) <= MAX_NODES:
        raise ValueError(f"a cloth has {MIN_NODES} to {MAX_NODES} nodes, the mesh has {len(points)}; simplify or subdivide it")
    chosen = {name: _nodes_of(name, indices, node_of_vertex) for name, indices in (node_sets or {}).items()}
    surface = curved_surface(points, nodes)
    plane = flatten(surface)
    model = _build_curved(surface, radius, material) if plane is None else _build_flat(plane, points, radius, material)
    rims = {"boundary": np.concatenate(surface.loops)} if surface.loops else {}
    rims |= {f"loop_{index}": loop for index, loop in enumerate(surface.loops)}
    return replace(model, node_sets={**rims, **model.node_sets, **chosen})


def cloth_from_file(
    path: str | Path, *, scale: float = 1.0, radius: float = 0.003, material: ClothMaterial | None = None
) -> Model:
    """Build a cloth from a file of a mesh, in any format that trimesh reads.

    Args:
        path: The file.
        scale: Factor on its coordinates that makes them metres, > 0.
        radius: Half the cloth's thickness [m], > 0.
        material: Material constants, `ClothMaterial()` by default.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it holds no triangles, or those of `cloth_from_mesh`.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"there is no file {path}")
    if not (np.isfinite(scale) and scale > 0.0):
        raise ValueError(f"scale must be finite and > 0, got {scale}")
    mesh = trimesh.load(path, force="mesh", process=False)
    if len(mesh.faces) == 0:
        raise ValueError(f"{path} holds no triangles")
    return cloth_from_mesh(scale * mesh.vertices, mesh.faces, radius=radius, material=material)


def _check_radius(radius: float) -> None:
    if not (np.isfinite(radius) and radius > 0.0):
        raise ValueError(f"the radius of a cloth must be finite and > 0 m, got {radius}")


def _nodes_of(name: str, vertices: Sequence[int], node_of_vertex: np.ndarray) -> np.ndarray:
    indices = np.asarray(vertices)
    if indices.ndim != 1 or len(indices) == 0 or indices.dtype.kind not in "iu":
        raise ValueError(f"node_sets[{name!r}] must be vertex indices (n >= 1,), got {vertices!r:.100}")
    if indices.min() < 0 or indices.max() >= len(node_of_vertex):
        raise ValueError(f"node_sets[{name!r}] must index vertices 0 to {len(node_of_vertex) - 1}, got {vertices!r:.100}")
    return node_of_vertex[indices]


def _build_flat(mesh: PlanarMesh, rest_positions: np.ndarray, radius: float, material: ClothMaterial) -> Model:
    """Build a flat cloth that lies at rest at given positions, (N, 3) [m]."""
    geodesics = distances_in_sheet(mesh.points, mesh.loops)
    arc = geodesics[mesh.corners].min(axis=0) / geodesics.max()
    model = _build(flat_surface(mesh.points, mesh.faces), radius, material, geodesics, arc)
    return replace(model, rest_positions=rest_positions.astype(np.float32), node_sets=_name_nodes(mesh))


def _build_curved(surface: Surface, radius: float, material: ClothMaterial) -> Model:
    """Build a cloth that is curved at rest. It begins at its rims, or if it is closed at two nodes that are farthest apart."""
    if material.shear_stiffness is not None:
        raise ValueError(
            f"a curved cloth is isotropic, its shear_stiffness must be None, got {material.shear_stiffness}: a mesh does not say "
            "how its threads run"
        )
    geodesics = distances_on_surface(surface)
    ends = np.concatenate(surface.loops) if surface.loops else np.array(np.unravel_index(geodesics.argmax(), geodesics.shape))
    arc = geodesics[ends].min(axis=0) / geodesics.max()
    return _build(surface, radius, material, geodesics, arc)


def _build(surface: Surface, radius: float, material: ClothMaterial, geodesics: np.ndarray, arc: np.ndarray) -> Model:
    """Fit springs and bending to a surface and lump its masses."""
    masses = np.bincount(surface.faces.ravel(), np.repeat(surface.areas / 3.0, 3), len(surface.points)) * material.area_density
    shear = 0.375 * material.stretch_stiffness if material.shear_stiffness is None else material.shear_stiffness
    edges, stiffness = fit_springs(surface, material.stretch_stiffness, shear)
    rest_lengths = np.linalg.norm(surface.points[edges[:, 0]] - surface.points[edges[:, 1]], axis=1)
    bending = fit_bending(surface, material.bend_stiffness)
    is_flat = np.abs(bending.sines) < FLAT_SINE
    width = float(np.sqrt(len(surface.points)))
    return Model(
        rest_positions=surface.points.astype(np.float32),
        masses=masses.astype(np.float32),
        radius=float(radius),
        damping=material.damping,
        friction=material.friction,
        edges=edges.astype(np.int32),
        rest_lengths=rest_lengths.astype(np.float32),
        stretch_compliances=(1.0 / stiffness).astype(np.float32),
        bends=bending.triples.astype(np.int32),
        bend_compliances=(1.0 / bending.triple_stiffness).astype(np.float32),
        arc=arc.astype(np.float32),
        length=float(np.linalg.norm(np.ptp(surface.points, axis=0))),
        faces=surface.faces.astype(np.int32),
        mesh_edges=surface.edges.astype(np.int32),
        hinges=bending.hinges[is_flat].astype(np.int32),
        hinge_weights=bending.weights[is_flat].astype(np.float32),
        hinge_compliances=(1.0 / bending.hinge_stiffness[is_flat]).astype(np.float32),
        folds=bending.hinges[~is_flat].astype(np.int32),
        fold_sines=bending.sines[~is_flat].astype(np.float32),
        fold_compliances=_fold_compliances(surface, bending)[~is_flat].astype(np.float32),
        max_strain=material.max_strain,
        wrinkle_strain=material.wrinkle_strain,
        geodesics=geodesics.astype(np.float32),
        default_substeps=max(MIN_SUBSTEPS, round(SUBSTEPS_PER_NODE_ROW * width)),
    )


def _fold_compliances(surface: Surface, bending: Bending) -> np.ndarray:
    """Return inverse stiffnesses against sin(theta / 2) [1/(N m)]: a hinge on the edge e has |C| = 2 |e| sin(theta / 2)."""
    along = surface.points[bending.hinges[:, 1]] - surface.points[bending.hinges[:, 0]]
    return 1.0 / (4.0 * (along**2).sum(axis=1) * bending.hinge_stiffness)


def _name_nodes(mesh: PlanarMesh) -> dict[str, np.ndarray]:
    outer, holes = mesh.loops[0], mesh.loops[1:]
    names = {"corners": mesh.corners.astype(np.int64), "boundary": np.concatenate(mesh.loops).astype(np.int64)}
    start = [int(np.flatnonzero(outer == corner)[0]) for corner in mesh.corners]
    for index, (first, last) in enumerate(zip(start, start[1:] + start[:1], strict=True)):
        count = (last - first) % len(outer) + 1
        names[f"edge_{index}"] = outer[(first + np.arange(count)) % len(outer)].astype(np.int64)
    if holes:
        names["hole"] = np.concatenate(holes).astype(np.int64)
        names |= {f"hole_{index}": hole.astype(np.int64) for index, hole in enumerate(holes)}
    return names
