"""The list of pairs of elements of one object that may come to touch, called by the fused kernel.

The list is laid out owner by owner and element by element. It outlives control steps: it is complete until nodes have come closer
to each other than it reaches, and then it is made anew. What is computed does not depend on when that was, since a pair acts only
by what the positions say (`self_contact`): a list may be longer than needed, never too short.
"""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.contact_search import SLOTS, contact_nodes, contact_thickness, find_pairs
from maniskill_grpd.physics.kernels.data import Objects, SelfContacts, Thread, Worlds
from maniskill_grpd.physics.kernels.lane_access import component, pick, put
from maniskill_grpd.physics.kernels.lanes import WIDTH, greater, inner, lesser, root, spread, sub  # noqa: F401 (operators on lanes)

# The last register of contacts may be read beyond its end.
REGISTER = wp.constant(WIDTH)
# What rounding may add to the distances of pairs [m].
ROUNDING = wp.constant(2.0e-5)
# Beyond any motion [m].
FAR = wp.constant(1.0e9)


@wp.func
def load_anchor(thread: Thread, node: int, groups: Any, contacts: SelfContacts):
    """Fetch where a node of all worlds was when motion was measured last."""
    for lane in range(groups.members.shape[1]):
        put(groups.anchors, thread.group, node, lane, contacts.anchors[groups.members[thread.group, lane], node])


@wp.func
def store_anchors(thread: Thread, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts):
    """Write where the nodes of all worlds were when motion was measured last; a world that froze may have been anywhere."""
    for node in range(thread.first, objects.node_counts[thread.variant], thread.stride):
        for lane in range(groups.counts[thread.group]):
            contacts.anchors[groups.members[thread.group, lane], node] = pick(groups.anchors, thread.group, node, lane)
    for lane in range(thread.first, groups.counts[thread.group], thread.stride):
        if worlds.frozen[groups.members[thread.group, lane]]:
            contacts.reaches[groups.members[thread.group, lane]] = -FAR


@wp.func
def measure_motion(thread: Thread, objects: Objects, groups: Any, contacts: SelfContacts):
    """Measure in all worlds of a group how much closer any two points may have come since the last time.

    Displacements of nodes lie in a box, and those of points between nodes too; no two differ by more than its diagonal.
    """
    group = thread.group
    low = spread(groups.positions[group, 0], FAR)
    high = spread(groups.positions[group, 0], -FAR)
    for node in range(thread.first, objects.node_counts[thread.variant], thread.stride):
        moved = groups.positions[group, node] - groups.anchors[group, node]
        groups.anchors[group, node] = groups.positions[group, node]
        low = lesser(low, moved)
        high = greater(high, moved)
    groups.lowest_motions[group, thread.first] = low
    groups.highest_motions[group, thread.first] = high
    synchronize_block()
    if thread.first == 0:
        for other in range(1, thread.stride):
            low = lesser(low, groups.lowest_motions[group, other])
            high = greater(high, groups.highest_motions[group, other])
        size = high - low
        motion = root(inner(size, size))
        for lane in range(groups.counts[group]):
            world = groups.members[group, lane]
            contacts.motions[world] = component(motion, lane)
            contacts.travels[world] = contacts.travels[world] + component(motion, lane)
    synchronize_block()


@wp.func
def is_complete(world: int, worlds: Worlds, contacts: SelfContacts) -> bool:
    """Return whether the list of a world still has every pair that has to be looked at."""
    needed = contacts.travels[world] + contacts.slacks[world] + ROUNDING
    return worlds.frozen[world] or needed < contacts.reaches[world]


@wp.func
def ask_for_lists(thread: Thread, worlds: Worlds, groups: Any, contacts: SelfContacts) -> bool:
    """Mark the worlds of a group whose list has to be made anew; return whether there are any."""
    asks = bool(False)
    for lane in range(groups.counts[thread.group]):
        if not is_complete(groups.members[thread.group, lane], worlds, contacts):
            asks = True
    if thread.first == 0:
        groups.searched[thread.group, 0] = spread(groups.searched[thread.group, 0], -FAR)
        for lane in range(groups.counts[thread.group]):
            if not is_complete(groups.members[thread.group, lane], worlds, contacts):
                put(groups.searched, thread.group, 0, lane, 0.0)
    synchronize_block()
    return asks


@wp.func
def remember_pairs(world: int, first: int, stride: int, num_owners: int, contacts: SelfContacts):
    """Put the list aside before it is laid out anew."""
    for owner in range(first, num_owners, stride):
        contacts.old_starts[world, owner] = contacts.starts[world, owner]
        contacts.old_ends[world, owner] = contacts.ends[world, owner]
    for pair in range(first, contacts.num_pairs[world], stride):
        contacts.old_elements[world, pair] = contacts.elements[world, pair]
        contacts.old_normals[world, pair] = contacts.pair_normals[world, pair]


