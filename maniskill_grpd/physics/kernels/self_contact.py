"""Contact of an object with itself: the impulses of a substep, called by the fused kernel.

A contact joins four nodes: a node and a triangle, or two edges. Per substep every contact computes its impulse from the same
positions, then every node gathers the impulses of its contacts (Jacobi): no two threads write to one place, and impulses cancel
in pairs. Every contact remembers its normal, from the second element to the first, and follows it as they turn about each
other: what passed through something is where the gap points against the normal, and is brought back.
"""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import count_up, synchronize_block
from maniskill_grpd.physics.kernels.closest_points import closest_weights
from maniskill_grpd.physics.kernels.contact_lanes import gather, load, store
from maniskill_grpd.physics.kernels.data import Objects, SelfContacts, Thread, Worlds
from maniskill_grpd.physics.kernels.lane_access import pick, put
from maniskill_grpd.physics.kernels.lanes import (  # noqa: F401 (operators on lanes)
    add,
    any_positive,
    choose,
    cross,
    div,
    greater,
    inner,
    lesser,
    mul,
    root,
    spread,
    sub,
)

# Weights below this belong to the rim of an element, where the gap itself is the normal.
RIM = wp.constant(1.0e-4)
# Squared sine of the angle between edges below which they have no normal but the gap.
FLAT_ANGLE = wp.constant(1.0e-4)
# Most Jacobi iterations in a substep, and the share of the thickness below which an overlap does not ask for another one.
ITERATIONS = wp.constant(10)
TOLERANCE = wp.constant(0.1)
# Most that a node with contacts moves in a substep before they are resolved, in thicknesses: two that meet do not pass.
MAX_MOTION = wp.constant(0.5)
# Contacts act up to this multiple of their thickness: one that has passed through is brought back from there.
GRASP = wp.constant(1.5)


@wp.func
def facing(is_edges: bool, x_0: Any, x_1: Any, x_2: Any, x_3: Any):
    """Return the direction perpendicular to both elements (of the triangle, or of two edges) and its squared relative length."""
    first = x_2 - x_1
    second = x_3 - x_1
    if is_edges:
        first = x_1 - x_0
        second = x_3 - x_2
    normal = cross(first, second)
    square = inner(normal, normal)
    scale = greater(inner(first, first) * inner(second, second), spread(square, 1.0e-24))
    return normal / root(greater(square, spread(square, 1.0e-24))), square / scale


