"""Contact of an object with itself: the impulses of a substep, called by the fused kernel.

A contact joins four nodes: a node and a triangle, or two edges. In every substep those pairs of the list are measured that may be
near by what nodes have moved since they were measured last. Near pairs remember their normal, from the second element to the
first, and it follows them as they turn about each other: what passed through something is where the gap points against the
normal, and is brought back. From one control step to the next normals are those of the gaps, but for pairs that have passed
through each other: these are part of the state.

Pairs that touch or nearly do are contacts. They are separated one after the other, in sweeps over closest points and normals that
stay as they were measured; what overlapped much is measured again.
"""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.closest_points import closest_weights
from maniskill_grpd.physics.kernels.contact_lanes import gather, load, store
from maniskill_grpd.physics.kernels.contact_list import REGISTER, ROUNDING, measure_motion, update_pairs
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
# Most times that contacts are measured in a substep, most sweeps over them after each, and the share of the thickness below which
# an overlap asks for neither.
ROUNDS = wp.constant(4)
SWEEPS = wp.constant(8)
TOLERANCE = wp.constant(0.1)
# Most that a node with contacts moves in a substep before they are resolved, in thicknesses: two that meet do not pass.
MAX_MOTION = wp.constant(0.5)
# Contacts act up to this multiple of their thickness: one that has passed through is brought back from there.
GRASP = wp.constant(1.5)
# Pairs closer than this beyond their thickness, relative to it, are near, and remember their sides.
NEAR = wp.constant(0.5)
# Share of its mobility, had it no held nodes, below which a contact does not act; it acts fully from twice that share on.
HELD = wp.constant(0.05)
# Near pairs closer than this multiple of their thickness take part in the iterations of a substep.
ENGAGED = wp.constant(1.1)


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
def follow_normal(is_edges: bool, x_0: Any, x_1: Any, x_2: Any, x_3: Any, remembered: Any):
    """Return gaps, their lengths, the normals, where these are perpendicular to both elements (> 0), and weights of the nodes.

    In the middle of both elements the normal is perpendicular to them, on the remembered side; at a rim it is the gap, as long as
    that has not turned by more than 90 degrees. Without a remembered normal (0) the side is that of the gap.
    """
    weight_0, weight_1, weight_2, weight_3 = closest_weights(is_edges, x_0, x_1, x_2, x_3)
    gap = x_0 * weight_0 + x_1 * weight_1 + x_2 * weight_2 + x_3 * weight_3
    length = root(inner(gap, gap))
    outward = choose(length - spread(length, 1.0e-9), gap / greater(length, spread(length, 1.0e-9)), remembered)
    before = choose(inner(remembered, remembered), remembered, outward)
    perpendicular, steepness = facing(is_edges, x_0, x_1, x_2, x_3)
    inside = lesser(lesser(weight_1 * -1.0, weight_2 * -1.0), weight_3 * -1.0)
    if is_edges:
        inside = lesser(lesser(weight_0, weight_1), lesser(weight_2 * -1.0, weight_3 * -1.0))
    inside = lesser(inside - spread(inside, RIM), steepness - spread(inside, FLAT_ANGLE))
    normal = choose(inner(perpendicular, before), perpendicular, perpendicular * -1.0)
    normal = choose(inside, normal, choose(inner(outward, before), outward, before))
    return gap, length, normal, inside, weight_0, weight_1, weight_2, weight_3


@wp.func
def measure_contacts(world: int, lane: int, first: int, is_edges: bool, group: int, groups: Any, contacts: SelfContacts):
    """Compute how far apart the elements of as many contacts are as there are lanes."""
    x_0 = gather(groups.positions, group, lane, contacts.nodes, world, first, 0)
    x_1 = gather(groups.positions, group, lane, contacts.nodes, world, first, 1)
    x_2 = gather(groups.positions, group, lane, contacts.nodes, world, first, 2)
    x_3 = gather(groups.positions, group, lane, contacts.nodes, world, first, 3)
    remembered = load(x_0, contacts.normals, world, first)
    gap, length, normal, inside, w_0, w_1, w_2, w_3 = follow_normal(is_edges, x_0, x_1, x_2, x_3, remembered)
    store(contacts.normals, world, first, normal)
    store(contacts.distances, world, first, inner(normal, gap))
    store(contacts.lengths, world, first, length)
    store(contacts.insides, world, first, inside)
    store(contacts.weights[0], world, first, w_0)
    store(contacts.weights[1], world, first, w_1)
    store(contacts.weights[2], world, first, w_2)
    store(contacts.weights[3], world, first, w_3)


