"""Ropes: an inextensible-to-elastic line with bending stiffness, built from any curve."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from maniskill_grpd.physics.mesh.curves import polyline_length, resample_polyline
from maniskill_grpd.physics.model import Model

COARSEST_SUBSTEPS = 20
"""Substeps of a control step for segments of `REFERENCE_SEGMENT` and longer."""
REFERENCE_SEGMENT = 0.02
"""Segment length l [m] below which substeps grow in proportion: bending acts softer by 3 EI dt^2 / (rho l^4)."""

SHORTEST_SEGMENT = 0.05
"""Shortest segment of a rope relative to its longest. Shorter ones need more substeps in proportion."""


@dataclass(frozen=True, kw_only=True)
class RopeMaterial:
    """Material of a rope in SI units. The defaults are those of a soft cotton rope of about 1 cm."""

    linear_density: float = 0.05
    """Mass per length [kg/m], > 0."""
    stretch_stiffness: float = 500.0
    """Axial stiffness EA [N], > 0: force per relative elongation."""
    bend_stiffness: float = 1e-5
    """Bending stiffness EI [N m^2], >= 0; 0 is a chain."""
    damping: float = 1.0
    """Decay rate of velocities in air [1/s], >= 0."""
    friction: float = 0.5
    """Coefficient of Coulomb friction against the table, >= 0."""

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            positive = entry.name in ("linear_density", "stretch_stiffness")
            if not np.isfinite(value) or value < 0.0 or (positive and value == 0.0):
                bound = "> 0" if positive else ">= 0"
                raise ValueError(f"RopeMaterial.{entry.name} must be finite and {bound}, got {value}")


def rope(curve: np.ndarray, *, num_nodes: int | None = 41, radius: float = 0.01, material: RopeMaterial | None = None) -> Model:
    """Build a rope along a curve.

    The curve gives the rope's rest positions and length; its natural shape is straight, so that a curved rope wants to unbend.
    Nodes carry half of each segment beside them: then the discrete rope stretches under its own weight by exactly
    rho g L^2 / (2 EA) at every resolution. Bending energy 1/2 EI kappa^2 per length with the curvature
    kappa = |x_p - 2 x_m + x_n| / l^2 gives the bend compliance l^3 / EI (segment length l). Where segments a and b differ,
    kappa = |(x_p - x_m) / a + (x_n - x_m) / b| / l with l = (a + b) / 2, over the length l.

    Args:
        curve: Polyline, (P, 2) or (P, 3) [m]; planar curves get z = 0.
        num_nodes: Number of nodes N, >= 3, at equal distances along the curve; None puts a node at each point of the curve, so
            that segments may have different lengths.
        radius: Half the rope's thickness [m], > 0.
        material: Material constants, `RopeMaterial()` by default.

    Raises:
        ValueError: If the curve is not a finite polyline of positive length, or a number is out of its range.
    """
    material = material or RopeMaterial()
    if num_nodes is not None and num_nodes < 3:
        raise ValueError(f"a rope has at least 3 nodes, got num_nodes={num_nodes}")
    if not radius > 0.0:
        raise ValueError(f"the radius of a rope must be > 0 m, got {radius}")
    curve = np.asarray(curve, dtype=np.float64)
    if curve.ndim != 2 or curve.shape[1] not in (2, 3):
        raise ValueError(f"the curve of a rope is an array (P, 2) or (P, 3), got shape {curve.shape}")
    if curve.shape[1] == 2:
        curve = np.column_stack([curve, np.zeros(len(curve))])
    length = polyline_length(curve)
    if num_nodes is None:
        positions, segments = curve, _segments(curve)
    else:
        positions = resample_polyline(curve, num_nodes)
        segments = np.full(num_nodes - 1, length / (num_nodes - 1))
    beside = np.concatenate([[0.0], segments, [0.0]])
    nodes = np.arange(len(positions), dtype=np.int32)
    arc = np.linspace(0.0, 1.0, num_nodes) if num_nodes else np.concatenate([[0.0], np.cumsum(segments)]) / segments.sum()
    return Model(
        rest_positions=positions.astype(np.float32),
        masses=(material.linear_density * 0.5 * (beside[:-1] + beside[1:])).astype(np.float32),
        radius=float(radius),
        damping=material.damping,
        friction=material.friction,
        edges=np.stack([nodes[:-1], nodes[1:]], axis=1),
        rest_lengths=segments.astype(np.float32),
        stretch_compliances=(segments / material.stretch_stiffness).astype(np.float32),
        arc=arc.astype(np.float32),
        length=length,
        default_substeps=max(COARSEST_SUBSTEPS, math.ceil(COARSEST_SUBSTEPS * REFERENCE_SEGMENT / segments.min() - 1e-6)),
        node_sets={"ends": np.array([0, len(nodes) - 1])},
        **_bending(segments, material.bend_stiffness),
    )


def _segments(curve: np.ndarray) -> np.ndarray:
    """Return the lengths of the segments between the points of a curve (P, 3), (P - 1,) [m]."""
    if len(curve) < 3:
        raise ValueError(f"a rope has at least 3 nodes, got a curve of {len(curve)} points")
    if not np.isfinite(curve).all():
        raise ValueError("the curve of a rope must be finite, got NaN or infinity")
    segments = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    short = np.flatnonzero(~(segments > SHORTEST_SEGMENT * segments.max()))
    if len(short):
        raise ValueError(
            f"segments of a rope must be longer than {SHORTEST_SEGMENT} of the longest, {segments.max():.3g} m; the one between "
            f"points {short[0]} and {short[0] + 1} is {segments[short[0]]:.3g} m"
        )
    return segments


def _bending(segments: np.ndarray, stiffness: float) -> dict[str, np.ndarray]:
    """Return the constraints on the curvature at inner nodes: triples on equal segments (S,) [m], weighted hinges on others."""
    nodes = np.arange(len(segments) + 1, dtype=np.int32)
    triples = np.stack([nodes[:-2], nodes[1:-1], nodes[2:]], axis=1)
    first, second = segments[:-1], segments[1:]
    mean = 0.5 * (first + second)
    if stiffness == 0.0:
        return {"bends": triples[:0], "bend_compliances": np.zeros(0, np.float32)}
    compliances = (mean**3 / stiffness).astype(np.float32)
    if (first == second).all():
        return {"bends": triples, "bend_compliances": compliances}
    none = np.zeros_like(mean)
    return {
        "bends": triples[:0],
        "bend_compliances": compliances[:0],
        "hinges": triples[:, [0, 1, 2, 0]],
        "hinge_weights": np.column_stack([mean / first, -mean / first - mean / second, mean / second, none]).astype(np.float32),
        "hinge_compliances": compliances,
    }
