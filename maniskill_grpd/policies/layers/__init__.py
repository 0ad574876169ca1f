"""Layers of policies, one per file.

Node features of equivariant layers are scalars (..., C) and vectors (3, ..., D): channels
contiguous, and each component of the vectors a contiguous block, so that products of components run
at full vector width.
"""

from maniskill_grpd.policies.layers.attention_block import AttentionBlock
from maniskill_grpd.policies.layers.channel_first_linear import ChannelFirstLinear
from maniskill_grpd.policies.layers.deep_sets_value import DeepSetsValue
from maniskill_grpd.policies.layers.direction_magnitude_decoder import DirectionMagnitudeDecoder
from maniskill_grpd.policies.layers.edges import CompleteEdges, EdgeGeometry, NeighborEdges, edges_from_tensors, edges_to_tensors
from maniskill_grpd.policies.layers.equivariant_update import EquivariantUpdate, vector_norms
from maniskill_grpd.policies.layers.gripper_head import GripperHead
from maniskill_grpd.policies.layers.invariant_std import InvariantStd
from maniskill_grpd.policies.layers.local_neighborhood import LocalNeighborhood
from maniskill_grpd.policies.layers.merged_nodes import MergedNodes
from maniskill_grpd.policies.layers.mlp_messages import MLPMessages
from maniskill_grpd.policies.layers.naive_decoder import NaiveDecoder
from maniskill_grpd.policies.layers.node_embedding import NodeEmbedding
from maniskill_grpd.policies.layers.orientation_grid import orientation_grid
from maniskill_grpd.policies.layers.orientation_round import OrientationRound
from maniskill_grpd.policies.layers.per_actuator import PerActuator
from maniskill_grpd.policies.layers.radial_basis import RadialBasis
from maniskill_grpd.policies.layers.raw_decoder import RawDecoder
from maniskill_grpd.policies.layers.raw_embedding import RawEmbedding
from maniskill_grpd.policies.layers.raw_node_embedding import RawNodeEmbedding
from maniskill_grpd.policies.layers.receiver_gate import ReceiverGate
from maniskill_grpd.policies.layers.solid_harmonics import solid_harmonics
from maniskill_grpd.policies.layers.steerable_conv import SteerableConv
from maniskill_grpd.policies.layers.vector_norm import VectorNorm

__all__ = [
    "AttentionBlock",
    "ChannelFirstLinear",
    "CompleteEdges",
    "DeepSetsValue",
    "DirectionMagnitudeDecoder",
    "EdgeGeometry",
    "EquivariantUpdate",
    "GripperHead",
    "InvariantStd",
    "LocalNeighborhood",
    "MLPMessages",
    "MergedNodes",
    "NaiveDecoder",
    "NeighborEdges",
    "NodeEmbedding",
    "OrientationRound",
    "PerActuator",
    "RadialBasis",
    "RawDecoder",
    "RawEmbedding",
    "RawNodeEmbedding",
    "ReceiverGate",
    "SteerableConv",
    "VectorNorm",
    "edges_from_tensors",
    "edges_to_tensors",
    "orientation_grid",
    "solid_harmonics",
    "vector_norms",
]
