"""What a constraint does to a node of a group of worlds.

An impulse lambda * grad C moves a free node by weight * impulse; a held node has weight 0 and stays, and the impulse is added to
its reaction, from which the force on its gripper follows.
"""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.lanes import add, choose, mul  # noqa: F401 (operators on lanes)


@wp.func
def push_node(group: int, node: int, impulse: Any, groups: Any):
    """Apply an impulse: x <- x + w * impulse for a free node, the gripper's reaction otherwise."""
    weight = groups.weights[group, node]
    groups.positions[group, node] = groups.positions[group, node] + impulse * weight
    if not groups.is_free[group, node]:
        reaction = groups.reactions[group, node]
        groups.reactions[group, node] = choose(weight, reaction, reaction + impulse)
