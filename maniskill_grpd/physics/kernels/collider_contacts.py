"""Contact of nodes and edges with all colliders of their world, called by the fused kernel."""

import warp as wp

from maniskill_grpd.physics.kernels.colliders import closest_on_edge, project_collider
from maniskill_grpd.physics.kernels.data import Obstacles, Touch


@wp.func
def project_colliders(
    world: int, position: wp.vec3, previous: wp.vec3, radius: float, friction: float, obstacles: Obstacles
) -> wp.vec3:
    """Keep one point out of all active colliders of its world, in their order."""
    for k in range(obstacles.kinds.shape[0]):
        if obstacles.active[world, k]:
            position = project_collider(
                position,
                previous,
                radius,
                friction,
                obstacles.positions[world, k],
                obstacles.rotations[world, k],
                k,
                obstacles.kinds[k],
                obstacles.sizes[world, k],
                obstacles.polygon_sizes[k],
                obstacles.polygons,
                obstacles.meshes[k],
            )
    return position


@wp.func
def project_edge(world: int, edge: wp.vec2i, radius: float, friction: float, obstacles: Obstacles, touch: Touch):
    """Keep the point x = (1 - t) x_i + t x_j of an edge that is closest to a collider out of it.

    A correction d of the point moves its nodes by w_i (1 - t) d / s and w_j t d / s with s = w_i (1 - t)^2 + w_j t^2.
    """
    i = edge[0]
    j = edge[1]
    w_i = touch.weights[world, i]
    w_j = touch.weights[world, j]
    if w_i + w_j > 0.0:
        for k in range(obstacles.kinds.shape[0]):
            if obstacles.active[world, k]:
                x_i = touch.positions[world, i]
                x_j = touch.positions[world, j]
                t = closest_on_edge(
                    x_i,
                    x_j,
                    radius,
                    obstacles.positions[world, k],
                    obstacles.rotations[world, k],
                    k,
                    obstacles.kinds[k],
                    obstacles.sizes[world, k],
                    obstacles.polygon_sizes[k],
                    obstacles.polygons,
                    obstacles.meshes[k],
                )
                if t > 0.0:
                    point = x_i * (1.0 - t) + x_j * t
                    start = touch.previous[world, i] * (1.0 - t) + touch.previous[world, j] * t
                    moved = project_collider(
                        point,
                        start,
                        radius,
                        friction,
                        obstacles.positions[world, k],
                        obstacles.rotations[world, k],
                        k,
                        obstacles.kinds[k],
                        obstacles.sizes[world, k],
                        obstacles.polygon_sizes[k],
                        obstacles.polygons,
                        obstacles.meshes[k],
                    )
                    share = w_i * (1.0 - t) * (1.0 - t) + w_j * t * t
                    if share > 0.0:
                        touch.positions[world, i] = x_i + (moved - point) * (w_i * (1.0 - t) / share)
                        touch.positions[world, j] = x_j + (moved - point) * (w_j * t / share)
