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


def rope(curve: np.ndarray, *, num_nodes: int = 41, radius: float = 0.01, material: RopeMaterial | None = None) -> Model:
    """Build a rope along a curve.

    The curve gives the rope's rest positions and length; its natural shape is straight, so that a curved rope wants to unbend.
    End nodes carry half a segment of mass: then the discrete rope stretches under its own weight by exactly
    rho g L^2 / (2 EA) at every resolution. Bending energy 1/2 EI kappa^2 per length with the curvature
    kappa = |x_p - 2 x_m + x_n| / l^2 gives the bend compliance l^3 / EI (segment length l).

    Args:
        curve: Polyline, (P, 2) or (P, 3) [m]; planar curves get z = 0. Resampled by arc length.
        num_nodes: Number of nodes N, >= 3.
        radius: Half the rope's thickness [m], > 0.
        material: Material constants, `RopeMaterial()` by default.

    Raises:
        ValueError: If the curve is not a finite polyline of positive length, or a number is out of its range.
    """
    material = material or RopeMaterial()
    if num_nodes < 3:
        raise ValueError(f"a rope has at least 3 nodes, got num_nodes={num_nodes}")
    if not radius > 0.0:
        raise ValueError(f"the radius of a rope must be > 0 m, got {radius}")
    curve = np.asarray(curve, dtype=np.float64)
    if curve.ndim != 2 or curve.shape[1] not in (2, 3):
        raise ValueError(f"the curve of a rope is an array (P, 2) or (P, 3), got shape {curve.shape}")
    if curve.shape[1] == 2:
        curve = np.column_stack([curve, np.zeros(len(curve))])
    positions = resample_polyline(curve, num_nodes)
    length = polyline_length(curve)
    segment = length / (num_nodes - 1)

    masses = np.full(num_nodes, material.linear_density * segment)
    masses[[0, -1]] *= 0.5
    nodes = np.arange(num_nodes, dtype=np.int32)
    has_bending = material.bend_stiffness > 0.0
    bends = np.stack([nodes[:-2], nodes[1:-1], nodes[2:]], axis=1) if has_bending else np.zeros((0, 3), np.int32)
    bend_compliance = segment**3 / material.bend_stiffness if has_bending else 0.0
    return Model(
        rest_positions=positions.astype(np.float32),
        masses=masses.astype(np.float32),
        radius=float(radius),
        damping=material.damping,
        friction=material.friction,
        edges=np.stack([nodes[:-1], nodes[1:]], axis=1),
        rest_lengths=np.full(num_nodes - 1, segment, dtype=np.float32),
        stretch_compliances=np.full(num_nodes - 1, segment / material.stretch_stiffness, dtype=np.float32),
        bends=bends,
        bend_compliances=np.full(len(bends), bend_compliance, dtype=np.float32),
        arc=np.linspace(0.0, 1.0, num_nodes, dtype=np.float32),
        length=length,
        default_substeps=max(COARSEST_SUBSTEPS, math.ceil(COARSEST_SUBSTEPS * REFERENCE_SEGMENT / segment - 1e-6)),
        node_sets={"ends": np.array([0, num_nodes - 1])},
    )
