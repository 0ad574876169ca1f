"""Where messages flow, and the geometric weights they carry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import nn

from maniskill_grpd.policies.layers.radial_basis import RadialBasis
from maniskill_grpd.policies.layers.solid_harmonics import solid_harmonics

_SMALLEST_SHARE = 0.05
"""Share of all senders below which a radial function is no longer averaged but fades out."""
_MATRIX_LIMIT = 12
"""Senders per listed neighbour up to which a matrix product with mostly zeros beats lists; measured
on a CPU, where they were equal between 11 (wide layers) and 20 (narrow ones)."""


@dataclass(frozen=True, eq=False)
class CompleteEdges:
    """Edges from every sender to every receiver.

    Attributes:
        weights: Kernel factors w[m, b], (B, M, R * Q, S): M harmonics, R receivers, Q radial
            functions, S senders; normalised over senders, zero on masked ones.
        num_radial: Q.
    """

    weights: torch.Tensor
    num_radial: int

    def moments(self, features: torch.Tensor, min_degree: int, max_degree: int) -> tuple[torch.Tensor, ...]:
        """Sum the features of the senders, weighted by the kernel factors, as one matrix product.

        Args:
            features: Sender features, (B, S, F).
            min_degree: Smallest degree of the harmonics used.
            max_degree: Largest degree of the harmonics used.

        Returns:
            One tensor (B, R, Q * F) per harmonic of these degrees.
        """
        batch, _, width = features.shape
        weights = self.weights[:, min_degree**2 : (max_degree + 1) ** 2]
        count, rows = weights.shape[1:3]
        moments = torch.bmm(weights.flatten(1, 2), features)
        receivers = rows // self.num_radial
        return moments.view(batch, count, receivers, self.num_radial * width).unbind(1)


@dataclass(frozen=True, eq=False)
class NeighborEdges:
    """Edges from a short list of neighbours to each of R receivers.

    Attributes:
        senders: Row of the sender in its graph, int64 (B, K, R); zero on padding.
        weights: Kernel factors, (B, M, K, Q, R); zero on padding.
    """

    senders: torch.Tensor
    weights: torch.Tensor

    def rows(self) -> torch.Tensor:
        """Kernel factors as columns over the receivers of all graphs, (M, K, Q, B * R, 1)."""
        return self.weights.permute(1, 2, 3, 0, 4).flatten(3).unsqueeze(-1)

    def gather(self, features: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Features of the neighbours.

        Args:
            features: (L, B, N, F).

        Returns:
            L * K tensors (B * R, F); the neighbours of one leading index follow each other.
        """
        leading, batch, count, width = features.shape
        first = torch.arange(leading * batch, device=features.device).view(leading, 1, batch, 1) * count
        # One gather along the first axis, whose backward pass is one scatter of whole rows.
        index = self.senders.transpose(0, 1) + first  # (L, K, B, R)
        gathered = features.reshape(-1, width).index_select(0, index.reshape(-1))
        return gathered.view(-1, index.shape[2] * index.shape[3], width).unbind(0)


def edges_to_tensors(edges: CompleteEdges | NeighborEdges) -> dict[str, torch.Tensor]:
    """Return what edges hold as tensors whose first axis is that of the graphs."""
    if isinstance(edges, CompleteEdges):
        return {"weights": edges.weights}
    return {"weights": edges.weights, "senders": edges.senders}


def edges_from_tensors(tensors: Mapping[str, torch.Tensor], num_radial: int) -> CompleteEdges | NeighborEdges:
    """Rebuild the edges of which `edges_to_tensors` made tensors, or of some of their graphs.

    Args:
        tensors: What it returned.
        num_radial: Radial functions Q.
    """
    if "senders" in tensors:
        return NeighborEdges(tensors["senders"], tensors["weights"])
    return CompleteEdges(tensors["weights"], num_radial)


