"""Cloth: an elastic sheet with bending stiffness, built from any polygon with holes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import trimesh

from maniskill_grpd.physics.mesh.distances import distances_in_sheet
from maniskill_grpd.physics.mesh.fit import fit_stiffness, quartic_coefficients
from maniskill_grpd.physics.mesh.outlines import check_holes, check_polygon
from maniskill_grpd.physics.mesh.triangulation import PlanarMesh, triangulate
from maniskill_grpd.physics.model import Model

MIN_NODES, MAX_NODES = 4, 2500
# Two triangles form nearly a rectangle, and get a spring across, if its diagonals differ by less than this factor.
RECTANGLE_RATIO = 1.2
# One substep passes tension on by about one node: larger meshes get more of them.
SUBSTEPS_PER_NODE_ROW = 1.0


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
    if not (np.isfinite(radius) and radius > 0.0):
        raise ValueError(f"the radius of a cloth must be finite and > 0 m, got {radius}")
    outline = check_polygon(outline, "the outline")
    holes = [check_polygon(hole, f"hole {index}") for index, hole in enumerate(holes)]
    check_holes(outline, holes)
    mesh = triangulate(outline, holes, num_nodes)

    surface = trimesh.Trimesh(_flat(mesh.points), mesh.faces, process=False)
    areas = surface.area_faces
    masses = np.bincount(mesh.faces.ravel(), np.repeat(areas / 3.0, 3), len(mesh.points)) * material.area_density
    edges, stiffness = _fit_springs(mesh.points, surface, material)
    rest_lengths = np.linalg.norm(mesh.points[edges[:, 0]] - mesh.points[edges[:, 1]], axis=1)
    hinges, weights, hinge_stiffness, triples, row_stiffness = _fit_bending(mesh.points, surface, material.bend_stiffness)
    geodesics = distances_in_sheet(mesh.points, mesh.loops)
    width = float(np.sqrt(len(mesh.points)))
    return Model(
        rest_positions=_flat(mesh.points).astype(np.float32),
        masses=masses.astype(np.float32),
        radius=float(radius),
        damping=material.damping,
        friction=material.friction,
        edges=edges.astype(np.int32),
        rest_lengths=rest_lengths.astype(np.float32),
        stretch_compliances=(1.0 / stiffness).astype(np.float32),
        bends=triples.astype(np.int32),
        bend_compliances=(1.0 / row_stiffness).astype(np.float32),
        arc=(geodesics[mesh.corners].min(axis=0) / geodesics.max()).astype(np.float32),
        length=float(np.linalg.norm(np.ptp(mesh.points, axis=0))),
        node_sets=_name_nodes(mesh),
        faces=mesh.faces.astype(np.int32),
        mesh_edges=surface.edges_unique.astype(np.int32),
        hinges=hinges.astype(np.int32),
        hinge_weights=weights.astype(np.float32),
        hinge_compliances=(1.0 / hinge_stiffness).astype(np.float32),
        max_strain=material.max_strain,
        wrinkle_strain=material.wrinkle_strain,
        geodesics=geodesics.astype(np.float32),
        default_substeps=max(20, round(SUBSTEPS_PER_NODE_ROW * width)),
    )


def _flat(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points, np.zeros(len(points))])


def _fit_springs(points: np.ndarray, surface: trimesh.Trimesh, material: ClothMaterial) -> tuple[np.ndarray, np.ndarray]:
    """Return springs (E, 2) along all edges, and across pairs of triangles that form a rectangle, with their stiffnesses [N/m].

    A spring of stiffness k strained along u stores 1/2 k (d . u)^4 / |d|^2 with d its rest vector. The sheet prescribes
    C_11 (cos^4 + sin^4) + 6 G cos^2 sin^2, where C_12 = G as in every network of springs, and E = C_11 - G^2 / C_11.
    """
    shear = 0.375 * material.stretch_stiffness if material.shear_stiffness is None else material.shear_stiffness
    c11 = 0.5 * (material.stretch_stiffness + np.sqrt(material.stretch_stiffness**2 + 4.0 * shear**2))
    target = np.array([0.75 * (c11 + shear), 0.0, 0.0, 0.25 * (c11 - 3.0 * shear), 0.0])
    edges, members = surface.edges_unique, _faces_of_edges(surface)
    across = surface.face_adjacency_unshared
    along = points[surface.face_adjacency_edges[:, 1]] - points[surface.face_adjacency_edges[:, 0]]
    diagonal = points[across[:, 1]] - points[across[:, 0]]
    ratio = np.linalg.norm(diagonal, axis=1) / np.linalg.norm(along, axis=1)
    is_rectangle = (ratio < RECTANGLE_RATIO) & (ratio > 1.0 / RECTANGLE_RATIO)
    edges = np.concatenate([edges, np.sort(across[is_rectangle], axis=1)])
    members = np.concatenate([members, surface.face_adjacency[is_rectangle]])
    vector = points[edges[:, 1]] - points[edges[:, 0]]
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    form = np.column_stack([vector**2, vector[:, 0] * vector[:, 1]]) / length
    order = np.lexsort(edges.T[::-1])
    members = np.where(members < 0, members[:, ::-1], members)  # a boundary spring belongs to its one triangle alone
    return edges[order], fit_stiffness(form, members, surface.area_faces, target)[order]


def _faces_of_edges(surface: trimesh.Trimesh) -> np.ndarray:
    """Return the one or two triangles at each unique edge, (E, 2), -1 for none."""
    members = np.full((len(surface.edges_unique), 2), -1, dtype=np.int64)
    for face, edges in enumerate(surface.faces_unique_edges):
        for edge in edges:
            members[edge, int(members[edge, 0] >= 0)] = face
    return members


def _fit_bending(
    points: np.ndarray, surface: trimesh.Trimesh, bend_stiffness: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Fit constraints that bend like a plate of the given rigidity [N m].

    Hinges have the cotangent weights of isometric bending (Bergou et al. 2006): C = sum_k weight_k x_k is linear in the positions
    and vanishes for all in-plane strains. Rolled up along u with curvature kappa it measures kappa times
    sum_k weight_k (u . x_k)^2 / 2. Where two right angles meet at a side, as in a square grid, a hinge sees but three nodes of
    a row; triples x_p - 2 x_m + x_n of all rows and columns take their place, so that no node is left free to bend.

    Free boundaries carry no moment: constraints that reach beyond them take part in the fit and are dropped.

    Returns:
        hinges: (H, 4), with weights (H, 4) and stiffnesses (H,) [N/m].
        triples: (T, 3), with stiffnesses (T,) [N/m].
    """
    if bend_stiffness == 0.0:
        return np.zeros((0, 4), np.int64), np.zeros((0, 4)), np.zeros(0), np.zeros((0, 3), np.int64), np.zeros(0)
    faces_of_edges = _faces_of_edges(surface)
    corners, hinge_faces = _hinges_with_mirrored(points, surface, faces_of_edges)
    weights = _hinge_weights(corners)
    is_row = np.abs(weights[:, :2]).min(axis=1) < 1e-5 * np.abs(weights).max(axis=1)
    triples, row_vectors, row_members = _rows(points, surface, faces_of_edges) if is_row.any() else _no_rows()
    is_row &= len(triples) > 0  # right angles of a lattice that is turned out of the axes belong to no row
    num_inner = len(surface.face_adjacency)
    kept = np.flatnonzero(~is_row)
    centered = corners - corners.mean(axis=1, keepdims=True)
    products = np.stack([centered[..., 0] ** 2, centered[..., 1] ** 2, centered[..., 0] * centered[..., 1]], axis=-1)
    form = 0.5 * (weights[..., None] * products).sum(axis=1)[kept]
    members = np.repeat(hinge_faces[kept], 2, axis=1)

    row_form = np.column_stack([row_vectors**2, row_vectors[:, 0] * row_vectors[:, 1]])
    target = quartic_coefficients(np.array([[1.0, 1.0, 0.0]]))[0] * bend_stiffness
    stiffness = fit_stiffness(
        np.concatenate([form, row_form]), np.concatenate([members, row_members]), surface.area_faces, target
    )
    is_hinge = kept < num_inner
    is_triple = triples[:, 2] >= 0
    hinges = np.column_stack([surface.face_adjacency_edges, surface.face_adjacency_unshared])[kept[is_hinge]]
    hinge_stiffness, row_stiffness = stiffness[: len(kept)], stiffness[len(kept) :]
    return hinges, weights[kept[is_hinge]], hinge_stiffness[is_hinge], triples[is_triple], row_stiffness[is_triple]


