"""The observation graph: what its channels mean, how they are scaled, and how it comes from points and is exported."""

from maniskill_grpd.graphs.export import from_hetero_data, to_hetero_data, to_networkx
from maniskill_grpd.graphs.normalization import GraphNormalizer
from maniskill_grpd.graphs.points import point_schema, points_to_graph
from maniskill_grpd.graphs.schema import Channel, GraphSchema, NodeSchema

__all__ = [
    "Channel",
    "GraphNormalizer",
    "GraphSchema",
    "NodeSchema",
    "from_hetero_data",
    "point_schema",
    "points_to_graph",
    "to_hetero_data",
    "to_networkx",
]
