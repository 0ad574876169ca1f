"""Forward kinematics and damped least squares of many arms in Warp, CPU and CUDA from one source.

Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

import warp as wp

NUM_JOINTS = 7
"""Most joints of an arm; the chains of shorter ones end with joints that are fixed."""
FIXED, REVOLUTE, PRISMATIC = wp.constant(0), wp.constant(1), wp.constant(2)
# An arm has arrived when its TCP is this near [m] and its hand turned by no more than this [rad].
ARRIVAL, TURN_ARRIVAL = wp.constant(1.0e-5), wp.constant(1.0e-4)
# Damping per squared error (Sugihara 2011) [1/m^2], and its bounds.
DAMPING, LEAST_DAMPING, LARGEST_DAMPING = wp.constant(0.1), wp.constant(1.0e-6), wp.constant(0.02)


Joints = wp.types.vector(length=NUM_JOINTS, dtype=wp.float32)
Columns = wp.types.matrix(shape=(6, NUM_JOINTS), dtype=wp.float32)
Square = wp.types.matrix(shape=(6, 6), dtype=wp.float32)
Six = wp.types.vector(length=6, dtype=wp.float32)


@wp.struct
class Arms:
    """A arms in each of B worlds: arrays (A,) or (A, J) of their chains, (B, A) or (B, A, J) of their state."""

    kinds: wp.array2d(dtype=int)
    offsets: wp.array2d(dtype=wp.transform)  # frame of each joint at rest in that of the one before it
    axes: wp.array2d(dtype=wp.vec3)
    lower: wp.array2d(dtype=float)
    upper: wp.array2d(dtype=float)
    speeds: wp.array2d(dtype=float)
    accelerations: wp.array2d(dtype=float)
    rest: wp.array2d(dtype=float)
    tools: wp.array(dtype=wp.transform)  # TCP in the frame of the last joint
    holds_rotation: wp.array(dtype=int)  # whether the hand keeps the rotation that is wanted, or is free
    bases: wp.array2d(dtype=wp.transform)
    qpos: wp.array3d(dtype=float)
    qvel: wp.array3d(dtype=float)
    seeds: wp.array3d(dtype=float)  # where the search for the next positions begins
    postures: wp.array3d(dtype=float)  # where the joints are drawn
    next: wp.array3d(dtype=float)
    rotations: wp.array2d(dtype=wp.quat)  # of the hands: wanted, and after a step what there is
    wanted: wp.array2d(dtype=wp.vec3)  # where object and colliders let the TCPs go
    reached: wp.array2d(dtype=wp.vec3)  # where the arms can bring them
    errors: wp.array2d(dtype=float)  # the distance that was lost [m]
    refused: wp.array2d(dtype=wp.bool)  # whether the arm stood still, for the table, another arm or want of agreement
    # Capsules about links, C for each arm: the joint they move with, -1 for none; ends in its frame; their number in the world.
    capsule_joints: wp.array2d(dtype=int)
    capsule_ends: wp.array2d(dtype=wp.vec3)  # (A, 2 C)
    capsule_radii: wp.array2d(dtype=float)
    capsule_is_fingers: wp.array2d(dtype=int)
    capsule_links: wp.array2d(dtype=int)
    column_ends: wp.array2d(dtype=wp.vec3)  # of the bases, in their frames, (A, 2)
    column_radii: wp.array(dtype=float)


@wp.struct
class Trace:
    """An arm at given joint positions."""

    axes: Columns  # rows 0 to 2 the axes of the joints, 3 to 5 their origins
    tool: wp.transform


@wp.struct
class Range:
    """Where the joints of an arm may be."""

    low: Joints
    high: Joints


@wp.func
def frame_at_joint(arms: Arms, arm: int, joint: int, frame: wp.transform) -> wp.transform:
    """Return the frame of a joint at rest from that behind the one before it."""
    return wp.transform_multiply(frame, arms.offsets[arm, joint])


@wp.func
def frame_behind_joint(arms: Arms, arm: int, joint: int, frame: wp.transform, position: float) -> wp.transform:
    """Return the frame behind a joint at a position from its frame at rest."""
    axis = arms.axes[arm, joint]
    if arms.kinds[arm, joint] == REVOLUTE:
        return wp.transform_multiply(frame, wp.transform(wp.vec3(), wp.quat_from_axis_angle(axis, position)))
    if arms.kinds[arm, joint] == PRISMATIC:
        return wp.transform_multiply(frame, wp.transform(axis * position, wp.quat_identity()))
    return frame


@wp.func
def trace_arm(arms: Arms, world: int, arm: int, q: Joints) -> Trace:
    """Forward kinematics."""
    trace = Trace()
    frame = arms.bases[world, arm]
    for joint in range(wp.static(NUM_JOINTS)):
        frame = frame_at_joint(arms, arm, joint, frame)
        direction = wp.quat_rotate(wp.transform_get_rotation(frame), arms.axes[arm, joint])
        origin = wp.transform_get_translation(frame)
        for k in range(3):
            trace.axes[k, joint] = direction[k]
            trace.axes[3 + k, joint] = origin[k]
        frame = frame_behind_joint(arms, arm, joint, frame, q[joint])
    trace.tool = wp.transform_multiply(frame, arms.tools[arm])
    return trace


@wp.func
def tool_position(arms: Arms, world: int, arm: int, q: Joints) -> wp.vec3:
    """Return the TCP."""
    trace = trace_arm(arms, world, arm, q)
    return wp.transform_get_translation(trace.tool)


@wp.func
def jacobian(arms: Arms, arm: int, trace: Trace, rows: int) -> Columns:
    """Return the velocity of the TCP (rows 0 to 2) and of the hand's turn (3 to 5) per speed of each joint."""
    found = Columns()
    tcp = wp.transform_get_translation(trace.tool)
    for joint in range(wp.static(NUM_JOINTS)):
        axis = wp.vec3(trace.axes[0, joint], trace.axes[1, joint], trace.axes[2, joint])
        origin = wp.vec3(trace.axes[3, joint], trace.axes[4, joint], trace.axes[5, joint])
        turns = arms.kinds[arm, joint] == REVOLUTE
        velocity = wp.where(turns, wp.cross(axis, tcp - origin), axis)
        for k in range(3):
            found[k, joint] = velocity[k]
            if rows == 6 and turns:
                found[3 + k, joint] = axis[k]
    return found