@wp.func
def measure_all(thread: Thread, lane: int, groups: Any, contacts: SelfContacts):
    """Compute how far apart the elements of all contacts of one world are."""
    group = thread.group
    world = groups.members[group, lane]
    width = groups.members.shape[1]
    first_edge = contacts.first_edge_contacts[world]
    for first in range(thread.first * width, first_edge, thread.stride * width):
        measure_contacts(world, lane, first, False, group, groups, contacts)
    for first in range(first_edge + thread.first * width, contacts.num_contacts[world], thread.stride * width):
        measure_contacts(world, lane, first, True, group, groups, contacts)
    synchronize_block()


@wp.func
def weigh_contact(world: int, lane: int, contact: int, acts_at_rim: bool, group: int, groups: Any, contacts: SelfContacts):
    """Compute the mass that a contact moves, 0 for one that does not act, and where its gap was at the start of the substep.

    A contact whose points are held almost entirely would throw the free rest far away: it acts less, and in the end not at all.
    """
    nodes = contacts.nodes[world, contact]
    inverse_mass = float(0.0)
    lightest = float(0.0)
    square = float(0.0)
    start = wp.vec3(0.0, 0.0, 0.0)
    for k in range(4):
        share = contacts.weights[k, world, contact]
        weight = pick(groups.weights, group, nodes[k], lane)
        inverse_mass += weight * share * share
        lightest = wp.max(lightest, weight)
        square += share * share
        start += pick(groups.previous, group, nodes[k], lane) * share
    acts = contacts.lengths[world, contact] < GRASP * contacts.thicknesses[world, contact]
    if contact >= contacts.first_edge_contacts[world] and not acts_at_rim:
        acts = acts and contacts.insides[world, contact] > 0.0
    contacts.starts_of_gaps[world, contact] = start
    mass = float(0.0)
    if acts and inverse_mass > 0.0:
        free = inverse_mass / (lightest * square)  # 1 where nothing is held
        mass = wp.clamp((free - HELD) / HELD, 0.0, 1.0) / inverse_mass
    contacts.masses[world, contact] = mass


@wp.func
def separate_contact(
    world: int, lane: int, contact: int, friction: float, group: int, groups: Any, contacts: SelfContacts
) -> float:
    """Push two elements apart along their normal until normal . gap = thickness, with friction; return how far they overlapped.

    What nodes cannot follow pulls on their grippers.
    """
    nodes = contacts.nodes[world, contact]
    gap = wp.vec3(0.0, 0.0, 0.0)
    for k in range(4):
        gap += pick(groups.positions, group, nodes[k], lane) * contacts.weights[k, world, contact]
    normal = contacts.normals[world, contact]
    depth = contacts.thicknesses[world, contact] - wp.dot(normal, gap)
    if depth <= 0.0:
        return 0.0
    moved = gap - contacts.starts_of_gaps[world, contact]
    tangential = moved - normal * wp.dot(moved, normal)
    cancelled = wp.min(1.0, friction * depth / wp.max(wp.length(tangential), 1.0e-12))
    impulse = (normal * depth - tangential * cancelled) * contacts.masses[world, contact]
    for k in range(4):
        node = nodes[k]
        share = contacts.weights[k, world, contact]
        if share != 0.0:
            weight = pick(groups.weights, group, node, lane)
            if weight > 0.0:
                moved_to = pick(groups.positions, group, node, lane) + impulse * (share * weight)
                put(groups.positions, group, node, lane, moved_to)
            else:
                put(groups.reactions, group, node, lane, pick(groups.reactions, group, node, lane) + impulse * share)
    return depth


@wp.func
def sweep_contacts(world: int, lane: int, friction: float, group: int, groups: Any, contacts: SelfContacts) -> bool:
    """Separate all contacts of one world one after the other (Gauss-Seidel); return whether any overlapped too much."""
    overlaps = bool(False)
    for contact in range(contacts.num_contacts[world]):
        if contacts.masses[world, contact] > 0.0:
            depth = separate_contact(world, lane, contact, friction, group, groups, contacts)
            if depth > TOLERANCE * contacts.thicknesses[world, contact]:
                overlaps = True
    return overlaps


@wp.func
def separate_world(thread: Thread, lane: int, friction: float, objects: Objects, groups: Any, contacts: SelfContacts) -> bool:
    """Keep the layers of the object of one world apart: sweeps with closest points and normals as measured before.

    Returns whether any overlapped so much that they have to be measured again.
    """
    group = thread.group
    world = groups.members[group, lane]
    for contact in range(thread.first, contacts.num_contacts[world], thread.stride):
        weigh_contact(world, lane, contact, objects.is_rope[thread.variant], group, groups, contacts)
    synchronize_block()
    if thread.first == 0:
        sweeps = int(0)
        while sweeps < SWEEPS and sweep_contacts(world, lane, friction, group, groups, contacts):
            sweeps += 1
        contacts.num_sweeps[world] = sweeps
    synchronize_block()
    return contacts.num_sweeps[world] > 0


