"""A tug: a spring that pulls one node of a world to a point, as somebody does who takes hold of the object."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.data import Thread, Timing, Worlds
from maniskill_grpd.physics.kernels.lane_access import pick, put


@wp.func
def pull_tugged_nodes(thread: Thread, timing: Timing, worlds: Worlds, groups: Any):
    """Move tugged nodes towards their points, by one XPBD iteration of a spring of rest length 0.

    With the inverse mass w and the stiffness k the correction is w / (w + 1 / (k dt^2)) of the way (Macklin et al. 2016).
    """
    for lane in range(thread.first, groups.counts[thread.group], thread.stride):
        world = groups.members[thread.group, lane]
        node = worlds.tug_nodes[world]
        if node >= 0:
            weight = pick(groups.weights, thread.group, node, lane)
            if weight > 0.0:
                position = pick(groups.positions, thread.group, node, lane)
                gain = weight * worlds.tug_stiffnesses[world] * timing.dt * timing.dt
                moved = position + (worlds.tug_targets[world] - position) * (gain / (1.0 + gain))
                put(groups.positions, thread.group, node, lane, moved)
