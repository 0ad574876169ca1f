"""How far links of arms stay from the table and from the bases of other arms.

Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

import warp as wp

from maniskill_grpd.agents.arms.kinematics import Arms, Joints, frame_at_joint, frame_behind_joint, present
from maniskill_grpd.physics.kernels.links import closest_share, share_on_axis

# How much farther links keep than they have to [m].
SPARE_GAP = wp.constant(5.0e-4)


@wp.func
def nearer(a: wp.vec4, b: wp.vec4) -> wp.vec4:
    """Return that of two (direction away, gap) whose gap is smaller."""
    if b[3] < a[3]:
        return b
    return a


@wp.func
def gap_to_table(start: wp.vec3, end: wp.vec3, plane: wp.vec4) -> wp.vec4:
    """Return the normal of the table and how far a segment is above it."""
    normal = wp.vec3(plane[0], plane[1], plane[2])
    height = wp.min(wp.dot(normal, start), wp.dot(normal, end)) - plane[3]
    return wp.vec4(normal[0], normal[1], normal[2], height)


@wp.func
def gap_to_column(start: wp.vec3, end: wp.vec3, arms: Arms, world: int, other: int) -> wp.vec4:
    """Return the direction from the base of an arm to a segment, and how far this is from it."""
    foot = wp.transform_point(arms.bases[world, other], arms.column_ends[other, 0])
    head = wp.transform_point(arms.bases[world, other], arms.column_ends[other, 1])
    point = wp.lerp(start, end, closest_share(start, end, foot, head))
    away = point - wp.lerp(foot, head, share_on_axis(point, foot, head))
    distance = wp.length(away)
    away = away / wp.max(distance, 1.0e-6)
    return wp.vec4(away[0], away[1], away[2], distance - arms.column_radii[other])


@wp.func
def clearance(arms: Arms, world: int, arm: int, q: Joints, plane: wp.vec4) -> wp.vec4:
    """Return how far the links of an arm without its fingers stay from the table and the bases of other arms.

    First the direction (3,) away from the nearest of these, then the gap [m].
    """
    least = wp.vec4(0.0, 0.0, 0.0, 1.0e9)
    frame = arms.bases[world, arm]
    for joint in range(arms.kinds.shape[1]):
        frame = frame_behind_joint(arms, arm, joint, frame_at_joint(arms, arm, joint, frame), q[joint])
        for c in range(arms.capsule_joints.shape[1]):
            if arms.capsule_joints[arm, c] == joint and not arms.capsule_is_fingers[arm, c]:
                radius = wp.vec4(0.0, 0.0, 0.0, arms.capsule_radii[arm, c])
                start = wp.transform_point(frame, arms.capsule_ends[arm, 2 * c])
                end = wp.transform_point(frame, arms.capsule_ends[arm, 2 * c + 1])
                least = nearer(least, gap_to_table(start, end, plane) - radius)
                for other in range(arms.bases.shape[1]):
                    if other != arm:
                        least = nearer(least, gap_to_column(start, end, arms, world, other) - radius)
    return least


@wp.func
def overlap(arms: Arms, world: int, arm: int, q: Joints, plane: wp.vec4) -> wp.vec3:
    """Return the way by which links that joint positions bring further into table or base would have to be moved, or zero."""
    gap = clearance(arms, world, arm, q, plane)
    if gap[3] >= 0.0 or gap[3] >= clearance(arms, world, arm, present(arms, world, arm), plane)[3]:
        return wp.vec3(0.0, 0.0, 0.0)
    return wp.vec3(gap[0], gap[1], gap[2]) * (SPARE_GAP - gap[3])
