"""The fused XPBD kernel: every substep of one control step, for one world per thread block.

On CUDA a block of threads works on one world: its lanes stride over nodes and over the constraints of one colour, with a block
barrier in between. On CPU the block has one lane and the same source is a plain sequential loop; worlds are split over threads
by the caller. `wp.static` leaves out what a solver does not need, so that a rope pays nothing for cloth. Annotations stay real
objects here (no postponed evaluation), because Warp reads them.
"""

from functools import cache

import warp as wp

from maniskill_grpd.physics.collider_functions import closest_on_edge, project_collider, project_table
from maniskill_grpd.physics.constraint_functions import (
    project_bend,
    project_hinge,
    project_stretch_line,
    project_tethers,
)
from maniskill_grpd.physics.gripper_functions import is_valid, limit_gripper_targets, stop_grippers
from maniskill_grpd.physics.kernel_data import Features, Objects, Obstacles, SelfContacts
from maniskill_grpd.physics.self_contact_functions import (
    BLOCK,
    SLOTS,
    bound_block,
    compute_contact_impulse,
    count_active,
    find_candidates,
    gather_contact_impulses,
    register_contacts,
    sort_contacts,
)

wp.config.log_level = wp.LOG_WARNING  # no banner when a library is imported


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
"""
)
def synchronize_block():
    """Wait until all lanes of the block have arrived; nothing to do for the single lane of the CPU."""


@wp.func
def project_colliders(
    world: int, position: wp.vec3, previous: wp.vec3, radius: float, friction: float, obstacles: Obstacles
) -> wp.vec3:
    """Keep one point out of all active colliders of its world, in their order."""
    for k in range(obstacles.kinds.shape[0]):
        if obstacles.active[world, k]:
            position = project_collider(
                position, previous, radius, friction, obstacles.positions[world, k], obstacles.rotations[world, k],
                k, obstacles.kinds[k], obstacles.sizes[world, k],
                obstacles.polygon_sizes[k], obstacles.polygons, obstacles.meshes[k],
            )  # fmt: skip
    return position


@wp.func
def project_edge(
    world: int,
    edge: wp.vec2i,
    radius: float,
    friction: float,
    obstacles: Obstacles,
    weights: wp.array2d(dtype=float),
    previous: wp.array2d(dtype=wp.vec3),
    positions: wp.array2d(dtype=wp.vec3),
):
    """Keep the point x = (1 - t) x_i + t x_j of an edge that is closest to a collider out of it.

    A correction d of the point moves its nodes by w_i (1 - t) d / s and w_j t d / s with s = w_i (1 - t)^2 + w_j t^2.
    """
    i = edge[0]
    j = edge[1]
    w_i = weights[world, i]
    w_j = weights[world, j]
    if w_i + w_j > 0.0:
        for k in range(obstacles.kinds.shape[0]):
            if obstacles.active[world, k]:
                x_i = positions[world, i]
                x_j = positions[world, j]
                t = closest_on_edge(
                    x_i, x_j, radius, obstacles.positions[world, k], obstacles.rotations[world, k], k, obstacles.kinds[k],
                    obstacles.sizes[world, k], obstacles.polygon_sizes[k], obstacles.polygons, obstacles.meshes[k],
                )  # fmt: skip
                if t > 0.0:
                    point = x_i * (1.0 - t) + x_j * t
                    start = previous[world, i] * (1.0 - t) + previous[world, j] * t
                    moved = project_collider(
                        point, start, radius, friction, obstacles.positions[world, k], obstacles.rotations[world, k],
                        k, obstacles.kinds[k], obstacles.sizes[world, k],
                        obstacles.polygon_sizes[k], obstacles.polygons, obstacles.meshes[k],
                    )  # fmt: skip
                    share = w_i * (1.0 - t) * (1.0 - t) + w_j * t * t
                    if share > 0.0:
                        positions[world, i] = x_i + (moved - point) * (w_i * (1.0 - t) / share)
                        positions[world, j] = x_j + (moved - point) * (w_j * t / share)


@cache
def build_step_kernel(features: Features) -> wp.Kernel:
    """Return the kernel that advances worlds with the given features by one control step."""

    @wp.kernel(module="unique", enable_backward=False)
    def step_worlds(
        # model:
        objects: Objects,
        obstacles: Obstacles,
        # time:
        num_substeps: int,
        search_interval: int,
        dt: float,
        # world:
        variants: wp.array(dtype=int),
        gravity: wp.array(dtype=wp.vec3),
        plane: wp.array(dtype=wp.vec4),
        friction: wp.array(dtype=float),
        damping: wp.array(dtype=float),
        stretch_scale: wp.array(dtype=float),
        bend_scale: wp.array(dtype=float),
        inverse_masses: wp.array2d(dtype=float),
        holder: wp.array2d(dtype=int),
        hold_offsets: wp.array2d(dtype=wp.vec3),
        gripper_nodes: wp.array2d(dtype=int),
        leashes: wp.array3d(dtype=float),
        # state:
        gripper_targets: wp.array2d(dtype=wp.vec3),
        gripper_positions: wp.array2d(dtype=wp.vec3),
        positions: wp.array2d(dtype=wp.vec3),
        velocities: wp.array2d(dtype=wp.vec3),
        frozen: wp.array(dtype=wp.bool),
        # out:
        gripper_forces: wp.array2d(dtype=wp.vec3),
        # scratch:
        previous: wp.array2d(dtype=wp.vec3),
        backup: wp.array2d(dtype=wp.vec3),
        weights: wp.array2d(dtype=float),
        reactions: wp.array2d(dtype=wp.vec3),
        tether_impulses: wp.array3d(dtype=wp.vec3),
        directions: wp.array2d(dtype=wp.vec3),
        upper: wp.array2d(dtype=float),
        multipliers: wp.array2d(dtype=float),
        contacts: SelfContacts,
    ):
        """Advance every world by `num_substeps` substeps of one XPBD iteration each (Macklin et al. 2016, 2019)."""
        world, lane = wp.tid()
        lanes = wp.block_dim()
        if frozen[world]:
            return
        variant = variants[world]
        num_nodes = objects.node_counts[variant]
        radius = objects.radii[variant]
        inverse_dt2 = 1.0 / (dt * dt)
        stretch_inverse_dt2 = inverse_dt2 / stretch_scale[world]
        bend_inverse_dt2 = inverse_dt2 / bend_scale[world]
        # In double precision: 1 - c dt has few digits left in single.
        velocity_decay = float(wp.exp(-wp.float64(damping[world]) * wp.float64(dt)))

        for node in range(lane, num_nodes, lanes):
            backup[world, node] = positions[world, node]
            reactions[world, node] = wp.vec3(0.0, 0.0, 0.0)
            weight = inverse_masses[world, node]
            if holder[world, node] >= 0:
                weight = float(0.0)
            weights[world, node] = weight
            if wp.static(features.tethers):
                for gripper in range(gripper_nodes.shape[1]):
                    tether_impulses[world, gripper, node] = wp.vec3(0.0, 0.0, 0.0)
        if lane == 0:
            limit_gripper_targets(world, leashes, gripper_targets)
            if wp.static(features.colliders):
                stop_grippers(
                    world, radius, obstacles, leashes, gripper_nodes, holder, hold_offsets, gripper_positions, gripper_targets
                )
        synchronize_block()

        for substep in range(num_substeps):
            if wp.static(features.self_contact):  # noqa: SIM102 (left out at compile time)
                # Find what may touch until the next search, and tell every node of its contacts.
                if substep % search_interval == 0:
                    for node in range(lane, num_nodes, lanes):
                        contacts.num_of_node[world, node] = 0
                    first_element = objects.element_starts[variant]
                    num_elements = objects.element_starts[variant + 1] - first_element
                    for block in range(lane, (num_elements + BLOCK - 1) // BLOCK, lanes):
                        bound_block(
                            world, block, first_element, num_elements, objects.elements, objects.element_radii,
                            positions, velocities, contacts.block_spheres, contacts.block_speeds,
                        )  # fmt: skip
                    synchronize_block()
                    for owner in range(lane, objects.owner_counts[variant], lanes):
                        find_candidates(
                            world, owner, first_element,
                            num_elements, objects.is_rope[variant], 3.0 * radius, objects.exclusions[variant],
                            2.0 * float(search_interval) * dt, variant, objects.elements, objects.element_radii,
                            objects.geodesics, positions, velocities,
                            contacts.nodes, contacts.sides, contacts.gaps, contacts.counts,
                            contacts.block_spheres, contacts.block_speeds,
                        )  # fmt: skip
                        register_contacts(
                            world, owner, contacts.nodes, contacts.counts, contacts.of_node, contacts.num_of_node
                        )
                    synchronize_block()
                    for node in range(lane, num_nodes, lanes):
                        sort_contacts(world, node, contacts.of_node, contacts.num_of_node)
                    synchronize_block()

            # Predict: held nodes follow their gripper along a straight line, free nodes fly.
            progress = float(substep + 1) / float(num_substeps)
            for node in range(lane, num_nodes, lanes):
                position = positions[world, node]
                previous[world, node] = position
                gripper = holder[world, node]
                if gripper >= 0:
                    start = gripper_positions[world, gripper]
                    grasp = start + (gripper_targets[world, gripper] - start) * progress
                    positions[world, node] = grasp + hold_offsets[world, node]
                elif inverse_masses[world, node] > 0.0:
                    velocity = velocities[world, node] * velocity_decay + gravity[world] * dt
                    positions[world, node] = position + velocity * dt
            synchronize_block()

            if wp.static(features.bends):
                for color in range(objects.bend_ranges[variant], objects.bend_ranges[variant + 1] - 1):
                    for c in range(objects.bend_colors[color] + lane, objects.bend_colors[color + 1], lanes):
                        project_bend(
                            world, objects.bends[c], objects.bend_compliances[c] * bend_inverse_dt2,
                            weights, positions, reactions,
                        )  # fmt: skip
                    synchronize_block()

            if wp.static(features.hinges):
                for color in range(objects.hinge_ranges[variant], objects.hinge_ranges[variant + 1] - 1):
                    for c in range(objects.hinge_colors[color] + lane, objects.hinge_colors[color + 1], lanes):
                        project_hinge(
                            world, objects.hinges[c], objects.hinge_weights[c], objects.hinge_compliances[c] * bend_inverse_dt2,
                            weights, positions, reactions,
                        )  # fmt: skip
                    synchronize_block()

            if wp.static(features.tethers):
                for node in range(lane, num_nodes, lanes):
                    project_tethers(
                        world, node, variant, objects.max_stretch[variant], objects.geodesics, gripper_nodes,
                        weights, positions, tether_impulses,
                    )  # fmt: skip
                synchronize_block()

            # Stretch after bending: the length is the stiffer and the more visible of the two.
            first_edge = objects.line_edges[objects.line_colors[objects.line_ranges[variant]]]
            for color in range(objects.line_ranges[variant], objects.line_ranges[variant + 1] - 1):
                for line in range(objects.line_colors[color] + lane, objects.line_colors[color + 1], lanes):
                    edge = objects.line_edges[line]
                    project_stretch_line(
                        world, edge, edge + line, edge - first_edge, objects.line_edges[line + 1] - edge,
                        objects.line_nodes, objects.rest_lengths, objects.stretch_compliances,
                        stretch_inverse_dt2, weights, positions, reactions, directions, upper, multipliers,
                    )  # fmt: skip
                synchronize_block()

            if wp.static(features.self_contact):
                for owner in range(lane, objects.owner_counts[variant], lanes):
                    for index in range(contacts.counts[world, owner]):
                        compute_contact_impulse(
                            world, owner * SLOTS + index, objects.is_rope[variant], 2.0 * radius, friction[world],
                            contacts.nodes, contacts.sides, weights, positions, previous, contacts.weights, contacts.impulses,
                        )  # fmt: skip
                synchronize_block()
                for node in range(lane, num_nodes, lanes):
                    contacts.num_active[world, node] = count_active(
                        world, node, contacts.of_node, contacts.num_of_node, contacts.impulses
                    )
                synchronize_block()
                for node in range(lane, num_nodes, lanes):
                    if contacts.num_active[world, node] > 0:
                        impulse = gather_contact_impulses(
                            world, node, contacts.of_node, contacts.num_of_node, contacts.nodes, contacts.weights,
                            contacts.impulses, contacts.num_active,
                        )  # fmt: skip
                        if weights[world, node] > 0.0:
                            positions[world, node] = positions[world, node] + impulse * weights[world, node]
                        else:
                            reactions[world, node] = reactions[world, node] + impulse
                synchronize_block()

            if wp.static(features.colliders):
                for color in range(objects.mesh_edge_ranges[variant], objects.mesh_edge_ranges[variant + 1] - 1):
                    for c in range(objects.mesh_edge_colors[color] + lane, objects.mesh_edge_colors[color + 1], lanes):
                        project_edge(
                            world, objects.mesh_edges[c], radius, friction[world], obstacles, weights, previous, positions
                        )
                    synchronize_block()

            # Surfaces last, so that no substep ends below the table; then velocities from the motion.
            for node in range(lane, num_nodes, lanes):
                position = positions[world, node]
                start = previous[world, node]
                if weights[world, node] > 0.0:
                    if wp.static(features.colliders):
                        position = project_colliders(world, position, start, radius, friction[world], obstacles)
                    position = project_table(position, start, plane[world], radius, friction[world])
                    positions[world, node] = position
                velocities[world, node] = (position - start) / dt
            synchronize_block()

        for node in range(lane, num_nodes, lanes):
            if not is_valid(positions[world, node]):
                frozen[world] = True
        for gripper in range(lane, gripper_positions.shape[1], lanes):
            if not is_valid(gripper_targets[world, gripper]):
                frozen[world] = True
        synchronize_block()

        # A world that blew up keeps its last valid state and rests there until it is reset.
        if frozen[world]:
            for node in range(lane, num_nodes, lanes):
                positions[world, node] = backup[world, node]
                velocities[world, node] = wp.vec3(0.0, 0.0, 0.0)
            for gripper in range(lane, gripper_positions.shape[1], lanes):
                gripper_targets[world, gripper] = gripper_positions[world, gripper]
                gripper_forces[world, gripper] = wp.vec3(0.0, 0.0, 0.0)
        else:
            for gripper in range(lane, gripper_positions.shape[1], lanes):
                gripper_positions[world, gripper] = gripper_targets[world, gripper]
                # Impulses here are in position units, force * dt^2.
                total = wp.vec3(0.0, 0.0, 0.0)
                for node in range(num_nodes):
                    if holder[world, node] == gripper:
                        total += reactions[world, node]
                        if inverse_masses[world, node] > 0.0:
                            total += gravity[world] * (dt * dt * float(num_substeps) / inverse_masses[world, node])
                    if wp.static(features.tethers):
                        total += tether_impulses[world, gripper, node]
                gripper_forces[world, gripper] = total * (inverse_dt2 / float(num_substeps))

    return step_worlds
