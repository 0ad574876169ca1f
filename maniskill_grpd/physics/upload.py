"""Object variants and colliders laid out in memory as the kernel reads them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import warp as wp

from maniskill_grpd.physics.colliders import MAX_POLYGON_VERTICES, Collider
from maniskill_grpd.physics.kernels.data import Colliders, Features, Objects, Timing
from maniskill_grpd.physics.mesh.coloring import color_constraints
from maniskill_grpd.physics.model import Model

# Distance beyond the thickness up to which a search for contact of an object with itself finds: in mean edge lengths, so that
# neighbours in a flat mesh are not found, and at least and at most in thicknesses.
EDGE_MARGIN, LEAST_MARGIN, LARGEST_MARGIN = 0.2, 0.25, 2.5


def choose_features(models: Sequence[Model], colliders: Sequence[Collider], self_collision: bool, has_links: bool) -> Features:
    """Return what the kernel must be able to do."""
    return Features(
        ropes=any(model.is_rope for model in models),
        sheets=any(not model.is_rope for model in models),
        bends=any(len(model.bends) > 0 for model in models),
        hinges=any(len(model.hinges) > 0 for model in models),
        folds=any(len(model.folds) > 0 for model in models),
        tethers=any(np.isfinite(model.max_strain) for model in models),
        colliders=len(colliders) > 0,
        self_contact=self_collision,
        links=has_links,
    )


def geodesic_table(models: Sequence[Model]) -> np.ndarray:
    """Return the distance through the object from every node (row) to every other, (M, N, N) float32 [m], inf in the padding."""
    width = max(model.num_nodes for model in models)
    table = np.full((len(models), width, width), np.inf, dtype=np.float32)
    for index, model in enumerate(models):
        count = model.num_nodes
        table[index, :count, :count] = model.geodesic_distances(np.arange(count)).T
    return table


def upload_timings(substeps: Sequence[int], control_dt: float, device: str) -> wp.array:
    """Divide the control step of each variant, M numbers of substeps, and hand that to Warp as (M,) `Timing`."""
    timings = []
    for number in substeps:
        timing = Timing()
        timing.num_substeps, timing.dt = number, control_dt / number
        timings.append(timing)
    return wp.array(timings, dtype=Timing, device=device)


def upload_objects(models: Sequence[Model], geodesics: wp.array, device: str) -> Objects:
    """Hand the constraints of all variants to Warp, sorted by colour."""

    def array(values: np.ndarray, dtype: type) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

    objects = Objects()
    objects.node_counts = array([model.num_nodes for model in models], int)
    objects.radii = array([model.radius for model in models], float)
    objects.max_strains = array([model.max_strain for model in models], float)
    objects.wrinkling = array([max(1.0 - model.wrinkle_strain, 0.0) for model in models], float)
    lines = _lines_by_color(models)
    objects.line_ranges, objects.line_colors = array(lines["ranges"], int), array(lines["colors"], int)
    objects.line_edges, objects.line_nodes = array(lines["edges"], int), array(lines["nodes"], int)
    objects.rest_lengths = array(lines["rest_lengths"], float)
    objects.stretch_compliances = array(lines["compliances"], float)

    ranges, colors, (nodes, compliances) = _by_color([(model.bends, model.bend_compliances) for model in models])
    objects.bend_ranges, objects.bend_colors, objects.bends = array(ranges, int), array(colors, int), array(nodes, wp.vec3i)
    objects.bend_compliances = array(compliances, float)

    hinges = [(model.hinges, model.hinge_weights, model.hinge_compliances) for model in models]
    ranges, colors, (nodes, weights, compliances) = _by_color(hinges)
    objects.hinge_ranges, objects.hinge_colors, objects.hinges = array(ranges, int), array(colors, int), array(nodes, wp.vec4i)
    objects.hinge_weights, objects.hinge_compliances = array(weights, wp.vec4), array(compliances, float)

    folds = [(model.folds, model.fold_sines, model.fold_compliances) for model in models]
    ranges, colors, (nodes, sines, compliances) = _by_color(folds)
    objects.fold_ranges, objects.fold_colors, objects.folds = array(ranges, int), array(colors, int), array(nodes, wp.vec4i)
    objects.fold_sines, objects.fold_compliances = array(sines, float), array(compliances, float)

    surface_edges = [(model.surface_edges,) for model in models]
    ranges, colors, (nodes,) = _by_color(surface_edges)
    objects.mesh_edge_ranges, objects.mesh_edge_colors = array(ranges, int), array(colors, int)
    objects.mesh_edges = array(nodes, wp.vec2i)
    objects.longest_edges = array([_longest_edge(model) for model in models], float)

    elements = [_elements(model) for model in models]
    objects.element_starts = array(_starts([len(nodes) for nodes in elements]), int)
    objects.elements = array(np.concatenate(elements), wp.vec3i)
    objects.face_counts = array([len(model.faces) for model in models], int)
    features = [_features(nodes[: len(model.faces)]) for nodes, model in zip(elements, models, strict=True)]
    padded = [np.pad(bits, (0, len(nodes) - len(bits))) for bits, nodes in zip(features, elements, strict=True)]
    objects.face_features = array(np.concatenate(padded), int)
    objects.contact_margins = array([_contact_margin(model) for model in models], float)
    objects.is_rope = array([model.is_rope for model in models], wp.bool)
    objects.geodesics = geodesics
    return objects


def upload_colliders(colliders: Sequence[Collider], device: str) -> tuple[Colliders, list[wp.Mesh]]:
    """Hand the shapes of the colliders to Warp. The meshes live as long as the list that is returned with them."""
    polygons = np.zeros((len(colliders), MAX_POLYGON_VERTICES, 2), dtype=np.float32)
    meshes: list[wp.Mesh] = []
    handles = np.zeros(len(colliders), dtype=np.uint64)
    for index, collider in enumerate(colliders):
        if collider.polygon is not None:
            polygons[index, : len(collider.polygon)] = collider.polygon
        if collider.vertices is not None:
            points = wp.array(collider.vertices, dtype=wp.vec3, device=device)
            meshes.append(wp.Mesh(points, wp.array(collider.faces.ravel(), dtype=int, device=device)))
            handles[index] = meshes[-1].id
    data = Colliders()
    data.kinds = wp.array([int(collider.kind) for collider in colliders], dtype=int, device=device)
    sizes = [0 if collider.polygon is None else len(collider.polygon) for collider in colliders]
    data.polygon_sizes = wp.array(sizes, dtype=int, device=device)
    data.polygons = wp.array(polygons, dtype=wp.vec2, device=device)
    data.meshes = wp.array(handles, dtype=wp.uint64, device=device)
    outlines = [collider.polygon if collider.vertices is None else collider.vertices for collider in colliders]
    bounds = np.zeros((2, len(colliders), 3), dtype=np.float32)
    for index, points in enumerate(outlines):
        if points is not None:
            bounds[:, index, : points.shape[1]] = points.min(axis=0), points.max(axis=0)
    data.lows, data.highs = (wp.array(corner, dtype=wp.vec3, device=device) for corner in bounds)
    return data, meshes


def _longest_edge(model: Model) -> float:
    """Return the length of the longest edge that touches colliders [m]."""
    i, j = model.surface_edges.T
    return float(np.linalg.norm(model.rest_positions[i] - model.rest_positions[j], axis=1).max())


def _contact_margin(model: Model) -> float:
    """Return the distance beyond the thickness up to which a search for contact of an object with itself finds [m]."""
    i, j = model.surface_edges.T
    mean = float(np.linalg.norm(model.rest_positions[i] - model.rest_positions[j], axis=1).mean())
    thickness = 2.0 * model.radius
    return float(np.clip(EDGE_MARGIN * mean, LEAST_MARGIN * thickness, LARGEST_MARGIN * thickness))


def _features(faces: np.ndarray) -> np.ndarray:
    """Return for which of their corners (bits 0 to 2) and edges opposite to these (bits 3 to 5) triangles (F, 3) stand, (F,).

    Each node and edge of the mesh is that of the first triangle that has it.
    """
    seen: set[tuple[int, ...]] = set()
    bits = np.zeros(len(faces), dtype=np.int32)
    for index, corners in enumerate(faces.tolist()):
        edges = [tuple(sorted((corners[k - 2], corners[k - 1]))) for k in range(3)]
        for bit, feature in enumerate([(corner,) for corner in corners] + edges):
            if feature not in seen:
                seen.add(feature)
                bits[index] |= 1 << bit
    return bits


def _starts(counts: Sequence[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)


def _lines_by_color(models: Sequence[Model]) -> dict[str, np.ndarray]:
    """Lay out the lines of all variants: `ranges` and `colors` as in `_by_color`, first edge of each line, nodes and columns."""
    counts, colors, lines, columns, total = [], [], [], [], 0
    for model in models:
        order, offsets = color_constraints(model.lines)
        sorted_lines = [model.lines[index] for index in order]
        colors.append(offsets + total)
        counts.append(len(offsets))
        total += len(order)
        lines += sorted_lines
        number = {tuple(sorted(nodes)): edge for edge, nodes in enumerate(model.edges.tolist())}
        edges = [number[tuple(sorted(pair))] for line in sorted_lines for pair in pairwise(line.tolist())]
        columns.append((model.rest_lengths[edges], model.stretch_compliances[edges]))
    return {
        "ranges": _starts(counts),
        "colors": np.concatenate(colors).astype(np.int32),
        "edges": _starts([len(line) - 1 for line in lines]),
        "nodes": np.concatenate(lines).astype(np.int32),
        "rest_lengths": np.concatenate([rest_lengths for rest_lengths, _ in columns]),
        "compliances": np.concatenate([compliances for _, compliances in columns]),
    }


def _by_color(variants: Sequence[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Sort the constraints of each variant by colour and put the variants one after the other.

    Args:
        variants: For each variant the nodes (C, k) of its constraints and further columns, each (C, ...).

    Returns:
        ranges: First entry of each variant in `colors`, closed by its length, (M + 1,) int32.
        colors: First constraint of each colour, and behind the last colour of a variant the end of its constraints, int32.
        columns: The columns of all variants in that order.
    """
    counts, colors, sorted_columns, total = [], [], [], 0
    for columns in variants:
        order, offsets = color_constraints(columns[0])
        colors.append(offsets + total)
        counts.append(len(offsets))
        sorted_columns.append([column[order] for column in columns])
        total += len(order)
    joined = [np.concatenate(column) for column in zip(*sorted_columns, strict=True)]
    return _starts(counts), np.concatenate(colors).astype(np.int32), joined


def _elements(model: Model) -> np.ndarray:
    """Return the triangles of a cloth, then its edges, or those of a rope, with their second node twice, (F + E, 3).

    Each are sorted so that those that follow each other lie together, in blocks rather than in rows.
    """
    edges = model.surface_edges[:, [0, 1, 1]]
    if model.is_rope:
        return edges
    middles = [model.rest_positions[nodes].mean(axis=1) for nodes in (model.faces, model.surface_edges)]
    order = [np.argsort(_z_order(points), kind="stable") for points in middles]
    return np.concatenate([model.faces[order[0]], edges[order[1]]])


def _z_order(points: np.ndarray) -> np.ndarray:
    """Return keys (P,) int64 that sort points (P, 3) along a curve that fills space (Morton 1966)."""
    low = points.min(axis=0)
    cells = ((points - low) / max(np.ptp(points, axis=0).max(), 1e-9) * 1023.0).astype(np.int64)
    bits = np.arange(10)
    spread = ((cells[:, :, None] >> bits) & 1) << (3 * bits)
    return (spread.sum(axis=2) << np.arange(3)).sum(axis=1)
