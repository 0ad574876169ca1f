"""The phases of a substep in which worlds are taken out of their lanes, one by one, for contact."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.contact_search import (
    BLOCK,
    bound_block,
    bound_element,
    bound_spheres,
    find_candidates,
    register_contacts,
    sort_contacts,
)
from maniskill_grpd.physics.kernels.data import Objects, SelfContacts, Thread, Timing, Touch, Worlds
from maniskill_grpd.physics.kernels.lane_access import pick, put
from maniskill_grpd.physics.kernels.self_contact import SLOTS, compute_contact_impulse, gather_contact_impulses


@wp.func
def prepare_touch(group: int, node: int, groups: Any, touch: Touch):
    """Fetch what does not change within the step, and set reactions to zero."""
    for lane in range(groups.counts[group]):
        world = groups.members[group, lane]
        touch.weights[world, node] = pick(groups.weights, group, node, lane)
        touch.reactions[world, node] = wp.vec3(0.0, 0.0, 0.0)


@wp.func
def take_out_of_lanes(thread: Thread, num_nodes: int, groups: Any, touch: Touch):
    """Copy where the nodes are and where they were before the substep."""
    for node in range(thread.first, num_nodes, thread.stride):
        for lane in range(groups.counts[thread.group]):
            world = groups.members[thread.group, lane]
            touch.positions[world, node] = pick(groups.positions, thread.group, node, lane)
            touch.previous[world, node] = pick(groups.previous, thread.group, node, lane)
    synchronize_block()


@wp.func
def put_into_lanes(thread: Thread, num_nodes: int, groups: Any, touch: Touch):
    """Copy positions back."""
    for node in range(thread.first, num_nodes, thread.stride):
        for lane in range(groups.counts[thread.group]):
            put(groups.positions, thread.group, node, lane, touch.positions[groups.members[thread.group, lane], node])
    synchronize_block()


@wp.func
def add_reactions(thread: Thread, num_nodes: int, groups: Any, touch: Touch):
    """Add what contacts did to held nodes to what constraints did."""
    for node in range(thread.first, num_nodes, thread.stride):
        for lane in range(groups.counts[thread.group]):
            reaction = touch.reactions[groups.members[thread.group, lane], node]
            put(groups.reactions, thread.group, node, lane, pick(groups.reactions, thread.group, node, lane) + reaction)
    synchronize_block()


@wp.func
def bound_elements(thread: Thread, world: int, objects: Objects, touch: Touch, contacts: SelfContacts):
    """Compute the spheres about all elements, blocks of elements and clusters of blocks of one world."""
    first_element = objects.element_starts[thread.variant]
    num_elements = objects.element_starts[thread.variant + 1] - first_element
    for element in range(thread.first, num_elements, thread.stride):
        bound_element(world, element, thread.variant, objects, touch, contacts)
    synchronize_block()
    num_blocks = (num_elements + BLOCK - 1) // BLOCK
    for block in range(thread.first, num_blocks, thread.stride):
        bound_block(world, block, first_element, num_elements, objects, touch, contacts)
    synchronize_block()
    for cluster in range(thread.first, (num_blocks + BLOCK - 1) // BLOCK, thread.stride):
        contacts.cluster_spheres[world, cluster] = bound_spheres(world, cluster, num_blocks, contacts.block_spheres)
    synchronize_block()


@wp.func
def search_world(thread: Thread, world: int, timing: Timing, objects: Objects, touch: Touch, contacts: SelfContacts):
    """Find what may touch until the next search, and tell every node of its contacts."""
    num_nodes = objects.node_counts[thread.variant]
    for node in range(thread.first, num_nodes, thread.stride):
        contacts.num_of_node[world, node] = 0
    bound_elements(thread, world, objects, touch, contacts)
    duration = 2.0 * float(timing.search_interval) * timing.dt
    for owner in range(thread.first, objects.owner_counts[thread.variant], thread.stride):
        dropped = find_candidates(world, owner, thread.variant, duration, objects, touch, contacts)
        dropped += register_contacts(world, owner, contacts)
        if dropped > 0:
            wp.atomic_add(contacts.dropped, world, dropped)
    synchronize_block()
    for node in range(thread.first, num_nodes, thread.stride):
        sort_contacts(world, node, contacts)
    synchronize_block()


@wp.func
def find_self_contacts(
    thread: Thread, timing: Timing, objects: Objects, worlds: Worlds, groups: Any, touch: Touch, contacts: SelfContacts
):
    """Let all worlds of a group search for contacts."""
    group = thread.group
    for lane in range(groups.counts[group]):
        world = groups.members[group, lane]
        for node in range(thread.first, objects.node_counts[thread.variant], thread.stride):
            touch.positions[world, node] = pick(groups.positions, group, node, lane)
            touch.velocities[world, node] = pick(groups.velocities, group, node, lane)
        synchronize_block()
        if not worlds.frozen[world]:
            search_world(thread, world, timing, objects, touch, contacts)


@wp.func
def project_self_contacts(thread: Thread, world: int, friction: float, objects: Objects, touch: Touch, contacts: SelfContacts):
    """Keep the layers of one object apart: impulses from the same positions, then every node gathers those of its contacts."""
    variant = thread.variant
    thickness = 2.0 * objects.radii[variant]
    for node in range(thread.first, objects.node_counts[variant], thread.stride):
        contacts.num_active[world, node] = 0
    synchronize_block()
    for owner in range(thread.first, objects.owner_counts[variant], thread.stride):
        for index in range(contacts.counts[world, owner]):
            slot = owner * SLOTS + index
            compute_contact_impulse(world, slot, objects.is_rope[variant], thickness, friction, touch, contacts)
    synchronize_block()
    for node in range(thread.first, objects.node_counts[variant], thread.stride):
        if contacts.num_active[world, node] > 0:
            impulse = gather_contact_impulses(world, node, contacts)
            weight = touch.weights[world, node]
            if weight > 0.0:
                touch.positions[world, node] = touch.positions[world, node] + impulse * weight
            else:
                touch.reactions[world, node] = touch.reactions[world, node] + impulse
    synchronize_block()
