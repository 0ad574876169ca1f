"""The fused XPBD kernel: every substep of one control step, for one world per thread block.

On CUDA a block of threads works on one world: its lanes stride over nodes and over the constraints of one colour, with a block
barrier in between. On CPU the block has one lane and the same source is a plain sequential loop; worlds are split over threads
by the caller. Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

import warp as wp

wp.config.log_level = wp.LOG_WARNING  # no banner when a library is imported

# A world is frozen when a coordinate is not finite or has left this range [m]: past it float32 cannot hold millimetres.
POSITION_LIMIT = wp.constant(1.0e4)
# Most sweeps over the gripper pairs, and the relative excess that is left alone: four grippers in a row need about forty.
LEASH_SWEEPS = wp.constant(64)
LEASH_TOLERANCE = wp.constant(1.0e-4)


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
"""
)
def synchronize_block():
    """Wait until all lanes of the block have arrived; nothing to do for the single lane of the CPU."""


@wp.func
def is_valid(p: wp.vec3) -> bool:
    """True when all coordinates are finite and within range."""
    return wp.abs(p[0]) < POSITION_LIMIT and wp.abs(p[1]) < POSITION_LIMIT and wp.abs(p[2]) < POSITION_LIMIT


@wp.func
def effective_inverse_mass(inverse_mass: float, gripper: int) -> float:
    """Inverse mass of a node as the constraints see it: held nodes are kinematic."""
    if gripper >= 0:
        return 0.0
    return inverse_mass


@wp.func
def limit_gripper_targets(world: int, leashes: wp.array3d(dtype=float), gripper_targets: wp.array2d(dtype=wp.vec3)):
    """Draw grippers together that would pull the object beyond its own length.

    Kinematic grippers have unlimited force and would tear any rope. Each pair that is further apart than its leash moves by half
    the excess, so targets stay inside their convex hull.
    """
    for _sweep in range(LEASH_SWEEPS):
        num_taut = int(0)
        for a in range(gripper_targets.shape[1]):
            for b in range(a):
                difference = gripper_targets[world, a] - gripper_targets[world, b]
                distance = wp.length(difference)
                if distance > leashes[world, a, b] * (1.0 + LEASH_TOLERANCE):
                    num_taut += 1
                    correction = difference * (0.5 * (distance - leashes[world, a, b]) / distance)
                    gripper_targets[world, a] = gripper_targets[world, a] - correction
                    gripper_targets[world, b] = gripper_targets[world, b] + correction
        if num_taut == 0:
            break


@wp.func
def project_stretch_chain(
    world: int,
    rest_lengths: wp.array(dtype=float),
    compliances: wp.array(dtype=float),
    inverse_dt2: float,
    inverse_masses: wp.array2d(dtype=float),
    holder: wp.array2d(dtype=int),
    positions: wp.array2d(dtype=wp.vec3),
    directions: wp.array2d(dtype=wp.vec3),
    upper: wp.array2d(dtype=float),
    multipliers: wp.array2d(dtype=float),
):
    """Project all stretch constraints C_k = |x_k - x_k+1| - rest_k of a chain at once.

    One Newton step of XPBD, (J W J^T + compliance / dt^2) lambda = -C, whose matrix is tridiagonal for a chain and solved by
    elimination in O(N) (Deul et al. 2018). A sweep of single projections would carry tension by one node per substep and so add
    an elongation of its own that grows with resolution; the direct solve leaves only the material's.
    """
    num_edges = rest_lengths.shape[0]
    pivot = float(1.0)
    eliminated = float(0.0)
    last_direction = wp.vec3(0.0, 0.0, 0.0)
    for k in range(num_edges):
        difference = positions[world, k] - positions[world, k + 1]
        length = wp.length(difference)
        direction = difference / wp.max(length, 1.0e-9)
        w_k = effective_inverse_mass(inverse_masses[world, k], holder[world, k])
        w_next = effective_inverse_mass(inverse_masses[world, k + 1], holder[world, k + 1])
        diagonal = w_k + w_next + compliances[k] * inverse_dt2
        off_diagonal = -w_k * wp.dot(last_direction, direction)
        ratio = off_diagonal / pivot
        if k > 0:
            upper[world, k - 1] = ratio
        pivot = diagonal - off_diagonal * ratio
        eliminated = (rest_lengths[k] - length - off_diagonal * eliminated) / pivot
        multipliers[world, k] = eliminated
        directions[world, k] = direction
        last_direction = direction

    multiplier = float(0.0)
    push = wp.vec3(0.0, 0.0, 0.0)  # lambda_k * direction_k of the edge behind
    for reverse in range(num_edges):
        k = num_edges - 1 - reverse
        multiplier = multipliers[world, k] - upper[world, k] * multiplier
        pull = directions[world, k] * multiplier
        w_next = effective_inverse_mass(inverse_masses[world, k + 1], holder[world, k + 1])
        positions[world, k + 1] = positions[world, k + 1] + (push - pull) * w_next
        push = pull
    w_first = effective_inverse_mass(inverse_masses[world, 0], holder[world, 0])
    positions[world, 0] = positions[world, 0] + push * w_first


@wp.func
def project_bend(
    world: int,
    bend: wp.vec3i,
    compliance_over_dt2: float,
    inverse_masses: wp.array2d(dtype=float),
    holder: wp.array2d(dtype=int),
    positions: wp.array2d(dtype=wp.vec3),
):
    """Project the vector constraint C = x_p - 2 x_m + x_n, which is linear in the positions."""
    p = bend[0]
    m = bend[1]
    n = bend[2]
    w_p = effective_inverse_mass(inverse_masses[world, p], holder[world, p])
    w_m = effective_inverse_mass(inverse_masses[world, m], holder[world, m])
    w_n = effective_inverse_mass(inverse_masses[world, n], holder[world, n])
    curvature = positions[world, p] - 2.0 * positions[world, m] + positions[world, n]
    correction = curvature / (w_p + 4.0 * w_m + w_n + compliance_over_dt2)
    positions[world, p] = positions[world, p] - correction * w_p
    positions[world, m] = positions[world, m] + correction * (2.0 * w_m)
    positions[world, n] = positions[world, n] - correction * w_n