@wp.func
def without_blocked(columns: Columns, error: Six, q: Joints, bounds: Range, rows: int) -> Columns:
    """Return the Jacobian without the joints that are at an end of their range and would have to leave it."""
    found = columns * 1.0
    for joint in range(wp.static(NUM_JOINTS)):
        slope = float(0.0)
        for i in range(rows):
            slope += columns[i, joint] * error[i]
        if (q[joint] <= bounds.low[joint] and slope <= 0.0) or (q[joint] >= bounds.high[joint] and slope >= 0.0):
            for i in range(rows):
                found[i, joint] = 0.0
    return found


@wp.func
def factorize(columns: Columns, damping: float, rows: int) -> Square:
    """Return the Cholesky factor of J J^T + damping."""
    factor = Square()
    for i in range(rows):
        for j in range(i + 1):
            total = wp.where(i == j, damping, 0.0)
            for k in range(wp.static(NUM_JOINTS)):
                total += columns[i, k] * columns[j, k]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                factor[i, i] = wp.sqrt(wp.max(total, 0.01 * damping))
            else:
                factor[i, j] = total / factor[j, j]
    return factor


@wp.func
def backsolve(factor: Square, right: Six, rows: int) -> Six:
    """Solve the factorized system."""
    y = right * 1.0
    for i in range(rows):
        total = y[i]
        for k in range(i):
            total -= factor[i, k] * y[k]
        y[i] = total / factor[i, i]
    for back in range(rows):
        i = rows - 1 - back
        total = y[i]
        for k in range(i + 1, rows):
            total -= factor[k, i] * y[k]
        y[i] = total / factor[i, i]
    return y


