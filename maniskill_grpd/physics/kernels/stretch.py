"""Projection of the stretch constraints of the lines of a cloth in a group of worlds, called by the fused kernel."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.data import Line, Objects, Thread, Worlds
from maniskill_grpd.physics.kernels.impulses import push_node
from maniskill_grpd.physics.kernels.lane_access import pick, put
from maniskill_grpd.physics.kernels.lanes import add, choose, div, greater, inner, mul, root, spread, sub  # noqa: F401 (operators on lanes)

# Factor on the compliance of edges that have given way to compression.
WRINKLE_SOFTENING = wp.constant(100.0)
# Time in which carried impulses follow the tension [s]: long beside the oscillations of a draped cloth, or they feed them.
TENSION_MEMORY = wp.constant(1.5)
# How many times faster they follow a tension that falls: what is carried beyond it would contract a cloth that has been let go.
RELEASE = wp.constant(4.0)
# Largest carried impulse in units of l / (w_i + w_j): a node between two such edges is moved by its own offset from their line.
# Beyond 2/3 it would overshoot by more than that.
MAX_CARRIED = wp.constant(0.2)


@wp.func
def eliminate_stretch_line(group: int, line: Line, wrinkling: float, objects: Objects, groups: Any):
    """Start to project all stretch constraints C_k = |x_k - x_k+1| - rest_k of a line of nodes at once.

    One Newton step of XPBD, (J W J^T + compliance / dt^2) lambda = -C, whose matrix is tridiagonal for a line and solved by
    elimination in O(N) (Deul et al. 2018). A sweep of single projections would carry tension by one node per substep and so add
    an elongation of its own that grows with resolution; the direct solve leaves only the material's.

    What `pull_sheet_line` has applied already is a part of lambda: the compliance adds it to C, and only the rest is solved for.

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
        shortage = shortage + compliance * groups.carried[group, line.first_column + k]
        eliminated = (shortage + off_diagonal * eliminated) / pivot
        groups.multipliers[group, line.first_scratch + k] = eliminated
        groups.directions[group, line.first_scratch + k] = direction
        last_direction = direction
        x = x_next
        w = w_next


@wp.func
def push_stretch_line(group: int, line: Line, carry_rate: float, objects: Objects, groups: Any):
    """Substitute what `eliminate_stretch_line` left, apply the impulses lambda_k d_k and let the carried ones follow."""
    node = objects.line_nodes[line.first_node]
    multiplier = spread(groups.weights[group, node], 0.0)
    push = spread(groups.positions[group, node], 0.0)  # lambda_k * direction_k of the edge behind
    for reverse in range(line.num_edges):
        k = line.num_edges - 1 - reverse
        multiplier = substitute(group, line.first_scratch + k, reverse, multiplier, groups)
        carry_impulse(group, line, k, multiplier * spread(multiplier, carry_rate), objects, groups)
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
def carry_impulse(group: int, line: Line, k: int, change: Any, objects: Objects, groups: Any):
    """Let the carried impulse of an edge follow what the solve finds missing, within its bounds."""
    w = groups.weights[group, objects.line_nodes[line.first_node + k]]
    w = w + groups.weights[group, objects.line_nodes[line.first_node + k + 1]]
    bound = spread(w, MAX_CARRIED * objects.rest_lengths[line.first_edge + k]) / greater(w, spread(w, 1.0e-9))
    carried = groups.carried[group, line.first_column + k]
    impulse = carried - choose(carried * change, change * spread(w, RELEASE), change)
    impulse = greater(impulse, bound * -1.0)
    groups.carried[group, line.first_column + k] = bound - greater(bound - impulse, spread(bound, 0.0))


@wp.func
def first_edge_of(variant: int, objects: Objects) -> int:
    """Return where the edges of a variant begin."""
    return objects.line_edges[objects.line_colors[objects.line_ranges[variant]]]


@wp.func
def num_edges_of(variant: int, objects: Objects) -> int:
    """Return how many edges a variant has."""
    return objects.line_edges[objects.line_colors[objects.line_ranges[variant + 1] - 1]] - first_edge_of(variant, objects)


@wp.func
def find_line(thread: Thread, index: int, objects: Objects) -> Line:
    """Return where a line is. A single thread computes one line after the other in the same scratch."""
    line = Line()
    line.first_edge = objects.line_edges[index]
    line.first_node = line.first_edge + index
    line.num_edges = objects.line_edges[index + 1] - line.first_edge
    line.first_column = line.first_edge - first_edge_of(thread.variant, objects)
    line.first_scratch = 0
    if thread.stride > 1:
        line.first_scratch = line.first_column
    return line


@wp.func
def load_tensions(thread: Thread, dt: float, objects: Objects, worlds: Worlds, groups: Any):
    """Fetch the tension of every edge as the impulse of one substep."""
    group = thread.group
    for k in range(thread.first, num_edges_of(thread.variant, objects), thread.stride):
        for lane in range(groups.members.shape[1]):
            put(groups.carried, group, k, lane, worlds.tensions[groups.members[group, lane], k] * (dt * dt))


@wp.func
def store_tensions(thread: Thread, dt: float, objects: Objects, worlds: Worlds, groups: Any):
    """Store the carried impulses of all worlds that are not frozen as tensions [N]."""
    group = thread.group
    for lane in range(groups.counts[group]):
        world = groups.members[group, lane]
        if not worlds.frozen[world]:
            for k in range(thread.first, num_edges_of(thread.variant, objects), thread.stride):
                worlds.tensions[world, k] = pick(groups.carried, group, k, lane) / (dt * dt)


@wp.func
def pull_sheet_line(thread: Thread, index: int, objects: Objects, groups: Any):
    """Apply the carried impulses of a line, in the directions of its edges at the start of the substep.

    A substep that starts from zero multipliers has to build up all tension in one sweep over the lines, and falls short by what
    gravity adds in the meantime: cloth then is softer than its material, the more so the finer its mesh. Tension that lasts is
    carried from substep to substep instead, and the sweep has only changes to find.

    Impulses along the edges' directions at the start change no angular momentum: with v = (x' - x) / dt that of a node is
    m x' x (x' - x) / dt = m x x x' / dt, so a pair of them adds (x_i - x_j) x d. Impulses along the directions of the sweep
    do, in a sense that follows its order.
    """
    line = find_line(thread, index, objects)
    group = thread.group
    node = objects.line_nodes[line.first_node]
    x = groups.previous[group, node]
    pull = spread(x, 0.0)
    for k in range(line.num_edges):
        next_node = objects.line_nodes[line.first_node + k + 1]
        x_next = groups.previous[group, next_node]
        difference = x_next - x
        length = root(inner(difference, difference))
        next_pull = difference * (groups.carried[group, line.first_column + k] / greater(length, spread(length, 1.0e-9)))
        push_node(group, node, next_pull - pull, groups)
        pull = next_pull
        node = next_node
        x = x_next
    push_node(group, node, pull * -1.0, groups)


@wp.func
def project_sheet_line(thread: Thread, index: int, dt: float, objects: Objects, groups: Any):
    """Project the stretch of all edges of a line at once."""
    line = find_line(thread, index, objects)
    eliminate_stretch_line(thread.group, line, objects.wrinkling[thread.variant], objects, groups)
    push_stretch_line(thread.group, line, dt / TENSION_MEMORY, objects, groups)
