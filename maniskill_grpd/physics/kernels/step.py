"""The fused XPBD kernel: every substep of one control step, for one group of worlds per thread block.

On CUDA a group is one world and its block has many threads, which stride over nodes and over the constraints of one colour, with
a barrier in between. On CPU a group is as many worlds as a vector register has lanes, its block has one thread, and the same
source is a sequential loop over operations on lanes. `wp.static` leaves out what a solver does not need, so that a rope pays
nothing for cloth. Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

from functools import cache

import warp as wp

from maniskill_grpd.physics.kernels.bending import project_bends, project_folds, project_hinges
from maniskill_grpd.physics.kernels.block import synchronize_block
from maniskill_grpd.physics.kernels.collider_contacts import place_collider_bounds, project_colliders
from maniskill_grpd.physics.kernels.contact_list import load_anchor, store_anchors, store_crossed
from maniskill_grpd.physics.kernels.data import (
    Colliders,
    Features,
    LaneGroups,
    Links,
    Objects,
    SelfContacts,
    SingleGroups,
    Thread,
    Timing,
    Worlds,
)
from maniskill_grpd.physics.kernels.grippers import find_ways, limit_gripper_targets, stop_grippers
from maniskill_grpd.physics.kernels.groups import is_idle, load_constants, load_node, predict_node, settle_node, store_world
from maniskill_grpd.physics.kernels.links import find_near_links, project_links
from maniskill_grpd.physics.kernels.rope_stretch import project_rope_line
from maniskill_grpd.physics.kernels.self_contact import find_contacts, project_self_contacts
from maniskill_grpd.physics.kernels.stretch import load_tensions, project_sheet_line, pull_sheet_line, store_tensions
from maniskill_grpd.physics.kernels.tethers import load_tethers, project_tethers, sum_tethers
from maniskill_grpd.physics.kernels.tugs import pull_tugged_nodes


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
        thread: Thread,
        timing: Timing,
        objects: Objects,
        colliders: Colliders,
        worlds: Worlds,
        groups: group_type,
        contacts: SelfContacts,
    ):
        """Limit the targets of the grippers and fetch the state of all worlds of a group."""
        for lane in range(thread.first, groups.counts[thread.group], thread.stride):
            world = groups.members[thread.group, lane]
            if not worlds.frozen[world]:
                if wp.static(features.colliders and features.ropes):
                    find_ways(world, thread.variant, objects, colliders, worlds)
                limit_gripper_targets(world, worlds)
                if wp.static(features.colliders):
                    stop_grippers(world, objects.radii[thread.variant], colliders, worlds)
        if wp.static(features.sheets):  # noqa: SIM102 (left out at compile time)
            if not objects.is_rope[thread.variant]:
                load_tensions(thread, timing.dt, objects, worlds, groups)
        if thread.first == 0:
            load_constants(thread.group, timing.dt, worlds, groups)
            if wp.static(features.colliders):
                place_collider_bounds(thread.group, colliders, groups)
        synchronize_block()
        for node in range(thread.first, objects.node_counts[thread.variant], thread.stride):
            load_node(thread.group, node, worlds, groups)
            if wp.static(features.self_contact):
                load_anchor(thread, node, groups, contacts)
            if wp.static(features.tethers):
                load_tethers(thread, node, objects, worlds, groups)
        synchronize_block()

    @wp.func
    def pull_edges(thread: Thread, objects: Objects, groups: group_type):
        """Apply the tension that the edges of a sheet had before."""
        if not objects.is_rope[thread.variant]:
            for color in range(objects.line_ranges[thread.variant], objects.line_ranges[thread.variant + 1] - 1):
                for line in range(objects.line_colors[color] + thread.first, objects.line_colors[color + 1], thread.stride):
                    pull_sheet_line(thread, line, objects, groups)
                synchronize_block()

    @wp.func
    def project_material(thread: Thread, timing: Timing, objects: Objects, worlds: Worlds, groups: group_type):
        """Project what holds an object together. Stretch comes last: length is the stiffer and the more visible."""
        if wp.static(features.sheets):
            pull_edges(thread, objects, groups)
        if wp.static(features.bends):
            project_bends(thread, objects, groups)
        if wp.static(features.hinges):
            project_hinges(thread, objects, groups)
        if wp.static(features.folds):
            project_folds(thread, objects, groups)
        if wp.static(features.tethers):
            project_tethers(thread, objects, worlds, groups)
        for color in range(objects.line_ranges[thread.variant], objects.line_ranges[thread.variant + 1] - 1):
            for line in range(objects.line_colors[color] + thread.first, objects.line_colors[color + 1], thread.stride):
                if wp.static(features.ropes):
                    project_rope_line(thread, line, timing.dt, objects, groups)
                else:
                    project_sheet_line(thread, line, timing.dt, objects, groups)
            synchronize_block()

    @wp.func
    def project_contacts(
        thread: Thread, objects: Objects, colliders: Colliders, worlds: Worlds, groups: group_type, contacts: SelfContacts
    ):
        """Resolve contact of all worlds with themselves and with colliders."""
        if wp.static(features.self_contact):
            project_self_contacts(thread, objects, worlds, groups, contacts)
        if wp.static(features.colliders):
            project_colliders(thread, objects, colliders, worlds, groups)

    @wp.func
    def store_group(thread: Thread, timing: Timing, objects: Objects, worlds: Worlds, groups: group_type, contacts: SelfContacts):
        """Write the state of all worlds of a group and the forces on their grippers."""
        if wp.static(features.self_contact):
            store_crossed(thread, worlds, groups, contacts)
        if wp.static(features.tethers):
            sum_tethers(thread, objects, groups)
        for lane in range(groups.counts[thread.group]):
            store_world(thread, lane, timing, objects, worlds, groups)
        if wp.static(features.self_contact):
            synchronize_block()
            store_anchors(thread, objects, worlds, groups, contacts)
        if wp.static(features.sheets):  # noqa: SIM102 (left out at compile time)
            if not objects.is_rope[thread.variant]:
                store_tensions(thread, timing.dt, objects, worlds, groups)

    @wp.kernel(module="unique", enable_backward=False)
    def step_groups(
        objects: Objects,
        colliders: Colliders,
        worlds: Worlds,
        groups: group_type,
        contacts: SelfContacts,
        links: Links,
        timings: wp.array(dtype=Timing),
        first_group: int,
        group_stride: int,
        first_thread: int,
        thread_stride: int,
    ):
        """Advance every group by substeps of one XPBD iteration each (Macklin et al. 2016, 2019).

        A block whose threads are those of several launches has `thread_stride` launches, numbered by `first_thread`.
        """
        index, first = wp.tid()
        group = first_group + index * group_stride
        if is_idle(group, worlds, groups):
            return
        thread = Thread()
        thread.group = group
        thread.variant = worlds.variants[groups.members[group, 0]]
        thread.first = first * thread_stride + first_thread
        thread.stride = wp.block_dim() * thread_stride
        timing = timings[thread.variant]
        num_nodes = objects.node_counts[thread.variant]
        load_group(thread, timing, objects, colliders, worlds, groups, contacts)
        if wp.static(features.links):
            find_near_links(thread, timing, objects, worlds, groups, links)
            synchronize_block()
        if wp.static(features.self_contact):
            find_contacts(thread, True, objects, worlds, groups, contacts)
        for substep in range(timing.num_substeps):
            progress = float(substep + 1) / float(timing.num_substeps)
            for node in range(thread.first, num_nodes, thread.stride):
                predict_node(group, node, timing.dt, progress, groups)
            synchronize_block()
            pull_tugged_nodes(thread, timing, worlds, groups)
            synchronize_block()
            project_material(thread, timing, objects, worlds, groups)
            if wp.static(features.colliders or features.self_contact):
                project_contacts(thread, objects, colliders, worlds, groups, contacts)
            if wp.static(features.links):
                project_links(thread, substep, timing, objects, worlds, groups, links)
            # The table last, so that no substep ends below it.
            for node in range(thread.first, num_nodes, thread.stride):
                settle_node(group, node, objects.radii[thread.variant], timing.dt, groups)
            synchronize_block()
        store_group(thread, timing, objects, worlds, groups, contacts)

    return step_groups
