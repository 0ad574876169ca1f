"""Layers of equivariant policies, one per file.

Node features are scalars (..., C) and vectors (3, ..., D): channels contiguous, and each component
of the vectors a contiguous block, so that products of components run at full vector width.
"""

from maniskill_grpd.policies.layers.deep_sets_value import DeepSetsValue
from maniskill_grpd.policies.layers.direction_magnitude_decoder import DirectionMagnitudeDecoder
from maniskill_grpd.policies.layers.edges import CompleteEdges, EdgeGeometry, NeighborEdges
from maniskill_grpd.policies.layers.equivariant_update import EquivariantUpdate, vector_norms
from maniskill_grpd.policies.layers.isotropic_std import IsotropicStd
from maniskill_grpd.policies.layers.node_embedding import NodeEmbedding
from maniskill_grpd.policies.layers.radial_basis import RadialBasis
from maniskill_grpd.policies.layers.solid_harmonics import solid_harmonics
from maniskill_grpd.policies.layers.steerable_conv import SteerableConv

__all__ = [
    "CompleteEdges",
    "DeepSetsValue",
    "DirectionMagnitudeDecoder",
    "EdgeGeometry",
    "EquivariantUpdate",
    "IsotropicStd",
    "NeighborEdges",
    "NodeEmbedding",
    "RadialBasis",
    "SteerableConv",
    "solid_harmonics",
    "vector_norms",
]