@wp.func
def compute_impulses(
    world: int,
    lane: int,
    first: int,
    is_edges: bool,
    acts_at_rim: bool,
    friction: float,
    group: int,
    groups: Any,
    contacts: SelfContacts,
):
    """Compute the impulses of C = normal . gap - thickness >= 0 and of friction, of as many contacts as there are lanes.

    In the middle of both elements the normal is perpendicular to them, on the remembered side; at a rim it is the gap, as long as
    that has not turned by more than 90 degrees.
    """
    x_0 = gather(groups.positions, group, lane, contacts.nodes, world, first, 0)
    x_1 = gather(groups.positions, group, lane, contacts.nodes, world, first, 1)
    x_2 = gather(groups.positions, group, lane, contacts.nodes, world, first, 2)
    x_3 = gather(groups.positions, group, lane, contacts.nodes, world, first, 3)
    weight_0, weight_1, weight_2, weight_3 = closest_weights(is_edges, x_0, x_1, x_2, x_3)
    gap = x_0 * weight_0 + x_1 * weight_1 + x_2 * weight_2 + x_3 * weight_3
    length = root(inner(gap, gap))
    remembered = load(gap, contacts.normals, world, first)
    outward = choose(length - spread(length, 1.0e-9), gap / greater(length, spread(length, 1.0e-9)), remembered)
    perpendicular, steepness = facing(is_edges, x_0, x_1, x_2, x_3)
    inside = lesser(lesser(weight_1 * -1.0, weight_2 * -1.0), weight_3 * -1.0)
    if is_edges:
        inside = lesser(lesser(weight_0, weight_1), lesser(weight_2 * -1.0, weight_3 * -1.0))
    inside = lesser(inside - spread(inside, RIM), steepness - spread(inside, FLAT_ANGLE))
    side = inner(perpendicular, remembered)
    normal = choose(side, perpendicular, perpendicular * -1.0)
    at_rim = choose(inner(outward, remembered), outward, remembered)
    normal = choose(inside, normal, at_rim)
    distance = inner(normal, gap)
    thickness = load(length, contacts.thicknesses, world, first)
    store(contacts.normals, world, first, normal)
    store(contacts.distances, world, first, distance)
    depth = choose(thickness * GRASP - length, thickness - distance, spread(length, 0.0))
    if is_edges and not acts_at_rim:
        depth = choose(inside, depth, spread(length, 0.0))
    nothing = spread(gap, 0.0)
    impulse = nothing
    if any_positive(depth):
        w_0 = gather(groups.weights, group, lane, contacts.nodes, world, first, 0)
        w_1 = gather(groups.weights, group, lane, contacts.nodes, world, first, 1)
        w_2 = gather(groups.weights, group, lane, contacts.nodes, world, first, 2)
        w_3 = gather(groups.weights, group, lane, contacts.nodes, world, first, 3)
        inverse_mass = w_0 * (weight_0 * weight_0) + w_1 * (weight_1 * weight_1)
        inverse_mass = inverse_mass + w_2 * (weight_2 * weight_2) + w_3 * (weight_3 * weight_3)
        start = gather(groups.previous, group, lane, contacts.nodes, world, first, 0) * weight_0
        start = start + gather(groups.previous, group, lane, contacts.nodes, world, first, 1) * weight_1
        start = start + gather(groups.previous, group, lane, contacts.nodes, world, first, 2) * weight_2
        start = start + gather(groups.previous, group, lane, contacts.nodes, world, first, 3) * weight_3
        moved = gap - start
        tangential = moved - normal * inner(moved, normal)
        slip = greater(root(inner(tangential, tangential)), spread(length, 1.0e-12))
        cancelled = lesser(spread(length, 1.0), depth * friction / slip)
        impulse = (normal * depth - tangential * cancelled) / greater(inverse_mass, spread(length, 1.0e-12))
        impulse = choose(lesser(depth, inverse_mass), impulse, nothing)
        store(contacts.weights[0], world, first, weight_0)
        store(contacts.weights[1], world, first, weight_1)
        store(contacts.weights[2], world, first, weight_2)
        store(contacts.weights[3], world, first, weight_3)
    store(contacts.impulses, world, first, impulse)


@wp.func
def is_active(world: int, contact: int, contacts: SelfContacts) -> bool:
    """Return whether a contact pushes."""
    return wp.length_sq(contacts.impulses[world, contact]) > 0.0


@wp.func
def count_active(world: int, contact: int, num_nodes: int, contacts: SelfContacts):
    """Tell the four nodes of a contact that it pushes them; behind the nodes, count overlaps that ask for another iteration."""
    if is_active(world, contact, contacts):
        nodes = contacts.nodes[world, contact]
        for k in range(4):
            count_up(contacts.num_active, world, nodes[k])
        if contacts.distances[world, contact] < (1.0 - TOLERANCE) * contacts.thicknesses[world, contact]:
            count_up(contacts.num_active, world, num_nodes)


@wp.func
def share_impulse(world: int, contact: int, contacts: SelfContacts):
    """Divide an impulse by the number of contacts of the busiest of its nodes, so that the sum over all contacts converges."""
    if is_active(world, contact, contacts):
        nodes = contacts.nodes[world, contact]
        busiest = int(1)
        for k in range(4):
            busiest = wp.max(busiest, contacts.num_active[world, nodes[k]])
        contacts.impulses[world, contact] = contacts.impulses[world, contact] / float(busiest)


