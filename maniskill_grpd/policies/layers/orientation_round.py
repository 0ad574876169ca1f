"""Messages between functions on a grid of directions."""

from __future__ import annotations

import torch
from torch import nn

_TINY = 1e-12
"""Under the root of squared lengths; their gradient is infinite at zero."""


class OrientationRound(nn.Module):
    r"""Convolution over positions, then over directions, then the update of the receivers (after Bekkers et al. 2024).

        m_r(o)  = mean_s k(p_rs . o, |p_rs - (p_rs . o) o|) * W f_s(o)
        m'_r(o) = mean_o' q(o . o') * m_r(o')
        f'_r(o) = f_r(o) + W_2 gelu(W_1 LayerNorm(m'_r(o) + W_r f_r(o)))

    Kernels k and q are networks of invariants, one number per channel. A rotation of the scene rotates functions of the direction
    o; on a grid that holds for rotations that map the grid onto itself, and else to the accuracy of the grid.

    Shapes: senders (B, S, O, C), receivers (B, R, O, C') -> (B, R, O, C').

    Args:
        sender_dim: C.
        receiver_dim: C'.
        kernel_dim: Width of the kernels.
        scale: Unit of relative positions [m].
        directions: The grid, (O, 3).
    """

    def __init__(self, sender_dim: int, receiver_dim: int, kernel_dim: int, scale: float, directions: torch.Tensor) -> None:
        super().__init__()
        self.scale = scale
        self.register_buffer("directions", directions, persistent=False)
        self.send = nn.Linear(sender_dim, receiver_dim, bias=False)
        self.receive = nn.Linear(receiver_dim, receiver_dim)
        self.spatial = nn.Sequential(nn.Linear(5, kernel_dim), nn.GELU(), nn.Linear(kernel_dim, receiver_dim))
        self.spherical = nn.Sequential(nn.Linear(2, kernel_dim), nn.GELU(), nn.Linear(kernel_dim, receiver_dim))
        self.norm = nn.LayerNorm(receiver_dim)
        self.update = nn.Sequential(
            nn.Linear(receiver_dim, 2 * receiver_dim), nn.GELU(), nn.Linear(2 * receiver_dim, receiver_dim)
        )

    def complete(
        self,
        senders: torch.Tensor,
        receivers: torch.Tensor,
        sender_positions: torch.Tensor,
        receiver_positions: torch.Tensor,
        sender_mask: torch.Tensor,
        *,
        exclude_self: bool = False,
    ) -> torch.Tensor:
        """Send from every sender to every receiver; return the new features of the receivers.

        Args:
            senders: Features, (B, S, O, C).
            receivers: Features, (B, R, O, C').
            sender_positions: (B, S, 3) [m].
            receiver_positions: (B, R, 3) [m].
            sender_mask: (B, S) bool; masked senders send nothing.
            exclude_self: Senders are the receivers, and none sends to itself.
        """
        offsets = sender_positions[:, None] - receiver_positions[:, :, None]
        share = sender_mask[:, None].to(offsets.dtype).expand(offsets.shape[:3])
        if exclude_self:
            share = share * (1.0 - torch.eye(share.shape[-1], dtype=share.dtype, device=share.device))
        return self._update(receivers, torch.einsum("brsoc,bsoc->broc", self._kernel(offsets, share), self.send(senders)))

    def neighbors(
        self, features: torch.Tensor, positions: torch.Tensor, mask: torch.Tensor, neighbors: torch.Tensor
    ) -> torch.Tensor:
        """Send from listed neighbours to every node; return the new features.

        Args:
            features: (B, N, O, C), senders and receivers alike.
            positions: (B, N, 3) [m].
            mask: (B, N) bool; masked nodes send nothing.
            neighbors: (B, N, K) int64, -1 where there is none.
        """
        batch, count, columns = neighbors.shape
        first = torch.arange(batch, device=neighbors.device)[:, None, None] * count
        index = (neighbors.clamp(min=0) + first).reshape(-1)

        def gather(rows: torch.Tensor) -> torch.Tensor:
            return rows.flatten(0, 1).index_select(0, index).view(batch, count, columns, *rows.shape[2:])

        offsets = gather(positions) - positions[:, :, None]
        share = (gather(mask) & (neighbors >= 0)).to(offsets.dtype)
        return self._update(features, (self._kernel(offsets, share) * gather(self.send(features))).sum(2))

    def _kernel(self, offsets: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
        """Kernel of each edge and direction, (B, R, S, O, C'), divided by the number of senders."""
        scaled = offsets / self.scale
        along = scaled @ self.directions.t()
        across = (scaled.square().sum(-1, keepdim=True) - along.square()).clamp(min=0.0).add(_TINY).sqrt()
        invariants = torch.stack([along, across, along.square(), across.square(), along * across], dim=-1)
        share = share / share.sum(-1, keepdim=True).clamp(min=1.0)
        return self.spatial(invariants) * share[..., None, None]

    def _update(self, receivers: torch.Tensor, messages: torch.Tensor) -> torch.Tensor:
        cosine = self.directions @ self.directions.t()
        kernel = self.spherical(torch.stack([cosine, cosine.square()], dim=-1)) / len(cosine)
        mixed = torch.einsum("opc,brpc->broc", kernel, messages)
        return receivers + self.update(self.norm(mixed + self.receive(receivers)))
