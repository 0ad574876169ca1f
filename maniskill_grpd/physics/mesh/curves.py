"""Polylines resampled by arc length."""

from __future__ import annotations

import numpy as np


def polyline_length(points: np.ndarray) -> float:
    """Return the length [m] of a polyline of points (P, D)."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def resample_polyline(points: np.ndarray, num: int) -> np.ndarray:
    """Place `num` points at equal arc-length steps along a polyline.

    Args:
        points: Polyline, (P, D) with P >= 2 [m].
        num: Number of points to place, >= 2; the first and last coincide with the polyline's ends.

    Returns:
        Points, (num, D) float64. Chords across a corner of the polyline are shorter than the arc-length step.

    Raises:
        ValueError: If the polyline is not a finite (P >= 2, D) array of positive length, or `num` < 2.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or len(points) < 2:
        raise ValueError(f"a polyline is an array of at least two points (P, D), got shape {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("a polyline must be finite, got NaN or infinity")
    if num < 2:
        raise ValueError(f"a polyline is resampled to at least 2 points, got num={num}")
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if arc[-1] <= 0.0:
        raise ValueError("a polyline must have positive length, all points coincide")
    targets = np.linspace(0.0, arc[-1], num)
    return np.stack([np.interp(targets, arc, column) for column in points.T], axis=1)
