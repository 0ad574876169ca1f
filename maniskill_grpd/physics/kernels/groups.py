"""What the fused kernel does with the nodes of a group of worlds: load, predict, keep above the table, store."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.collider_contacts import resolve_contact
from maniskill_grpd.physics.kernels.data import Objects, Thread, Timing, Worlds
from maniskill_grpd.physics.kernels.grippers import is_valid
from maniskill_grpd.physics.kernels.lane_access import pick, put
from maniskill_grpd.physics.kernels.lanes import add, any_positive, choose, div, inner, mul, spread, sub  # noqa: F401 (operators on lanes)


@wp.func
def is_idle(group: int, worlds: Worlds, groups: Any) -> bool:
    """Return whether a group has no world that moves."""
    num_moving = int(0)
    for lane in range(groups.counts[group]):
        if not worlds.frozen[groups.members[group, lane]]:
            num_moving += 1
    return num_moving == 0


@wp.func
def load_constants(group: int, dt: float, worlds: Worlds, groups: Any):
    """Fetch what is one number or vector for each world."""
    for lane in range(groups.members.shape[1]):
        world = groups.members[group, lane]
        plane = worlds.plane[world]
        put(groups.gravity, group, 0, lane, worlds.gravity[world])
        put(groups.table_normals, group, 0, lane, wp.vec3(plane[0], plane[1], plane[2]))
        put(groups.table_offsets, group, 0, lane, plane[3])
        put(groups.friction, group, 0, lane, worlds.friction[world])
        # In double precision: 1 - c dt has few digits left in single.
        decay = wp.exp(-wp.float64(worlds.damping[world]) * wp.float64(dt))
        put(groups.decays, group, 0, lane, float(decay))
        put(groups.stretch_rates, group, 0, lane, 1.0 / (dt * dt) / worlds.stretch_scale[world])
        put(groups.bend_rates, group, 0, lane, 1.0 / (dt * dt) / worlds.bend_scale[world])
    for gripper in range(groups.pulls.shape[1]):
        groups.pulls[group, gripper] = spread(groups.pulls[group, gripper], 0.0)


@wp.func
def load_node(group: int, node: int, worlds: Worlds, groups: Any):
    """Fetch the state of a node of all worlds, and how grippers will move it."""
    is_free = bool(True)
    is_held = bool(False)
    for lane in range(groups.members.shape[1]):
        world = groups.members[group, lane]
        put(groups.positions, group, node, lane, worlds.positions[world, node])
        put(groups.velocities, group, node, lane, worlds.velocities[world, node])
        weight = worlds.inverse_masses[world, node]
        gripper = worlds.holder[world, node]
        if gripper >= 0:
            weight = float(0.0)
            is_held = True
        if not weight > 0.0:
            is_free = False
        put(groups.weights, group, node, lane, weight)
    groups.is_free[group, node] = is_free
    groups.is_held[group, node] = is_held
    groups.reactions[group, node] = spread(groups.reactions[group, node], 0.0)
    if is_held:
        for lane in range(groups.members.shape[1]):
            world = groups.members[group, lane]
            gripper = worlds.holder[world, node]
            start = worlds.gripper_positions[world, wp.max(gripper, 0)]
            put(groups.held, group, node, lane, wp.where(gripper >= 0, 1.0, 0.0))
            put(groups.hold_starts, group, node, lane, start)
            put(groups.hold_motions, group, node, lane, worlds.gripper_targets[world, wp.max(gripper, 0)] - start)
            put(groups.hold_offsets, group, node, lane, worlds.hold_offsets[world, node])


@wp.func
def predict_node(group: int, node: int, dt: float, progress: float, groups: Any):
    """Let a free node fly; a held one follows its gripper along a straight line."""
    position = groups.positions[group, node]
    groups.previous[group, node] = position
    velocity = groups.velocities[group, node] * groups.decays[group, 0] + groups.gravity[group, 0] * dt
    flown = position + velocity * dt
    if not groups.is_free[group, node]:
        flown = choose(groups.weights[group, node], flown, position)
        if groups.is_held[group, node]:
            grasp = groups.hold_starts[group, node] + groups.hold_motions[group, node] * progress
            flown = choose(groups.held[group, node], grasp + groups.hold_offsets[group, node], flown)
    groups.positions[group, node] = flown


@wp.func
def settle_node(group: int, node: int, radius: float, dt: float, groups: Any):
    """Keep a free node at its radius above the table n . x = c, then compute its velocity from its motion."""
    position = groups.positions[group, node]
    start = groups.previous[group, node]
    normal = groups.table_normals[group, 0]
    weight = groups.weights[group, node]
    height = inner(normal, position) - groups.table_offsets[group, 0]
    depth = choose(weight, spread(weight, radius) - height, spread(weight, 0.0))
    if any_positive(depth):
        position = resolve_contact(position, start, normal, depth, groups.friction[group, 0])
        groups.positions[group, node] = position
    groups.velocities[group, node] = (position - start) / spread(weight, dt)


@wp.func
def mean_force(group: int, lane: int, gripper: int, num_nodes: int, timing: Timing, worlds: Worlds, groups: Any) -> wp.vec3:
    """Return the force on a gripper: impulses over the step and the weight of what it holds. Impulses are force * dt^2 here."""
    world = groups.members[group, lane]
    total = pick(groups.pulls, group, gripper, lane)
    for node in range(num_nodes):
        if groups.is_held[group, node] and worlds.holder[world, node] == gripper:
            total += pick(groups.reactions, group, node, lane)
            if worlds.inverse_masses[world, node] > 0.0:
                total += worlds.gravity[world] * (
                    timing.dt * timing.dt * float(timing.num_substeps) / worlds.inverse_masses[world, node]
                )
    return total * (1.0 / (timing.dt * timing.dt) / float(timing.num_substeps))


@wp.func
def store_world(thread: Thread, lane: int, timing: Timing, objects: Objects, worlds: Worlds, groups: Any):
    """Write the state of a world back; a world that blew up keeps its last valid state and rests there until it is reset."""
    group = thread.group
    num_nodes = objects.node_counts[thread.variant]
    world = groups.members[group, lane]
    was_frozen = worlds.frozen[world]
    synchronize_block()
    for node in range(thread.first, num_nodes, thread.stride):
        if not is_valid(pick(groups.positions, group, node, lane)):
            worlds.frozen[world] = True
    for gripper in range(thread.first, worlds.gripper_targets.shape[1], thread.stride):
        if not is_valid(worlds.gripper_targets[world, gripper]):
            worlds.frozen[world] = True
    synchronize_block()
    if worlds.frozen[world]:
        if not was_frozen:
            for node in range(thread.first, num_nodes, thread.stride):
                worlds.velocities[world, node] = wp.vec3(0.0, 0.0, 0.0)
            for gripper in range(thread.first, worlds.gripper_targets.shape[1], thread.stride):
                worlds.gripper_targets[world, gripper] = worlds.gripper_positions[world, gripper]
                worlds.gripper_forces[world, gripper] = wp.vec3(0.0, 0.0, 0.0)
    else:
        for node in range(thread.first, num_nodes, thread.stride):
            worlds.positions[world, node] = pick(groups.positions, group, node, lane)
            worlds.velocities[world, node] = pick(groups.velocities, group, node, lane)
        for gripper in range(thread.first, worlds.gripper_targets.shape[1], thread.stride):
            worlds.gripper_positions[world, gripper] = worlds.gripper_targets[world, gripper]
            worlds.gripper_forces[world, gripper] = mean_force(group, lane, gripper, num_nodes, timing, worlds, groups)
