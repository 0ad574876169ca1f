"""The kernel that moves arms by one control step, CPU and CUDA from one source.

Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

from functools import cache

import warp as wp

from maniskill_grpd.agents.arms.clearance import overlap
from maniskill_grpd.agents.arms.kinematics import (
    ARRIVAL,
    NUM_JOINTS,
    Arms,
    Joints,
    Range,
    approach,
    frame_at_joint,
    frame_behind_joint,
    present,
    tool_position,
    trace_arm,
)
from maniskill_grpd.physics.kernels.data import Colliders, Links, Objects, Worlds
from maniskill_grpd.physics.kernels.grippers import find_ways, is_valid, limit_gripper_targets, stop_grippers

# Newton steps within a control step.
STEPS = wp.constant(12)
# Share of the way to the posture that the joints are drawn in one control step, and the largest share of what they can move.
POSTURE_GAIN, POSTURE_SHARE = wp.constant(0.05), wp.constant(0.2)
# Rounds in which object, colliders and arms take turns to shorten the motion of grippers.
ROUNDS = wp.constant(24)
# How often an arm is solved for: at last for where its TCP is already.
ATTEMPTS = wp.constant(4)


@wp.func
def write_links(arms: Arms, world: int, arm: int, q: Joints, points: wp.array2d(dtype=wp.vec3)):
    """Write where the axes of the links of an arm are."""
    frame = arms.bases[world, arm]
    for joint in range(arms.kinds.shape[1]):
        frame = frame_behind_joint(arms, arm, joint, frame_at_joint(arms, arm, joint, frame), q[joint])
        for c in range(arms.capsule_joints.shape[1]):
            if arms.capsule_joints[arm, c] == joint:
                for end in range(2):
                    points[world, 2 * arms.capsule_links[arm, c] + end] = wp.transform_point(
                        frame, arms.capsule_ends[arm, 2 * c + end]
                    )


@wp.func
def next_range(arms: Arms, world: int, arm: int, dt: float) -> Range:
    """Return where the joints of an arm may be after a control step.

    The acceleration limits how a joint gains speed, not how it loses it: a hand that could not stop would tear what it holds.
    """
    found = Range()
    for joint in range(wp.static(NUM_JOINTS)):
        q = arms.qpos[world, arm, joint]
        v = arms.qvel[world, arm, joint]
        gain = arms.accelerations[arm, joint] * dt
        high = wp.min(arms.speeds[arm, joint], wp.max(v, 0.0) + gain)
        low = wp.max(-arms.speeds[arm, joint], wp.min(v, 0.0) - gain)
        found.low[joint] = wp.max(arms.lower[arm, joint], q + low * dt)
        found.high[joint] = wp.min(arms.upper[arm, joint], q + high * dt)
    return found


@wp.func
def solve_arm(arms: Arms, world: int, arm: int, dt: float, target: wp.vec3, bounds: Range, rows: int) -> Joints:
    """Return joint positions within bounds that bring the TCP of an arm as near to a target as they find to."""
    start = Joints()
    drawn = Joints()
    for joint in range(wp.static(NUM_JOINTS)):
        way = arms.speeds[arm, joint] * dt
        start[joint] = wp.clamp(arms.seeds[world, arm, joint], bounds.low[joint], bounds.high[joint])
        pull = POSTURE_GAIN * (arms.postures[world, arm, joint] - start[joint])
        drawn[joint] = wp.clamp(pull, -POSTURE_SHARE * way, POSTURE_SHARE * way)
    q = approach(arms, world, arm, start, bounds, drawn, target, arms.rotations[world, arm], rows, STEPS)
    missed = wp.length(target - tool_position(arms, world, arm, q))
    if missed > ARRIVAL:  # joints that are drawn may be missing where they are needed
        other = approach(arms, world, arm, start, bounds, Joints(), target, arms.rotations[world, arm], rows, STEPS)
        if wp.length(target - tool_position(arms, world, arm, other)) < missed:
            q = other
    return q


@wp.func
def step_arm(arms: Arms, world: int, arm: int, dt: float, target: wp.vec3, plane: wp.vec4):
    """Write the next joint positions of an arm, and where they bring its TCP.

    Where links would come into the table or another arm's base, the target yields; where that does not help the TCP stays, and
    the joints are drawn to rest as far as they may; else the arm stands still.
    """
    bounds = next_range(arms, world, arm, dt)
    goal = target * 1.0
    q = Joints()
    blocked = bool(True)
    for attempt in range(ATTEMPTS):
        if blocked:
            if attempt == ATTEMPTS - 1:
                goal = tool_position(arms, world, arm, present(arms, world, arm))
            q = solve_arm(arms, world, arm, dt, goal, bounds, 3 + 3 * arms.holds_rotation[arm])
            away = overlap(arms, world, arm, q, plane)
            arms.refused[world, arm] = attempt == ATTEMPTS - 1
            blocked = wp.length_sq(away) > 0.0
            goal += away
    if blocked:
        q = present(arms, world, arm)
    for joint in range(wp.static(NUM_JOINTS)):
        arms.next[world, arm, joint] = q[joint]
    arms.reached[world, arm] = tool_position(arms, world, arm, q)


@wp.func
def settle_arm(arms: Arms, world: int, arm: int, dt: float, agreed: bool, worlds: Worlds, links: Links):
    """Move an arm to its next joint positions, or leave it and its gripper where they are."""
    write_links(arms, world, arm, present(arms, world, arm), links.starts)
    if not agreed:
        arms.refused[world, arm] = True
        worlds.gripper_targets[world, arm] = worlds.gripper_positions[world, arm]
    arms.errors[world, arm] = wp.length(arms.wanted[world, arm] - worlds.gripper_targets[world, arm])
    q = Joints()
    for joint in range(wp.static(NUM_JOINTS)):
        before = arms.qpos[world, arm, joint]
        q[joint] = wp.where(agreed, arms.next[world, arm, joint], before)
        arms.qvel[world, arm, joint] = (q[joint] - before) / dt
        arms.qpos[world, arm, joint] = q[joint]
        arms.seeds[world, arm, joint] = q[joint]
    write_links(arms, world, arm, q, links.ends)
    trace = trace_arm(arms, world, arm, q)
    arms.rotations[world, arm] = wp.transform_get_rotation(trace.tool)


@wp.func
def move_once(arms: Arms, world: int, dt: float, turn: int, worlds: Worlds) -> bool:
    """Solve for all arms of a world whose targets have changed; return whether all reach theirs."""
    reached = bool(True)
    for arm in range(arms.tools.shape[0]):
        target = worlds.gripper_targets[world, arm]
        if turn == 0:
            arms.wanted[world, arm] = target
        if turn == 0 or wp.length(target - arms.reached[world, arm]) > ARRIVAL:
            step_arm(arms, world, arm, dt, target, worlds.plane[world])
        if wp.length(target - arms.reached[world, arm]) > ARRIVAL:
            worlds.gripper_targets[world, arm] = arms.reached[world, arm]
            reached = False
    return reached


@cache
def follow_kernel(has_colliders: bool, has_ropes: bool) -> wp.Kernel:
    """Return the kernel that moves the arms of worlds with or without colliders and ropes by one control step."""

    @wp.kernel(module="unique", enable_backward=False)
    def follow(
        arms: Arms,
        objects: Objects,
        colliders: Colliders,
        worlds: Worlds,
        links: Links,
        dt: float,
        first_world: int,
        world_stride: int,
    ):
        """Move the joints of all arms of a world after the targets of its grippers, and the targets to where the TCPs get.

        Object, colliders and arms shorten the motion in turn. Where they find no agreement, all arms of the world stay where
        they are, which always is one.
        """
        world = first_world + wp.tid() * world_stride
        if worlds.frozen[world]:
            return
        for arm in range(arms.tools.shape[0]):
            if not is_valid(worlds.gripper_targets[world, arm]):  # freezes the world
                return
        if wp.static(has_colliders and has_ropes):
            find_ways(world, worlds.variants[world], objects, colliders, worlds)
        agreed = bool(False)
        for turn in range(ROUNDS):
            if not agreed:
                limit_gripper_targets(world, worlds)
                if wp.static(has_colliders):
                    stop_grippers(world, objects.radii[worlds.variants[world]], colliders, worlds)
                agreed = move_once(arms, world, dt, turn, worlds)
        for arm in range(arms.tools.shape[0]):
            settle_arm(arms, world, arm, dt, agreed, worlds, links)

    return follow
