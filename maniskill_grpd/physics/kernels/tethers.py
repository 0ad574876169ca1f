"""Tethers: how far the nodes of a group of worlds may be from what grippers hold, called by the fused kernel."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.lanes import add, any_positive, choose, div, inner, mul, root, spread, sub  # noqa: F401 (operators on lanes)


@wp.func
def project_tethers(group: int, node: int, groups: Any):
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
