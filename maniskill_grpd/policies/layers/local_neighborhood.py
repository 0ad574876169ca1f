"""Neighbour lists of a homogeneous graph."""

from __future__ import annotations

from dataclasses import dataclass

import torch

_TINY = 1e-12
"""Smallest squared distance that is divided by [m^2]."""
_FAR = 1e24
"""Squared distance that stands for "nowhere" [m^2]; unlike infinity it can be divided by itself."""


@dataclass(frozen=True, eq=False)
class LocalNeighborhood:
    r"""Edges of objects and actuators in one list of nodes, objects first.

    An actuator hears its k nearest object nodes and the other actuators; an object node hears its
    mesh neighbours and, if it is among the k nearest of its nearest actuator, that actuator. Edges
    found by distance fade out before they end,

        e(a, u) = (1 - d_au^2 / d_k+1^2)_+^2,   times (1 - d_au^2 / d_bu^2)^2 at the object node

    with d_k+1 the distance of the actuator's (k+1)-th nearest node and b the second nearest
    actuator of node u. Without the envelope a tie in distance, the normal case along a straight
    rope, would be broken by rounding, differently in every orientation of the scene.

    Symmetry: lists and envelopes are invariant under rotations and translations.

    Attributes:
        objects: Senders of each object node, (B, N, K + 1) int64, -1 where there is none.
        object_envelope: (B, N, K + 1).
        actuators: Senders of each actuator, (B, A, k + A).
        actuator_envelope: (B, A, k + A).
    """

    objects: torch.Tensor
    object_envelope: torch.Tensor
    actuators: torch.Tensor
    actuator_envelope: torch.Tensor

    @classmethod
    def find(cls, position: torch.Tensor, mask: torch.Tensor, neighbors: torch.Tensor, num_nearest: int) -> LocalNeighborhood:
        """Find all edges.

        Args:
            position: Positions of N object nodes, then A actuators, (B, N + A, 3) [m].
            mask: (B, N + A) bool.
            neighbors: Mesh neighbours, (B, N, K) int64, -1 padded.
            num_nearest: k.
        """
        count = neighbors.shape[1]
        points, tools = position[:, None, :count], position[:, count:, None]
        squared = (points - tools).square().sum(-1)  # (B, A, N)
        nearest, reach = _nearest(squared, mask[:, None, :count], num_nearest)
        near = _envelope(squared, reach)
        num_tools = tools.shape[1]
        others = count + torch.arange(num_tools, device=position.device).repeat(num_tools, 1)
        others = others.masked_fill(torch.eye(num_tools, device=others.device) > 0, -1)
        others = others.expand(position.shape[0], -1, -1)
        best, lead = _leader(squared, mask[:, count:, None])
        own = (near.gather(1, best) * lead).transpose(1, 2)
        return cls(
            objects=torch.cat([neighbors, count + best.transpose(1, 2)], dim=-1),
            object_envelope=torch.cat([torch.ones_like(neighbors, dtype=own.dtype), own], dim=-1),
            actuators=torch.cat([nearest, others], dim=-1),
            actuator_envelope=torch.cat([near.gather(2, nearest), torch.ones_like(others, dtype=near.dtype)], dim=-1),
        )


def _nearest(squared: torch.Tensor, mask: torch.Tensor, num: int) -> tuple[torch.Tensor, torch.Tensor]:
    """The num nearest nodes of each actuator, (B, A, num), and its squared reach, (B, A, 1)."""
    visible = squared.masked_fill(~mask, _FAR)
    if squared.shape[-1] <= num:
        everything = torch.arange(squared.shape[-1], device=squared.device)
        reach = torch.full_like(squared[..., :1], _FAR)
        return everything.expand(squared.shape), reach
    distances, index = visible.topk(num + 1, dim=-1, largest=False)
    return index[..., :num], distances[..., num:]


def _leader(squared: torch.Tensor, mask: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Nearest actuator of each node and by how much it leads over the next, both (B, 1, N)."""
    visible = squared.masked_fill(~mask, _FAR)
    best = visible.argmin(dim=1, keepdim=True)
    second = visible.scatter(1, best, _FAR).amin(dim=1, keepdim=True)
    return best, _envelope(squared.gather(1, best), second)


def _envelope(squared: torch.Tensor, end: torch.Tensor) -> torch.Tensor:
    """(1 - squared / end)_+^2, zero where both are."""
    return ((end - squared) / end.clamp(min=_TINY)).clamp(min=0.0).square()
