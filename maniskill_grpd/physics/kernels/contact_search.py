"""Search for what an object may touch of itself, called by the fused kernel a few times per control step.

Elements (triangles, segments) lie in blocks and blocks in clusters, each with a sphere about it, so that a node passes over what
is far away as a whole. Every owner writes into its own slots only.
"""

import warp as wp

from maniskill_grpd.physics.kernels.block import count_up
from maniskill_grpd.physics.kernels.data import Objects, SelfContacts, Touch
from maniskill_grpd.physics.kernels.self_contact import MAX_CONTACTS_PER_NODE, SLOTS, barycentric_gap, closest_weights, facing

# Elements in a block that a search passes over as a whole when all of it is too far away.
BLOCK = wp.constant(16)
# Distance [radii] within which elements are candidates even if they do not approach each other; they touch at two.
REACH = wp.constant(3.0)
# Most that two points are expected to approach each other between two searches [m]: both at twice the speed of a gripper.
MAX_APPROACH = wp.constant(0.04)


@wp.func
def bound_element(world: int, element: int, variant: int, objects: Objects, touch: Touch, contacts: SelfContacts):
    """Compute a sphere (centre, radius) about a triangle, at its centroid, or about a segment, at its middle."""
    corners = objects.elements[objects.element_starts[variant] + element]
    x_0 = touch.positions[world, corners[0]]
    x_1 = touch.positions[world, corners[1]]
    x_2 = touch.positions[world, corners[2]]
    center = (x_0 + x_1 + x_2) / 3.0
    if objects.is_rope[variant]:
        center = (x_0 + x_1) / 2.0
    radius = wp.max(wp.length(x_0 - center), wp.max(wp.length(x_1 - center), wp.length(x_2 - center)))
    contacts.element_spheres[world, element] = wp.vec4(center[0], center[1], center[2], radius)


@wp.func
def bound_block(
    world: int, block: int, first_element: int, num_elements: int, objects: Objects, touch: Touch, contacts: SelfContacts
):
    """Compute a sphere about the elements of a block, and one about the velocities of their first corners."""
    contacts.block_spheres[world, block] = bound_spheres(world, block, num_elements, contacts.element_spheres)
    start = block * BLOCK
    end = wp.min(start + BLOCK, num_elements)
    velocity = wp.vec3(0.0, 0.0, 0.0)
    for element in range(start, end):
        velocity += touch.velocities[world, objects.elements[first_element + element][0]] / float(end - start)
    spread = float(0.0)
    for element in range(start, end):
        spread = wp.max(spread, wp.length(touch.velocities[world, objects.elements[first_element + element][0]] - velocity))
    contacts.block_motions[world, block] = wp.vec4(velocity[0], velocity[1], velocity[2], spread)


@wp.func
def bound_spheres(world: int, block: int, count: int, spheres: wp.array2d(dtype=wp.vec4)) -> wp.vec4:
    """Return a sphere about those of `count` spheres that lie in one block."""
    start = block * BLOCK
    end = wp.min(start + BLOCK, count)
    center = wp.vec3(0.0, 0.0, 0.0)
    for k in range(start, end):
        sphere = spheres[world, k]
        center += wp.vec3(sphere[0], sphere[1], sphere[2]) / float(end - start)
    radius = float(0.0)
    for k in range(start, end):
        sphere = spheres[world, k]
        radius = wp.max(radius, wp.length(wp.vec3(sphere[0], sphere[1], sphere[2]) - center) + sphere[3])
    return wp.vec4(center[0], center[1], center[2], radius)


@wp.func
def is_near(x: wp.vec3, sphere: wp.vec4, margin: float) -> bool:
    """Return whether a point is less than a margin away from a sphere (centre, radius)."""
    offset = x - wp.vec3(sphere[0], sphere[1], sphere[2])
    far = sphere[3] + margin
    return wp.dot(offset, offset) < far * far


@wp.func
def farthest_slot(world: int, first_slot: int, contacts: SelfContacts) -> int:
    """Return the slot of the candidate that is farthest away, of an owner whose slots are all taken."""
    slot = first_slot
    for other in range(first_slot + 1, first_slot + SLOTS):
        if contacts.gaps[world, other] > contacts.gaps[world, slot]:
            slot = other
    return slot


@wp.func
def keep_nearest(
    world: int,
    owner: int,
    num_found: int,
    nodes: wp.vec4i,
    is_rope: bool,
    reach: float,
    thickness: float,
    touch: Touch,
    contacts: SelfContacts,
) -> int:
    """Write a candidate within reach into a free slot or that of the farthest, if that one is farther.

    Returns:
        1 if a slot was filled that was free, -1 if two elements that touch had to share one.
    """
    weight = closest_weights(world, nodes, is_rope, touch.positions)
    gap = barycentric_gap(weight, nodes, world, touch.positions)
    length = wp.length(gap)
    if length >= reach:
        return 0
    slot = owner * SLOTS + num_found
    result = int(1)
    if num_found == SLOTS:
        slot = farthest_slot(world, owner * SLOTS, contacts)
        farthest = contacts.gaps[world, slot]
        result = wp.where(wp.max(length, farthest) < thickness, -1, 0)
        if length >= farthest:
            return result
    contacts.nodes[world, slot] = nodes
    contacts.gaps[world, slot] = length
    side = wp.dot(gap, facing(world, nodes, is_rope, touch.positions))
    contacts.sides[world, slot] = wp.where(side < 0.0, -1.0, 1.0)
    return result


