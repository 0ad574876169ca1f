"""Triangles to pixels in numpy: scan conversion, a depth buffer, smooth shading, translucency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MIN_DOUBLE_AREA = 1e-9
"""Triangles below it are dropped [pixels^2]."""


@dataclass(frozen=True)
class Fragments:
    """The pixels that triangles cover."""

    faces: np.ndarray
    """Triangle of each fragment, (k,) int64."""
    rows: np.ndarray
    """(k,) int64."""
    columns: np.ndarray
    """(k,) int64."""


class Canvas:
    """An image that knows how near what it shows is.

    Nearness is the inverse of the depth: it is linear over the image of a triangle. 0 is infinitely far.
    """

    def __init__(self, colors: np.ndarray, nearness: np.ndarray) -> None:
        """Start from an image (H, W, 3) float32 and its nearness (H, W) float32 [1/m]; both will be painted on."""
        self.colors = colors
        self.nearness = nearness

    def copy(self) -> Canvas:
        """Return a canvas with the same image."""
        return Canvas(self.colors.copy(), self.nearness.copy())

    def paint(self, corners: np.ndarray, nearness: np.ndarray, colors: np.ndarray) -> None:
        """Paint opaque triangles.

        Args:
            corners: (F, 3, 2) [pixels], x right and y down.
            nearness: Of the corners, (F, 3) [1/m].
            colors: Of the corners, (F, 3, 3) in [0, 1].
        """
        fragments, depths, values = self._front_layer(corners, nearness, colors, self.nearness)
        self.nearness[fragments.rows, fragments.columns] = depths
        self.colors[fragments.rows, fragments.columns] = values

    def glaze(
        self,
        corners: np.ndarray,
        nearness: np.ndarray,
        colors: np.ndarray,
        *,
        alpha: float,
        hidden_alpha: float = 0.0,
        limit: np.ndarray | None = None,
    ) -> None:
        """Paint the foremost layer of triangles translucently; what lies behind it still counts as the nearest.

        Args:
            corners: As for `paint`.
            nearness: As for `paint`.
            colors: As for `paint`.
            alpha: Opacity in [0, 1].
            hidden_alpha: Opacity where something opaque is in front, in [0, 1].
            limit: Nearness (H, W) beyond which the layer counts as in front, by default that of the image.
        """
        empty = np.zeros_like(self.nearness)
        fragments, depths, values = self._front_layer(corners, nearness, colors, empty)
        at = fragments.rows, fragments.columns
        is_hidden = depths < (self.nearness if limit is None else limit)[at]
        opacity = np.where(is_hidden, hidden_alpha, alpha).astype(np.float32)[:, None]
        self.colors[at] += opacity * (values - self.colors[at])

    def _front_layer(
        self, corners: np.ndarray, nearness: np.ndarray, colors: np.ndarray, limit: np.ndarray
    ) -> tuple[Fragments, np.ndarray, np.ndarray]:
        """Return the foremost fragments, their nearness (k,) and colours (k, 3); none behind a limit (H, W)."""
        fragments = scan(corners, self.nearness.shape)
        planes = _planes(corners, np.concatenate([nearness[..., None], colors], axis=-1))
        depths = _evaluate(planes[..., 0], fragments)
        nearest = limit.copy()
        np.maximum.at(nearest, (fragments.rows, fragments.columns), depths)
        wins = (depths >= nearest[fragments.rows, fragments.columns]).nonzero()[0]
        fragments = Fragments(fragments.faces[wins], fragments.rows[wins], fragments.columns[wins])
        values = np.stack([_evaluate(planes[..., 1 + k], fragments) for k in range(3)], axis=-1)
        return fragments, depths[wins], values


def scan(corners: np.ndarray, shape: tuple[int, int]) -> Fragments:
    """Return the pixels of an image (H, W) whose centres lie in triangles (F, 3, 2) [pixels]; none of NaN ones."""
    height, width = shape
    sense = np.sign(_double_areas(corners))
    faces, rows = _spread(sense**2 * corners[..., 1].min(axis=1), sense**2 * corners[..., 1].max(axis=1), height)
    start, end = corners[faces], np.roll(corners[faces], -1, axis=1)
    # In each row the sides of a triangle, run through in one sense, bound x from below or from above.
    rise = (end[..., 1] - start[..., 1]) * sense[faces, None]
    slope = (end[..., 0] - start[..., 0]) / np.where(rise == 0.0, np.nan, end[..., 1] - start[..., 1])
    crossing = start[..., 0] + (rows[:, None] + 0.5 - start[..., 1]) * slope
    left = np.where(rise < 0.0, crossing, -np.inf).max(axis=1)
    right = np.where(rise > 0.0, crossing, np.inf).min(axis=1)
    spans, columns = _spread(left, right, width)
    return Fragments(faces[spans], rows[spans], columns)


def _spread(low: np.ndarray, high: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells of [0, size) whose centres lie in intervals (n,): interval and cell of each, (k,) int64."""
    low, high = (np.nan_to_num(bound, nan=fallback) for bound, fallback in ((low, 1.0), (high, 0.0)))
    first = np.ceil(np.clip(low, 0.0, size) - 0.5).astype(np.int64).clip(0)
    last = np.floor(np.clip(high, -1.0, size) - 0.5).astype(np.int64).clip(None, size - 1)
    counts = np.maximum(last - first + 1, 0)
    intervals = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts
    return intervals, np.arange(len(intervals)) - (before - first)[intervals]


def _double_areas(corners: np.ndarray) -> np.ndarray:
    """Return twice the signed areas of triangles (F, 3, 2), NaN for those without area."""
    (ax, ay), (bx, by) = (corners[:, corner].T - corners[:, 0].T for corner in (1, 2))
    area = ax * by - ay * bx
    return np.where(np.abs(area) > MIN_DOUBLE_AREA, area, np.nan)


def _planes(corners: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return (F, 3, C): constant, x- and y-slope of the functions with given values (F, 3, C) at the corners."""
    (ax, ay), (bx, by) = (corners[:, corner].T - corners[:, 0].T for corner in (1, 2))
    area = _double_areas(corners)[:, None]
    first, second = values[:, 1] - values[:, 0], values[:, 2] - values[:, 0]
    x_slope = (by[:, None] * first - ay[:, None] * second) / area
    y_slope = (ax[:, None] * second - bx[:, None] * first) / area
    constant = values[:, 0] - corners[:, 0, :1] * x_slope - corners[:, 0, 1:] * y_slope
    return np.stack([constant, x_slope, y_slope], axis=1)


def _evaluate(planes: np.ndarray, fragments: Fragments) -> np.ndarray:
    """Return the value of one function per triangle, (F, 3), at the centres of fragments, (k,) float32."""
    constant, x_slope, y_slope = planes.T
    constant = constant + 0.5 * (x_slope + y_slope)
    faces = fragments.faces
    value = constant[faces] + x_slope[faces] * fragments.columns + y_slope[faces] * fragments.rows
    return value.astype(np.float32)