@wp.func
def tool_error(trace: Trace, target: wp.vec3, rotation: wp.quat, rows: int) -> Six:
    """Return the way to a target [m] and, for six rows, the turn to a rotation, axis times twice the sine of half the angle."""
    error = Six()
    away = target - wp.transform_get_translation(trace.tool)
    turn = rotation * wp.quat_inverse(wp.transform_get_rotation(trace.tool))
    side = wp.where(turn[3] < 0.0, -2.0, 2.0)
    for k in range(3):
        error[k] = away[k]
        if rows == 6:
            error[3 + k] = side * turn[k]
    return error


@wp.func
def has_arrived(error: Six) -> bool:
    """Whether an error is so small that another step is not worth it."""
    away = wp.vec3(error[0], error[1], error[2])
    turn = wp.vec3(error[3], error[4], error[5])
    return wp.length(away) < 0.5 * ARRIVAL and wp.length(turn) < 0.5 * TURN_ARRIVAL


@wp.func
def newton_step(columns: Columns, error: Six, drawn: Joints, boost: float, rows: int) -> Joints:
    """Return a change of the joints, dq = J^T (J J^T + d)^-1 (e - J dq0) + dq0: what dq0 would do to the TCP is undone."""
    rest = error * 1.0
    for joint in range(wp.static(NUM_JOINTS)):
        for i in range(rows):
            rest[i] = rest[i] - columns[i, joint] * drawn[joint]
    damping = boost * wp.clamp(DAMPING * wp.dot(error, error), LEAST_DAMPING, LARGEST_DAMPING)
    y = backsolve(factorize(columns, damping, rows), rest, rows)
    change = drawn * 1.0
    for joint in range(wp.static(NUM_JOINTS)):
        for i in range(rows):
            change[joint] = change[joint] + columns[i, joint] * y[i]
    return change


@wp.func
def approach(
    arms: Arms,
    world: int,
    arm: int,
    start: Joints,
    bounds: Range,
    drawn: Joints,
    target: wp.vec3,
    rotation: wp.quat,
    rows: int,
    steps: int,
) -> Joints:
    """Bring a TCP to a target by damped least squares, with the joints drawn somewhere in the first step.

    Joints at the end of their range do not move out of it, and the others do the rest: the projected Newton method (Bertsekas
    1982), here with the damping of Levenberg and Marquardt. A step that does not come nearer is taken back, but for the first.
    """
    q = start * 1.0
    best = start * 1.0
    pull = drawn * 1.0
    least = float(1.0e30)
    boost = float(1.0)
    for step in range(steps):
        trace = trace_arm(arms, world, arm, q)
        error = tool_error(trace, target, rotation, rows)
        size = wp.dot(error, error)
        if size <= least or (step == 1 and wp.dot(drawn, drawn) > 0.0):
            best = q * 1.0
            least = size
            if step > 0 and has_arrived(error):
                break
            boost = wp.max(0.25 * boost, 1.0)
            columns = without_blocked(jacobian(arms, arm, trace, rows), error, q, bounds, rows)
            change = newton_step(columns, error, pull, boost, rows)
            for joint in range(wp.static(NUM_JOINTS)):
                q[joint] = wp.clamp(q[joint] + change[joint], bounds.low[joint], bounds.high[joint])
                pull[joint] = 0.0
        else:
            q = best * 1.0
            boost *= 32.0
    return best


@wp.func
def present(arms: Arms, world: int, arm: int) -> Joints:
    """Return the joint positions of an arm before the step."""
    q = Joints()
    for joint in range(wp.static(NUM_JOINTS)):
        q[joint] = arms.qpos[world, arm, joint]
    return q
