"""What the fused kernel works on: features, object variants, colliders, worlds and the groups in which worlds are advanced.

Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

from dataclasses import dataclass

import warp as wp

from maniskill_grpd.physics.fields import Field, fields_of_struct
from maniskill_grpd.physics.kernels.lanes import Numbers, Vectors


@wp.struct
class Thread:
    """What one thread does: of the group of its block it takes every `stride`-th node, edge, ... from `first` on."""

    group: int
    variant: int  # of all worlds of the group
    first: int
    stride: int


@wp.struct
class Line:
    """Where the edges and nodes of a line are in `Objects`, and what is computed for them in the scratch of a group."""

    first_edge: int
    first_node: int
    first_column: int  # of its edges among those of the object
    first_scratch: int
    num_edges: int


@wp.struct
class Timing:
    """How the control steps of a variant are divided."""

    num_substeps: int
    dt: float  # duration of a substep [s]


@dataclass(frozen=True)
class Features:
    """What the worlds of a solver contain. Everything else is left out of its kernel."""

    ropes: bool = False
    sheets: bool = False
    bends: bool = False
    hinges: bool = False
    folds: bool = False
    tethers: bool = False
    colliders: bool = False
    self_contact: bool = False
    links: bool = False


@wp.struct
class Objects:
    """The M variants, one after the other in flat arrays. Constraints are sorted by colour.

    Colours of variant m are `*_colors[*_ranges[m]] ... `, each the first constraint of a colour, closed by the end of the last.
    """

    node_counts: wp.array(dtype=int)
    radii: wp.array(dtype=float)
    max_strains: wp.array(dtype=float)
    wrinkling: wp.array(dtype=float)  # 1 - wrinkle_strain, 0 where edges never give way
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
    fold_ranges: wp.array(dtype=int)
    fold_colors: wp.array(dtype=int)
    folds: wp.array(dtype=wp.vec4i)
    fold_sines: wp.array(dtype=float)
    fold_compliances: wp.array(dtype=float)
    geodesics: wp.array3d(dtype=float)  # through the material between all nodes, by variant
    # Edges that touch colliders with all their length.
    longest_edges: wp.array(dtype=float)
    mesh_edge_ranges: wp.array(dtype=int)
    mesh_edge_colors: wp.array(dtype=int)
    mesh_edges: wp.array(dtype=wp.vec2i)
    # Triangles, then edges (with their second node twice), for contact of an object with itself.
    element_starts: wp.array(dtype=int)
    elements: wp.array(dtype=wp.vec3i)
    face_counts: wp.array(dtype=int)
    face_features: wp.array(dtype=int)  # corners and edges for which a triangle stands, see `is_represented`
    contact_margins: wp.array(dtype=float)  # distance beyond the thickness up to which a search finds
    is_rope: wp.array(dtype=wp.bool)


def _record(name: str, fields: dict[str, Field], doc: str, **others: wp.array) -> type:
    """Return a class with the annotations of some fields and of others beside them."""
    annotations = {**others, **{key: field.array_type for key, field in fields.items()}}
    return type(name, (), {"__annotations__": annotations, "__doc__": doc, "__module__": __name__, "__qualname__": name})


Colliders = wp.struct(
    _record(
        "Colliders",
        fields_of_struct("colliders"),
        "The K colliders: their shapes with bounds (of polygons and meshes), and their pose, size and switch in every world.",
        kinds=wp.array(dtype=int),
        polygon_sizes=wp.array(dtype=int),
        polygons=wp.array2d(dtype=wp.vec2),
        meshes=wp.array(dtype=wp.uint64),
        lows=wp.array(dtype=wp.vec3),
        highs=wp.array(dtype=wp.vec3),
    )
)


@wp.struct
class PlacedCollider:
    """One collider as it stands in one world."""

    index: int
    kind: int
    num_vertices: int  # of its polygon
    mesh: wp.uint64
    size: wp.vec3
    position: wp.vec3
    rotation: wp.quat


@wp.struct
class Links:
    """The L links of arms: capsules that belong to grippers and move; bits of numbers say which of them nodes may touch."""

    owners: wp.array(dtype=int)
    radii: wp.array(dtype=float)
    starts: wp.array2d(dtype=wp.vec3)  # both ends of their axes before a control step, (B, 2 L)
    ends: wp.array2d(dtype=wp.vec3)  # and after it
    near: wp.array2d(dtype=int)
    pinched: wp.array2d(dtype=int)  # between whose fingers nodes lie
    near_any: wp.array2d(dtype=int)  # in any world of a group


@wp.struct
class SelfContacts:
    """Contact of an object with itself, in every world: what owners found, the list of pairs, the contacts of a substep."""

    found: wp.array2d(dtype=int)  # elements, in the slots of each owner
    found_gaps: wp.array2d(dtype=float)  # distances beyond the thickness
    found_counts: wp.array2d(dtype=int)
    found_reaches: wp.array2d(dtype=float)  # distance beyond the thickness of the nearest that was left out
    anchors: wp.array2d(dtype=wp.vec3)  # where nodes were when motion was measured last
    motions: wp.array(dtype=float)  # how much closer any two points may have come since the time before
    travels: wp.array(dtype=float)  # and since the list was made
    slacks: wp.array(dtype=float)  # distance beyond the thickness within which pairs are near
    reaches: wp.array(dtype=float)  # and within which the list was complete when it was made
    starts: wp.array2d(dtype=int)  # first pair of each owner, and behind its last
    ends: wp.array2d(dtype=int)
    num_pairs: wp.array(dtype=int)
    first_edges: wp.array(dtype=int)  # pairs of edges follow those of nodes
    owners: wp.array2d(dtype=int)
    elements: wp.array2d(dtype=int)
    wakes: wp.array2d(dtype=float)  # distances beyond the thickness, added to the travel until they were measured
    pair_nodes: wp.array2d(dtype=wp.vec4i)
    pair_thicknesses: wp.array2d(dtype=float)
    pair_normals: wp.array2d(dtype=wp.vec3)  # 0 for pairs that are not near
    pair_distances: wp.array2d(dtype=float)  # along the normals, < 0 for what has crossed
    old_starts: wp.array2d(dtype=int)
    old_ends: wp.array2d(dtype=int)
    old_elements: wp.array2d(dtype=int)
    old_normals: wp.array2d(dtype=wp.vec3)
    num_contacts: wp.array(dtype=int)
    first_edge_contacts: wp.array(dtype=int)
    pairs: wp.array2d(dtype=int)  # of which contacts are made, -1 for one that does nothing
    nodes: wp.array2d(dtype=wp.vec4i)
    thicknesses: wp.array2d(dtype=float)
    normals: wp.array2d(dtype=wp.vec3)
    distances: wp.array2d(dtype=float)
    lengths: wp.array2d(dtype=float)  # of the gaps
    weights: wp.array3d(dtype=float)  # of the four nodes
    insides: wp.array2d(dtype=float)  # > 0 where closest points are in the middle of both elements
    starts_of_gaps: wp.array2d(dtype=wp.vec3)  # at the start of the substep
    masses: wp.array2d(dtype=float)  # 0 for what does not act
    num_sweeps: wp.array(dtype=int)
    dropped: wp.array(dtype=int)


Worlds = wp.struct(
    _record(
        "Worlds",
        fields_of_struct("worlds"),
        "The state of all worlds, see `FIELDS`; where a rope touches colliders between each two of the A grippers, (B, A * A).",
        way_starts=wp.array2d(dtype=wp.vec3),
        way_ends=wp.array2d(dtype=wp.vec3),
        way_lengths=wp.array2d(dtype=float),  # -1 where it does not
        way_spans=wp.array2d(dtype=wp.vec2),  # through the rope to the first and from the last of these places
    )
)


def _groups(number: type, vector: type) -> type:
    """Return the type of scratch of groups of worlds that are advanced together."""

    @wp.struct
    class Groups:
        """Scratch of the G groups during a control step; a column for each node, gripper or edge, or a single one."""

        members: wp.array2d(dtype=int)  # world in each lane; lanes without one repeat the first
        counts: wp.array(dtype=int)  # lanes that have a world of their own
        gravity: wp.array2d(dtype=vector)
        table_normals: wp.array2d(dtype=vector)
        table_offsets: wp.array2d(dtype=number)
        friction: wp.array2d(dtype=number)
        decays: wp.array2d(dtype=number)
        stretch_rates: wp.array2d(dtype=number)  # 1 / (scale of the stiffness * dt^2)
        bend_rates: wp.array2d(dtype=number)
        positions: wp.array2d(dtype=vector)
        previous: wp.array2d(dtype=vector)
        velocities: wp.array2d(dtype=vector)
        weights: wp.array2d(dtype=number)  # inverse masses as constraints see them, 0 for held and fixed nodes
        reactions: wp.array2d(dtype=vector)
        is_free: wp.array2d(dtype=wp.bool)  # in all lanes
        is_held: wp.array2d(dtype=wp.bool)  # in any lane
        held: wp.array2d(dtype=number)  # 1 for held nodes, and for these:
        hold_starts: wp.array2d(dtype=vector)
        hold_motions: wp.array2d(dtype=vector)
        hold_offsets: wp.array2d(dtype=vector)
        pulls: wp.array2d(dtype=vector)  # of the tethers on each gripper, summed over the step
        has_tethers: wp.array2d(dtype=wp.bool)
        tether_ends: wp.array2d(dtype=vector)
        tether_lengths: wp.array3d(dtype=number)
        tether_impulses: wp.array3d(dtype=vector)
        directions: wp.array2d(dtype=vector)
        straightened: wp.array2d(dtype=vector)
        # Colliders: position, axes (three each) and the bounding box along these; > 0 where a node is near one of them.
        collider_positions: wp.array2d(dtype=vector)
        collider_axes: wp.array2d(dtype=vector)
        collider_lows: wp.array2d(dtype=number)
        collider_highs: wp.array2d(dtype=number)
        nearness: wp.array2d(dtype=number)
        # Spheres about the elements that may touch each other, and about blocks of them.
        element_centers: wp.array2d(dtype=vector)
        element_radii: wp.array2d(dtype=number)
        block_centers: wp.array2d(dtype=vector)
        block_radii: wp.array2d(dtype=number)
        anchors: wp.array2d(dtype=vector)  # see `SelfContacts`
        lowest_motions: wp.array2d(dtype=vector)  # of the nodes of each thread, by component
        highest_motions: wp.array2d(dtype=vector)
        searched: wp.array2d(dtype=number)  # 0 for worlds whose list is made anew, far below it for the others
        touching: wp.array2d(dtype=number)  # 1 for nodes of pairs that are near
        upper: wp.array2d(dtype=number)
        carried: wp.array2d(dtype=number)  # impulses that pull the ends of the edges of a sheet together in every substep
        multipliers: wp.array2d(dtype=number)

    return Groups


LaneGroups = _groups(Numbers, Vectors)
"""Groups of worlds in lanes, for CPU."""
SingleGroups = _groups(float, wp.vec3)
"""Groups of one world each, for CUDA."""
