"""Contact of nodes and edges with all colliders of their world, called by the fused kernel."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.colliders import FAR, local_distance, local_high, local_low, place_collider
from maniskill_grpd.physics.kernels.data import Colliders, Objects, PlacedCollider, Thread, Worlds
from maniskill_grpd.physics.kernels.lane_access import component, pick, put
from maniskill_grpd.physics.kernels.lanes import add, any_positive, choose, div, greater, inner, lesser, mul, root, spread, sub  # noqa: F401 (operators on lanes)

# Evaluations of the signed distance along one motion; conservative advancement of a sphere needs about five.
SWEEP_STEPS = wp.constant(12)
# How close to touching a sweep stops, as a fraction of the object's radius.
SWEEP_TOLERANCE = wp.constant(0.02)
# Halvings of the stretch of an edge that is searched for the point closest to a collider.
SEARCH_STEPS = wp.constant(5)
# Closest points in this part of an edge at either end are left to its nodes.
EDGE_END = wp.constant(0.05)
# Distance, in longest edges, within which a node is near a collider: an edge that touches has an end within half its length, and
# the rest is for its stretch and for what the contacts before it in the substep did.
NEAR_EDGE = wp.constant(1.25)


@wp.func
def resolve_contact(position: Any, previous: Any, normal: Any, depth: Any, friction: Any):
    """Push points out of a surface where their depth is positive and apply Coulomb friction to their motion within the substep.

    The normal correction `depth` is the normal impulse in position units, so the tangential motion is cancelled up to
    friction * depth: complete cancellation is stick, the rest slides (Macklin et al. 2014, section 6.1).
    """
    moved = position - previous
    tangential = moved - normal * inner(moved, normal)
    slip = root(inner(tangential, tangential))
    nothing = spread(depth, 0.0)
    cancelled = choose(slip, lesser(spread(depth, 1.0), friction * depth / slip), nothing)
    return choose(depth, position + normal * depth - tangential * cancelled, position)


@wp.func
def closest_on_edge(
    collider: PlacedCollider, x_i: wp.vec3, x_j: wp.vec3, radius: float, polygons: wp.array2d(dtype=wp.vec2)
) -> float:
    """Return the fraction t at which an edge is closest to a collider, 0 if it does not come near or an end does.

    The signed distance of a convex collider is convex along the edge: its slope (the normal along the edge) tells on which side
    the minimum lies, and bisection finds it.
    """
    start = wp.quat_rotate_inv(collider.rotation, x_i - collider.position)
    along = wp.quat_rotate_inv(collider.rotation, x_j - x_i)
    at = local_distance(collider, start + 0.5 * along, polygons)
    if at[3] > radius + 0.5 * wp.length(along):
        return 0.0
    low = float(0.0)
    high = float(1.0)
    for _step in range(SEARCH_STEPS):
        middle = 0.5 * (low + high)
        at = local_distance(collider, start + middle * along, polygons)
        if at[0] * along[0] + at[1] * along[1] + at[2] * along[2] > 0.0:
            high = middle
        else:
            low = middle
    t = 0.5 * (low + high)
    if t < EDGE_END or t > 1.0 - EDGE_END:
        return 0.0
    return t


@wp.func
def project_collider(
    collider: PlacedCollider,
    position: wp.vec3,
    previous: wp.vec3,
    radius: float,
    friction: float,
    polygons: wp.array2d(dtype=wp.vec2),
) -> wp.vec3:
    """Keep a point at its radius from a collider, however far it moved in the substep.

    The motion is swept by conservative advancement: steps of the signed distance cannot miss a surface. A point that ends
    inside, or beyond the far side of a thin plate, is brought back to the tangent plane where it met the surface.
    """
    start = wp.quat_rotate_inv(collider.rotation, previous - collider.position)
    end = wp.quat_rotate_inv(collider.rotation, position - collider.position)
    motion = end - start
    travel = wp.length(motion)
    met = local_distance(collider, start, polygons)
    if met[3] - radius > travel:
        return position
    touching = radius * (1.0 + SWEEP_TOLERANCE)
    progress = float(0.0)
    for _step in range(SWEEP_STEPS):
        if met[3] > touching:
            progress += (met[3] - radius) / travel
            if progress >= 1.0:
                return position
            met = local_distance(collider, start + motion * progress, polygons)
    at = local_distance(collider, end, polygons)
    normal = wp.vec3(at[0], at[1], at[2])
    depth = radius - at[3]
    met_normal = wp.vec3(met[0], met[1], met[2])
    if wp.dot(normal, met_normal) < 0.0 or at[3] < 0.0:
        normal = met_normal
        depth = radius - (met[3] + wp.dot(met_normal, motion) * (1.0 - progress))
    if depth <= 0.0:
        return position
    return wp.quat_rotate(collider.rotation, resolve_contact(end, start, normal, depth, friction)) + collider.position


@wp.func
def place_collider_bounds(group: int, colliders: Colliders, groups: Any):
    """Fetch the pose and the bounding box of every collider, in its own frame, of all worlds of a group."""
    for k in range(colliders.kinds.shape[0]):
        for lane in range(groups.members.shape[1]):
            world = groups.members[group, lane]
            collider = place_collider(world, k, colliders)
            put(groups.collider_positions, group, k, lane, collider.position)
            low = local_low(collider, colliders.lows[k])
            high = local_high(collider, colliders.highs[k])
            for axis in range(3):
                unit = wp.vec3(0.0, 0.0, 0.0)
                unit[axis] = 1.0
                put(groups.collider_axes, group, 3 * k + axis, lane, wp.quat_rotate(collider.rotation, unit))
                put(groups.collider_lows, group, 3 * k + axis, lane, wp.where(colliders.active[world, k], low[axis], FAR))
                put(groups.collider_highs, group, 3 * k + axis, lane, high[axis])


@wp.func
def bound_distance(group: int, k: int, position: Any, groups: Any):
    """Return a distance that is at most that of a point from a collider: the largest along an axis of its bounding box."""
    offset = position - groups.collider_positions[group, k]
    distance = spread(groups.weights[group, 0], -FAR)
    for axis in range(3 * k, 3 * k + 3):
        along = inner(offset, groups.collider_axes[group, axis])
        beyond = greater(along - groups.collider_highs[group, axis], groups.collider_lows[group, axis] - along)
        distance = greater(distance, beyond)
    return distance


@wp.func
def find_near_node(group: int, node: int, reach: float, num_colliders: int, groups: Any):
    """Compute in which worlds a node may touch a collider in this substep, or an edge at it may: where `nearness` is > 0."""
    moved = groups.positions[group, node] - groups.previous[group, node]
    far = root(inner(moved, moved)) + spread(groups.weights[group, node], reach)
    nearness = spread(far, -1.0)
    for k in range(num_colliders):
        nearness = greater(nearness, far - bound_distance(group, k, groups.previous[group, node], groups))
    groups.nearness[group, node] = nearness


@wp.func
def project_node(world: int, lane: int, group: int, node: int, radius: float, colliders: Colliders, friction: float, groups: Any):
    """Keep a free node out of all active colliders of its world, in their order."""
    if pick(groups.weights, group, node, lane) > 0.0:
        position = pick(groups.positions, group, node, lane)
        previous = pick(groups.previous, group, node, lane)
        for k in range(colliders.kinds.shape[0]):
            if colliders.active[world, k]:
                collider = place_collider(world, k, colliders)
                position = project_collider(collider, position, previous, radius, friction, colliders.polygons)
        put(groups.positions, group, node, lane, position)


@wp.func
def project_edge(
    world: int, lane: int, group: int, edge: wp.vec2i, radius: float, colliders: Colliders, friction: float, groups: Any
):
    """Keep the point x = (1 - t) x_i + t x_j of an edge that is closest to a collider out of it.

    A correction d of the point moves its nodes by w_i (1 - t) d / s and w_j t d / s with s = w_i (1 - t)^2 + w_j t^2.
    """
    i = edge[0]
    j = edge[1]
    w_i = pick(groups.weights, group, i, lane)
    w_j = pick(groups.weights, group, j, lane)
    if w_i + w_j > 0.0:
        for k in range(colliders.kinds.shape[0]):
            if colliders.active[world, k]:
                x_i = pick(groups.positions, group, i, lane)
                x_j = pick(groups.positions, group, j, lane)
                collider = place_collider(world, k, colliders)
                t = closest_on_edge(collider, x_i, x_j, radius, colliders.polygons)
                if t > 0.0:
                    point = x_i * (1.0 - t) + x_j * t
                    start = pick(groups.previous, group, i, lane) * (1.0 - t) + pick(groups.previous, group, j, lane) * t
                    moved = project_collider(collider, point, start, radius, friction, colliders.polygons)
                    share = w_i * (1.0 - t) * (1.0 - t) + w_j * t * t
                    if share > 0.0:
                        put(groups.positions, group, i, lane, x_i + (moved - point) * (w_i * (1.0 - t) / share))
                        put(groups.positions, group, j, lane, x_j + (moved - point) * (w_j * t / share))


@wp.func
def project_near_edge(thread: Thread, edge: wp.vec2i, radius: float, colliders: Colliders, worlds: Worlds, groups: Any):
    """Keep an edge out of the colliders in those worlds where it is near any."""
    group = thread.group
    nearness = greater(groups.nearness[group, edge[0]], groups.nearness[group, edge[1]])
    if any_positive(nearness):
        for lane in range(groups.counts[group]):
            if component(nearness, lane) > 0.0:
                world = groups.members[group, lane]
                project_edge(world, lane, group, edge, radius, colliders, worlds.friction[world], groups)


@wp.func
def project_near_node(thread: Thread, node: int, radius: float, colliders: Colliders, worlds: Worlds, groups: Any):
    """Keep a node out of the colliders in those worlds where it is near any."""
    group = thread.group
    nearness = groups.nearness[group, node]
    if any_positive(nearness):
        for lane in range(groups.counts[group]):
            if component(nearness, lane) > 0.0:
                world = groups.members[group, lane]
                project_node(world, lane, group, node, radius, colliders, worlds.friction[world], groups)


@wp.func
def project_colliders(thread: Thread, objects: Objects, colliders: Colliders, worlds: Worlds, groups: Any):
    """Keep edges, then nodes out of all colliders. What is far from them is passed over in lanes."""
    variant = thread.variant
    radius = objects.radii[variant]
    reach = radius + NEAR_EDGE * objects.longest_edges[variant]
    for node in range(thread.first, objects.node_counts[variant], thread.stride):
        find_near_node(thread.group, node, reach, colliders.kinds.shape[0], groups)
    synchronize_block()
    for color in range(objects.mesh_edge_ranges[variant], objects.mesh_edge_ranges[variant + 1] - 1):
        for c in range(objects.mesh_edge_colors[color] + thread.first, objects.mesh_edge_colors[color + 1], thread.stride):
            project_near_edge(thread, objects.mesh_edges[c], radius, colliders, worlds, groups)
        synchronize_block()
    for node in range(thread.first, objects.node_counts[variant], thread.stride):
        project_near_node(thread, node, radius, colliders, worlds, groups)
    synchronize_block()
