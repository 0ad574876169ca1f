"""The fused XPBD kernel: every substep of one control step, for one group of worlds per thread block.

On CUDA a group is one world and its block has many threads, which stride over nodes and over the constraints of one colour, with
a barrier in between. On CPU a group is as many worlds as a vector register has lanes, its block has one thread, and the same
source is a sequential loop over operations on lanes. `wp.static` leaves out what a solver does not need, so that a rope pays
nothing for cloth. Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

from functools import cache

import warp as wp

from maniskill_grpd.physics.kernels.barrier import synchronize_block
from maniskill_grpd.physics.kernels.bending import project_bend, project_hinge
from maniskill_grpd.physics.kernels.contact_phases import (
    add_reactions,
    find_self_contacts,
    prepare_touch,
    project_obstacles,
    project_self_contacts,
    put_into_lanes,
    take_out_of_lanes,
)
from maniskill_grpd.physics.kernels.data import (
    Features,
    LaneGroups,
    Objects,
    Obstacles,
    SelfContacts,
    SingleGroups,
    Touch,
    Worlds,
)
from maniskill_grpd.physics.kernels.grippers import limit_gripper_targets, stop_grippers
from maniskill_grpd.physics.kernels.groups import (
    is_idle,
    load_constants,
    load_node,
    load_tethers,
    place_tether_ends,
    predict_node,
    settle_node,
    store_world,
    sum_tethers,
)
from maniskill_grpd.physics.kernels.lanes import any_positive, spread, sub  # noqa: F401 (operators on lanes)
from maniskill_grpd.physics.kernels.stretch import eliminate_stretch_line, measure_tautness, push_stretch_line, straighten_line
from maniskill_grpd.physics.kernels.tethers import project_tethers

wp.config.log_level = wp.LOG_WARNING  # no banner when a library is imported


@cache
def build_step_kernel(features: Features, in_lanes: bool) -> wp.Kernel:
    """Return the kernel that advances groups of worlds with the given features by one control step.

    Args:
        features: What the worlds contain.
        in_lanes: Groups of many worlds in lanes (CPU) rather than of one (CUDA).
    """
    group_type = LaneGroups if in_lanes else SingleGroups

    @wp.func
    def load_group(
        group: int,
        thread: int,
        threads: int,
        dt: float,
        variant: int,
        objects: Objects,
        obstacles: Obstacles,
        worlds: Worlds,
        groups: group_type,
        touch: Touch,
    ):
        """Limit the targets of the grippers and fetch the state of all worlds of a group."""
        for lane in range(thread, groups.counts[group], threads):
            world = groups.members[group, lane]
            if not worlds.frozen[world]:
                limit_gripper_targets(world, worlds.leashes, worlds.gripper_targets)
                if wp.static(features.colliders):
                    stop_grippers(
                        world,
                        objects.radii[variant],
                        obstacles,
                        worlds.leashes,
                        worlds.gripper_nodes,
                        worlds.holder,
                        worlds.hold_offsets,
                        worlds.gripper_positions,
                        worlds.gripper_targets,
                    )
        if thread == 0:
            load_constants(group, dt, worlds, groups)
        synchronize_block()
        for node in range(thread, objects.node_counts[variant], threads):
            load_node(group, node, worlds, groups)
            if wp.static(features.tethers):
                load_tethers(group, node, objects.max_stretch[variant], objects.geodesics, worlds, groups)
            if wp.static(features.colliders or features.self_contact):
                prepare_touch(group, node, groups, touch)
        synchronize_block()

    @wp.func
    def project_line(
        group: int,
        first_edge: int,
        first_node: int,
        scratch: int,
        num_edges: int,
        variant: int,
        objects: Objects,
        groups: group_type,
    ):
        """Project the stretch of all edges of a line at once, in the directions to which a taut rope is pulled."""
        eliminate_stretch_line(
            group,
            first_edge,
            first_node,
            scratch,
            num_edges,
            objects.wrinkling[variant],
            False,
            objects.line_nodes,
            objects.rest_lengths,
            objects.stretch_compliances,
            groups,
        )
        if wp.static(features.ropes):  # noqa: SIM102 (left out at compile time)
            if objects.is_rope[variant]:
                tautness = measure_tautness(
                    group, first_edge, first_node, num_edges, objects.line_nodes, objects.rest_lengths, groups
                )
                if any_positive(tautness - spread(tautness, 1.0)):
                    straighten_line(
                        group, first_edge, first_node, num_edges, tautness, objects.line_nodes, objects.rest_lengths, groups
                    )
                    eliminate_stretch_line(
                        group,
                        first_edge,
                        first_node,
                        scratch,
                        num_edges,
                        objects.wrinkling[variant],
                        True,
                        objects.line_nodes,
                        objects.rest_lengths,
                        objects.stretch_compliances,
                        groups,
                    )
        push_stretch_line(group, first_node, scratch, num_edges, objects.line_nodes, groups)

    @wp.func
    def project_material(
        group: int, thread: int, threads: int, variant: int, objects: Objects, worlds: Worlds, groups: group_type
    ):
        """Project what holds an object together. Stretch comes last: length is the stiffer and the more visible."""
        if wp.static(features.bends):
            for color in range(objects.bend_ranges[variant], objects.bend_ranges[variant + 1] - 1):
                for c in range(objects.bend_colors[color] + thread, objects.bend_colors[color + 1], threads):
                    project_bend(group, objects.bends[c], objects.bend_compliances[c], groups)
                synchronize_block()
        if wp.static(features.hinges):
            for color in range(objects.hinge_ranges[variant], objects.hinge_ranges[variant + 1] - 1):
                for c in range(objects.hinge_colors[color] + thread, objects.hinge_colors[color + 1], threads):
                    project_hinge(group, objects.hinges[c], objects.hinge_weights[c], objects.hinge_compliances[c], groups)
                synchronize_block()
        if wp.static(features.tethers):
            for gripper in range(thread, groups.has_tethers.shape[1], threads):
                place_tether_ends(group, gripper, worlds, groups)
            synchronize_block()
            for node in range(thread, objects.node_counts[variant], threads):
                project_tethers(group, node, groups)
            synchronize_block()
        first_edge = objects.line_edges[objects.line_colors[objects.line_ranges[variant]]]
        for color in range(objects.line_ranges[variant], objects.line_ranges[variant + 1] - 1):
            for line in range(objects.line_colors[color] + thread, objects.line_colors[color + 1], threads):
                edge = objects.line_edges[line]
                scratch = int(0)  # a single thread does one line after the other in the same place
                if wp.static(not in_lanes):
                    scratch = edge - first_edge
                project_line(group, edge, edge + line, scratch, objects.line_edges[line + 1] - edge, variant, objects, groups)
            synchronize_block()

    @wp.func
    def project_contacts(
        group: int,
        thread: int,
        threads: int,
        variant: int,
        objects: Objects,
        obstacles: Obstacles,
        worlds: Worlds,
        groups: group_type,
        touch: Touch,
        contacts: SelfContacts,
    ):
        """Take the worlds out of their lanes to resolve contact with themselves and with colliders."""
        take_out_of_lanes(group, thread, threads, objects.node_counts[variant], groups, touch)
        for lane in range(groups.counts[group]):
            world = groups.members[group, lane]
            friction = worlds.friction[world]
            if not worlds.frozen[world]:
                if wp.static(features.self_contact):
                    project_self_contacts(world, thread, threads, variant, friction, objects, touch, contacts)
                if wp.static(features.colliders):
                    project_obstacles(world, thread, threads, variant, friction, objects, obstacles, touch)
        put_into_lanes(group, thread, threads, objects.node_counts[variant], groups, touch)

    @wp.func
    def store_group(
        group: int,
        thread: int,
        threads: int,
        num_nodes: int,
        num_substeps: int,
        dt: float,
        worlds: Worlds,
        groups: group_type,
        touch: Touch,
    ):
        """Write the state of all worlds of a group and the forces on their grippers."""
        if wp.static(features.self_contact):
            add_reactions(group, thread, threads, num_nodes, groups, touch)
        if wp.static(features.tethers):
            for gripper in range(thread, groups.pulls.shape[1], threads):
                sum_tethers(group, gripper, num_nodes, groups)
            synchronize_block()
        for lane in range(groups.counts[group]):
            store_world(group, lane, thread, threads, num_nodes, num_substeps, dt, worlds, groups)

    @wp.kernel(module="unique", enable_backward=False)
    def step_groups(
        objects: Objects,
        obstacles: Obstacles,
        worlds: Worlds,
        groups: group_type,
        touch: Touch,
        contacts: SelfContacts,
        num_substeps: int,
        search_interval: int,
        dt: float,
        first_group: int,
        group_stride: int,
    ):
        """Advance every group by `num_substeps` substeps of one XPBD iteration each (Macklin et al. 2016, 2019)."""
        index, thread = wp.tid()
        threads = wp.block_dim()
        group = first_group + index * group_stride
        if is_idle(group, worlds, groups):
            return
        variant = worlds.variants[groups.members[group, 0]]
        num_nodes = objects.node_counts[variant]
        radius = objects.radii[variant]
        load_group(group, thread, threads, dt, variant, objects, obstacles, worlds, groups, touch)
        for substep in range(num_substeps):
            if wp.static(features.self_contact):  # noqa: SIM102 (left out at compile time)
                if substep % search_interval == 0:
                    find_self_contacts(
                        group, thread, threads, search_interval, dt, variant, objects, worlds, groups, touch, contacts
                    )
            progress = float(substep + 1) / float(num_substeps)
            for node in range(thread, num_nodes, threads):
                predict_node(group, node, dt, progress, groups)
            synchronize_block()
            project_material(group, thread, threads, variant, objects, worlds, groups)
            if wp.static(features.colliders or features.self_contact):
                project_contacts(group, thread, threads, variant, objects, obstacles, worlds, groups, touch, contacts)
            # The table last, so that no substep ends below it.
            for node in range(thread, num_nodes, threads):
                settle_node(group, node, radius, dt, groups)
            synchronize_block()
        store_group(group, thread, threads, num_nodes, num_substeps, dt, worlds, groups, touch)

    return step_groups
