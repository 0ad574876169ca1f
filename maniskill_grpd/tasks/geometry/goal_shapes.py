"""Planar curves that a rope can be asked to take."""

from __future__ import annotations

import numpy as np

from maniskill_grpd.physics import resample_polyline

W_STROKE_ANGLE = np.deg2rad(55.0)
"""Angle between the strokes of the W and its base line."""
POINTS_PER_SEGMENT = 64
"""Points of the fine polyline per segment of the goal curve; corners are cut by below 2 %."""
CHORD_ITERATIONS = 100
"""Far more than needed: the spread of the chords shrinks by half or better in each iteration."""


def goal_curve(name: str, length: float, num_nodes: int) -> np.ndarray:
    """Return where the nodes of a rope lie when it has the shape `name`.

    Neighbouring nodes are exactly one rope segment apart, also across corners, so that an
    unstretched rope fits the curve.

    Args:
        name: One of `GOAL_SHAPES`.
        length: Length of the rope [m].
        num_nodes: Number of nodes N of the rope.

    Returns:
        Positions in the plane, (N, 2) float64 [m], in the order of the nodes, their mean at the
        origin.

    Raises:
        ValueError: If there is no shape of that name.
    """
    if name not in _OUTLINES:
        raise ValueError(f"unknown goal shape {name!r}; allowed are {', '.join(GOAL_SHAPES)}")
    outline = resample_polyline(_OUTLINES[name](), POINTS_PER_SEGMENT * (num_nodes - 1) + 1)
    points = _with_equal_chords(outline, num_nodes)
    chord = np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
    points *= length / (num_nodes - 1) / chord
    return points - points.mean(axis=0)


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


_OUTLINES = {
    "W": _outline_w,
    "V": _outline_v,
    "U": _outline_u,
    "S": _outline_s,
    "L": _outline_l,
    "O": _outline_o,
    "spiral": _outline_spiral,
}
GOAL_SHAPES = tuple(_OUTLINES)
"""Names of all shapes."""
