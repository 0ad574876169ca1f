"""Projections of the constraints inside an object, called by the fused kernel for one constraint of one world.

`weights` are inverse masses as the constraints see them, 0 for held and fixed nodes. An impulse lambda * grad C moves a free node
by weight * impulse; a held node stays, and the impulse is added to `reactions`, from which the force on its gripper follows.
"""

import warp as wp


@wp.func
def push_node(
    world: int,
    node: int,
    impulse: wp.vec3,
    weights: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    reactions: wp.array2d(dtype=wp.vec3),
):
    """Apply an impulse: x <- x + w * impulse for a free node, the gripper's reaction otherwise."""
    weight = weights[world, node]
    if weight > 0.0:
        positions[world, node] = positions[world, node] + impulse * weight
    else:
        reactions[world, node] = reactions[world, node] + impulse


@wp.func
def project_stretch_line(
    world: int,
    first_edge: int,
    first_node: int,
    first_scratch: int,
    num_edges: int,
    line_nodes: wp.array(dtype=int),
    rest_lengths: wp.array(dtype=float),
    compliances: wp.array(dtype=float),
    inverse_dt2: float,
    weights: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    reactions: wp.array2d(dtype=wp.vec3),
    directions: wp.array2d(dtype=wp.vec3),
    upper: wp.array2d(dtype=float),
    multipliers: wp.array2d(dtype=float),
):
    """Project all stretch constraints C_k = |x_k - x_k+1| - rest_k of a line of nodes at once.

    One Newton step of XPBD, (J W J^T + compliance / dt^2) lambda = -C, whose matrix is tridiagonal for a line and solved by
    elimination in O(N) (Deul et al. 2018). A sweep of single projections would carry tension by one node per substep and so add
    an elongation of its own that grows with resolution; the direct solve leaves only the material's.
    """
    pivot = float(1.0)
    eliminated = float(0.0)
    last_direction = wp.vec3(0.0, 0.0, 0.0)
    node = line_nodes[first_node]
    x = positions[world, node]
    w = weights[world, node]
    for k in range(num_edges):
        next_node = line_nodes[first_node + k + 1]
        x_next = positions[world, next_node]
        w_next = weights[world, next_node]
        difference = x - x_next
        length = wp.length(difference)
        direction = difference / wp.max(length, 1.0e-9)
        diagonal = w + w_next + compliances[first_edge + k] * inverse_dt2
        off_diagonal = -w * wp.dot(last_direction, direction)
        ratio = off_diagonal / pivot
        if k > 0:
            upper[world, first_scratch + k - 1] = ratio
        pivot = diagonal - off_diagonal * ratio
        eliminated = (rest_lengths[first_edge + k] - length - off_diagonal * eliminated) / pivot
        multipliers[world, first_scratch + k] = eliminated
        directions[world, first_scratch + k] = direction
        last_direction = direction
        x = x_next
        w = w_next

    multiplier = float(0.0)
    push = wp.vec3(0.0, 0.0, 0.0)  # lambda_k * direction_k of the edge behind
    for reverse in range(num_edges):
        k = num_edges - 1 - reverse
        multiplier = multipliers[world, first_scratch + k] - upper[world, first_scratch + k] * multiplier
        pull = directions[world, first_scratch + k] * multiplier
        push_node(world, line_nodes[first_node + k + 1], push - pull, weights, positions, reactions)
        push = pull
    push_node(world, line_nodes[first_node], push, weights, positions, reactions)


@wp.func
def project_bend(
    world: int,
    bend: wp.vec3i,
    compliance_over_dt2: float,
    weights: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    reactions: wp.array2d(dtype=wp.vec3),
):
    """Project the vector constraint C = x_p - 2 x_m + x_n, which is linear in the positions."""
    p = bend[0]
    m = bend[1]
    n = bend[2]
    w_p = weights[world, p]
    w_m = weights[world, m]
    w_n = weights[world, n]
    curvature = positions[world, p] - 2.0 * positions[world, m] + positions[world, n]
    correction = curvature / (w_p + 4.0 * w_m + w_n + compliance_over_dt2)
    push_node(world, p, -correction, weights, positions, reactions)
    if w_m > 0.0:
        positions[world, m] = positions[world, m] + correction * (2.0 * w_m)
    else:
        reactions[world, m] = reactions[world, m] + correction * 2.0
    push_node(world, n, -correction, weights, positions, reactions)


@wp.func
def project_hinge(
    world: int,
    nodes: wp.vec4i,
    c: wp.vec4,
    compliance_over_dt2: float,
    weights: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    reactions: wp.array2d(dtype=wp.vec3),
):
    """Project the vector constraint C = sum_k c_k x_k: lambda = -C / (sum_k w_k c_k^2 + compliance / dt^2)."""
    x_0 = positions[world, nodes[0]]
    x_1 = positions[world, nodes[1]]
    x_2 = positions[world, nodes[2]]
    x_3 = positions[world, nodes[3]]
    w_0 = weights[world, nodes[0]]
    w_1 = weights[world, nodes[1]]
    w_2 = weights[world, nodes[2]]
    w_3 = weights[world, nodes[3]]
    inverse_mass = w_0 * c[0] * c[0] + w_1 * c[1] * c[1] + w_2 * c[2] * c[2] + w_3 * c[3] * c[3]
    curvature = x_0 * c[0] + x_1 * c[1] + x_2 * c[2] + x_3 * c[3]
    impulse = curvature * (-1.0 / (inverse_mass + compliance_over_dt2))
    if wp.min(wp.min(w_0, w_1), wp.min(w_2, w_3)) > 0.0:
        positions[world, nodes[0]] = x_0 + impulse * (w_0 * c[0])
        positions[world, nodes[1]] = x_1 + impulse * (w_1 * c[1])
        positions[world, nodes[2]] = x_2 + impulse * (w_2 * c[2])
        positions[world, nodes[3]] = x_3 + impulse * (w_3 * c[3])
    else:
        for k in range(4):
            push_node(world, nodes[k], impulse * c[k], weights, positions, reactions)


@wp.func
def project_tethers(
    world: int,
    node: int,
    variant: int,
    max_stretch: float,
    geodesics: wp.array3d(dtype=float),
    gripper_nodes: wp.array2d(dtype=int),
    weights: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    tether_impulses: wp.array3d(dtype=wp.vec3),
):
    """Project C = |x_i - x_g| - max_stretch * geodesic_ig <= 0 towards every node g that a gripper holds (Kim et al. 2012).

    They carry the pull of a gripper through the whole cloth within one substep. Slack, they do nothing.
    """
    weight = weights[world, node]
    if weight > 0.0:
        for gripper in range(gripper_nodes.shape[1]):
            held = gripper_nodes[world, gripper]
            if held >= 0:
                difference = positions[world, held] - positions[world, node]
                distance = wp.length(difference)
                excess = distance - max_stretch * geodesics[variant, held, node]
                if excess > 0.0:
                    move = difference * (excess / distance)
                    positions[world, node] = positions[world, node] + move
                    tether_impulses[world, gripper, node] = tether_impulses[world, gripper, node] - move / weight
