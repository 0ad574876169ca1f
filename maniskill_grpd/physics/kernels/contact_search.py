"""Search for pairs of elements of one object that may come to touch, called by the fused kernel when its list may lack some.

Owners of pairs are nodes, which may touch triangles, and edges, which may touch edges behind them in the list. Elements
(triangles, edges) lie in blocks, each with a sphere about it, so that an owner passes over what is far away as a whole. Distances
are computed in all worlds of a group at once. A pair is found if its elements are closer than `contact_margins` beyond their
thickness, so that the list is complete until nodes have come that much closer to each other.
"""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.closest_points import closest_on_edges, closest_on_triangle
from maniskill_grpd.physics.kernels.data import Objects, SelfContacts, Thread
from maniskill_grpd.physics.kernels.lane_access import component
from maniskill_grpd.physics.kernels.lanes import add, any_positive, div, greater, inner, lesser, mul, root, spread, sub  # noqa: F401 (operators on lanes)

# Elements in a block that a search passes over as a whole when all of it is too far away.
BLOCK = wp.constant(16)
# Elements that one owner can have found.
SLOTS = wp.constant(48)
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
def shares_node(own: wp.vec2i, corners: wp.vec3i) -> bool:
    """Return whether an owner and an element have a node in common."""
    for k in range(3):
        if own[0] == corners[k] or own[1] == corners[k]:
            return True
    return False


@wp.func
def bound_element(group: int, variant: int, element: int, objects: Objects, groups: Any):
    """Compute a sphere about a triangle or edge, at the mean of its corners."""
    corners = objects.elements[objects.element_starts[variant] + element]
    count = wp.where(element < objects.face_counts[variant], 3, 2)
    center = groups.positions[group, corners[0]]
    for k in range(1, count):
        center = center + groups.positions[group, corners[k]]
    center = center * (1.0 / float(count))
    farthest = spread(groups.weights[group, 0], 0.0)
    for k in range(count):
        offset = groups.positions[group, corners[k]] - center
        farthest = greater(farthest, inner(offset, offset))
    groups.element_centers[group, element] = center
    groups.element_radii[group, element] = root(farthest)


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
    """Compute a sphere about the elements of a block."""
    span = block_elements(variant, block, objects)
    share = 1.0 / float(span[1] - span[0])
    center = spread(groups.element_centers[group, span[0]], 0.0)
    for element in range(span[0], span[1]):
        center = center + groups.element_centers[group, element] * share
    radius = spread(groups.weights[group, 0], 0.0)
    for element in range(span[0], span[1]):
        offset = groups.element_centers[group, element] - center
        radius = greater(radius, root(inner(offset, offset)) + groups.element_radii[group, element])
    groups.block_centers[group, block] = center
    groups.block_radii[group, block] = radius


@wp.func
def farthest_slot(world: int, first_slot: int, contacts: SelfContacts) -> int:
    """Return the slot of the element that is farthest away, of an owner whose slots are all taken."""
    slot = first_slot
    for other in range(first_slot + 1, first_slot + SLOTS):
        if contacts.found_gaps[world, other] > contacts.found_gaps[world, slot]:
            slot = other
    return slot


@wp.func
def keep_nearest(world: int, owner: int, element: int, gap: float, contacts: SelfContacts):
    """Write an element behind those found before it; without a free slot the farthest is left out.

    How far that is limits how long the list is complete; what touches and is left out is counted. `gap` is the distance beyond
    the thickness [m].
    """
    count = contacts.found_counts[world, owner]
    last = owner * SLOTS + count
    if count < SLOTS:
        contacts.found_counts[world, owner] = count + 1
    else:
        slot = farthest_slot(world, owner * SLOTS, contacts)
        farthest = wp.max(gap, contacts.found_gaps[world, slot])
        contacts.found_reaches[world, owner] = wp.min(contacts.found_reaches[world, owner], farthest)
        if farthest < 0.0:
            wp.atomic_add(contacts.dropped, world, 1)
        if gap >= farthest:
            return
        last = owner * SLOTS + SLOTS - 1
        for other in range(slot, last):  # elements stay in their order
            contacts.found[world, other] = contacts.found[world, other + 1]
            contacts.found_gaps[world, other] = contacts.found_gaps[world, other + 1]
    contacts.found[world, last] = element
    contacts.found_gaps[world, last] = gap


@wp.func
def exceeds(distance: Any, reach: Any, offset: Any):
    """Return numbers > 0 where the distance of two things along an offset, times its length, is not beyond a reach."""
    least = greater(distance, spread(distance, 0.0))
    return reach * reach * inner(offset, offset) - least * least


@wp.func
def triangle_gap(group: int, node: int, element: int, corners: wp.vec3i, reach: Any, groups: Any):
    """Return the distance of a node from a triangle, or a number beyond reach if they are apart along the line of centres."""
    x = groups.positions[group, node]
    x_0 = groups.positions[group, corners[0]]
    x_1 = groups.positions[group, corners[1]]
    x_2 = groups.positions[group, corners[2]]
    offset = x - groups.element_centers[group, element]
    nearest = lesser(lesser(inner(x - x_0, offset), inner(x - x_1, offset)), inner(x - x_2, offset))
    length = reach + reach
    if any_positive(exceeds(nearest, reach, offset)):
        u, v, w = closest_on_triangle(x, x_0, x_1, x_2)
        between = x - x_0 * u - x_1 * v - x_2 * w
        length = root(inner(between, between))
    return length