class EdgeGeometry(nn.Module):
    r"""Kernel factors of the edges (eq. 29, 30).

        w[m, b] = phi_b(|p|) Y_m(p / sqrt(|p|^2 + s^2)) / (sum_senders phi_b + 0.05 n)

    with p the position of the sender relative to the receiver, s a softening length and n the
    number of senders. The softened direction is smooth where sender and receiver coincide, which is
    where a gripper holds a node. The denominator makes each moment a local average, the same for a
    coarse and a fine mesh.

    Nothing here is learned; without gradients on positions no graph is recorded.

    Symmetry: translations leave p alone; under a rotation w[m, :] turns like the harmonics.

    Args:
        num_radial: Number Q of radial functions.
        max_degree: Largest degree of the harmonics, 0 to 2.
        cutoff: Unit of distance of the radial functions [m].
        softening: Softening length s [m].
    """

    def __init__(self, num_radial: int, max_degree: int, cutoff: float, softening: float) -> None:
        super().__init__()
        self.basis = RadialBasis(num_radial, cutoff)
        self.max_degree = max_degree
        self.softening = softening

    def complete(
        self,
        senders: torch.Tensor,
        sender_mask: torch.Tensor,
        receivers: torch.Tensor,
        *,
        exclude_self: bool = False,
        envelope: torch.Tensor | None = None,
    ) -> CompleteEdges:
        """Connect every receiver with every sender.

        Args:
            senders: Positions (3, B, S) [m].
            sender_mask: (B, S) bool; masked senders send nothing.
            receivers: Positions (3, B, R) [m].
            exclude_self: Senders are the receivers, and none sends to itself.
            envelope: Invariant factor of each edge, (B, R, S); by default one.
        """
        offsets = senders[:, :, None] - receivers[:, :, :, None]
        mask = sender_mask[:, None].to(offsets.dtype)
        if exclude_self:
            mask = mask * (1.0 - torch.eye(mask.shape[-1], dtype=mask.dtype, device=mask.device))
        if envelope is not None:
            mask = mask * envelope
        radial, harmonics = self._factors(offsets)
        radial = torch.stack(radial, dim=2) * mask[:, :, None]  # (B, R, Q, S)
        count = mask.sum(-1, keepdim=True).clamp(min=1.0)[:, :, None]
        radial = radial / (radial.sum(-1, keepdim=True) + _SMALLEST_SHARE * count)
        weights = torch.stack(harmonics, dim=1)[:, :, :, None] * radial[:, None]
        return CompleteEdges(weights.flatten(2, 3), self.basis.num_basis)

    def neighbors(
        self,
        position: torch.Tensor,
        mask: torch.Tensor,
        neighbors: torch.Tensor,
        *,
        receivers: torch.Tensor | None = None,
        envelope: torch.Tensor | None = None,
    ) -> CompleteEdges | NeighborEdges:
        """Connect every receiver with its listed neighbours, in the form that is faster.

        Args:
            position: Positions of the senders, (3, B, N) [m].
            mask: (B, N) bool; masked nodes send nothing.
            neighbors: Senders by receiver, (B, R, K) int64, -1 where there is none.
            receivers: Positions of the receivers, (3, B, R) [m]; by default the senders.
            envelope: Invariant factor of each edge, (B, R, K); by default one.
        """
        is_small = position.shape[2] <= _MATRIX_LIMIT * neighbors.shape[2]
        connect = self.neighbor_matrix if is_small else self.neighbor_lists
        return connect(position, mask, neighbors, receivers=receivers, envelope=envelope)

    def neighbor_matrix(
        self,
        position: torch.Tensor,
        mask: torch.Tensor,
        neighbors: torch.Tensor,
        *,
        receivers: torch.Tensor | None = None,
        envelope: torch.Tensor | None = None,
    ) -> CompleteEdges:
        """As `neighbors`, always as complete edges of which most weigh nothing."""
        valid = (neighbors >= 0).to(position.dtype)
        if envelope is not None:
            valid = valid * envelope
        matrix = valid.new_zeros(*neighbors.shape[:2], position.shape[2])
        matrix = matrix.scatter_add(2, neighbors.clamp(min=0), valid)
        return self.complete(position, mask, position if receivers is None else receivers, envelope=matrix)

    def neighbor_lists(
        self,
        position: torch.Tensor,
        mask: torch.Tensor,
        neighbors: torch.Tensor,
        *,
        receivers: torch.Tensor | None = None,
        envelope: torch.Tensor | None = None,
    ) -> NeighborEdges:
        """As `neighbors`, always as lists."""
        batch, count, _ = neighbors.shape
        neighbors = neighbors.permute(2, 0, 1)
        senders = neighbors.clamp(min=0)
        first = torch.arange(batch, device=neighbors.device)[:, None] * position.shape[2]
        index = (senders + first).reshape(-1, batch * count)
        rows = position.reshape(3, -1)
        own = rows if receivers is None else receivers.reshape(3, -1)
        offsets = rows[:, index] - own[:, None]  # (3, K, B R)
        valid = (mask.reshape(-1)[index] & (neighbors >= 0).reshape(index.shape)).to(rows.dtype)
        if envelope is not None:
            valid = valid * envelope.permute(2, 0, 1).reshape(index.shape)
        radial, harmonics = self._factors(offsets)
        radial = torch.stack(radial, dim=1) * valid[:, None]  # (K, Q, B R)
        share = radial.sum(0) + _SMALLEST_SHARE * valid.sum(0).clamp(min=1.0)
        weights = torch.stack(harmonics)[:, :, None] * (radial / share)
        # The order in memory stays that of `rows`.
        return NeighborEdges(senders.transpose(0, 1), weights.unflatten(-1, (batch, count)).permute(3, 0, 1, 2, 4))

    def _factors(self, offsets: torch.Tensor) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        """Radial functions and harmonics of offsets (3, ...), each entry (...)."""
        x, y, z = offsets.unbind(0)
        soft = (x * x + y * y + z * z + self.softening**2).sqrt()
        harmonics = solid_harmonics(x / soft, y / soft, z / soft, self.max_degree)
        return self.basis(soft - self.softening), harmonics
