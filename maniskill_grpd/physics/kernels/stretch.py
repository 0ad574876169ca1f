"""Projection of the stretch constraints of the lines of a cloth in a group of worlds, called by the fused kernel."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.data import Line, Objects, Thread
from maniskill_grpd.physics.kernels.impulses import push_node
from maniskill_grpd.physics.kernels.lanes import add, choose, div, greater, inner, mul, root, spread, sub  # noqa: F401 (operators on lanes)

# Factor on the compliance of edges that have given way to compression.
WRINKLE_SOFTENING = wp.constant(100.0)


@wp.func
def eliminate_stretch_line(group: int, line: Line, wrinkling: float, objects: Objects, groups: Any):
    """Start to project all stretch constraints C_k = |x_k - x_k+1| - rest_k of a line of nodes at once.

    One Newton step of XPBD, (J W J^T + compliance / dt^2) lambda = -C, whose matrix is tridiagonal for a line and solved by
    elimination in O(N) (Deul et al. 2018). A sweep of single projections would carry tension by one node per substep and so add
    an elongation of its own that grows with resolution; the direct solve leaves only the material's.

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
    eliminate_stretch_line(thread.group, line, objects.wrinkling[thread.variant], objects, groups)
    push_stretch_line(thread.group, line, objects, groups)