@wp.func
def fill_register(world: int, count: int, contacts: SelfContacts) -> int:
    """Add contacts that do nothing until a register is full; return how many there are then."""
    end = (count + REGISTER - 1) // REGISTER * REGISTER
    for contact in range(count, end):
        contacts.pairs[world, contact] = -1
        contacts.nodes[world, contact] = wp.vec4i(0, 0, 0, 0)
        contacts.thicknesses[world, contact] = 0.0
        contacts.lengths[world, contact] = 0.0
        contacts.normals[world, contact] = wp.vec3(0.0, 0.0, 1.0)
    return end


@wp.func
def wake_pairs(
    world: int, first: int, end: int, start: int, is_first: bool, width: int, like: Any, contacts: SelfContacts
) -> int:
    """Make contacts, from `start` on, of those pairs from `first` to `end` that may be near; return how many there are then."""
    awake = contacts.travels[world] + contacts.slacks[world] + ROUNDING
    count = int(start)
    for register in range(first, end, width):
        wakes = load(like, contacts.wakes, world, register)
        if any_positive(spread(like, awake) - wakes):
            for pair in range(register, wp.min(register + width, end)):
                if contacts.wakes[world, pair] < awake:
                    if is_first:
                        contacts.pair_normals[world, pair] = wp.vec3(0.0, 0.0, 0.0)
                    contacts.pairs[world, count] = pair
                    contacts.nodes[world, count] = contacts.pair_nodes[world, pair]
                    contacts.thicknesses[world, count] = contacts.pair_thicknesses[world, pair]
                    contacts.normals[world, count] = contacts.pair_normals[world, pair]
                    count += 1
    return count


@wp.func
def is_represented(world: int, contact: int, is_edges: bool, variant: int, objects: Objects, contacts: SelfContacts) -> bool:
    """Return whether a contact is the one of its kind: a rim that triangles share touches with one of them.

    Bits 0 to 2 of `face_features` are the corners, bits 3 to 5 the edges opposite to them, for which a triangle stands.
    """
    if is_edges:
        return True
    inner_corners = int(0)
    last_corner = int(0)
    first_rim = int(0)
    for k in range(3):
        if contacts.weights[k + 1, world, contact] < -RIM:
            inner_corners += 1
            last_corner = k
        else:
            first_rim = k
    if inner_corners == 3:
        return True
    element = contacts.elements[world, contacts.pairs[world, contact]]
    bit = wp.where(inner_corners == 2, first_rim + 3, last_corner)
    return (objects.face_features[objects.element_starts[variant] + element] >> bit) & 1 == 1


@wp.func
def has_crossed(world: int, pair: int, worlds: Worlds, contacts: SelfContacts) -> bool:
    """Return whether a pair has passed through each other by the state."""
    for index in range(worlds.crossed_owners.shape[1]):
        if worlds.crossed_owners[world, index] < 0:
            return False
        if (
            worlds.crossed_owners[world, index] == contacts.owners[world, pair]
            and worlds.crossed_elements[world, index] == contacts.elements[world, pair]
        ):
            return True
    return False


@wp.func
def sort_out(
    thread: Thread,
    lane: int,
    first: int,
    end: int,
    start: int,
    is_edges: bool,
    is_first: bool,
    objects: Objects,
    worlds: Worlds,
    groups: Any,
    contacts: SelfContacts,
) -> int:
    """Note what was measured of contacts `first` to `end`, and keep those, from `start` on, that touch or nearly do."""
    group = thread.group
    world = groups.members[group, lane]
    is_rope = objects.is_rope[thread.variant]
    kept = int(start)
    for contact in range(first, end):
        pair = contacts.pairs[world, contact]
        if pair >= 0:
            thickness = contacts.thicknesses[world, contact]
            distance = contacts.distances[world, contact]
            normal = contacts.normals[world, contact]
            nodes = contacts.nodes[world, contact]
            beyond = contacts.lengths[world, contact] - thickness
            contacts.wakes[world, pair] = beyond + contacts.travels[world]
            if is_first and has_crossed(world, pair, worlds, contacts):
                normal = -normal
                distance = -distance
            if beyond < contacts.slacks[world]:
                for k in range(4):
                    put(groups.touching, group, nodes[k], lane, 1.0)
                is_engaged = distance < ENGAGED * thickness and (
                    is_rope or not is_edges or contacts.insides[world, contact] > 0.0
                )
                if is_engaged and is_represented(world, contact, is_edges, thread.variant, objects, contacts):
                    contacts.pairs[world, kept] = pair
                    contacts.nodes[world, kept] = nodes
                    contacts.thicknesses[world, kept] = thickness
                    contacts.normals[world, kept] = normal
                    contacts.distances[world, kept] = distance
                    contacts.lengths[world, kept] = contacts.lengths[world, contact]
                    contacts.insides[world, kept] = contacts.insides[world, contact]
                    for k in range(4):
                        contacts.weights[k, world, kept] = contacts.weights[k, world, contact]
                    kept += 1
            else:
                normal = wp.vec3(0.0, 0.0, 0.0)
                distance = beyond
            contacts.pair_normals[world, pair] = normal
            contacts.pair_distances[world, pair] = distance
    return kept


