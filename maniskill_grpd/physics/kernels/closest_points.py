"""Closest points of a node and a triangle, and of two edges, in lanes and for single points alike."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.kernels.lanes import add, choose, div, greater, inner, lesser, mul, root, spread, sub  # noqa: F401 (operators on lanes)

# Squares of lengths below this [m^2] count as zero.
TINY = wp.constant(1.0e-14)
# Squared sine of the angle below which two edges are parallel, and have many closest points.
PARALLEL = wp.constant(1.0e-6)


@wp.func
def clamp_fraction(a: Any):
    """Return a, but at least 0 and at most 1."""
    return lesser(greater(a, spread(a, 0.0)), spread(a, 1.0))


@wp.func
def closest_on_triangle(p: Any, a: Any, b: Any, c: Any):
    """Return barycentric coordinates of the point of a triangle closest to p: its projection, or else on one of three edges."""
    ab = b - a
    ac = c - a
    ap = p - a
    bc = c - b
    bp = p - b
    d00 = greater(inner(ab, ab), spread(inner(ab, ab), TINY))
    d11 = greater(inner(ac, ac), spread(d00, TINY))
    d01 = inner(ab, ac)
    d20 = inner(ap, ab)
    d21 = inner(ap, ac)
    area = greater(d00 * d11 - d01 * d01, spread(d00, TINY * TINY))
    v = (d11 * d20 - d01 * d21) / area
    w = (d00 * d21 - d01 * d20) / area
    one = spread(v, 1.0)
    zero = spread(v, 0.0)
    is_over = lesser(one - v - w, lesser(v, w))
    along_ab = clamp_fraction(d20 / d00)
    along_ac = clamp_fraction(d21 / d11)
    along_bc = clamp_fraction(inner(bp, bc) / greater(inner(bc, bc), spread(d00, TINY)))
    to_ab = ap - ab * along_ab
    to_ac = ap - ac * along_ac
    to_bc = bp - bc * along_bc
    gap_ab = inner(to_ab, to_ab)
    gap_ac = inner(to_ac, to_ac)
    gap_bc = inner(to_bc, to_bc)
    rim_v = choose(gap_ac - gap_ab, along_ab, zero)
    rim_w = choose(gap_ac - gap_ab, zero, along_ac)
    is_bc = lesser(gap_ab, gap_ac) - gap_bc
    rim_v = choose(is_bc, one - along_bc, rim_v)
    rim_w = choose(is_bc, along_bc, rim_w)
    v = choose(is_over, v, rim_v)
    w = choose(is_over, w, rim_w)
    return one - v - w, v, w


@wp.func
def closest_on_edges(p: Any, q: Any, r: Any, s: Any):
    """Return the fractions along p-q and r-s of their closest points (Ericson 2005, section 5.1.9)."""
    d1 = q - p
    d2 = s - r
    offset = p - r
    a = greater(inner(d1, d1), spread(inner(d1, d1), TINY))
    e = greater(inner(d2, d2), spread(a, TINY))
    b = inner(d1, d2)
    c = inner(d1, offset)
    f = inner(d2, offset)
    determinant = a * e - b * b
    crossing = clamp_fraction((b * f - c * e) / greater(determinant, spread(a, TINY * TINY)))
    along = choose(determinant - a * e * PARALLEL, crossing, spread(a, 0.5))
    free = (b * along + f) / e
    other = clamp_fraction(free)
    slid = free - other
    along = choose(slid * slid, clamp_fraction((b * other - c) / a), along)
    return along, other


@wp.func
def closest_weights(is_edges: bool, x_0: Any, x_1: Any, x_2: Any, x_3: Any):
    """Return weights with which sum_k weight_k x_k is the shortest vector from the second of two elements to the first.

    They are edges (0, 1) and (2, 3) if `is_edges`, else node 0 and triangle (1, 2, 3).
    """
    first = spread(inner(x_0, x_0), 1.0)
    second = first
    third = first
    fourth = first
    if is_edges:
        along, other = closest_on_edges(x_0, x_1, x_2, x_3)
        third = other - first
        first = first - along
        second = along
        fourth = other * -1.0
    else:
        u, v, w = closest_on_triangle(x_0, x_1, x_2, x_3)
        second = u * -1.0
        third = v * -1.0
        fourth = w * -1.0
    return first, second, third, fourth
