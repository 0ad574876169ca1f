"""The phases of a substep in which worlds are taken out of their lanes, one by one, for contact."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.barrier import synchronize_block
from maniskill_grpd.physics.kernels.collider_contacts import project_colliders, project_edge
from maniskill_grpd.physics.kernels.contact_search import (
    BLOCK,
    bound_block,
    bound_element,
    bound_spheres,
    find_candidates,
    register_contacts,
    sort_contacts,
)
from maniskill_grpd.physics.kernels.data import Objects, Obstacles, SelfContacts, Touch, Worlds
from maniskill_grpd.physics.kernels.lanes import pick, put
from maniskill_grpd.physics.kernels.self_contact import SLOTS, compute_contact_impulse, gather_contact_impulses


@wp.func
def prepare_touch(group: int, node: int, groups: Any, touch: Touch):
    """Fetch what does not change within the step, and set reactions to zero."""
    for lane in range(groups.counts[group]):
        world = groups.members[group, lane]
        touch.weights[world, node] = pick(groups.weights, group, node, lane)
        touch.reactions[world, node] = wp.vec3(0.0, 0.0, 0.0)


@wp.func
def take_out_of_lanes(group: int, thread: int, threads: int, num_nodes: int, groups: Any, touch: Touch):
    """Copy where the nodes are and where they were before the substep."""
    for node in range(thread, num_nodes, threads):
        for lane in range(groups.counts[group]):
            world = groups.members[group, lane]
            touch.positions[world, node] = pick(groups.positions, group, node, lane)
            touch.previous[world, node] = pick(groups.previous, group, node, lane)
    synchronize_block()


@wp.func
def put_into_lanes(group: int, thread: int, threads: int, num_nodes: int, groups: Any, touch: Touch):
    """Copy positions back."""
    for node in range(thread, num_nodes, threads):
        for lane in range(groups.counts[group]):
            put(groups.positions, group, node, lane, touch.positions[groups.members[group, lane], node])
    synchronize_block()


@wp.func
def add_reactions(group: int, thread: int, threads: int, num_nodes: int, groups: Any, touch: Touch):
    """Add what contacts did to held nodes to what constraints did."""
    for node in range(thread, num_nodes, threads):
        for lane in range(groups.counts[group]):
            reaction = touch.reactions[groups.members[group, lane], node]
            put(groups.reactions, group, node, lane, pick(groups.reactions, group, node, lane) + reaction)
    synchronize_block()


@wp.func
def search_world(
    world: int,
    thread: int,
    threads: int,
    search_interval: int,
    dt: float,
    variant: int,
    objects: Objects,
    touch: Touch,
    contacts: SelfContacts,
):
    """Find what may touch until the next search, and tell every node of its contacts."""
    num_nodes = objects.node_counts[variant]
    first_element = objects.element_starts[variant]
    num_elements = objects.element_starts[variant + 1] - first_element
    for node in range(thread, num_nodes, threads):
        contacts.num_of_node[world, node] = 0
    for element in range(thread, num_elements, threads):
        bound_element(
            world, element, first_element, objects.is_rope[variant], objects.elements, touch.positions, contacts.element_spheres
        )
    synchronize_block()
    num_blocks = (num_elements + BLOCK - 1) // BLOCK
    for block in range(thread, num_blocks, threads):
        bound_block(
            world,
            block,
            first_element,
            num_elements,
            objects.elements,
            touch.velocities,
            contacts.element_spheres,
            contacts.block_spheres,
            contacts.block_motions,
        )
    synchronize_block()
    for cluster in range(thread, (num_blocks + BLOCK - 1) // BLOCK, threads):
        contacts.cluster_spheres[world, cluster] = bound_spheres(world, cluster, num_blocks, contacts.block_spheres)
    synchronize_block()
    for owner in range(thread, objects.owner_counts[variant], threads):
        dropped = find_candidates(
            world,
            owner,
            first_element,
            num_elements,
            objects.is_rope[variant],
            objects.radii[variant],
            objects.exclusions[variant],
            2.0 * float(search_interval) * dt,
            variant,
            objects.elements,
            contacts.element_spheres,
            objects.geodesics,
            touch.positions,
            touch.velocities,
            contacts.nodes,
            contacts.sides,
            contacts.gaps,
            contacts.counts,
            contacts.block_spheres,
            contacts.block_motions,
            contacts.cluster_spheres,
        )
        dropped += register_contacts(world, owner, contacts.nodes, contacts.counts, contacts.of_node, contacts.num_of_node)
        if dropped > 0:
            wp.atomic_add(contacts.dropped, world, dropped)
    synchronize_block()
    for node in range(thread, num_nodes, threads):
        sort_contacts(world, node, contacts.of_node, contacts.num_of_node)
    synchronize_block()


@wp.func
def find_self_contacts(
    group: int,
    thread: int,
    threads: int,
    search_interval: int,
    dt: float,
    variant: int,
    objects: Objects,
    worlds: Worlds,
    groups: Any,
    touch: Touch,
    contacts: SelfContacts,
):
    """Let all worlds of a group search for contacts."""
    num_nodes = objects.node_counts[variant]
    for lane in range(groups.counts[group]):
        world = groups.members[group, lane]
        for node in range(thread, num_nodes, threads):
            touch.positions[world, node] = pick(groups.positions, group, node, lane)
            touch.velocities[world, node] = pick(groups.velocities, group, node, lane)
        synchronize_block()
        if not worlds.frozen[world]:
            search_world(world, thread, threads, search_interval, dt, variant, objects, touch, contacts)


@wp.func
def project_self_contacts(
    world: int, thread: int, threads: int, variant: int, friction: float, objects: Objects, touch: Touch, contacts: SelfContacts
):
    """Keep the layers of one object apart: impulses from the same positions, then every node gathers those of its contacts."""
    thickness = 2.0 * objects.radii[variant]
    for node in range(thread, objects.node_counts[variant], threads):
        contacts.num_active[world, node] = 0
    synchronize_block()
    for owner in range(thread, objects.owner_counts[variant], threads):
        for index in range(contacts.counts[world, owner]):
            compute_contact_impulse(
                world,
                owner * SLOTS + index,
                objects.is_rope[variant],
                thickness,
                friction,
                contacts.nodes,
                contacts.sides,
                touch.weights,
                touch.positions,
                touch.previous,
                contacts.weights,
                contacts.impulses,
                contacts.num_active,
            )
    synchronize_block()
    for node in range(thread, objects.node_counts[variant], threads):
        if contacts.num_active[world, node] > 0:
            impulse = gather_contact_impulses(
                world,
                node,
                contacts.of_node,
                contacts.num_of_node,
                contacts.nodes,
                contacts.weights,
                contacts.impulses,
                contacts.num_active,
            )
            weight = touch.weights[world, node]
            if weight > 0.0:
                touch.positions[world, node] = touch.positions[world, node] + impulse * weight
            else:
                touch.reactions[world, node] = touch.reactions[world, node] + impulse
    synchronize_block()


@wp.func
def project_obstacles(
    world: int, thread: int, threads: int, variant: int, friction: float, objects: Objects, obstacles: Obstacles, touch: Touch
):
    """Keep edges, then nodes out of all colliders."""
    radius = objects.radii[variant]
    for color in range(objects.mesh_edge_ranges[variant], objects.mesh_edge_ranges[variant + 1] - 1):
        for c in range(objects.mesh_edge_colors[color] + thread, objects.mesh_edge_colors[color + 1], threads):
            project_edge(world, objects.mesh_edges[c], radius, friction, obstacles, touch)
        synchronize_block()
    for node in range(thread, objects.node_counts[variant], threads):
        if touch.weights[world, node] > 0.0:
            touch.positions[world, node] = project_colliders(
                world, touch.positions[world, node], touch.previous[world, node], radius, friction, obstacles
            )
    synchronize_block()