@wp.func
def list_contacts(
    thread: Thread, lane: int, is_first: bool, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts
):
    """List what touches or nearly does in one world, and remember the sides of what is near."""
    group = thread.group
    world = groups.members[group, lane]
    width = groups.members.shape[1]
    like = groups.weights[group, 0]
    if thread.first == 0:
        first_edge = wake_pairs(world, 0, contacts.first_edges[world], 0, is_first, width, like, contacts)
        first_edge = fill_register(world, first_edge, contacts)
        contacts.first_edge_contacts[world] = first_edge
        num_pairs = contacts.num_pairs[world]
        count = wake_pairs(world, contacts.first_edges[world], num_pairs, first_edge, is_first, width, like, contacts)
        fill_register(world, count, contacts)
        contacts.num_contacts[world] = count
    synchronize_block()
    measure_all(thread, lane, groups, contacts)
    if thread.first == 0:
        first_edge = contacts.first_edge_contacts[world]
        num_contacts = contacts.num_contacts[world]
        count = sort_out(thread, lane, 0, first_edge, 0, False, is_first, objects, worlds, groups, contacts)
        count = fill_register(world, count, contacts)
        contacts.first_edge_contacts[world] = count
        count = sort_out(thread, lane, first_edge, num_contacts, count, True, is_first, objects, worlds, groups, contacts)
        fill_register(world, count, contacts)
        contacts.num_contacts[world] = count
    synchronize_block()


@wp.func
def find_contacts(thread: Thread, is_first: bool, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts):
    """List in all worlds of a group what touches or nearly does, at the start of a control step (`is_first`) or in a substep."""
    group = thread.group
    thickness = 2.0 * objects.radii[thread.variant]
    slack = wp.min(NEAR * thickness, 0.8 * objects.contact_margins[thread.variant])
    measure_motion(thread, objects, groups, contacts)
    for lane in range(thread.first, groups.counts[group], thread.stride):
        contacts.slacks[groups.members[group, lane]] = slack
    for node in range(thread.first, objects.node_counts[thread.variant], thread.stride):
        groups.touching[group, node] = spread(groups.touching[group, node], 0.0)
    synchronize_block()
    update_pairs(thread, objects, worlds, groups, contacts)
    for lane in range(groups.counts[group]):
        if not worlds.frozen[groups.members[group, lane]]:
            list_contacts(thread, lane, is_first, objects, worlds, groups, contacts)


@wp.func
def limit_motion(thread: Thread, objects: Objects, groups: Any):
    """Shorten the motion in this substep of nodes that were near something, so that they cannot pass through it."""
    group = thread.group
    for node in range(thread.first, objects.node_counts[thread.variant], thread.stride):
        touching = lesser(groups.touching[group, node], groups.weights[group, node])
        if any_positive(touching):
            start = groups.previous[group, node]
            motion = groups.positions[group, node] - start
            longest = spread(touching, MAX_MOTION * 2.0 * objects.radii[thread.variant])
            length = root(inner(motion, motion))
            limited = start + motion * (longest / greater(length, longest))
            limited = choose(lesser(touching, length - longest), limited, groups.positions[group, node])
            groups.positions[group, node] = limited
    synchronize_block()


@wp.func
def project_self_contacts(thread: Thread, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts):
    """Keep the layers of the objects of all worlds of a group apart."""
    group = thread.group
    limit_motion(thread, objects, groups)
    find_contacts(thread, False, objects, worlds, groups, contacts)
    for lane in range(groups.counts[group]):
        world = groups.members[group, lane]
        if not worlds.frozen[world] and contacts.num_contacts[world] > 0:
            for _round in range(ROUNDS - 1):
                if not separate_world(thread, lane, worlds.friction[world], objects, groups, contacts):
                    break
                measure_all(thread, lane, groups, contacts)
            for contact in range(thread.first, contacts.num_contacts[world], thread.stride):
                pair = contacts.pairs[world, contact]
                if pair >= 0:
                    contacts.pair_normals[world, pair] = contacts.normals[world, contact]
                    contacts.pair_distances[world, pair] = contacts.distances[world, contact]
            synchronize_block()
