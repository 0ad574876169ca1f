"""Contact of an object with itself, called by the fused kernel.

A contact joins four nodes: a node and the triangle of another layer (cloth), or two segments (rope). Candidates are found a few
times per control step, each owned by one node or segment, which has a fixed number of slots for them. Per substep every candidate
computes its impulse from the same positions, then every node gathers the impulses of its contacts (Jacobi): no two lanes write to
one place, and impulses cancel in pairs. The side on which the two are is remembered from the search, so that what passed through
within a substep is brought back.
"""

import warp as wp

# Candidates that one node or segment can own, and contacts that one node can take part in.
SLOTS = wp.constant(16)
MAX_CONTACTS_PER_NODE = wp.constant(192)
# Elements in a block that a search passes over as a whole when all of it is too far away.
BLOCK = wp.constant(16)
# Elements that are closer than this fraction of the reach touch: reach is three times the radius, thickness two.
TOUCHING = wp.constant(2.0 / 3.0)
# Most that two points are expected to approach each other between two searches [m]: both at twice the speed of a gripper.
MAX_APPROACH = wp.constant(0.04)


@wp.func
def closest_on_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Return barycentric coordinates of the point of a triangle closest to p (Ericson 2005, section 5.1.5)."""
    ab = b - a
    ac = c - a
    ap = p - a
    d1 = wp.dot(ab, ap)
    d2 = wp.dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    bp = p - b
    d3 = wp.dot(ab, bp)
    d4 = wp.dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    cp = p - c
    d5 = wp.dot(ab, cp)
    d6 = wp.dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return wp.vec3(1.0 - v, v, 0.0)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return wp.vec3(1.0 - w, 0.0, w)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return wp.vec3(0.0, 1.0 - w, w)
    total = va + vb + vc
    return wp.vec3(va / total, vb / total, vc / total)


@wp.func
def closest_on_segments(p: wp.vec3, q: wp.vec3, r: wp.vec3, s: wp.vec3) -> wp.vec2:
    """Return the fractions along p-q and r-s of their closest points (Ericson 2005, section 5.1.9)."""
    d1 = q - p
    d2 = s - r
    offset = p - r
    a = wp.max(wp.dot(d1, d1), 1.0e-12)
    e = wp.max(wp.dot(d2, d2), 1.0e-12)
    b = wp.dot(d1, d2)
    c = wp.dot(d1, offset)
    f = wp.dot(d2, offset)
    determinant = a * e - b * b
    along = float(0.5)
    if determinant > 1.0e-6 * a * e:
        along = wp.clamp((b * f - c * e) / determinant, 0.0, 1.0)
    other = (b * along + f) / e
    if other < 0.0 or other > 1.0:
        other = wp.clamp(other, 0.0, 1.0)
        along = wp.clamp((b * other - c) / a, 0.0, 1.0)
    return wp.vec2(along, other)


@wp.func
def barycentric_gap(weight: wp.vec4, nodes: wp.vec4i, world: int, positions: wp.array2d(dtype=wp.vec3)) -> wp.vec3:
    """Return sum_k weight_k x_k: the vector between the two touching points."""
    return (
        positions[world, nodes[0]] * weight[0]
        + positions[world, nodes[1]] * weight[1]
        + positions[world, nodes[2]] * weight[2]
        + positions[world, nodes[3]] * weight[3]
    )


@wp.func
def closest_weights(world: int, nodes: wp.vec4i, is_rope: bool, positions: wp.array2d(dtype=wp.vec3)) -> wp.vec4:
    """Return weights of the four nodes at which `barycentric_gap` is the shortest vector between the two."""
    x_0 = positions[world, nodes[0]]
    x_1 = positions[world, nodes[1]]
    x_2 = positions[world, nodes[2]]
    x_3 = positions[world, nodes[3]]
    if is_rope:
        fraction = closest_on_segments(x_0, x_1, x_2, x_3)
        return wp.vec4(1.0 - fraction[0], fraction[0], fraction[1] - 1.0, -fraction[1])
    at = closest_on_triangle(x_0, x_1, x_2, x_3)
    return wp.vec4(1.0, -at[0], -at[1], -at[2])


@wp.func
def facing(world: int, nodes: wp.vec4i, is_rope: bool, positions: wp.array2d(dtype=wp.vec3)) -> wp.vec3:
    """Return the direction perpendicular to both (of the triangle, or of two crossing segments), not normalised."""
    first = positions[world, nodes[2]] - positions[world, nodes[1]]
    second = positions[world, nodes[3]] - positions[world, nodes[1]]
    if is_rope:
        first = positions[world, nodes[1]] - positions[world, nodes[0]]
        second = positions[world, nodes[3]] - positions[world, nodes[2]]
    return wp.cross(first, second)


@wp.func
def bound_block(
    world: int,
    block: int,
    first_element: int,
    num_elements: int,
    elements: wp.array(dtype=wp.vec3i),
    element_radii: wp.array(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    block_spheres: wp.array2d(dtype=wp.vec4),
    block_motions: wp.array2d(dtype=wp.vec4),
):
    """Compute a sphere (centre, radius) about the first corners of the elements of a block, and one about their velocities.

    The first is widened by the radii of the elements.
    """
    start = block * BLOCK
    end = wp.min(start + BLOCK, num_elements)
    center = wp.vec3(0.0, 0.0, 0.0)
    velocity = wp.vec3(0.0, 0.0, 0.0)
    for element in range(start, end):
        center += positions[world, elements[first_element + element][0]] / float(end - start)
        velocity += velocities[world, elements[first_element + element][0]] / float(end - start)
    radius = float(0.0)
    spread = float(0.0)
    for element in range(start, end):
        corner = elements[first_element + element][0]
        radius = wp.max(radius, wp.length(positions[world, corner] - center) + element_radii[first_element + element])
        spread = wp.max(spread, wp.length(velocities[world, corner] - velocity))
    block_spheres[world, block] = wp.vec4(center[0], center[1], center[2], radius)
    block_motions[world, block] = wp.vec4(velocity[0], velocity[1], velocity[2], spread)


@wp.func
def bound_cluster(
    world: int,
    cluster: int,
    num_blocks: int,
    block_spheres: wp.array2d(dtype=wp.vec4),
    cluster_spheres: wp.array2d(dtype=wp.vec4),
):
    """Compute a sphere about the spheres of a cluster of blocks."""
    start = cluster * BLOCK
    end = wp.min(start + BLOCK, num_blocks)
    center = wp.vec3(0.0, 0.0, 0.0)
    for block in range(start, end):
        sphere = block_spheres[world, block]
        center += wp.vec3(sphere[0], sphere[1], sphere[2]) / float(end - start)
    radius = float(0.0)
    for block in range(start, end):
        sphere = block_spheres[world, block]
        radius = wp.max(radius, wp.length(wp.vec3(sphere[0], sphere[1], sphere[2]) - center) + sphere[3])
    cluster_spheres[world, cluster] = wp.vec4(center[0], center[1], center[2], radius)


@wp.func
def is_near(x: wp.vec3, sphere: wp.vec4, margin: float) -> bool:
    """Return whether a point is less than a margin away from a sphere (centre, radius)."""
    offset = x - wp.vec3(sphere[0], sphere[1], sphere[2])
    far = sphere[3] + margin
    return wp.dot(offset, offset) < far * far


@wp.func
def keep_nearest(
    world: int, first_slot: int, num_found: int, nodes: wp.vec4i, is_rope: bool, reach: float,
    positions: wp.array2d(dtype=wp.vec3),
    contact_nodes: wp.array2d(dtype=wp.vec4i), contact_sides: wp.array2d(dtype=float), contact_gaps: wp.array2d(dtype=float),
) -> int:  # fmt: skip
    """Write a candidate within reach into a free slot or that of the farthest, if that one is farther.

    Returns:
        1 if a slot was filled that was free, -1 if two elements that are closer than `TOUCHING` of the reach had to share one.
    """
    weight = closest_weights(world, nodes, is_rope, positions)
    gap = barycentric_gap(weight, nodes, world, positions)
    length = wp.length(gap)
    if length >= reach:
        return 0
    slot = num_found
    result = int(1)
    if num_found == SLOTS:
        slot = int(0)
        for other in range(1, SLOTS):
            if contact_gaps[world, first_slot + other] > contact_gaps[world, first_slot + slot]:
                slot = other
        farthest = contact_gaps[world, first_slot + slot]
        result = wp.where(wp.max(length, farthest) < TOUCHING * reach, -1, 0)
        if length >= farthest:
            return result
    contact_nodes[world, first_slot + slot] = nodes
    contact_gaps[world, first_slot + slot] = length
    side = wp.dot(gap, facing(world, nodes, is_rope, positions))
    contact_sides[world, first_slot + slot] = wp.where(side < 0.0, -1.0, 1.0)
    return result


@wp.func
def through_material(variant: int, owner: int, corners: wp.vec3i, geodesics: wp.array3d(dtype=float)) -> float:
    """Return the distance through the material from a node to the nearest corner of an element."""
    first = geodesics[variant, owner, corners[0]]
    return wp.min(first, wp.min(geodesics[variant, owner, corners[1]], geodesics[variant, owner, corners[2]]))


@wp.func
def find_candidates(
    world: int,
    owner: int,
    first_element: int,
    num_elements: int,
    is_rope: bool,
    reach: float,
    exclusion: float,
    step_duration: float,
    variant: int,
    elements: wp.array(dtype=wp.vec3i),
    element_radii: wp.array(dtype=float),
    geodesics: wp.array3d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    contact_nodes: wp.array2d(dtype=wp.vec4i),
    contact_sides: wp.array2d(dtype=float),
    contact_gaps: wp.array2d(dtype=float),
    contact_counts: wp.array2d(dtype=int),
    block_spheres: wp.array2d(dtype=wp.vec4),
    block_motions: wp.array2d(dtype=wp.vec4),
    cluster_spheres: wp.array2d(dtype=wp.vec4),
) -> int:
    """Fill the slots of a node (or segment) with the nearest elements that it may touch before the next search.

    Elements that are closer than `exclusion` through the material are neighbours rather than contacts. When the slots are full
    the farthest gives way, so that the result does not depend on anything but the positions. Returns how many contacts were lost.
    """
    num_found = int(0)
    num_lost = int(0)
    start = int(0)
    if is_rope:
        start = owner + 1
    x = positions[world, owner]
    v = velocities[world, owner]
    num_blocks = (num_elements + BLOCK - 1) // BLOCK
    for cluster in range(start // (BLOCK * BLOCK), (num_blocks + BLOCK - 1) // BLOCK):
        if not is_near(x, cluster_spheres[world, cluster], reach + MAX_APPROACH):
            continue
        for block in range(wp.max(cluster * BLOCK, start // BLOCK), wp.min((cluster + 1) * BLOCK, num_blocks)):
            if not is_near(x, block_spheres[world, block], reach + MAX_APPROACH):
                continue
            motion = block_motions[world, block]
            speed = wp.length(v - wp.vec3(motion[0], motion[1], motion[2])) + motion[3]
            block_approach = wp.min(speed * step_duration, MAX_APPROACH)
            if not is_near(x, block_spheres[world, block], reach + block_approach):
                continue
            for element in range(wp.max(start, block * BLOCK), wp.min((block + 1) * BLOCK, num_elements)):
                corners = elements[first_element + element]
                bound = element_radii[first_element + element] + reach
                distance = wp.length(x - positions[world, corners[0]])
                if distance < bound + block_approach:
                    approach = wp.min(wp.length(v - velocities[world, corners[0]]) * step_duration, MAX_APPROACH)
                    if distance < bound + approach and through_material(variant, owner, corners, geodesics) > exclusion:
                        nodes = wp.vec4i(owner, corners[0], corners[1], corners[2])
                        if is_rope:
                            nodes = wp.vec4i(owner, owner + 1, corners[0], corners[1])
                        kept = keep_nearest(
                            world, owner * SLOTS, num_found, nodes, is_rope, reach + approach, positions,
                            contact_nodes, contact_sides, contact_gaps,
                        )  # fmt: skip
                        num_found += wp.max(kept, 0)
                        num_lost -= wp.min(kept, 0)
    contact_counts[world, owner] = num_found
    return num_lost


@wp.func
def register_contacts(
    world: int,
    owner: int,
    contact_nodes: wp.array2d(dtype=wp.vec4i),
    contact_counts: wp.array2d(dtype=int),
    contacts_of_node: wp.array3d(dtype=int),
    num_contacts_of_node: wp.array2d(dtype=int),
) -> int:
    """Enter the contacts of one owner with each of their four nodes; return how many entries found no room.

    The order of entry is undone by `sort_contacts`.
    """
    num_dropped = int(0)
    for index in range(contact_counts[world, owner]):
        slot = owner * SLOTS + index
        nodes = contact_nodes[world, slot]
        for k in range(4):
            entry = wp.atomic_add(num_contacts_of_node, world, nodes[k], 1)
            if entry < MAX_CONTACTS_PER_NODE:
                contacts_of_node[world, nodes[k], entry] = 4 * slot + k
            else:
                num_dropped += 1
    return num_dropped


@wp.func
def sort_contacts(
    world: int, node: int, contacts_of_node: wp.array3d(dtype=int), num_contacts_of_node: wp.array2d(dtype=int)
):
    """Sort the contacts of a node, so that sums do not depend on the order in which lanes entered them."""
    count = wp.min(num_contacts_of_node[world, node], MAX_CONTACTS_PER_NODE)
    num_contacts_of_node[world, node] = count
    for i in range(1, count):
        entry = contacts_of_node[world, node, i]
        j = int(i)
        while j > 0 and contacts_of_node[world, node, wp.max(j - 1, 0)] > entry:
            contacts_of_node[world, node, j] = contacts_of_node[world, node, j - 1]
            j -= 1
        contacts_of_node[world, node, j] = entry


@wp.func
def is_apart(world: int, nodes: wp.vec4i, is_rope: bool, thickness: float, positions: wp.array2d(dtype=wp.vec3)) -> bool:
    """Return whether two elements cannot touch because they lie apart along an axis."""
    x_0 = positions[world, nodes[0]]
    x_1 = positions[world, nodes[1]]
    x_2 = positions[world, nodes[2]]
    x_3 = positions[world, nodes[3]]
    low = x_0
    high = x_0
    other_low = wp.min(x_2, x_3)
    other_high = wp.max(x_2, x_3)
    if is_rope:
        low = wp.min(x_0, x_1)
        high = wp.max(x_0, x_1)
    else:
        other_low = wp.min(other_low, x_1)
        other_high = wp.max(other_high, x_1)
    between = wp.max(wp.max(other_low - high), wp.max(low - other_high))
    return between > thickness


@wp.func
def compute_contact_impulse(
    world: int,
    slot: int,
    is_rope: bool,
    thickness: float,
    friction: float,
    contact_nodes: wp.array2d(dtype=wp.vec4i),
    contact_sides: wp.array2d(dtype=float),
    weights: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    previous: wp.array2d(dtype=wp.vec3),
    contact_weights: wp.array2d(dtype=wp.vec4),
    contact_impulses: wp.array2d(dtype=wp.vec3),
    num_active: wp.array2d(dtype=int),
):
    """Compute the impulse of C = side * n . gap - thickness >= 0 and of the friction against the motion along the surface.

    Near the rim of a triangle, or the end of a segment, the gap itself is the normal; in the middle the remembered side tells on
    which side of the surface the point belongs.
    """
    nodes = contact_nodes[world, slot]
    contact_impulses[world, slot] = wp.vec3(0.0, 0.0, 0.0)
    if is_apart(world, nodes, is_rope, thickness, positions):
        return
    weight = closest_weights(world, nodes, is_rope, positions)
    gap = barycentric_gap(weight, nodes, world, positions)
    length = wp.length(gap)
    contact_weights[world, slot] = weight
    normal = facing(world, nodes, is_rope, positions)
    area = wp.length(normal)
    is_inside = weight[1] < -1.0e-4 and weight[2] < -1.0e-4 and weight[3] < -1.0e-4
    if is_rope:
        is_inside = weight[0] > 1.0e-4 and weight[1] > 1.0e-4 and weight[2] < -1.0e-4 and weight[3] < -1.0e-4
    if is_inside and area > 1.0e-12:
        normal = normal * (contact_sides[world, slot] / area)
    elif length > 1.0e-9:
        normal = gap / length
    else:
        return
    depth = thickness - wp.dot(normal, gap)
    inverse_mass = float(0.0)
    for k in range(4):
        inverse_mass += weights[world, nodes[k]] * weight[k] * weight[k]
    if depth <= 0.0 or inverse_mass <= 0.0:
        return
    moved = gap - barycentric_gap(weight, nodes, world, previous)
    tangential = moved - normal * wp.dot(moved, normal)
    slip = wp.length(tangential)
    cancelled = float(0.0)
    if slip > 0.0:
        cancelled = wp.min(1.0, friction * depth / slip)
    contact_impulses[world, slot] = (normal * depth - tangential * cancelled) / inverse_mass
    for k in range(4):
        wp.atomic_add(num_active, world, nodes[k], 1)


@wp.func
def gather_contact_impulses(
    world: int,
    node: int,
    contacts_of_node: wp.array3d(dtype=int),
    num_contacts_of_node: wp.array2d(dtype=int),
    contact_nodes: wp.array2d(dtype=wp.vec4i),
    contact_weights: wp.array2d(dtype=wp.vec4),
    contact_impulses: wp.array2d(dtype=wp.vec3),
    num_active: wp.array2d(dtype=int),
) -> wp.vec3:
    """Return the sum of a node's contact impulses, each shared by the busiest of its four nodes so that the sum converges."""
    total = wp.vec3(0.0, 0.0, 0.0)
    for entry in range(num_contacts_of_node[world, node]):
        code = contacts_of_node[world, node, entry]
        slot = code // 4
        impulse = contact_impulses[world, slot]
        if wp.dot(impulse, impulse) > 0.0:
            nodes = contact_nodes[world, slot]
            weight = contact_weights[world, slot]
            busiest = int(1)
            for k in range(4):
                busiest = wp.max(busiest, num_active[world, nodes[k]])
            total += impulse * (weight[code % 4] / float(busiest))
    return total
