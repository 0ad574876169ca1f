"""Batched XPBD rope physics in NVIDIA Warp.

World-local coordinates, SI units, float32, right-handed with gravity as a per-world vector. `B` worlds, `N` nodes,
`A` grippers. Knows numpy, torch and Warp; knows nothing of gymnasium or ManiSkill.
"""

from maniskill_grpd.physics.curves import resample_polyline
from maniskill_grpd.physics.model import Model
from maniskill_grpd.physics.rope import RopeMaterial, rope
from maniskill_grpd.physics.solver import Solver

__all__ = ["Model", "RopeMaterial", "Solver", "resample_polyline", "rope"]
