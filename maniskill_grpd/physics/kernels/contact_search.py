"""Search for what an object may touch of itself, called by the fused kernel a few times per control step.

Owners of contacts are nodes, which may touch triangles, and edges, which may touch edges behind them in the list. Elements
(triangles, edges) lie in blocks, each with a sphere about it, so that an owner passes over what is far away as a whole, in all
worlds of a group at once. What may touch is measured in the worlds where it may.
"""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.closest_points import closest_weights
from maniskill_grpd.physics.kernels.data import Objects, SelfContacts, Thread, Timing, Worlds
from maniskill_grpd.physics.kernels.lane_access import component, pick
from maniskill_grpd.physics.kernels.lanes import add, any_positive, div, greater, inner, lesser, mul, root, spread, sub  # noqa: F401 (operators on lanes)

# Elements in a block that a search passes over as a whole when all of it is too far away.
BLOCK = wp.constant(16)
# Elements that one owner can have found.
SLOTS = wp.constant(24)
# Distance, in thicknesses, within which elements are found even if they do not approach each other.
REACH = wp.constant(1.5)
# Most that two points are expected to approach each other between two searches [m]: both faster than a gripper.
MAX_APPROACH = wp.constant(0.02)
# Thickness of a contact between parts that lie close together in the material, relative to their distance there: at rest, and
# also when compressed, they must not touch.
NEIGHBOR_THICKNESS = wp.constant(0.6)


@wp.func
def owner_nodes(variant: int, owner: int, objects: Objects) -> wp.vec2i:
    """Return the nodes of an owner: those of an edge, or a node twice."""
    num_nodes = objects.node_counts[variant]
    if owner < num_nodes:
        return wp.vec2i(owner, owner)
    edge = objects.elements[objects.element_starts[variant] + objects.face_counts[variant] + owner - num_nodes]
    return wp.vec2i(edge[0], edge[1])


@wp.func
def contact_nodes(variant: int, owner: int, element: int, objects: Objects) -> wp.vec4i:
    """Return the four nodes that touch: node and triangle, or two edges."""
    corners = objects.elements[objects.element_starts[variant] + element]
    if owner < objects.node_counts[variant]:
        return wp.vec4i(owner, corners[0], corners[1], corners[2])
    own = owner_nodes(variant, owner, objects)
    return wp.vec4i(own[0], own[1], corners[0], corners[1])


@wp.func
def contact_thickness(variant: int, owner: int, element: int, objects: Objects) -> float:
    """Return the distance at which two elements touch, 0 if they share a node."""
    own = owner_nodes(variant, owner, objects)
    corners = objects.elements[objects.element_starts[variant] + element]
    apart = objects.geodesics[variant, own[0], corners[0]]
    for k in range(3):
        apart = wp.min(apart, objects.geodesics[variant, own[0], corners[k]])
        apart = wp.min(apart, objects.geodesics[variant, own[1], corners[k]])
    return wp.min(2.0 * objects.radii[variant], NEIGHBOR_THICKNESS * apart)


@wp.func
def bound_element(group: int, variant: int, element: int, objects: Objects, groups: Any):
    """Compute a sphere about a triangle or edge, at the mean of its corners, and its mean velocity."""
    corners = objects.elements[objects.element_starts[variant] + element]
    count = wp.where(element < objects.face_counts[variant], 3, 2)
    center = groups.positions[group, corners[0]]
    velocity = groups.velocities[group, corners[0]]
    for k in range(1, count):
        center = center + groups.positions[group, corners[k]]
        velocity = velocity + groups.velocities[group, corners[k]]
    center = center * (1.0 / float(count))
    farthest = spread(groups.weights[group, 0], 0.0)
    for k in range(count):
        offset = groups.positions[group, corners[k]] - center
        farthest = greater(farthest, inner(offset, offset))
    groups.element_centers[group, element] = center
    groups.element_radii[group, element] = root(farthest)
    groups.element_velocities[group, element] = velocity * (1.0 / float(count))


@wp.func
def block_elements(variant: int, block: int, objects: Objects) -> wp.vec2i:
    """Return the first element of a block and the one behind its last; blocks of edges follow those of triangles."""
    num_faces = objects.face_counts[variant]
    num_blocks = (num_faces + BLOCK - 1) // BLOCK
    if block < num_blocks:
        return wp.vec2i(block * BLOCK, wp.min((block + 1) * BLOCK, num_faces))
    num_elements = objects.element_starts[variant + 1] - objects.element_starts[variant]
    start = num_faces + (block - num_blocks) * BLOCK
    return wp.vec2i(start, wp.min(start + BLOCK, num_elements))


