"""Tethers: how far the nodes of a group of worlds may be from what grippers hold, called by the fused kernel."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.data import Objects, Thread, Worlds
from maniskill_grpd.physics.kernels.lane_access import pick, put
from maniskill_grpd.physics.kernels.lanes import add, any_positive, choose, div, inner, mul, root, spread, sub  # noqa: F401 (operators on lanes)

# Length of the tether of a gripper that holds nothing [m].
NO_TETHER = wp.constant(1.0e9)
# Within this distance of a grip, through the material, a tether has no slack [m]: fingers hold a patch, whatever the mesh. As a
# patch of fixed nodes could not turn with the cloth, the nodes in it turn about the one that is held.
GRIP_RADIUS = wp.constant(0.025)


@wp.func
def load_tethers(thread: Thread, node: int, objects: Objects, worlds: Worlds, groups: Any):
    """Fetch how far a node may be from what each gripper holds."""
    group = thread.group
    for gripper in range(groups.has_tethers.shape[1]):
        has_tethers = bool(False)
        for lane in range(groups.members.shape[1]):
            world = groups.members[group, lane]
            held = worlds.gripper_nodes[world, gripper]
            length = float(NO_TETHER)
            if held >= 0:
                has_tethers = True
                distance = objects.geodesics[worlds.variants[world], held, node]
                length = distance + objects.max_strains[thread.variant] * wp.max(distance - GRIP_RADIUS, 0.0)
            put(groups.tether_lengths[gripper], group, node, lane, length)
        zero = spread(groups.tether_impulses[gripper, group, node], 0.0)
        groups.tether_impulses[gripper, group, node] = zero
        if node == 0:
            groups.has_tethers[group, gripper] = has_tethers


@wp.func
def place_tether_ends(group: int, gripper: int, worlds: Worlds, groups: Any):
    """Fetch where the nodes are that a gripper holds."""
    for lane in range(groups.members.shape[1]):
        held = wp.max(worlds.gripper_nodes[groups.members[group, lane], gripper], 0)
        put(groups.tether_ends, group, gripper, lane, pick(groups.positions, group, held, lane))


@wp.func
def project_node_tethers(group: int, node: int, groups: Any):
    """Project C = |x_i - x_g| - length_ig <= 0 towards every node g that a gripper holds (Kim et al. 2012).

    They carry the pull of a gripper through the whole cloth within one substep. Slack, they do nothing.
    """
    weight = groups.weights[group, node]
    if any_positive(weight):
        for gripper in range(groups.has_tethers.shape[1]):
            if groups.has_tethers[group, gripper]:
                x = groups.positions[group, node]
                difference = groups.tether_ends[group, gripper] - x
                distance2 = inner(difference, difference)
                length = groups.tether_lengths[gripper, group, node]
                excess2 = choose(weight, distance2 - length * length, spread(weight, 0.0))
                if any_positive(excess2):
                    distance = root(distance2)
                    move = difference * ((distance - length) / distance)
                    groups.positions[group, node] = choose(excess2, x + move, x)
                    impulse = groups.tether_impulses[gripper, group, node]
                    groups.tether_impulses[gripper, group, node] = choose(excess2, impulse - move / weight, impulse)


@wp.func
def project_tethers(thread: Thread, objects: Objects, worlds: Worlds, groups: Any):
    """Project the tethers of all nodes."""
    for gripper in range(thread.first, groups.has_tethers.shape[1], thread.stride):
        place_tether_ends(thread.group, gripper, worlds, groups)
    synchronize_block()
    for node in range(thread.first, objects.node_counts[thread.variant], thread.stride):
        project_node_tethers(thread.group, node, groups)
    synchronize_block()


@wp.func
def sum_tethers(thread: Thread, objects: Objects, groups: Any):
    """Add the impulses of each gripper's tethers to its total."""
    group = thread.group
    for gripper in range(thread.first, groups.pulls.shape[1], thread.stride):
        total = spread(groups.pulls[group, gripper], 0.0)
        for node in range(objects.node_counts[thread.variant]):
            total = total + groups.tether_impulses[gripper, group, node]
        groups.pulls[group, gripper] = total
    synchronize_block()
