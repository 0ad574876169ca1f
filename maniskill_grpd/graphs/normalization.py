"""Scaling of graph channels that commutes with rotations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import nn

from maniskill_grpd.graphs.schema import NODE_TYPES, GraphSchema

STANDARD_GRAVITY = 9.81
"""Unit of the gravity channel [m/s^2]."""

_SMALLEST_RMS = 1e-6
"""A channel whose root mean square is below this carries no signal and is left unscaled."""


class GraphNormalizer(nn.Module):
    """Divides each channel by one number: its root mean square over all data seen so far.

    For a vector channel v the number is sqrt(E[|v|^2] / 3), the RMS of one component under random
    rotation; for a scalar channel sqrt(E[s^2]). No mean is subtracted from anything and no axis has
    a scale of its own: either would break SO(3) equivariance. Outliers are shortened: vectors to
    the norm `clip` (direction kept), scalars to [-clip, clip].

    Positions are returned as they are (they enter policies only as differences); gravity in units
    of 9.81 m/s^2. Until the first `update` channels are not scaled. Whatever stands in padding,
    even NaN, is replaced by zeros.

    Args:
        schema: What the graphs hold.
        clip: Largest norm of a normalised vector, and absolute value of a normalised scalar.
    """

    def __init__(self, schema: GraphSchema, clip: float = 10.0) -> None:
        super().__init__()
        self.clip = clip
        for node_type in NODE_TYPES:
            node = schema.node(node_type)
            self.register_buffer(f"{node_type}_count", torch.zeros((), dtype=torch.int64))
            for kind, width in (("vectors", node.num_vectors), ("scalars", node.num_scalars)):
                self.register_buffer(f"{node_type}_{kind}_mean_square", torch.zeros(width))

    @torch.no_grad()
    def update(self, graph: Mapping[str, Any]) -> None:
        """Add all unmasked nodes of a raw graph to the statistics.

        Args:
            graph: A graph with any leading batch size.
        """
        for node_type in NODE_TYPES:
            nodes = graph[node_type]
            weight = nodes["mask"].to(nodes["position"].dtype)
            seen = nodes["mask"].sum()
            count = getattr(self, f"{node_type}_count")
            count += seen
            # A batch without nodes has fraction 0 and therefore changes nothing.
            fraction = seen.to(weight.dtype) / count.clamp(min=1).to(weight.dtype)
            squares = {"vectors": nodes["vectors"].square().sum(-1) / 3.0, "scalars": nodes["scalars"].square()}
            for kind, square in squares.items():
                # Padding may hold anything, even NaN; a product with zero would let it through.
                square = torch.where(nodes["mask"][..., None], square, torch.zeros_like(square))
                mean = square.sum(dim=(0, 1)) / seen.clamp(min=1)
                running = getattr(self, f"{node_type}_{kind}_mean_square")
                running.add_((mean - running) * fraction)

    def root_mean_square(self, node_type: str, kind: str) -> torch.Tensor:
        """Scale of each channel, in the unit of the channel.

        Args:
            node_type: "object" or "actuator".
            kind: "vectors" or "scalars".

        Returns:
            (V,) or (S,); one where nothing has been seen.
        """
        rms = getattr(self, f"{node_type}_{kind}_mean_square").sqrt()
        return torch.where(rms > _SMALLEST_RMS, rms, torch.ones_like(rms))

    def forward(self, graph: Mapping[str, Any]) -> dict[str, Any]:
        """Scale a raw graph.

        Args:
            graph: A raw graph; not changed.

        Returns:
            A graph of the same shapes. Vectors, scalars and gravity are dimensionless.
        """
        scaled: dict[str, Any] = {"gravity": graph["gravity"] / STANDARD_GRAVITY}
        for node_type in NODE_TYPES:
            nodes = graph[node_type]
            mask = nodes["mask"][..., None]
            vectors = nodes["vectors"] / self.root_mean_square(node_type, "vectors")[:, None]
            scalars = nodes["scalars"] / self.root_mean_square(node_type, "scalars")
            norm = vectors.square().sum(-1, keepdim=True).clamp(min=self.clip**2).sqrt()
            vectors = vectors * (self.clip / norm)
            scalars = scalars.clamp(-self.clip, self.clip)
            scaled[node_type] = {
                **nodes,
                "position": nodes["position"].masked_fill(~mask, 0.0),
                "vectors": vectors.masked_fill(~mask[..., None], 0.0),
                "scalars": scalars.masked_fill(~mask, 0.0),
            }
        if "critic" in graph:
            scaled["critic"] = self(graph["critic"])
        return scaled