@wp.func
def bound_block(group: int, variant: int, block: int, objects: Objects, groups: Any):
    """Compute a sphere about the elements of a block, and one about their velocities."""
    span = block_elements(variant, block, objects)
    share = 1.0 / float(span[1] - span[0])
    center = spread(groups.element_centers[group, span[0]], 0.0)
    velocity = center
    for element in range(span[0], span[1]):
        center = center + groups.element_centers[group, element] * share
        velocity = velocity + groups.element_velocities[group, element] * share
    radius = spread(groups.weights[group, 0], 0.0)
    spreading = radius
    for element in range(span[0], span[1]):
        offset = groups.element_centers[group, element] - center
        radius = greater(radius, root(inner(offset, offset)) + groups.element_radii[group, element])
        offset = groups.element_velocities[group, element] - velocity
        spreading = greater(spreading, inner(offset, offset))
    groups.block_centers[group, block] = center
    groups.block_radii[group, block] = radius
    groups.block_velocities[group, block] = velocity
    groups.block_spreads[group, block] = root(spreading)


@wp.func
def farthest_slot(world: int, first_slot: int, contacts: SelfContacts) -> int:
    """Return the slot of the element that is farthest away, of an owner whose slots are all taken."""
    slot = first_slot
    for other in range(first_slot + 1, first_slot + SLOTS):
        if contacts.found_gaps[world, other] > contacts.found_gaps[world, slot]:
            slot = other
    return slot


@wp.func
def contact_gap(group: int, lane: int, nodes: wp.vec4i, is_edges: bool, groups: Any) -> wp.vec3:
    """Return the shortest vector from the second of two elements to the first in one world."""
    x_0 = pick(groups.positions, group, nodes[0], lane)
    x_1 = pick(groups.positions, group, nodes[1], lane)
    x_2 = pick(groups.positions, group, nodes[2], lane)
    x_3 = pick(groups.positions, group, nodes[3], lane)
    w_0, w_1, w_2, w_3 = closest_weights(is_edges, x_0, x_1, x_2, x_3)
    return x_0 * w_0 + x_1 * w_1 + x_2 * w_2 + x_3 * w_3


@wp.func
def may_cross(group: int, lane: int, nodes: wp.vec4i, slide: float, groups: Any) -> bool:
    """Return whether two edges of a cloth cross seen along their common normal, or do so after they slid by some distance.

    Where they do not, nodes and triangles touch before edges do.
    """
    first = pick(groups.positions, group, nodes[1], lane) - pick(groups.positions, group, nodes[0], lane)
    second = pick(groups.positions, group, nodes[3], lane) - pick(groups.positions, group, nodes[2], lane)
    offset = pick(groups.positions, group, nodes[2], lane) - pick(groups.positions, group, nodes[0], lane)
    normal = wp.cross(first, second)
    square = wp.length_sq(normal)
    along = wp.dot(wp.cross(offset, second), normal)
    other = wp.dot(wp.cross(offset, first), normal)
    # |first| slid along itself by a length is that length over |first| in units of the edge; likewise the second.
    margin = square * slide / wp.length(first)
    other_margin = square * slide / wp.length(second)
    if along < -margin or along > square + margin:
        return False
    return other >= -other_margin and other <= square + other_margin


@wp.func
def keep_nearest(world: int, owner: int, element: int, length: float, thickness: float, contacts: SelfContacts):
    """Write an element into a free slot, or that of the farthest if that one is farther; count what touches and has none."""
    count = contacts.found_counts[world, owner]
    slot = owner * SLOTS + count
    if count < SLOTS:
        contacts.found_counts[world, owner] = count + 1
    else:
        slot = farthest_slot(world, owner * SLOTS, contacts)
        farthest = contacts.found_gaps[world, slot]
        if wp.max(length, farthest) < thickness:
            wp.atomic_add(contacts.dropped, world, 1)
        if length >= farthest:
            return
    contacts.found[world, slot] = element
    contacts.found_gaps[world, slot] = length


