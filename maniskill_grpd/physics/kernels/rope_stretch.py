"""Projection of the stretch of ropes in a group of worlds, slack or taut, at any stiffness; called by the fused kernel.

The tensions of a rope follow from one Newton step of XPBD, (J W J^T + compliance / dt^2) lambda = -C, whose matrix is tridiagonal
(Deul et al. 2018). Where they are small the nodes are pushed along the edges as predicted. Where they are large that would be
unstable across the rope; there the nodes go to the equilibrium of a net whose edges have these tensions as force densities.
"""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.data import Line, Objects, Thread
from maniskill_grpd.physics.kernels.impulses import push_node
from maniskill_grpd.physics.kernels.lanes import add, any_positive, choose, div, greater, inner, mul, root, spread, sub  # noqa: F401 (operators on lanes)
from maniskill_grpd.physics.kernels.stretch import find_line, project_sheet_line


@wp.func
def eliminate_rope(group: int, line: Line, is_straightened: bool, objects: Objects, groups: Any):
    """Eliminate the multipliers of a rope from its first edge to its last.

    Constraints are C_k = |x_k - x_k+1| - rest_k in the directions d_k at the nodes, or, for a rope that is straightened, in those
    at the points s of `straighten_rope`: there C_k is |s_k - s_k+1| - rest_k + d_k . ((x_k - s_k) - (x_k+1 - s_k+1)).

    A pivot is w_k+1 + y_k, y_k = how far the rope behind node k+1 yields to a unit impulse along edge k:

        y_k = compliance_k / dt^2 + w_k (y_k-1 + w_k sin^2) / (w_k + y_k-1),   y_0 = compliance_0 / dt^2 + w_0

    with the angle between edges k-1 and k. Nothing is subtracted, so y keeps its digits. The textbook form w_k + w_k+1 +
    compliance / dt^2 - w_k^2 cos^2 / pivot loses them on a straight rope with both ends held: all that is left there at the last
    edge is the sum of the compliances, which for a stiff rope is less than what w rounds by.
    """
    node = objects.line_nodes[line.first_node]
    x = groups.positions[group, node]
    w = groups.weights[group, node]
    rate = groups.stretch_rates[group, 0]
    behind = spread(w, 0.0)  # y of the edge before
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
        share = spread(w, 0.0)  # of the impulse along the edge before
        yielded = w
        if k > 0:
            bend = direction - last_direction
            turn = inner(bend, bend)
            sine_squared = turn * (spread(w, 1.0) - turn * 0.25)
            share = w / (w + behind)
            yielded = share * (behind + w * sine_squared)
            share = share * inner(last_direction, direction)
            groups.upper[group, k - 1] = share
        behind = yielded + rate * objects.stretch_compliances[line.first_edge + k]
        shortage = spread(length, objects.rest_lengths[line.first_edge + k]) - length
        if is_straightened:
            shortage = shortage - inner(direction, x - x_next - difference)
        eliminated = (shortage + w * inner(last_direction, direction) * eliminated) / (behind + w_next)
        groups.multipliers[group, k] = eliminated
        groups.directions[group, k] = direction
        last_direction = direction
        x = x_next
        w = w_next


@wp.func
def solve_tensions(group: int, line: Line, objects: Objects, groups: Any):
    """Substitute what `eliminate_rope` left; return the largest tension in units of the one from which on it is unstable.

    A tension T_k = -lambda_k / dt^2 moves nodes across by w T dt^2 / l times the second difference of their positions before the
    projection. A zigzag changes by -4 w T dt^2 / l times its amplitude; beyond -4/3 it overshoots by more than damping takes out.
    """
    multiplier = spread(groups.weights[group, objects.line_nodes[line.first_node]], 0.0)
    tautness = multiplier
    w = groups.weights[group, objects.line_nodes[line.first_node + line.num_edges]]
    for reverse in range(line.num_edges):
        k = line.num_edges - 1 - reverse
        if reverse > 0:
            multiplier = groups.multipliers[group, k] + groups.upper[group, k] * multiplier
        else:
            multiplier = groups.multipliers[group, k]
        groups.multipliers[group, k] = multiplier
        w_before = groups.weights[group, objects.line_nodes[line.first_node + k]]
        tautness = greater(tautness, (w_before + w) * multiplier * (-1.5 / objects.rest_lengths[line.first_edge + k]))
        w = w_before
    return tautness


@wp.func
def force_density(group: int, line: Line, k: int, tautness: Any, objects: Objects, groups: Any):
    """Return tau_k = T_k dt^2 / l_k of an edge under tension in worlds where the rope is taut, 0 elsewhere.

    l_k = rest_k + compliance_k T_k is how long an edge of that tension is; how long it is at present would be carried on.
    """
    nothing = spread(tautness, 0.0)
    impulse = greater(groups.multipliers[group, k] * -1.0, nothing)
    stretch = groups.stretch_rates[group, 0] * objects.stretch_compliances[line.first_edge + k] * impulse
    density = impulse / (stretch + spread(nothing, objects.rest_lengths[line.first_edge + k]))
    return choose(tautness - spread(tautness, 1.0), density, nothing)