@wp.func
def edge_gap(group: int, own: wp.vec2i, first: int, element: int, corners: wp.vec3i, reach: Any, groups: Any):
    """Return the distance of two edges, or a number beyond reach if they are apart along the line of their centres."""
    x_0 = groups.positions[group, own[0]]
    x_1 = groups.positions[group, own[1]]
    x_2 = groups.positions[group, corners[0]]
    x_3 = groups.positions[group, corners[1]]
    offset = groups.element_centers[group, first] - groups.element_centers[group, element]
    own_reach = inner(x_1 - x_0, offset)
    its_reach = inner(x_3 - x_2, offset)
    own_reach = greater(own_reach, own_reach * -1.0)
    its_reach = greater(its_reach, its_reach * -1.0)
    nearest = inner(offset, offset) - (own_reach + its_reach) * 0.5
    length = reach + reach
    if any_positive(exceeds(nearest, reach, offset)):
        along, other = closest_on_edges(x_0, x_1, x_2, x_3)
        between = x_0 - x_2 + (x_1 - x_0) * along - (x_3 - x_2) * other
        length = root(inner(between, between))
    return length


@wp.func
def keep_found(thread: Thread, owner: int, element: int, length: Any, objects: Objects, groups: Any, contacts: SelfContacts):
    """Keep an element in the worlds that are searched and where its distance from an owner is within reach."""
    group = thread.group
    gap = length - spread(length, contact_thickness(thread.variant, owner, element, objects))
    is_near = spread(gap, objects.contact_margins[thread.variant]) - gap + groups.searched[group, 0]
    if any_positive(is_near):
        for lane in range(groups.counts[group]):
            if component(is_near, lane) > 0.0:
                keep_nearest(groups.members[group, lane], owner, element, component(gap, lane), contacts)


@wp.func
def test_element(thread: Thread, owner: int, own: wp.vec2i, element: int, objects: Objects, groups: Any, contacts: SelfContacts):
    """Find an element in the worlds that are searched and where it is close to an owner."""
    group = thread.group
    variant = thread.variant
    corners = objects.elements[objects.element_starts[variant] + element]
    if shares_node(own, corners):
        return
    reach = spread(groups.weights[group, 0], 2.0 * objects.radii[variant] + objects.contact_margins[variant])
    if owner < objects.node_counts[variant]:
        length = triangle_gap(group, owner, element, corners, reach, groups)
        if any_positive(reach - length + groups.searched[group, 0]):
            keep_found(thread, owner, element, length, objects, groups, contacts)
    else:
        first = objects.face_counts[variant] + owner - objects.node_counts[variant]
        distance = edge_gap(group, own, first, element, corners, reach, groups)
        if any_positive(reach - distance + groups.searched[group, 0]):
            keep_found(thread, owner, element, distance, objects, groups, contacts)


@wp.func
def find_elements(thread: Thread, owner: int, objects: Objects, groups: Any, contacts: SelfContacts):
    """Find the elements that are close to an owner, in the worlds of a group that are searched."""
    group = thread.group
    variant = thread.variant
    margin = objects.contact_margins[variant]
    for lane in range(groups.counts[group]):
        contacts.found_counts[groups.members[group, lane], owner] = 0
        contacts.found_reaches[groups.members[group, lane], owner] = margin
    num_nodes = objects.node_counts[variant]
    num_faces = objects.face_counts[variant]
    num_elements = objects.element_starts[variant + 1] - objects.element_starts[variant]
    is_edges = owner >= num_nodes
    own = owner_nodes(variant, owner, objects)
    first_block = int(0)
    end_block = (num_faces + BLOCK - 1) // BLOCK
    first = int(0)
    x = groups.positions[group, own[0]]
    reach = spread(groups.weights[group, 0], 2.0 * objects.radii[variant] + margin)
    if is_edges:
        first = num_faces + owner - num_nodes + 1
        first_block = end_block + (first - num_faces) // BLOCK
        end_block += (num_elements - num_faces + BLOCK - 1) // BLOCK
        x = groups.element_centers[group, first - 1]
        reach = reach + groups.element_radii[group, first - 1]
    for block in range(first_block, end_block):
        offset = x - groups.block_centers[group, block]
        far = reach + groups.block_radii[group, block]
        if any_positive(far * far - inner(offset, offset) + groups.searched[group, 0]):
            span = block_elements(variant, block, objects)
            for element in range(wp.max(first, span[0]), span[1]):
                offset = x - groups.element_centers[group, element]
                far = reach + groups.element_radii[group, element]
                if any_positive(far * far - inner(offset, offset) + groups.searched[group, 0]):
                    test_element(thread, owner, own, element, objects, groups, contacts)


@wp.func
def find_pairs(thread: Thread, objects: Objects, groups: Any, contacts: SelfContacts):
    """Find for all owners what is close to them, in those worlds of a group where `searched` is 0 and not far below it."""
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
    num_owners = objects.node_counts[variant] + num_elements - num_faces
    for owner in range(thread.first, num_owners, thread.stride):
        find_elements(thread, owner, objects, groups, contacts)
    synchronize_block()
