"""Kernels that say where arms are, and that put them somewhere.

Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

import warp as wp

from maniskill_grpd.agents.arms.kinematics import (
    ARRIVAL,
    NUM_JOINTS,
    Arms,
    Joints,
    Range,
    approach,
    tool_error,
    tool_position,
    trace_arm,
)

# Newton steps of an arm that is put somewhere, angles of its first joint that are tried, and searches.
STEPS, SEEDS, SEARCHES = wp.constant(100), wp.constant(16), wp.constant(8)


@wp.kernel(enable_backward=False)
def forward(arms: Arms, q: wp.array3d(dtype=float), tools: wp.array2d(dtype=wp.transform)):
    """Write where joint positions (B, A, J) bring the TCPs, (B, A)."""
    world, arm = wp.tid()
    positions = Joints()
    for joint in range(wp.static(NUM_JOINTS)):
        positions[joint] = q[world, arm, joint]
    trace = trace_arm(arms, world, arm, positions)
    tools[world, arm] = trace.tool


@wp.func
def best_seed(arms: Arms, world: int, arm: int, target: wp.vec3) -> Joints:
    """Return the rest posture, with its first joint turned to where it brings the TCP nearest to a target."""
    trial = Joints()
    for joint in range(wp.static(NUM_JOINTS)):
        trial[joint] = arms.rest[arm, joint]
    found = trial * 1.0
    least = wp.length(target - tool_position(arms, world, arm, trial))
    for seed in range(SEEDS):
        turn = wp.PI * (2.0 * (float(seed) + 0.5) / float(SEEDS) - 1.0)
        trial[0] = wp.clamp(arms.rest[arm, 0] + turn, arms.lower[arm, 0], arms.upper[arm, 0])
        gap = wp.length(target - tool_position(arms, world, arm, trial))
        found[0] = wp.where(gap < least, trial[0], found[0])
        least = wp.min(gap, least)
    return found


@wp.func
def random_seed(arms: Arms, arm: int, attempt: int) -> Joints:
    """Return joint positions anywhere within the limits, always the same for an attempt."""
    found = Joints()
    state = wp.rand_init(0, attempt)
    for joint in range(wp.static(NUM_JOINTS)):
        found[joint] = wp.lerp(arms.lower[arm, joint], arms.upper[arm, joint], wp.randf(state))
    return found


@wp.kernel(enable_backward=False)
def place(
    arms: Arms,
    worlds: wp.array(dtype=wp.int64),
    points: wp.array2d(dtype=wp.vec3),
    rotations: wp.array2d(dtype=wp.quat),
    rows: int,
    q: wp.array3d(dtype=float),
    gaps: wp.array2d(dtype=float),
):
    """Write joint positions (b, A, J) with which arms of some worlds (b,) come nearest to points (b, A), and how near.

    With six rows hands come to rotations too. A search that ends elsewhere is begun anew from other joint positions.
    """
    row, arm = wp.tid()
    world = int(worlds[row])
    bounds = Range()
    for joint in range(wp.static(NUM_JOINTS)):
        bounds.low[joint] = arms.lower[arm, joint]
        bounds.high[joint] = arms.upper[arm, joint]
    target = points[row, arm]
    start = best_seed(arms, world, arm, target)
    least = float(1.0e9)
    for attempt in range(SEARCHES):
        if least > ARRIVAL * ARRIVAL:
            found = approach(arms, world, arm, start, bounds, Joints(), target, rotations[row, arm], rows, STEPS)
            trace = trace_arm(arms, world, arm, found)
            error = tool_error(trace, target, rotations[row, arm], rows)
            if wp.dot(error, error) < least:
                least = wp.dot(error, error)
                gaps[row, arm] = wp.length(target - wp.transform_get_translation(trace.tool))
                for joint in range(wp.static(NUM_JOINTS)):
                    q[row, arm, joint] = found[joint]
            start = random_seed(arms, arm, attempt)
