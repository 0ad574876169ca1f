"""Projection of the bending constraints of a group of worlds, called by the fused kernel."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.data import Objects, Thread
from maniskill_grpd.physics.kernels.impulses import push_node
from maniskill_grpd.physics.kernels.lanes import add, div, mul, spread, sub  # noqa: F401 (operators on lanes)


@wp.func
def project_bend(group: int, bend: wp.vec3i, compliance: float, groups: Any):
    """Project the vector constraint C = x_p - 2 x_m + x_n, which is linear in the positions."""
    p = bend[0]
    m = bend[1]
    n = bend[2]
    w_p = groups.weights[group, p]
    w_m = groups.weights[group, m]
    w_n = groups.weights[group, n]
    curvature = groups.positions[group, p] - groups.positions[group, m] * 2.0 + groups.positions[group, n]
    correction = curvature / (w_p + w_m * 4.0 + w_n + groups.bend_rates[group, 0] * compliance)
    push_node(group, p, correction * -1.0, groups)
    push_node(group, m, correction * 2.0, groups)
    push_node(group, n, correction * -1.0, groups)


@wp.func
def project_hinge(group: int, nodes: wp.vec4i, c: wp.vec4, compliance: float, groups: Any):
    """Project the vector constraint C = sum_k c_k x_k: lambda = -C / (sum_k w_k c_k^2 + compliance / dt^2)."""
    curvature = groups.positions[group, nodes[0]] * c[0]
    inverse_mass = groups.weights[group, nodes[0]] * (c[0] * c[0])
    for k in range(1, 4):
        curvature = curvature + groups.positions[group, nodes[k]] * c[k]
        inverse_mass = inverse_mass + groups.weights[group, nodes[k]] * (c[k] * c[k])
    share = spread(inverse_mass, -1.0) / (inverse_mass + groups.bend_rates[group, 0] * compliance)
    impulse = curvature * share
    for k in range(4):
        push_node(group, nodes[k], impulse * c[k], groups)


@wp.func
def project_bends(thread: Thread, objects: Objects, groups: Any):
    """Project the triples of ropes and of the rows of square grids, one colour after the other."""
    for color in range(objects.bend_ranges[thread.variant], objects.bend_ranges[thread.variant + 1] - 1):
        for c in range(objects.bend_colors[color] + thread.first, objects.bend_colors[color + 1], thread.stride):
            project_bend(thread.group, objects.bends[c], objects.bend_compliances[c], groups)
        synchronize_block()


@wp.func
def project_hinges(thread: Thread, objects: Objects, groups: Any):
    """Project the hinges between triangles, one colour after the other."""
    for color in range(objects.hinge_ranges[thread.variant], objects.hinge_ranges[thread.variant + 1] - 1):
        for c in range(objects.hinge_colors[color] + thread.first, objects.hinge_colors[color + 1], thread.stride):
            project_hinge(thread.group, objects.hinges[c], objects.hinge_weights[c], objects.hinge_compliances[c], groups)
        synchronize_block()
