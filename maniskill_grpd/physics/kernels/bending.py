"""Projection of the bending constraints of a group of worlds, called by the fused kernel."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.data import Objects, Thread
from maniskill_grpd.physics.kernels.impulses import push_node
from maniskill_grpd.physics.kernels.lanes import add, choose, cross, div, greater, inner, mul, root, spread, sub  # noqa: F401 (operators on lanes)

# Edges shorter than the root of this [m^2], and triangles of less than twice that area, have no direction.
SMALLEST_SQUARE = wp.constant(1.0e-14)


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
def project_fold(group: int, nodes: wp.vec4i, rest_sine: float, compliance: float, groups: Any):
    """Project C = sin(theta / 2) - sin(theta_0 / 2) of the angle theta between two triangles.

    The gradient of theta (Grinspun et al. 2003) is that of the two unit normals over the heights of the triangles, and what the
    apexes get the ends of the edge get back at the feet of those heights: momentum and angular momentum are conserved.
    """
    x = groups.positions[group, nodes[0]]
    along = groups.positions[group, nodes[1]] - x
    to_first = groups.positions[group, nodes[2]] - x
    to_second = groups.positions[group, nodes[3]] - x
    first = cross(along, to_first)
    second = cross(to_second, along)
    length2 = inner(along, along)
    smallest = spread(length2, SMALLEST_SQUARE)
    length2 = greater(length2, smallest)
    first2 = greater(inner(first, first), smallest * smallest)
    second2 = greater(inner(second, second), smallest * smallest)
    first_normal = first / root(first2)
    second_normal = second / root(second2)
    apart = first_normal - second_normal
    together = first_normal + second_normal
    sine = root(inner(apart, apart)) * 0.5
    cosine = root(inner(together, together)) * 0.5
    sine = choose(inner(cross(second, first), along), sine, sine * -1.0)
    slope = cosine * root(length2) * 0.5
    first_gradient = first * (slope / first2)
    second_gradient = second * (slope / second2)
    end_gradient = first_gradient * (inner(to_first, along) / length2) + second_gradient * (inner(to_second, along) / length2)
    start_gradient = first_gradient + second_gradient - end_gradient
    inverse_mass = (
        groups.weights[group, nodes[0]] * inner(start_gradient, start_gradient)
        + groups.weights[group, nodes[1]] * inner(end_gradient, end_gradient)
        + groups.weights[group, nodes[2]] * inner(first_gradient, first_gradient)
        + groups.weights[group, nodes[3]] * inner(second_gradient, second_gradient)
    )
    multiplier = (spread(sine, rest_sine) - sine) / (inverse_mass + groups.bend_rates[group, 0] * compliance)
    push_node(group, nodes[0], start_gradient * multiplier * -1.0, groups)
    push_node(group, nodes[1], end_gradient * multiplier * -1.0, groups)
    push_node(group, nodes[2], first_gradient * multiplier, groups)
    push_node(group, nodes[3], second_gradient * multiplier, groups)


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


@wp.func
def project_folds(thread: Thread, objects: Objects, groups: Any):
    """Project the hinges that are folded at rest, one colour after the other."""
    for color in range(objects.fold_ranges[thread.variant], objects.fold_ranges[thread.variant + 1] - 1):
        for c in range(objects.fold_colors[color] + thread.first, objects.fold_colors[color + 1], thread.stride):
            project_fold(thread.group, objects.folds[c], objects.fold_sines[c], objects.fold_compliances[c], groups)
        synchronize_block()
