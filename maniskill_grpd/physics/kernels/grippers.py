"""How far grippers get in a control step: leashes hold them together, colliders stop them. Called once by the fused kernel."""

import warp as wp

from maniskill_grpd.physics import leashes
from maniskill_grpd.physics.kernels.colliders import MESH, collider_distance
from maniskill_grpd.physics.kernels.data import Colliders, Objects, Worlds

# A world is frozen when a coordinate is not finite or has left this range [m]: past it float32 cannot hold millimetres.
POSITION_LIMIT = wp.constant(1.0e4)
# Most sweeps over the gripper pairs, and the relative excess that is left alone: four grippers in a row need about forty.
LEASH_SWEEPS = wp.constant(64)
LEASH_TOLERANCE = wp.constant(1.0e-4)
NO_LEASH = wp.constant(leashes.NO_LEASH)
# Strain of a rope between a gripper and a collider that holds it by friction: the pull at which it slips along.
SPAN_STRAIN = wp.constant(0.02)
# Most rounds of drawing grippers together and stopping them again; each halves what is left of an excess.
STOP_ROUNDS = wp.constant(24)
# Surfaces along which a stopped gripper slides on within one control step.
SLIDES = wp.constant(4)
# Evaluations of the distance along one straight motion. Newton's method needs about five for a convex collider.
MARCH_STEPS = wp.constant(64)
# A gripper has arrived at a surface when it is this fraction of its margin away from touching; the least step past a mesh.
ARRIVAL, LEAST_STEP = wp.constant(0.02), wp.constant(0.1)


@wp.func
def is_valid(p: wp.vec3) -> bool:
    """True when all coordinates are finite and within range."""
    return wp.abs(p[0]) < POSITION_LIMIT and wp.abs(p[1]) < POSITION_LIMIT and wp.abs(p[2]) < POSITION_LIMIT


@wp.func
def is_near_collider(world: int, point: wp.vec3, margin: float, colliders: Colliders) -> bool:
    """Return whether a point is within a margin of any collider."""
    near = bool(False)
    for k in range(colliders.kinds.shape[0]):
        if colliders.active[world, k] and collider_distance(world, k, point, colliders)[3] <= margin:
            near = True
    return near


@wp.func
def find_ways(world: int, variant: int, objects: Objects, colliders: Colliders, worlds: Worlds):
    """Find where a rope touches colliders between each two grippers that hold it with no third one in between.

    Its way from one to the other is at least the straight lines to the first and from the last place where it touches, and the
    chords between all such places. A node counts as touching within half an edge of contact: at a sharp corner it is the edge
    between two nodes that touches.
    """
    num_grippers = worlds.gripper_targets.shape[1]
    first_edge = objects.line_edges[objects.line_colors[objects.line_ranges[variant]]]
    for a in range(num_grippers):
        for b in range(num_grippers):
            pair = a * num_grippers + b
            worlds.way_lengths[world, pair] = -1.0
            first = worlds.gripper_nodes[world, a]
            last = worlds.gripper_nodes[world, b]
            if objects.is_rope[variant] and worlds.leashes[world, a, b] < NO_LEASH and first >= 0 and first < last:
                touched = worlds.positions[world, first]
                for node in range(first + 1, last):
                    point = worlds.positions[world, node]
                    edge = wp.max(objects.rest_lengths[first_edge + node - 1], objects.rest_lengths[first_edge + node])
                    margin = objects.radii[variant] + 0.5 * edge
                    if is_near_collider(world, point, margin, colliders):
                        if worlds.way_lengths[world, pair] < 0.0:
                            worlds.way_starts[world, pair] = point
                            worlds.way_lengths[world, pair] = 0.0
                            worlds.way_spans[world, pair][0] = objects.geodesics[variant, first, node]
                        else:
                            worlds.way_lengths[world, pair] = worlds.way_lengths[world, pair] + wp.length(point - touched)
                        worlds.way_spans[world, pair][1] = objects.geodesics[variant, last, node]
                        touched = point
                worlds.way_ends[world, pair] = touched


@wp.func
def held_point(world: int, gripper: int, worlds: Worlds) -> wp.vec3:
    """Return where the node that a gripper holds is to go."""
    return worlds.gripper_targets[world, gripper] + worlds.hold_offsets[world, worlds.gripper_nodes[world, gripper]]


@wp.func
def limit_along_way(world: int, a: int, b: int, worlds: Worlds) -> bool:
    """Draw two grippers towards the collider around which the rope between them is too short; return whether they were."""
    pair = a * worlds.gripper_targets.shape[1] + b
    if worlds.way_lengths[world, pair] < 0.0:
        return False
    if not (is_valid(worlds.gripper_targets[world, a]) and is_valid(worlds.gripper_targets[world, b])):
        return False  # which freezes the world
    to_start = worlds.way_starts[world, pair] - held_point(world, a, worlds)
    to_end = worlds.way_ends[world, pair] - held_point(world, b, worlds)
    before = wp.length(to_start)
    behind = wp.length(to_end)
    share = 0.5 * (before + worlds.way_lengths[world, pair] + behind - worlds.leashes[world, a, b])
    spans = worlds.way_spans[world, pair] * (1.0 + SPAN_STRAIN)
    back = wp.vec2(wp.max(share, before - spans[0]), wp.max(share, behind - spans[1]))
    if not wp.max(back[0], back[1]) > 0.5 * LEASH_TOLERANCE * worlds.leashes[world, a, b]:
        return False
    back = wp.vec2(wp.clamp(back[0], 0.0, before), wp.clamp(back[1], 0.0, behind))
    worlds.gripper_targets[world, a] = worlds.gripper_targets[world, a] + to_start * (back[0] / wp.max(before, 1.0e-9))
    worlds.gripper_targets[world, b] = worlds.gripper_targets[world, b] + to_end * (back[1] / wp.max(behind, 1.0e-9))
    return True


