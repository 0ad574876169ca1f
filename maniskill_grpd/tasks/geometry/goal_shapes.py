"""Planar curves that a rope can be asked to take, by name or as points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from maniskill_grpd.physics import resample_polyline
from maniskill_grpd.physics.mesh.curves import polyline_length
from maniskill_grpd.physics.mesh.outlines import as_points
from maniskill_grpd.tasks.geometry.shape_registry import GivenShape, Shape, ShapeRegistry

W_STROKE_ANGLE = np.deg2rad(55.0)
"""Angle between the strokes of the W and its base line."""
POINTS_PER_SEGMENT = 64
"""Points of the fine polyline per segment of the goal curve; corners are cut by below 2 %."""
CHORD_ITERATIONS = 100
"""Far more than needed: the spread of the chords shrinks by half or better in each iteration."""
CHORD_TOLERANCE = 1e-3
"""Largest relative difference of the chords of a curve that a rope can take."""


def goal_curve(shape: Shape, length: float, num_nodes: int) -> np.ndarray:
    """Return where the nodes of a rope lie when it has a shape.

    Neighbouring nodes are exactly one rope segment apart, also across corners, so that an
    unstretched rope fits the curve. Whatever its size, a curve is scaled to the rope.

    Args:
        shape: One of `GOAL_SHAPES`, or a curve, (P >= 2, 2).
        length: Length of the rope [m].
        num_nodes: Number of nodes N of the rope.

    Returns:
        Positions in the plane, (N, 2) float64 [m], in the order of the nodes, their mean at the
        origin.

    Raises:
        ValueError: If there is no shape of that name, the curve is none, or it turns back on itself
            within a segment of the rope.
    """
    outline = resample_polyline(GOAL_SHAPES.points(shape), POINTS_PER_SEGMENT * (num_nodes - 1) + 1)
    points = _with_equal_chords(outline, num_nodes)
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if np.ptp(chords) > CHORD_TOLERANCE * chords.mean():
        raise ValueError(
            f"a rope of {num_nodes} nodes cannot take this curve: it turns back on itself within a segment, so that the way "
            f"between neighbouring nodes is {chords.min() / chords.mean():.2f} to {chords.max() / chords.mean():.2f} segments"
        )
    points *= length / (num_nodes - 1) / chords.mean()
    return points - points.mean(axis=0)


def register_goal_shape(name: str, curve: GivenShape | Callable[[], GivenShape]) -> None:
    """Offer a goal shape by a name, as in `gym.make("RopeShaping-v1", goal_shape="zigzag")`.

    Args:
        name: A new name.
        curve: Open curve from the rope's first node to its last, (P >= 2, 2) of any size; or a function
            without arguments that returns one.

    Raises:
        ValueError: If the name is taken, or the curve is not finite or has no length.
    """
    GOAL_SHAPES.register(name, curve)


def _check_curve(points: Any, name: str) -> np.ndarray:
    curve = as_points(points, name, "a curve (P >= 2, 2)")
    if len(curve) < 2 or polyline_length(curve) == 0.0:
        raise ValueError(f"{name} must be a curve (P >= 2, 2) that has a length, got {len(curve)} points with a way of 0 m")
    return curve


def _with_equal_chords(outline: np.ndarray, num: int) -> np.ndarray:
    """Place `num` points along a polyline, ends included, with neighbours equally far apart.

    Fixed-point iteration on their arc-length parameters: points move to where the cumulated chord
    length of the last iterate says they should be.
    """
    along = np.linspace(0.0, 1.0, len(outline))
    even = np.linspace(0.0, 1.0, num)
    fractions = even
    for _ in range(CHORD_ITERATIONS):
        points = np.stack([np.interp(fractions, along, column) for column in outline.T], axis=1)
        cumulated = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        fractions = np.interp(even, cumulated / cumulated[-1], fractions)
    return points


def _outline_w() -> np.ndarray:
    stroke = np.array([np.cos(W_STROKE_ANGLE), np.sin(W_STROKE_ANGLE)])
    return np.array([[0, 1], [1, 0], [2, 1], [3, 0], [4, 1]]) * stroke


def _outline_v() -> np.ndarray:
    return np.array([[-1.0, np.sqrt(3.0)], [0.0, 0.0], [1.0, np.sqrt(3.0)]])


def _outline_l() -> np.ndarray:
    return np.array([[0.0, 1.5], [0.0, 0.0], [1.0, 0.0]])


def _outline_u() -> np.ndarray:
    return np.concatenate([[[-1.0, 1.5]], _arc((0.0, 0.0), -180.0, 0.0), [[1.0, 1.5]]])


def _outline_s() -> np.ndarray:
    upper, lower = _arc((0.0, 1.0), 30.0, 270.0), _arc((0.0, -1.0), 90.0, -150.0)
    return np.concatenate([upper, lower[1:]])


def _outline_o() -> np.ndarray:
    # Open by 10 degrees: about the thickness of the rope, so that its two ends have room.
    return _arc((0.0, 0.0), 95.0, 445.0)


def _outline_spiral() -> np.ndarray:
    angle = np.linspace(np.pi, 4.0 * np.pi, 1000)
    return angle[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _arc(centre: tuple[float, float], start: float, end: float) -> np.ndarray:
    """Return a unit circle's arc between two angles [degrees], (P, 2)."""
    angle = np.deg2rad(np.linspace(start, end, 1000))
    return np.asarray(centre) + np.stack([np.cos(angle), np.sin(angle)], axis=1)


GOAL_SHAPES = ShapeRegistry("goal shapes", "curves (P >= 2, 2) [m]", _check_curve)
"""Curves by the names of all shapes."""
for _name, _curve in {
    "W": _outline_w,
    "V": _outline_v,
    "U": _outline_u,
    "S": _outline_s,
    "L": _outline_l,
    "O": _outline_o,
    "spiral": _outline_spiral,
}.items():
    GOAL_SHAPES.register(_name, _curve)
