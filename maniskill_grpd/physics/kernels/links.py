"""Contact with the links of arms: capsules that move while a control step lasts, called by the fused kernel.

Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.collider_contacts import NEAR_EDGE, resolve_contact
from maniskill_grpd.physics.kernels.data import Links, Objects, Thread, Timing, Worlds
from maniskill_grpd.physics.kernels.lane_access import pick, put

# What is within this distance through the material of where a hand holds lies between its fingers [m].
PINCHED = wp.constant(0.04)
# Speed with which what is inside a link comes out again [m/s]; faster would fling it away.
RECOVERY_SPEED = wp.constant(0.5)
# Distance beyond what velocities say within which a link is looked at during the whole control step [m].
SPARE_REACH = wp.constant(0.02)
# Closest points in this part of an edge at either end are left to its nodes.
EDGE_END = wp.constant(0.05)


@wp.func
def share_on_axis(point: wp.vec3, start: wp.vec3, end: wp.vec3) -> float:
    """Return where on a segment it is closest to a point, 0 at its start and 1 at its end."""
    along = end - start
    return wp.clamp(wp.dot(point - start, along) / wp.max(wp.dot(along, along), 1.0e-12), 0.0, 1.0)


@wp.func
def axis_distance(point: wp.vec3, start: wp.vec3, end: wp.vec3) -> float:
    """Return the distance of a point from a segment."""
    return wp.length(point - wp.lerp(start, end, share_on_axis(point, start, end)))


@wp.func
def find_near_links_of_node(world: int, node: int, reach: float, variant: int, objects: Objects, worlds: Worlds, links: Links):
    """Mark the links that a node may touch in this control step, and those between whose fingers it lies."""
    near = int(0)
    pinched = int(0)
    position = worlds.positions[world, node]
    for link in range(links.radii.shape[0]):
        held = worlds.gripper_nodes[world, links.owners[link]]
        if held >= 0 and objects.geodesics[variant, wp.max(held, 0), node] < PINCHED:
            pinched = pinched | (1 << link)
        moved = float(0.0)
        for end in range(2 * link, 2 * link + 2):
            moved = wp.max(moved, wp.length(links.ends[world, end] - links.starts[world, end]))
        gap = axis_distance(position, links.starts[world, 2 * link], links.starts[world, 2 * link + 1]) - links.radii[link]
        if gap < reach + moved:
            near = near | (1 << link)
    links.near[world, node] = near
    links.pinched[world, node] = pinched


@wp.func
def find_near_links(thread: Thread, timing: Timing, objects: Objects, worlds: Worlds, groups: Any, links: Links):
    """Mark which links each node may touch in this control step, in every world of a group and in any of them."""
    margin = objects.radii[thread.variant] + NEAR_EDGE * objects.longest_edges[thread.variant] + SPARE_REACH
    duration = timing.dt * float(timing.num_substeps)
    for node in range(thread.first, objects.node_counts[thread.variant], thread.stride):
        near = int(0)
        for lane in range(groups.counts[thread.group]):
            world = groups.members[thread.group, lane]
            reach = margin + wp.length(worlds.velocities[world, node]) * duration
            find_near_links_of_node(world, node, reach, thread.variant, objects, worlds, links)
            near = near | links.near[world, node]
        links.near_any[thread.group, node] = near


@wp.func
def push_out(
    world: int,
    link: int,
    progress: wp.vec2,
    point: wp.vec3,
    previous: wp.vec3,
    margin: float,
    friction: float,
    dt: float,
    links: Links,
) -> wp.vec3:
    """Keep a point, that was at `previous` a substep ago, at a margin from a link that moves too; progress before and after.

    What was inside before comes out slowly.
    """
    a = 2 * link
    start = wp.lerp(links.starts[world, a], links.ends[world, a], progress[1])
    end = wp.lerp(links.starts[world, a + 1], links.ends[world, a + 1], progress[1])
    share = share_on_axis(point, start, end)
    on_axis = wp.lerp(start, end, share)
    away = point - on_axis
    distance = wp.length(away)
    depth = links.radii[link] + margin - distance
    if depth <= 0.0 or distance < 1.0e-6:
        return point
    start_before = wp.lerp(links.starts[world, a], links.ends[world, a], progress[0])
    end_before = wp.lerp(links.starts[world, a + 1], links.ends[world, a + 1], progress[0])
    depth_before = links.radii[link] + margin - axis_distance(previous, start_before, end_before)
    depth = wp.min(depth, depth - wp.max(depth_before, 0.0) + RECOVERY_SPEED * dt)
    if depth <= 0.0:
        return point
    carried = previous + on_axis - wp.lerp(start_before, end_before, share)
    return resolve_contact(point, carried, away / distance, depth, friction)


@wp.func
def push_node(
    world: int,
    lane: int,
    group: int,
    node: int,
    margin: float,
    friction: float,
    progress: wp.vec2,
    dt: float,
    groups: Any,
    links: Links,
):
    """Keep a free node out of the links it may touch, in their order."""
    touchable = links.near[world, node] & ~links.pinched[world, node]
    if touchable != 0 and pick(groups.weights, group, node, lane) > 0.0:
        position = pick(groups.positions, group, node, lane)
        previous = pick(groups.previous, group, node, lane)
        for link in range(links.radii.shape[0]):
            if (touchable >> link) & 1:
                position = push_out(world, link, progress, position, previous, margin, friction, dt, links)
        put(groups.positions, group, node, lane, position)


@wp.func
def closest_share(x_i: wp.vec3, x_j: wp.vec3, start: wp.vec3, end: wp.vec3) -> float:
    """Return where on an edge it is closest to a segment, 0 and 1 at its nodes (Ericson 2005, section 5.1.9)."""
    along = x_j - x_i
    axis = end - start
    between = x_i - start
    a = wp.dot(along, along)
    b = wp.dot(along, axis)
    e = wp.max(wp.dot(axis, axis), 1.0e-12)
    f = wp.dot(axis, between)
    c = wp.dot(along, between)
    divisor = a * e - b * b
    t = float(0.5)
    if divisor > 1.0e-9 * a * e:
        t = wp.clamp((b * f - c * e) / divisor, 0.0, 1.0)
    on_axis = wp.clamp((b * t + f) / e, 0.0, 1.0)
    return wp.clamp((b * on_axis - c) / wp.max(a, 1.0e-12), 0.0, 1.0)


@wp.func
def push_edge(
    world: int,
    lane: int,
    group: int,
    edge: wp.vec2i,
    margin: float,
    friction: float,
    progress: wp.vec2,
    dt: float,
    groups: Any,
    links: Links,
):
    """Keep the point of an edge that is closest to a link out of it; its nodes share the motion by their inverse masses."""
    i = edge[0]
    j = edge[1]
    touchable = (links.near[world, i] | links.near[world, j]) & ~(links.pinched[world, i] | links.pinched[world, j])
    w_i = pick(groups.weights, group, i, lane)
    w_j = pick(groups.weights, group, j, lane)
    if touchable != 0 and w_i + w_j > 0.0:
        for link in range(links.radii.shape[0]):
            if (touchable >> link) & 1:
                x_i = pick(groups.positions, group, i, lane)
                x_j = pick(groups.positions, group, j, lane)
                start = wp.lerp(links.starts[world, 2 * link], links.ends[world, 2 * link], progress[1])
                end = wp.lerp(links.starts[world, 2 * link + 1], links.ends[world, 2 * link + 1], progress[1])
                t = closest_share(x_i, x_j, start, end)
                share = w_i * (1.0 - t) * (1.0 - t) + w_j * t * t
                if t > EDGE_END and t < 1.0 - EDGE_END and share > 0.0:
                    point = wp.lerp(x_i, x_j, t)
                    previous = wp.lerp(pick(groups.previous, group, i, lane), pick(groups.previous, group, j, lane), t)
                    moved = push_out(world, link, progress, point, previous, margin, friction, dt, links) - point
                    put(groups.positions, group, i, lane, x_i + moved * (w_i * (1.0 - t) / share))
                    put(groups.positions, group, j, lane, x_j + moved * (w_j * t / share))


@wp.func
def project_links(thread: Thread, substep: int, timing: Timing, objects: Objects, worlds: Worlds, groups: Any, links: Links):
    """Keep edges, then nodes out of the links of all arms, as far as these have come after a substep."""
    margin = objects.radii[thread.variant]
    group = thread.group
    steps = float(timing.num_substeps)
    progress = wp.vec2(float(substep) / steps, float(substep + 1) / steps)
    for color in range(objects.mesh_edge_ranges[thread.variant], objects.mesh_edge_ranges[thread.variant + 1] - 1):
        for c in range(objects.mesh_edge_colors[color] + thread.first, objects.mesh_edge_colors[color + 1], thread.stride):
            edge = objects.mesh_edges[c]
            if (links.near_any[group, edge[0]] | links.near_any[group, edge[1]]) != 0:
                for lane in range(groups.counts[group]):
                    world = groups.members[group, lane]
                    push_edge(world, lane, group, edge, margin, worlds.friction[world], progress, timing.dt, groups, links)
        synchronize_block()
    for node in range(thread.first, objects.node_counts[thread.variant], thread.stride):
        if links.near_any[group, node] != 0:
            for lane in range(groups.counts[group]):
                world = groups.members[group, lane]
                push_node(world, lane, group, node, margin, worlds.friction[world], progress, timing.dt, groups, links)
    synchronize_block()