@wp.func
def limit_gripper_targets(world: int, worlds: Worlds) -> bool:
    """Draw grippers together that would pull the object beyond its own length; return whether any were.

    Kinematic grippers have unlimited force and would tear any rope. Each pair that is further apart than its leash moves by half
    the excess, so targets stay inside their convex hull. Of a rope that touches a collider the way past it counts.
    """
    drawn = bool(False)
    num_grippers = worlds.gripper_targets.shape[1]
    for _sweep in range(LEASH_SWEEPS):
        num_taut = int(0)
        for a in range(num_grippers):
            for b in range(a):
                difference = worlds.gripper_targets[world, a] - worlds.gripper_targets[world, b]
                distance = wp.length(difference)
                if distance > worlds.leashes[world, a, b] * (1.0 + LEASH_TOLERANCE):
                    num_taut += 1
                    correction = difference * (0.5 * (distance - worlds.leashes[world, a, b]) / distance)
                    worlds.gripper_targets[world, a] = worlds.gripper_targets[world, a] - correction
                    worlds.gripper_targets[world, b] = worlds.gripper_targets[world, b] + correction
        for pair in range(worlds.way_lengths.shape[1]):
            if limit_along_way(world, pair // num_grippers, pair % num_grippers, worlds):
                num_taut += 1
        if num_taut == 0:
            break
        drawn = True
    return drawn


@wp.func
def march(world: int, start: wp.vec3, motion: wp.vec3, margin: float, colliders: Colliders) -> wp.vec4:
    """Return the normal of the first surface that a point meets on a straight way, and the fraction of the way until there.

    Along a line the distance to a convex collider is a convex function of the fraction: its tangent lies below it, so a Newton
    step cannot pass the surface, and where it grows the collider lies behind. To a mesh steps of the distance are taken.
    """
    travel = wp.length(motion)
    progress = float(0.0)
    normal = wp.vec3(0.0, 0.0, 0.0)
    arrived = travel == 0.0
    for _step in range(MARCH_STEPS):
        if progress >= 1.0 or arrived:
            break
        free = 1.0 - progress
        for k in range(colliders.kinds.shape[0]):
            if colliders.active[world, k]:
                at = collider_distance(world, k, start + motion * progress, colliders)
                outward = wp.vec3(at[0], at[1], at[2])
                approach = -wp.dot(outward, motion)
                gap = at[3] - margin
                if approach > 0.0 and gap <= ARRIVAL * margin:
                    arrived = True
                    normal = outward
                elif colliders.kinds[k] == MESH:
                    free = wp.min(free, wp.max(gap, LEAST_STEP * margin) / travel)
                elif approach > 0.0:
                    free = wp.min(free, gap / approach)
        if not arrived:
            progress += free
    if travel == 0.0:
        progress = 1.0
    return wp.vec4(normal[0], normal[1], normal[2], wp.min(progress, 1.0))


@wp.func
def stop_motion(world: int, start: wp.vec3, motion: wp.vec3, margin: float, colliders: Colliders) -> wp.vec3:
    """Return how far a point gets that stops at colliders and slides along them without friction.

    The way there is straight in the end, as that of a held node is within a control step.
    """
    moved = wp.vec3(0.0, 0.0, 0.0)
    rest = motion
    for _slide in range(SLIDES):
        met = march(world, start + moved, rest, margin, colliders)
        moved += rest * met[3]
        if met[3] >= 1.0:
            break
        rest *= 1.0 - met[3]
        normal = wp.vec3(met[0], met[1], met[2])
        rest -= normal * wp.min(wp.dot(normal, rest), 0.0)
    straight = march(world, start, moved, margin, colliders)
    return moved * straight[3]


@wp.func
def stop_grippers(world: int, margin: float, colliders: Colliders, worlds: Worlds):
    """Move targets to where colliders let the node that a gripper holds, or else the gripper itself, come at most.

    A gripper that is stopped can leave another one at the end of its leash, so both limits take turns. Where they find no
    agreement, as for grippers told to go tens of metres apart, all stay where they are.
    """
    agreed = bool(False)
    for _round in range(STOP_ROUNDS):
        for gripper in range(worlds.gripper_targets.shape[1]):
            start = worlds.gripper_positions[world, gripper]
            motion = worlds.gripper_targets[world, gripper] - start
            pivot = start
            node = worlds.gripper_nodes[world, gripper]
            if node >= 0 and worlds.holder[world, wp.max(node, 0)] == gripper:
                pivot += worlds.hold_offsets[world, node]
            if is_valid(pivot + motion):  # a target that is not freezes the world
                stopped = stop_motion(world, pivot, motion, margin, colliders)
                if wp.length_sq(stopped - motion) > 0.0:
                    worlds.gripper_targets[world, gripper] = start + stopped
        if not limit_gripper_targets(world, worlds):
            agreed = True
            break
    if not agreed:
        for gripper in range(worlds.gripper_targets.shape[1]):
            if is_valid(worlds.gripper_targets[world, gripper]):
                worlds.gripper_targets[world, gripper] = worlds.gripper_positions[world, gripper]