@wp.func
def project_contact(position: wp.vec3, previous: wp.vec3, plane: wp.vec4, radius: float, friction: float) -> wp.vec3:
    """Push a node out of the table and apply Coulomb friction to its motion within the substep.

    The normal correction `depth` is the normal impulse in position units, so the tangential motion is cancelled up to
    friction * depth: complete cancellation is stick, the rest slides (Macklin et al. 2014, section 6.1).
    """
    normal = wp.vec3(plane[0], plane[1], plane[2])
    depth = radius - (wp.dot(normal, position) - plane[3])
    if depth <= 0.0:
        return position
    moved = position - previous
    tangential = moved - normal * wp.dot(moved, normal)
    slip = wp.length(tangential)
    cancelled = float(0.0)
    if slip > 0.0:
        cancelled = wp.min(1.0, friction * depth / slip)
    return position + normal * depth - tangential * cancelled


@wp.kernel
def step_worlds(
    # model:
    rest_lengths: wp.array(dtype=float),
    stretch_compliances: wp.array(dtype=float),
    bends: wp.array(dtype=wp.vec3i),
    bend_compliances: wp.array(dtype=float),
    bend_color_offsets: wp.array(dtype=int),
    radius: float,
    velocity_decay: float,
    # time:
    num_substeps: int,
    dt: float,
    # world:
    gravity: wp.array(dtype=wp.vec3),
    plane: wp.array(dtype=wp.vec4),
    friction: wp.array(dtype=float),
    inverse_masses: wp.array2d(dtype=float),
    holder: wp.array2d(dtype=int),
    hold_offsets: wp.array2d(dtype=wp.vec3),
    leashes: wp.array3d(dtype=float),
    # state:
    gripper_targets: wp.array2d(dtype=wp.vec3),
    gripper_positions: wp.array2d(dtype=wp.vec3),
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    frozen: wp.array(dtype=wp.bool),
    # scratch:
    previous: wp.array2d(dtype=wp.vec3),
    backup: wp.array2d(dtype=wp.vec3),
    directions: wp.array2d(dtype=wp.vec3),
    upper: wp.array2d(dtype=float),
    multipliers: wp.array2d(dtype=float),
):
    """Advance every world by `num_substeps` substeps of one XPBD iteration each (Macklin et al. 2016, 2019)."""
    world, lane = wp.tid()
    lanes = wp.block_dim()
    num_nodes = positions.shape[1]
    if frozen[world]:
        return

    for node in range(lane, num_nodes, lanes):
        backup[world, node] = positions[world, node]
    if lane == 0:
        limit_gripper_targets(world, leashes, gripper_targets)
    synchronize_block()
    inverse_dt2 = 1.0 / (dt * dt)

    for substep in range(num_substeps):
        # Predict: held nodes follow their gripper along a straight line, free nodes fly.
        progress = float(substep + 1) / float(num_substeps)
        for node in range(lane, num_nodes, lanes):
            position = positions[world, node]
            previous[world, node] = position
            gripper = holder[world, node]
            if gripper >= 0:
                start = gripper_positions[world, gripper]
                grasp = start + (gripper_targets[world, gripper] - start) * progress
                positions[world, node] = grasp + hold_offsets[world, node]
            elif inverse_masses[world, node] > 0.0:
                velocity = velocities[world, node] * velocity_decay + gravity[world] * dt
                positions[world, node] = position + velocity * dt
        synchronize_block()

        for color in range(bend_color_offsets.shape[0] - 1):
            for c in range(bend_color_offsets[color] + lane, bend_color_offsets[color + 1], lanes):
                project_bend(world, bends[c], bend_compliances[c] * inverse_dt2, inverse_masses, holder, positions)
            synchronize_block()

        # Stretch after bending: a rope's length is the stiffer and the more visible of the two.
        if lane == 0:
            project_stretch_chain(
                world, rest_lengths, stretch_compliances, inverse_dt2, inverse_masses, holder, positions,
                directions, upper, multipliers,
            )  # fmt: skip
        synchronize_block()

        # Contact last, so that no substep ends below the table; then velocities from the motion.
        for node in range(lane, num_nodes, lanes):
            position = positions[world, node]
            start = previous[world, node]
            if effective_inverse_mass(inverse_masses[world, node], holder[world, node]) > 0.0:
                position = project_contact(position, start, plane[world], radius, friction[world])
                positions[world, node] = position
            velocities[world, node] = (position - start) / dt
        synchronize_block()

    for node in range(lane, num_nodes, lanes):
        if not is_valid(positions[world, node]):
            frozen[world] = True
    for gripper in range(lane, gripper_positions.shape[1], lanes):
        if not is_valid(gripper_targets[world, gripper]):
            frozen[world] = True
    synchronize_block()

    # A world that blew up keeps its last valid state and rests there until it is reset.
    if frozen[world]:
        for node in range(lane, num_nodes, lanes):
            positions[world, node] = backup[world, node]
            velocities[world, node] = wp.vec3(0.0, 0.0, 0.0)
        for gripper in range(lane, gripper_positions.shape[1], lanes):
            gripper_targets[world, gripper] = gripper_positions[world, gripper]
    else:
        for gripper in range(lane, gripper_positions.shape[1], lanes):
            gripper_positions[world, gripper] = gripper_targets[world, gripper]
