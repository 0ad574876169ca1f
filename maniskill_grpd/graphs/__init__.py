"""The observation graph: what its channels mean, and how they are scaled."""

from maniskill_grpd.graphs.normalization import GraphNormalizer
from maniskill_grpd.graphs.schema import Channel, GraphSchema, NodeSchema

__all__ = ["Channel", "GraphNormalizer", "GraphSchema", "NodeSchema"]