@wp.func
def push_node_apart(world: int, lane: int, group: int, node: int, groups: Any, contacts: SelfContacts):
    """Apply the impulses of all contacts of a node; what it cannot follow pulls on its gripper."""
    impulse = wp.vec3(0.0, 0.0, 0.0)
    for index in range(contacts.entry_starts[world, node], contacts.entry_starts[world, node + 1]):
        entry = contacts.entries[world, index]
        contact = entry // 4
        if is_active(world, contact, contacts):
            impulse += contacts.impulses[world, contact] * contacts.weights[entry % 4, world, contact]
    weight = pick(groups.weights, group, node, lane)
    if weight > 0.0:
        put(groups.positions, group, node, lane, pick(groups.positions, group, node, lane) + impulse * weight)
    else:
        put(groups.reactions, group, node, lane, pick(groups.reactions, group, node, lane) + impulse)


@wp.func
def separate_world(thread: Thread, lane: int, friction: float, objects: Objects, groups: Any, contacts: SelfContacts):
    """Keep the layers of the object of one world apart, by one Jacobi iteration."""
    group = thread.group
    world = groups.members[group, lane]
    num_nodes = objects.node_counts[thread.variant]
    width = groups.members.shape[1]
    is_rope = objects.is_rope[thread.variant]
    num_at_nodes = contacts.starts[world, num_nodes]  # whole registers, see `lay_out_contacts`
    num_contacts = contacts.num_contacts[world]
    for node in range(thread.first, num_nodes + 1, thread.stride):
        contacts.num_active[world, node] = 0
    for first in range(thread.first * width, num_at_nodes, thread.stride * width):
        compute_impulses(world, lane, first, False, True, friction, group, groups, contacts)
    for first in range(num_at_nodes + thread.first * width, num_contacts, thread.stride * width):
        compute_impulses(world, lane, first, True, is_rope, friction, group, groups, contacts)
    synchronize_block()
    for contact in range(thread.first, num_contacts, thread.stride):
        count_active(world, contact, num_nodes, contacts)
    synchronize_block()
    for contact in range(thread.first, num_contacts, thread.stride):
        share_impulse(world, contact, contacts)
    synchronize_block()
    for node in range(thread.first, num_nodes, thread.stride):
        if contacts.num_active[world, node] > 0:
            push_node_apart(world, lane, group, node, groups, contacts)
    synchronize_block()


@wp.func
def limit_motion(world: int, lane: int, group: int, node: int, longest: float, groups: Any, contacts: SelfContacts):
    """Shorten the motion of a node in this substep if it has contacts, so that it cannot pass through what it may touch."""
    if (
        contacts.entry_starts[world, node + 1] > contacts.entry_starts[world, node]
        and pick(groups.weights, group, node, lane) > 0.0
    ):
        start = pick(groups.previous, group, node, lane)
        motion = pick(groups.positions, group, node, lane) - start
        length = wp.length(motion)
        if length > longest:
            put(groups.positions, group, node, lane, start + motion * (longest / length))


@wp.func
def project_self_contacts(thread: Thread, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts):
    """Keep the layers of the objects of all worlds of a group apart."""
    group = thread.group
    num_nodes = objects.node_counts[thread.variant]
    longest = MAX_MOTION * 2.0 * objects.radii[thread.variant]
    for lane in range(groups.counts[group]):
        world = groups.members[group, lane]
        if not worlds.frozen[world] and contacts.num_contacts[world] > 0:
            for node in range(thread.first, num_nodes, thread.stride):
                limit_motion(world, lane, group, node, longest, groups, contacts)
            synchronize_block()
            for _iteration in range(ITERATIONS):
                separate_world(thread, lane, worlds.friction[world], objects, groups, contacts)
                is_apart = contacts.num_active[world, num_nodes] == 0
                synchronize_block()
                if is_apart:
                    break
