"""Contact of nodes and edges with all colliders of their world, called by the fused kernel."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.colliders import local_distance, place_collider
from maniskill_grpd.physics.kernels.data import Colliders, Objects, PlacedCollider, Thread, Touch
from maniskill_grpd.physics.kernels.lanes import add, choose, div, inner, lesser, mul, root, spread, sub  # noqa: F401 (operators)

# Evaluations of the signed distance along one motion; conservative advancement of a sphere needs about five.
SWEEP_STEPS = wp.constant(12)
# How close to touching a sweep stops, as a fraction of the object's radius.
SWEEP_TOLERANCE = wp.constant(0.02)
# Halvings of the stretch of an edge that is searched for the point closest to a collider.
SEARCH_STEPS = wp.constant(5)
# Closest points in this part of an edge at either end are left to its nodes.
EDGE_END = wp.constant(0.05)


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
def project_node(world: int, node: int, radius: float, friction: float, colliders: Colliders, touch: Touch):
    """Keep a free node out of all active colliders of its world, in their order."""
    if touch.weights[world, node] > 0.0:
        position = touch.positions[world, node]
        for k in range(colliders.kinds.shape[0]):
            if colliders.active[world, k]:
                collider = place_collider(world, k, colliders)
                position = project_collider(collider, position, touch.previous[world, node], radius, friction, colliders.polygons)
        touch.positions[world, node] = position


@wp.func
def project_edge(world: int, edge: wp.vec2i, radius: float, friction: float, colliders: Colliders, touch: Touch):
    """Keep the point x = (1 - t) x_i + t x_j of an edge that is closest to a collider out of it.

    A correction d of the point moves its nodes by w_i (1 - t) d / s and w_j t d / s with s = w_i (1 - t)^2 + w_j t^2.
    """
    i = edge[0]
    j = edge[1]
    w_i = touch.weights[world, i]
    w_j = touch.weights[world, j]
    if w_i + w_j > 0.0:
        for k in range(colliders.kinds.shape[0]):
            if colliders.active[world, k]:
                x_i = touch.positions[world, i]
                x_j = touch.positions[world, j]
                collider = place_collider(world, k, colliders)
                t = closest_on_edge(collider, x_i, x_j, radius, colliders.polygons)
                if t > 0.0:
                    point = x_i * (1.0 - t) + x_j * t
                    start = touch.previous[world, i] * (1.0 - t) + touch.previous[world, j] * t
                    moved = project_collider(collider, point, start, radius, friction, colliders.polygons)
                    share = w_i * (1.0 - t) * (1.0 - t) + w_j * t * t
                    if share > 0.0:
                        touch.positions[world, i] = x_i + (moved - point) * (w_i * (1.0 - t) / share)
                        touch.positions[world, j] = x_j + (moved - point) * (w_j * t / share)


@wp.func
def project_colliders(thread: Thread, world: int, friction: float, objects: Objects, colliders: Colliders, touch: Touch):
    """Keep edges, then nodes out of all colliders."""
    variant = thread.variant
    radius = objects.radii[variant]
    for color in range(objects.mesh_edge_ranges[variant], objects.mesh_edge_ranges[variant + 1] - 1):
        for c in range(objects.mesh_edge_colors[color] + thread.first, objects.mesh_edge_colors[color + 1], thread.stride):
            project_edge(world, objects.mesh_edges[c], radius, friction, colliders, touch)
        synchronize_block()
    for node in range(thread.first, objects.node_counts[variant], thread.stride):
        project_node(world, node, radius, friction, colliders, touch)
    synchronize_block()
