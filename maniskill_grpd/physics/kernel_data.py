"""What the fused kernel reads: features, object variants, obstacles and contact candidates.

Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

from dataclasses import dataclass

import warp as wp


@dataclass(frozen=True)
class Features:
    """What the worlds of a solver contain. Everything else is left out of its kernel."""

    bends: bool = False
    hinges: bool = False
    tethers: bool = False
    colliders: bool = False
    self_contact: bool = False


@wp.struct
class Objects:
    """The M variants, one after the other in flat arrays. Constraints are sorted by colour.

    Colours of variant m are `*_colors[*_ranges[m]] ... `, each the first constraint of a colour, closed by the end of the last.
    """

    node_counts: wp.array(dtype=int)
    radii: wp.array(dtype=float)
    max_stretch: wp.array(dtype=float)  # 1 + max_strain
    # Lines of edges; line l has the edges line_edges[l] ... line_edges[l + 1], and one node more.
    line_ranges: wp.array(dtype=int)
    line_colors: wp.array(dtype=int)
    line_edges: wp.array(dtype=int)
    line_nodes: wp.array(dtype=int)
    rest_lengths: wp.array(dtype=float)
    stretch_compliances: wp.array(dtype=float)
    bend_ranges: wp.array(dtype=int)
    bend_colors: wp.array(dtype=int)
    bends: wp.array(dtype=wp.vec3i)
    bend_compliances: wp.array(dtype=float)
    hinge_ranges: wp.array(dtype=int)
    hinge_colors: wp.array(dtype=int)
    hinges: wp.array(dtype=wp.vec4i)
    hinge_weights: wp.array(dtype=wp.vec4)
    hinge_compliances: wp.array(dtype=float)
    geodesics: wp.array3d(dtype=float)  # through the material between all nodes, by variant
    # Edges that touch obstacles with all their length.
    mesh_edge_ranges: wp.array(dtype=int)
    mesh_edge_colors: wp.array(dtype=int)
    mesh_edges: wp.array(dtype=wp.vec2i)
    # Triangles of cloth and segments of ropes, for contact of an object with itself.
    element_starts: wp.array(dtype=int)
    elements: wp.array(dtype=wp.vec3i)
    element_radii: wp.array(dtype=float)
    owner_counts: wp.array(dtype=int)
    exclusions: wp.array(dtype=float)
    is_rope: wp.array(dtype=wp.bool)


@wp.struct
class Obstacles:
    """The K colliders and their pose, size and switch in every world."""

    kinds: wp.array(dtype=int)
    polygon_sizes: wp.array(dtype=int)
    polygons: wp.array2d(dtype=wp.vec2)
    meshes: wp.array(dtype=wp.uint64)
    positions: wp.array2d(dtype=wp.vec3)
    rotations: wp.array2d(dtype=wp.vec4)
    sizes: wp.array2d(dtype=wp.vec3)
    active: wp.array2d(dtype=wp.bool)


@wp.struct
class SelfContacts:
    """Candidates of contact of an object with itself, in every world."""

    nodes: wp.array2d(dtype=wp.vec4i)
    sides: wp.array2d(dtype=float)
    gaps: wp.array2d(dtype=float)
    weights: wp.array2d(dtype=wp.vec4)
    impulses: wp.array2d(dtype=wp.vec3)
    counts: wp.array2d(dtype=int)
    of_node: wp.array3d(dtype=int)
    num_of_node: wp.array2d(dtype=int)
    num_active: wp.array2d(dtype=int)
    block_spheres: wp.array2d(dtype=wp.vec4)
    block_speeds: wp.array2d(dtype=float)
