"""The list of contacts of an object with itself, and what they remember, called by the fused kernel.

After each search the list is laid out anew: owner by owner, so that it depends on nothing but what was found. A contact that was
in the list before keeps its normal. From one control step to the next the normals are those of the gaps, but for contacts whose
elements have passed through each other: these are part of the state.
"""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import count_up, synchronize_block
from maniskill_grpd.physics.kernels.contact_search import SLOTS, contact_gap, contact_nodes, contact_thickness, find_contacts
from maniskill_grpd.physics.kernels.data import Objects, SelfContacts, Thread, Timing, Worlds
from maniskill_grpd.physics.kernels.lanes import WIDTH

# Contacts of nodes fill whole registers, and those of edges begin behind them.
REGISTER = wp.constant(WIDTH)


@wp.func
def remember_contacts(world: int, first: int, stride: int, num_owners: int, contacts: SelfContacts):
    """Put the list aside before it is laid out anew."""
    for owner in range(first, num_owners, stride):
        contacts.old_starts[world, owner] = contacts.starts[world, owner]
        contacts.old_ends[world, owner] = contacts.ends[world, owner]
    for contact in range(first, contacts.num_contacts[world], stride):
        contacts.old_elements[world, contact] = contacts.elements[world, contact]
        contacts.old_normals[world, contact] = contacts.normals[world, contact]


@wp.func
def lay_out_contacts(world: int, num_nodes: int, num_owners: int, contacts: SelfContacts):
    """Give every owner its part of the list; count what has no room."""
    room = contacts.nodes.shape[1] - REGISTER  # the last register may be read beyond its contacts
    total = int(0)
    for owner in range(num_owners):
        if owner == num_nodes:
            end = (total + REGISTER - 1) // REGISTER * REGISTER
            for contact in range(total, end):  # a contact without thickness does nothing
                contacts.nodes[world, contact] = wp.vec4i(0, 0, 0, 0)
                contacts.thicknesses[world, contact] = 0.0
            total = end
        contacts.starts[world, owner] = total
        kept = wp.max(wp.min(contacts.found_counts[world, owner], room - total), 0)
        contacts.dropped[world] = contacts.dropped[world] + contacts.found_counts[world, owner] - kept
        total += kept
        contacts.ends[world, owner] = total
    if num_owners == num_nodes:
        contacts.starts[world, num_nodes] = total
    contacts.num_contacts[world] = total


@wp.func
def recall_normal(
    world: int, owner: int, element: int, gap: wp.vec3, is_first: bool, worlds: Worlds, contacts: SelfContacts
) -> wp.vec3:
    """Return the normal of a contact: that of the list before, or of the gap, against which it points if the two have crossed."""
    length = wp.length(gap)
    outward = wp.vec3(0.0, 0.0, 1.0)
    if length > 0.0:
        outward = gap / length
    if is_first:
        for index in range(worlds.crossed_owners.shape[1]):
            if worlds.crossed_owners[world, index] < 0:
                break
            if worlds.crossed_owners[world, index] == owner and worlds.crossed_elements[world, index] == element:
                return -outward
        return outward
    for contact in range(contacts.old_starts[world, owner], contacts.old_ends[world, owner]):
        if contacts.old_elements[world, contact] == element:
            return contacts.old_normals[world, contact]
    return outward


@wp.func
def fill_contacts(
    thread: Thread, lane: int, owner: int, is_first: bool, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts
):
    """Write the contacts of an owner into its part of the list, and count those of every node."""
    world = groups.members[thread.group, lane]
    is_edges = owner >= objects.node_counts[thread.variant]
    start = contacts.starts[world, owner]
    for contact in range(start, contacts.ends[world, owner]):
        element = contacts.found[world, owner * SLOTS + contact - start]
        nodes = contact_nodes(thread.variant, owner, element, objects)
        gap = contact_gap(thread.group, lane, nodes, is_edges, groups)
        contacts.nodes[world, contact] = nodes
        contacts.owners[world, contact] = owner
        contacts.elements[world, contact] = element
        contacts.distances[world, contact] = 0.0
        contacts.thicknesses[world, contact] = contact_thickness(thread.variant, owner, element, objects)
        contacts.normals[world, contact] = recall_normal(world, owner, element, gap, is_first, worlds, contacts)
        for k in range(4):
            count_up(contacts.num_of_node, world, nodes[k])


