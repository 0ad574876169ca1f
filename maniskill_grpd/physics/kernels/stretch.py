"""Projection of the stretch constraints of a line of nodes in a group of worlds, called by the fused kernel."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.data import Line, Objects, Thread
from maniskill_grpd.physics.kernels.impulses import push_node
from maniskill_grpd.physics.kernels.lanes import add, any_positive, choose, div, greater, inner, mul, root, spread, sub  # noqa: F401 (operators on lanes)

# Factor on the compliance of edges that have given way to compression.
WRINKLE_SOFTENING = wp.constant(100.0)


@wp.func
def eliminate_stretch_line(group: int, line: Line, wrinkling: float, is_straightened: bool, objects: Objects, groups: Any):
    """Start to project all stretch constraints C_k = |x_k - x_k+1| - rest_k of a line of nodes at once.

    One Newton step of XPBD, (J W J^T + compliance / dt^2) lambda = -C, whose matrix is tridiagonal for a line and solved by
    elimination in O(N) (Deul et al. 2018). A sweep of single projections would carry tension by one node per substep and so add
    an elongation of its own that grows with resolution; the direct solve leaves only the material's.

    Directions d_k are those at the nodes, or at the points s of `straighten_line`; there C_k is |s_k - s_k+1| - rest_k
    + d_k . ((x_k - s_k) - (x_k+1 - s_k+1)).

    Edges shorter than `wrinkling` times their rest length are soft: there the material would fold more finely than its mesh can
    (Choi and Ko 2002), and edges that resist would make the others stretch instead. 0 leaves them stiff.
    """
    node = objects.line_nodes[line.first_node]
    x = groups.positions[group, node]
    w = groups.weights[group, node]
    rate = groups.stretch_rates[group, 0]
    pivot = spread(w, 1.0)
    eliminated = spread(w, 0.0)
    last_direction = spread(x, 0.0)
    for k in range(line.num_edges):
        next_node = objects.line_nodes[line.first_node + k + 1]
        x_next = groups.positions[group, next_node]
        w_next = groups.weights[group, next_node]
        difference = x - x_next
        if is_straightened:
            difference = groups.straightened[group, k] - groups.straightened[group, k + 1]
        length = root(inner(difference, difference))
        direction = difference / greater(length, spread(length, 1.0e-9))
        compliance = rate * objects.stretch_compliances[line.first_edge + k]
        if wrinkling > 0.0:
            shortness = spread(length, objects.rest_lengths[line.first_edge + k] * wrinkling) - length
            compliance = choose(shortness, compliance * WRINKLE_SOFTENING, compliance)
        diagonal = w + w_next + compliance
        off_diagonal = w * inner(last_direction, direction)  # times -1
        ratio = off_diagonal / pivot
        if k > 0:
            groups.upper[group, line.first_scratch + k - 1] = ratio
        pivot = diagonal - off_diagonal * ratio
        shortage = spread(length, objects.rest_lengths[line.first_edge + k]) - length
        if is_straightened:
            shortage = shortage - inner(direction, x - x_next - difference)
        eliminated = (shortage + off_diagonal * eliminated) / pivot
        groups.multipliers[group, line.first_scratch + k] = eliminated
        groups.directions[group, line.first_scratch + k] = direction
        last_direction = direction
        x = x_next
        w = w_next


@wp.func
def push_stretch_line(group: int, line: Line, objects: Objects, groups: Any):
    """Substitute what `eliminate_stretch_line` left, and apply the impulses lambda_k d_k."""
    node = objects.line_nodes[line.first_node]
    multiplier = spread(groups.weights[group, node], 0.0)
    push = spread(groups.positions[group, node], 0.0)  # lambda_k * direction_k of the edge behind
    for reverse in range(line.num_edges):
        k = line.num_edges - 1 - reverse
        multiplier = substitute(group, line.first_scratch + k, reverse, multiplier, groups)
        pull = groups.directions[group, line.first_scratch + k] * multiplier
        push_node(group, objects.line_nodes[line.first_node + k + 1], push - pull, groups)
        push = pull
    push_node(group, node, push, groups)


@wp.func
def substitute(group: int, entry: int, num_behind: int, multiplier: Any, groups: Any):
    """Return lambda of an edge, given that of the edge behind it on the line if there is one."""
    result = groups.multipliers[group, entry]
    if num_behind > 0:
        result = result + groups.upper[group, entry] * multiplier
    return result


@wp.func
def measure_tautness(group: int, line: Line, objects: Objects, groups: Any):
    """Return the largest tension on a line in units of the one from which on it is unstable across the line.

    A tension T_k = -lambda_k / dt^2 moves nodes across by w T dt^2 / l times the second difference of their positions before the
    projection. A zigzag changes by -4 w T dt^2 / l times its amplitude; beyond -4/3 it overshoots by more than damping takes out.
    """
    multiplier = spread(groups.weights[group, objects.line_nodes[line.first_node]], 0.0)
    tautness = multiplier
    w = groups.weights[group, objects.line_nodes[line.first_node + line.num_edges]]
    for reverse in range(line.num_edges):
        k = line.num_edges - 1 - reverse
        multiplier = substitute(group, k, reverse, multiplier, groups)
        w_before = groups.weights[group, objects.line_nodes[line.first_node + k]]
        tautness = greater(tautness, (w_before + w) * multiplier * (-1.5 / objects.rest_lengths[line.first_edge + k]))
        w = w_before
    return tautness


@wp.func
def straighten_line(group: int, line: Line, tautness: Any, objects: Objects, groups: Any):
    """Predict where its tension takes a taut line (tautness > 1), so that directions are those at the end of the substep.

    Implicit in the directions, as with the geometric stiffness of Tournier et al. (2015), a substep leaves 1 / (1 + k) of a
    zigzag at any k = 4 w T dt^2 / l. With the force densities tau_k = T_k dt^2 / l_k (Schek 1974) that is one more tridiagonal
    system, the same for x, y and z:

        s_i = x_i + w_i (tau_i-1 (s_i-1 - s_i) + tau_i (s_i+1 - s_i))

    In worlds where the line is not taut s is x, bit by bit.
    """
    multiplier = spread(tautness, 0.0)
    density = spread(tautness, 0.0)  # of the edge behind
    ratio = spread(tautness, 0.0)
    point = spread(groups.positions[group, objects.line_nodes[line.first_node]], 0.0)
    for reverse in range(line.num_edges + 1):
        k = line.num_edges - reverse
        node = objects.line_nodes[line.first_node + k]
        w = groups.weights[group, node]
        density_before = spread(tautness, 0.0)
        if k > 0:
            multiplier = substitute(group, k - 1, reverse, multiplier, groups)
            density_before = greater(multiplier * (-1.0 / objects.rest_lengths[line.first_edge + k - 1]), density_before)
        pivot = spread(w, 1.0) + w * (density_before + density * (spread(w, 1.0) - ratio))
        point = (groups.positions[group, node] + point * (w * density)) / pivot
        ratio = w * density_before / pivot
        groups.straightened[group, k] = point
        if k > 0:
            groups.upper[group, k - 1] = ratio
        density = density_before

    excess = tautness - spread(tautness, 1.0)
    for k in range(line.num_edges + 1):
        if k > 0:
            point = groups.straightened[group, k] + point * groups.upper[group, k - 1]
        groups.straightened[group, k] = choose(excess, point, groups.positions[group, objects.line_nodes[line.first_node + k]])


@wp.func
def find_line(thread: Thread, index: int, objects: Objects) -> Line:
    """Return where a line is. A single thread computes one line after the other in the same scratch."""
    line = Line()
    line.first_edge = objects.line_edges[index]
    line.first_node = line.first_edge + index
    line.num_edges = objects.line_edges[index + 1] - line.first_edge
    line.first_scratch = 0
    if thread.stride > 1:
        line.first_scratch = line.first_edge - objects.line_edges[objects.line_colors[objects.line_ranges[thread.variant]]]
    return line


@wp.func
def project_sheet_line(thread: Thread, index: int, objects: Objects, groups: Any):
    """Project the stretch of all edges of a line at once."""
    line = find_line(thread, index, objects)
    eliminate_stretch_line(thread.group, line, objects.wrinkling[thread.variant], False, objects, groups)
    push_stretch_line(thread.group, line, objects, groups)


@wp.func
def project_rope_line(thread: Thread, index: int, objects: Objects, groups: Any):
    """Project the stretch of all edges of a line at once, in the directions to which a taut rope is pulled."""
    group = thread.group
    line = find_line(thread, index, objects)
    wrinkling = objects.wrinkling[thread.variant]
    eliminate_stretch_line(group, line, wrinkling, False, objects, groups)
    if objects.is_rope[thread.variant]:
        tautness = measure_tautness(group, line, objects, groups)
        if any_positive(tautness - spread(tautness, 1.0)):
            straighten_line(group, line, tautness, objects, groups)
            eliminate_stretch_line(group, line, wrinkling, True, objects, groups)
    push_stretch_line(group, line, objects, groups)