@wp.func
def straighten_rope(group: int, line: Line, tautness: Any, is_last: bool, objects: Objects, groups: Any):
    """Compute where their tensions take the nodes of a taut rope (tautness > 1), with the directions of the result.

    Implicit in the directions, as with the geometric stiffness of Tournier et al. (2015), a substep leaves 1 / (1 + k) of a
    zigzag at any k = 4 w T dt^2 / l. With the force densities tau_k = T_k dt^2 / l_k (Schek 1974) that is one
    more tridiagonal system, the same for x, y and z:

        s_i = x_i + w_i (tau_i-1 (s_i-1 - s_i) + tau_i (s_i+1 - s_i))

    Every s_i is a weighted mean, so that nothing cancels. In worlds where the rope is not taut s is x. Force densities take the
    place of the multipliers. The last time nodes move to s, and what held ones are pulled by is added to their reactions.
    """
    density = spread(tautness, 0.0)  # of the edge behind
    ratio = spread(tautness, 0.0)
    point = spread(groups.positions[group, objects.line_nodes[line.first_node]], 0.0)
    for reverse in range(line.num_edges + 1):
        k = line.num_edges - reverse
        node = objects.line_nodes[line.first_node + k]
        w = groups.weights[group, node]
        density_before = spread(tautness, 0.0)
        if k > 0:
            density_before = force_density(group, line, k - 1, tautness, objects, groups)
            groups.multipliers[group, k - 1] = density_before
        pivot = spread(w, 1.0) + w * (density_before + density * (spread(w, 1.0) - ratio))
        point = (groups.positions[group, node] + point * (w * density)) / pivot
        ratio = w * density_before / pivot
        groups.straightened[group, k] = point
        if k > 0:
            groups.upper[group, k - 1] = ratio
        density = density_before

    for k in range(line.num_edges + 1):
        before = point
        if k > 0:
            point = groups.straightened[group, k] + point * groups.upper[group, k - 1]
            groups.straightened[group, k] = point
        if is_last:
            node = objects.line_nodes[line.first_node + k]
            groups.positions[group, node] = point
            if k > 0:
                last_node = objects.line_nodes[line.first_node + k - 1]
                if not (groups.is_free[group, node] and groups.is_free[group, last_node]):
                    pull = (before - point) * groups.multipliers[group, k - 1]
                    react(group, node, pull, groups)
                    react(group, last_node, pull * -1.0, groups)


@wp.func
def react(group: int, node: int, impulse: Any, groups: Any):
    """Add an impulse to the reactions of a node that is held."""
    if not groups.is_free[group, node]:
        reaction = groups.reactions[group, node]
        groups.reactions[group, node] = choose(groups.weights[group, node], reaction, reaction + impulse)


@wp.func
def push_rope(group: int, line: Line, tautness: Any, objects: Objects, groups: Any):
    """Apply the impulses lambda_k d_k; of a taut rope only those of compressed edges."""
    push = spread(groups.positions[group, objects.line_nodes[line.first_node]], 0.0)  # of the edge behind
    for reverse in range(line.num_edges):
        k = line.num_edges - 1 - reverse
        multiplier = groups.multipliers[group, k]
        compression = greater(multiplier, spread(multiplier, 0.0))
        pull = groups.directions[group, k] * choose(tautness - spread(tautness, 1.0), compression, multiplier)
        push_node(group, objects.line_nodes[line.first_node + k + 1], push - pull, groups)
        push = pull
    push_node(group, objects.line_nodes[line.first_node], push, groups)


@wp.func
def project_rope_line(thread: Thread, index: int, dt: float, objects: Objects, groups: Any):
    """Project the stretch of all edges of a rope at once; of lines of a cloth beside it as `project_sheet_line` does.

    The tensions of a taut rope are solved for twice, the second time in directions to which those of the first have straightened
    it. They never come out too large: a length is a convex function of the nodes, and its linearisation lies below it.
    """
    if not objects.is_rope[thread.variant]:
        project_sheet_line(thread, index, dt, objects, groups)
        return
    group = thread.group
    line = find_line(thread, index, objects)
    eliminate_rope(group, line, False, objects, groups)
    tautness = solve_tensions(group, line, objects, groups)
    is_taut = any_positive(tautness - spread(tautness, 1.0))
    if is_taut:
        straighten_rope(group, line, tautness, False, objects, groups)
        eliminate_rope(group, line, True, objects, groups)
        solve_tensions(group, line, objects, groups)
    push_rope(group, line, tautness, objects, groups)
    if is_taut:
        straighten_rope(group, line, tautness, True, objects, groups)