def _hinges_with_mirrored(
    points: np.ndarray, surface: trimesh.Trimesh, faces_of_edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (H, 4, 2) and triangles (H, 2) of all hinges, then those of boundary edges with a mirrored triangle."""
    boundary = np.flatnonzero(faces_of_edges[:, 1] < 0)
    rim, rim_face = surface.edges_unique[boundary], faces_of_edges[boundary, 0]
    apex = np.array([np.setdiff1d(surface.faces[f], e)[0] for f, e in zip(rim_face, rim, strict=True)])
    mirrored = np.stack([points[rim[:, 0]], points[rim[:, 1]], points[apex], points[apex]], axis=1)
    along = mirrored[:, 1] - mirrored[:, 0]
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    height = ((mirrored[:, 2] - mirrored[:, 0]) * normal).sum(axis=1, keepdims=True)
    mirrored[:, 3] = mirrored[:, 2] - 2.0 * height * normal
    inner = points[np.column_stack([surface.face_adjacency_edges, surface.face_adjacency_unshared])]
    faces = np.concatenate([surface.face_adjacency, np.column_stack([rim_face, np.full(len(rim), -1)])])
    return np.concatenate([inner, mirrored]), faces


def _rows(points: np.ndarray, surface: trimesh.Trimesh, faces_of_edges: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return triples of nodes in the rows and columns of a square grid.

    Where a row ends at a node its last edge alone counts, with -1 as the third node.

    Returns:
        triples: (previous, middle, next), (T, 3).
        vectors: From the middle to the next node, or to the previous one, (T, 2) [m].
        members: Triangles at the two edges, those at the boundary twice, -1 beyond the end, (T, 4).
    """
    vector = points[surface.edges_unique[:, 1]] - points[surface.edges_unique[:, 0]]
    straight = np.flatnonzero(np.abs(vector).min(axis=1) < 1e-6 * np.abs(vector).max(axis=1))
    around: dict[tuple[int, int, int], tuple[int, int]] = {}  # (node, axis, sign) -> (neighbor, edge)
    for edge in straight:
        axis = int(np.abs(vector[edge]).argmax())
        sign = int(np.sign(vector[edge, axis]))
        first, second = (int(node) for node in surface.edges_unique[edge])
        around[first, axis, sign], around[second, axis, -sign] = (second, edge), (first, edge)
    triples, vectors, members = [], [], []
    for (node, axis, sign), (neighbor, edge) in sorted(around.items()):
        step = points[neighbor] - points[node]
        other, other_edge = around.get((node, axis, -sign), (-1, -1))
        is_even = other >= 0 and np.linalg.norm(points[other] - points[node] + step) < 1e-3 * np.linalg.norm(step)
        faces = faces_of_edges[edge]
        faces = np.where(faces < 0, faces[::-1], faces)
        if is_even and sign > 0:
            other_faces = faces_of_edges[other_edge]
            triples.append([other, node, neighbor])
            members.append([*faces, *np.where(other_faces < 0, other_faces[::-1], other_faces)])
        elif not is_even:
            triples.append([neighbor, node, -1])
            members.append([*faces, -1, -1])
        else:
            continue
        vectors.append(step)
    return (np.array(triples), np.array(vectors), np.array(members)) if triples else _no_rows()


def _no_rows() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.zeros((0, 3), np.int64), np.zeros((0, 2)), np.zeros((0, 4), np.int64)


def _hinge_weights(corners: np.ndarray) -> np.ndarray:
    """Return the weights of hinges with planar corners (H, 4, 2): edge 0-1, opposite nodes 2 and 3."""

    def cotangent(at: int, a: int, b: int) -> np.ndarray:
        p, q = corners[:, a] - corners[:, at], corners[:, b] - corners[:, at]
        return (p * q).sum(axis=1) / np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])

    c01, c02 = cotangent(0, 1, 2), cotangent(0, 1, 3)
    c03, c04 = cotangent(1, 0, 2), cotangent(1, 0, 3)
    return np.column_stack([c03 + c04, c01 + c02, -c01 - c03, -c02 - c04])


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