@wp.func
def lay_out_entries(world: int, num_nodes: int, contacts: SelfContacts):
    """Give every node its part of the list of entries, one for each contact that it takes part in."""
    total = int(0)
    for node in range(num_nodes):
        contacts.entry_starts[world, node] = total
        total += contacts.num_of_node[world, node]
        contacts.num_of_node[world, node] = 0
    contacts.entry_starts[world, num_nodes] = total


@wp.func
def enter_contacts(world: int, owner: int, contacts: SelfContacts):
    """Enter the contacts of an owner with each of their four nodes, in an order that `sort_entries` undoes."""
    for contact in range(contacts.starts[world, owner], contacts.ends[world, owner]):
        nodes = contacts.nodes[world, contact]
        for k in range(4):
            place = count_up(contacts.num_of_node, world, nodes[k])
            contacts.entries[world, contacts.entry_starts[world, nodes[k]] + place] = 4 * contact + k


@wp.func
def sort_entries(world: int, node: int, contacts: SelfContacts):
    """Sort the entries of a node, so that sums do not depend on the order in which threads made them."""
    start = contacts.entry_starts[world, node]
    for i in range(start + 1, contacts.entry_starts[world, node + 1]):
        entry = contacts.entries[world, i]
        j = int(i)
        while j > start and contacts.entries[world, wp.max(j - 1, 0)] > entry:
            contacts.entries[world, j] = contacts.entries[world, j - 1]
            j -= 1
        contacts.entries[world, j] = entry


@wp.func
def list_contacts(
    thread: Thread, lane: int, is_first: bool, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts
):
    """Lay out the contacts that a search found in one world."""
    world = groups.members[thread.group, lane]
    num_nodes = objects.node_counts[thread.variant]
    num_edges = objects.element_starts[thread.variant + 1] - objects.element_starts[thread.variant]
    num_owners = num_nodes + num_edges - objects.face_counts[thread.variant]
    if not is_first:
        remember_contacts(world, thread.first, thread.stride, num_owners, contacts)
    for node in range(thread.first, num_nodes, thread.stride):
        contacts.num_of_node[world, node] = 0
    synchronize_block()
    if thread.first == 0:
        lay_out_contacts(world, num_nodes, num_owners, contacts)
    synchronize_block()
    if contacts.num_contacts[world] == 0:
        return
    for owner in range(thread.first, num_owners, thread.stride):
        fill_contacts(thread, lane, owner, is_first, objects, worlds, groups, contacts)
    synchronize_block()
    if thread.first == 0:
        lay_out_entries(world, num_nodes, contacts)
    synchronize_block()
    for owner in range(thread.first, num_owners, thread.stride):
        enter_contacts(world, owner, contacts)
    synchronize_block()
    for node in range(thread.first, num_nodes, thread.stride):
        sort_entries(world, node, contacts)
    synchronize_block()


@wp.func
def find_self_contacts(
    thread: Thread, is_first: bool, timing: Timing, objects: Objects, worlds: Worlds, groups: Any, contacts: SelfContacts
):
    """Search in all worlds of a group, and lay out what is found.

    The first search of a control step (`is_first`) knows no list before it, but that of crossed contacts.
    """
    find_contacts(thread, timing, objects, worlds, groups, contacts)
    for lane in range(groups.counts[thread.group]):
        if not worlds.frozen[groups.members[thread.group, lane]]:
            list_contacts(thread, lane, is_first, objects, worlds, groups, contacts)


@wp.func
def store_crossed(thread: Thread, worlds: Worlds, groups: Any, contacts: SelfContacts):
    """Write which contacts of all worlds of a group have passed through each other into their state."""
    for lane in range(thread.first, groups.counts[thread.group], thread.stride):
        world = groups.members[thread.group, lane]
        if not worlds.frozen[world]:
            room = worlds.crossed_owners.shape[1]
            count = int(0)
            for contact in range(contacts.num_contacts[world]):
                if contacts.distances[world, contact] < 0.0 and contacts.thicknesses[world, contact] > 0.0:
                    if count < room:
                        worlds.crossed_owners[world, count] = contacts.owners[world, contact]
                        worlds.crossed_elements[world, count] = contacts.elements[world, contact]
                        count += 1
                    else:
                        contacts.dropped[world] = contacts.dropped[world] + 1
            for index in range(count, room):
                worlds.crossed_owners[world, index] = -1
                worlds.crossed_elements[world, index] = -1
    synchronize_block()