@wp.func
def lay_out_pairs(world: int, num_nodes: int, num_owners: int, contacts: SelfContacts):
    """Give every owner its part of the list. Without room for all it holds what may touch now, and is made anew the next time."""
    room = contacts.owners.shape[1] - REGISTER
    reach = contacts.found_reaches[world, 0]
    found = int(0)
    for owner in range(num_owners):
        reach = wp.min(reach, contacts.found_reaches[world, owner])
        found += contacts.found_counts[world, owner]
    limit = float(FAR)
    if found > room:
        limit = contacts.slacks[world] + ROUNDING
        reach = 0.0
    total = int(0)
    for owner in range(num_owners):
        contacts.starts[world, owner] = total
        for slot in range(owner * SLOTS, owner * SLOTS + contacts.found_counts[world, owner]):
            gap = contacts.found_gaps[world, slot]
            if gap < limit and total < room:
                contacts.owners[world, total] = owner
                contacts.elements[world, total] = contacts.found[world, slot]
                contacts.wakes[world, total] = gap
                total += 1
            elif gap < 0.0:
                contacts.dropped[world] = contacts.dropped[world] + 1
        contacts.ends[world, owner] = total
        if owner == num_nodes - 1:
            contacts.first_edges[world] = total
    contacts.num_pairs[world] = total
    contacts.reaches[world] = reach
    contacts.travels[world] = 0.0


@wp.func
def recall_normal(world: int, owner: int, element: int, contacts: SelfContacts) -> wp.vec3:
    """Return the normal of a pair in the list before, 0 if it had none."""
    for pair in range(contacts.old_starts[world, owner], contacts.old_ends[world, owner]):
        if contacts.old_elements[world, pair] == element:
            return contacts.old_normals[world, pair]
    return wp.vec3(0.0, 0.0, 0.0)


@wp.func
def list_pairs(thread: Thread, lane: int, objects: Objects, groups: Any, contacts: SelfContacts):
    """Lay out the pairs that a search found in one world."""
    variant = thread.variant
    world = groups.members[thread.group, lane]
    num_nodes = objects.node_counts[variant]
    num_edges = objects.element_starts[variant + 1] - objects.element_starts[variant] - objects.face_counts[variant]
    remember_pairs(world, thread.first, thread.stride, num_nodes + num_edges, contacts)
    synchronize_block()
    if thread.first == 0:
        lay_out_pairs(world, num_nodes, num_nodes + num_edges, contacts)
    synchronize_block()
    for pair in range(thread.first, contacts.num_pairs[world], thread.stride):
        owner = contacts.owners[world, pair]
        element = contacts.elements[world, pair]
        contacts.pair_nodes[world, pair] = contact_nodes(variant, owner, element, objects)
        contacts.pair_thicknesses[world, pair] = contact_thickness(variant, owner, element, objects)
        normal = wp.vec3(0.0, 0.0, 0.0)
        if contacts.wakes[world, pair] < contacts.slacks[world] + ROUNDING:  # what is asleep remembers no side
            normal = recall_normal(world, owner, element, contacts)
        contacts.pair_normals[world, pair] = normal
        contacts.pair_distances[world, pair] = 0.0
    synchronize_block()


@wp.func
def update_pairs(thread: Thread, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts):
    """Make the lists anew of those worlds of a group that may lack a pair."""
    if ask_for_lists(thread, worlds, groups, contacts):
        find_pairs(thread, objects, groups, contacts)
        for lane in range(groups.counts[thread.group]):
            if pick(groups.searched, thread.group, 0, lane) == 0.0:
                list_pairs(thread, lane, objects, groups, contacts)


@wp.func
def store_crossed(thread: Thread, worlds: Worlds, groups: Any, contacts: SelfContacts):
    """Write which pairs of all worlds of a group have passed through each other into their state."""
    for lane in range(thread.first, groups.counts[thread.group], thread.stride):
        world = groups.members[thread.group, lane]
        if not worlds.frozen[world]:
            room = worlds.crossed_owners.shape[1]
            count = int(0)
            for pair in range(contacts.num_pairs[world]):
                if contacts.pair_distances[world, pair] < 0.0:
                    if count < room:
                        worlds.crossed_owners[world, count] = contacts.owners[world, pair]
                        worlds.crossed_elements[world, count] = contacts.elements[world, pair]
                        count += 1
                    else:
                        contacts.dropped[world] = contacts.dropped[world] + 1
            for index in range(count, room):
                worlds.crossed_owners[world, index] = -1
                worlds.crossed_elements[world, index] = -1
    synchronize_block()
