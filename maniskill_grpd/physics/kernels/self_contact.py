"""Contact of an object with itself, called by the fused kernel.

A contact joins four nodes: a node and the triangle of another layer (cloth), or two segments (rope). Candidates are found a few
times per control step, each owned by one node or segment, which has a fixed number of slots for them. Per substep every candidate
computes its impulse from the same positions, then every node gathers the impulses of its contacts (Jacobi): no two lanes write to
one place, and impulses cancel in pairs. The side on which the two are is remembered from the search, so that what passed through
within a substep is brought back.
"""

import warp as wp

from maniskill_grpd.physics.kernels.block import count_up
from maniskill_grpd.physics.kernels.data import SelfContacts, Touch

# Candidates that one node or segment can own, and contacts that one node can take part in.
SLOTS = wp.constant(16)
MAX_CONTACTS_PER_NODE = wp.constant(192)


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
    world: int, slot: int, is_rope: bool, thickness: float, friction: float, touch: Touch, contacts: SelfContacts
):
    """Compute the impulse of C = side * n . gap - thickness >= 0 and of the friction against the motion along the surface.

    Near the rim of a triangle, or the end of a segment, the gap itself is the normal; in the middle the remembered side tells on
    which side of the surface the point belongs.
    """
    nodes = contacts.nodes[world, slot]
    contacts.impulses[world, slot] = wp.vec3(0.0, 0.0, 0.0)
    if is_apart(world, nodes, is_rope, thickness, touch.positions):
        return
    weight = closest_weights(world, nodes, is_rope, touch.positions)
    gap = barycentric_gap(weight, nodes, world, touch.positions)
    length = wp.length(gap)
    contacts.weights[world, slot] = weight
    normal = facing(world, nodes, is_rope, touch.positions)
    area = wp.length(normal)
    is_inside = weight[1] < -1.0e-4 and weight[2] < -1.0e-4 and weight[3] < -1.0e-4
    if is_rope:
        is_inside = weight[0] > 1.0e-4 and weight[1] > 1.0e-4 and weight[2] < -1.0e-4 and weight[3] < -1.0e-4
    if is_inside and area > 1.0e-12:
        normal = normal * (contacts.sides[world, slot] / area)
    elif length > 1.0e-9:
        normal = gap / length
    else:
        return
    depth = thickness - wp.dot(normal, gap)
    inverse_mass = float(0.0)
    for k in range(4):
        inverse_mass += touch.weights[world, nodes[k]] * weight[k] * weight[k]
    if depth <= 0.0 or inverse_mass <= 0.0:
        return
    moved = gap - barycentric_gap(weight, nodes, world, touch.previous)
    tangential = moved - normal * wp.dot(moved, normal)
    slip = wp.length(tangential)
    cancelled = float(0.0)
    if slip > 0.0:
        cancelled = wp.min(1.0, friction * depth / slip)
    contacts.impulses[world, slot] = (normal * depth - tangential * cancelled) / inverse_mass
    for k in range(4):
        count_up(contacts.num_active, world, nodes[k])


@wp.func
def gather_contact_impulses(world: int, node: int, contacts: SelfContacts) -> wp.vec3:
    """Return the sum of a node's contact impulses, each shared by the busiest of its four nodes so that the sum converges."""
    total = wp.vec3(0.0, 0.0, 0.0)
    for entry in range(contacts.num_of_node[world, node]):
        code = contacts.of_node[world, node, entry]
        slot = code // 4
        impulse = contacts.impulses[world, slot]
        if wp.dot(impulse, impulse) > 0.0:
            nodes = contacts.nodes[world, slot]
            weight = contacts.weights[world, slot]
            busiest = int(1)
            for k in range(4):
                busiest = wp.max(busiest, contacts.num_active[world, nodes[k]])
            total += impulse * (weight[code % 4] / float(busiest))
    return total