@wp.func
def test_element(
    thread: Thread,
    owner: int,
    element: int,
    x: Any,
    v: Any,
    own_radius: Any,
    duration: float,
    objects: Objects,
    worlds: Worlds,
    groups: Any,
    contacts: SelfContacts,
):
    """Find an element in the worlds where an owner at x with velocity v may touch it before the next search."""
    group = thread.group
    variant = thread.variant
    offset = x - groups.element_centers[group, element]
    far = own_radius + groups.element_radii[group, element]
    apart = inner(offset, offset)
    thickness = float(2.0 * objects.radii[variant])
    widest = far + spread(far, REACH * thickness + MAX_APPROACH)
    if not any_positive(widest * widest - apart):
        return
    relative = v - groups.element_velocities[group, element]
    approach = lesser(root(inner(relative, relative)) * duration, spread(far, MAX_APPROACH))
    widest = far + spread(far, REACH * thickness) + approach
    if not any_positive(widest * widest - apart):
        return
    thickness = contact_thickness(variant, owner, element, objects)
    if thickness <= 0.0:
        return
    reach = far + spread(far, REACH * thickness) + approach
    is_near = reach * reach - apart
    if any_positive(is_near):
        nodes = contact_nodes(variant, owner, element, objects)
        is_edges = owner >= objects.node_counts[variant]
        for lane in range(groups.counts[group]):
            world = groups.members[group, lane]
            if component(is_near, lane) > 0.0 and not worlds.frozen[world]:
                slide = REACH * thickness + component(approach, lane)
                length = wp.length(contact_gap(group, lane, nodes, is_edges, groups))
                is_idle = is_edges and not objects.is_rope[variant] and not may_cross(group, lane, nodes, slide, groups)
                if length < slide and not is_idle:
                    keep_nearest(world, owner, element, length, thickness, contacts)


@wp.func
def find_elements(
    thread: Thread, owner: int, duration: float, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts
):
    """Find the elements that an owner may touch before the next search, in all worlds of a group."""
    group = thread.group
    variant = thread.variant
    for lane in range(groups.counts[group]):
        contacts.found_counts[groups.members[group, lane], owner] = 0
    num_nodes = objects.node_counts[variant]
    num_faces = objects.face_counts[variant]
    num_elements = objects.element_starts[variant + 1] - objects.element_starts[variant]
    first_block = int(0)
    end_block = (num_faces + BLOCK - 1) // BLOCK
    first = int(0)
    x = groups.positions[group, wp.min(owner, num_nodes - 1)]
    v = groups.velocities[group, wp.min(owner, num_nodes - 1)]
    own_radius = spread(groups.weights[group, 0], 0.0)
    if owner >= num_nodes:
        own = num_faces + owner - num_nodes
        first = own + 1
        first_block = end_block + (first - num_faces) // BLOCK
        end_block += (num_elements - num_faces + BLOCK - 1) // BLOCK
        x = groups.element_centers[group, own]
        v = groups.element_velocities[group, own]
        own_radius = groups.element_radii[group, own]
    for block in range(first_block, end_block):
        offset = x - groups.block_centers[group, block]
        relative = v - groups.block_velocities[group, block]
        speed = root(inner(relative, relative)) + groups.block_spreads[group, block]
        reach = own_radius + groups.block_radii[group, block] + lesser(speed * duration, spread(speed, MAX_APPROACH))
        reach = reach + spread(speed, REACH * 2.0 * objects.radii[variant])
        if any_positive(reach * reach - inner(offset, offset)):
            span = block_elements(variant, block, objects)
            for element in range(wp.max(first, span[0]), span[1]):
                test_element(thread, owner, element, x, v, own_radius, duration, objects, worlds, groups, contacts)


@wp.func
def find_contacts(thread: Thread, timing: Timing, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts):
    """Find for all owners in all worlds of a group what they may touch until the next search."""
    variant = thread.variant
    num_faces = objects.face_counts[variant]
    num_elements = objects.element_starts[variant + 1] - objects.element_starts[variant]
    for element in range(thread.first, num_elements, thread.stride):
        bound_element(thread.group, variant, element, objects, groups)
    synchronize_block()
    num_blocks = (num_faces + BLOCK - 1) // BLOCK + (num_elements - num_faces + BLOCK - 1) // BLOCK
    for block in range(thread.first, num_blocks, thread.stride):
        bound_block(thread.group, variant, block, objects, groups)
    synchronize_block()
    duration = 2.0 * float(timing.search_interval) * timing.dt
    num_owners = objects.node_counts[variant] + num_elements - num_faces
    for owner in range(thread.first, num_owners, thread.stride):
        find_elements(thread, owner, duration, objects, worlds, groups, contacts)
    synchronize_block()