@wp.func
def through_material(variant: int, owner: int, corners: wp.vec3i, geodesics: wp.array3d(dtype=float)) -> float:
    """Return the distance through the material from a node to the nearest corner of an element."""
    first = geodesics[variant, owner, corners[0]]
    return wp.min(first, wp.min(geodesics[variant, owner, corners[1]], geodesics[variant, owner, corners[2]]))


@wp.func
def find_candidates(
    world: int, owner: int, variant: int, duration: float, objects: Objects, touch: Touch, contacts: SelfContacts
) -> int:
    """Fill the slots of a node (or segment) with the nearest elements that it may touch before the next search.

    Elements that are closer than the exclusion through the material are neighbours rather than contacts. When the slots are full
    the farthest gives way, so that the result does not depend on anything but the positions. Returns how many elements found no
    slot although they touch.
    """
    first_element = objects.element_starts[variant]
    num_elements = objects.element_starts[variant + 1] - first_element
    is_rope = objects.is_rope[variant]
    reach = REACH * objects.radii[variant]
    thickness = 2.0 * objects.radii[variant]
    num_found = int(0)
    num_lost = int(0)
    start = int(0)
    x = touch.positions[world, owner]
    v = touch.velocities[world, owner]
    own_radius = float(0.0)
    if is_rope:
        start = owner + 1
        sphere = contacts.element_spheres[world, owner]
        x = wp.vec3(sphere[0], sphere[1], sphere[2])
        own_radius = sphere[3]
    extent = reach + own_radius
    farthest = float(MAX_APPROACH + reach)  # gap of the last candidate, once all slots are taken
    num_blocks = (num_elements + BLOCK - 1) // BLOCK
    for cluster in range(start // (BLOCK * BLOCK), (num_blocks + BLOCK - 1) // BLOCK):
        if not is_near(x, contacts.cluster_spheres[world, cluster], extent + MAX_APPROACH):
            continue
        for block in range(wp.max(cluster * BLOCK, start // BLOCK), wp.min((cluster + 1) * BLOCK, num_blocks)):
            motion = contacts.block_motions[world, block]
            speed = wp.length(v - wp.vec3(motion[0], motion[1], motion[2])) + motion[3]
            block_approach = wp.min(speed * duration, MAX_APPROACH)
            if not is_near(x, contacts.block_spheres[world, block], extent + block_approach):
                continue
            for element in range(wp.max(start, block * BLOCK), wp.min((block + 1) * BLOCK, num_elements)):
                sphere = contacts.element_spheres[world, element]
                if is_near(x, sphere, extent + block_approach):
                    corners = objects.elements[first_element + element]
                    approach = wp.min(wp.length(v - touch.velocities[world, corners[0]]) * duration, MAX_APPROACH)
                    wanted = wp.min(reach + approach, wp.max(farthest, thickness))
                    if is_near(x, sphere, own_radius + wanted) and (
                        through_material(variant, owner, corners, objects.geodesics) > objects.exclusions[variant]
                    ):
                        nodes = wp.vec4i(owner, corners[0], corners[1], corners[2])
                        if is_rope:
                            nodes = wp.vec4i(owner, owner + 1, corners[0], corners[1])
                        kept = keep_nearest(world, owner, num_found, nodes, is_rope, reach + approach, thickness, touch, contacts)
                        num_found += wp.max(kept, 0)
                        num_lost -= wp.min(kept, 0)
                        if num_found == SLOTS:
                            farthest = contacts.gaps[world, farthest_slot(world, owner * SLOTS, contacts)]
    contacts.counts[world, owner] = num_found
    return num_lost


@wp.func
def register_contacts(world: int, owner: int, contacts: SelfContacts) -> int:
    """Enter the contacts of one owner with each of their four nodes; return how many entries found no room.

    The order of entry is undone by `sort_contacts`.
    """
    num_dropped = int(0)
    for index in range(contacts.counts[world, owner]):
        slot = owner * SLOTS + index
        nodes = contacts.nodes[world, slot]
        for k in range(4):
            entry = count_up(contacts.num_of_node, world, nodes[k])
            if entry < MAX_CONTACTS_PER_NODE:
                contacts.of_node[world, nodes[k], entry] = 4 * slot + k
            else:
                num_dropped += 1
    return num_dropped


@wp.func
def sort_contacts(world: int, node: int, contacts: SelfContacts):
    """Sort the contacts of a node, so that sums do not depend on the order in which lanes entered them."""
    count = wp.min(contacts.num_of_node[world, node], MAX_CONTACTS_PER_NODE)
    contacts.num_of_node[world, node] = count
    for i in range(1, count):
        entry = contacts.of_node[world, node, i]
        j = int(i)
        while j > 0 and contacts.of_node[world, node, wp.max(j - 1, 0)] > entry:
            contacts.of_node[world, node, j] = contacts.of_node[world, node, j - 1]
            j -= 1
        contacts.of_node[world, node, j] = entry
