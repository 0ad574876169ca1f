"""Messages from a network of raw relative positions."""

from __future__ import annotations

import torch
from torch import nn


class MLPMessages(nn.Module):
    r"""Messages by an MLP per edge (eq. 2, 24, 25), averaged over senders.

        m_r = W_o mean_s silu(W_s h_s + W_r h_r + W_e (p_rs, |p_rs|) / scale + b)

    The first map of the MLP is split so that its node parts run per node; the last one commutes
    with the mean and runs per receiver. The nonlinearity remains per edge and channel.

    Shapes: senders (B, S, C_s), receivers (B, R, C_r) -> (B, R, O).
    Symmetry: under translations only, if features respect them; not under rotations.
        Invariant to the order of senders.

    Args:
        sender_dim: C_s.
        receiver_dim: C_r.
        hidden_dim: Width of the MLP.
        out_dim: O.
        scale: Unit of relative positions [m].
    """

    def __init__(self, sender_dim: int, receiver_dim: int, hidden_dim: int, out_dim: int, scale: float) -> None:
        super().__init__()
        self.scale = scale
        self.sender = nn.Linear(sender_dim, hidden_dim, bias=False)
        self.receiver = nn.Linear(receiver_dim, hidden_dim)
        self.offset = nn.Linear(4, hidden_dim, bias=False)
        self.output = nn.Linear(hidden_dim, out_dim)

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
        """Send from every sender to every receiver.

        Args:
            senders: Features, (B, S, C_s).
            receivers: Features, (B, R, C_r).
            sender_positions: (B, S, 3) [m].
            receiver_positions: (B, R, 3) [m].
            sender_mask: (B, S) bool; masked senders send nothing.
            exclude_self: Senders are the receivers, and none sends to itself.

        Returns:
            (B, R, O).
        """
        offsets = sender_positions[:, None] - receiver_positions[:, :, None]
        weight = sender_mask[:, None].to(offsets.dtype).expand(offsets.shape[:3])
        if exclude_self:
            eye = torch.eye(weight.shape[-1], dtype=weight.dtype, device=weight.device)
            weight = weight * (1.0 - eye)
        return self._pool(self.sender(senders)[:, None], receivers, offsets, weight)

    def neighbors(
        self, features: torch.Tensor, positions: torch.Tensor, mask: torch.Tensor, neighbors: torch.Tensor
    ) -> torch.Tensor:
        """Send from listed neighbours to every node.

        Args:
            features: (B, N, C), senders and receivers alike.
            positions: (B, N, 3) [m].
            mask: (B, N) bool; masked nodes send nothing.
            neighbors: (B, N, K) int64, -1 where there is none.

        Returns:
            (B, N, O).
        """
        batch, count, columns = neighbors.shape
        first = torch.arange(batch, device=neighbors.device)[:, None, None] * count
        index = (neighbors.clamp(min=0) + first).reshape(-1)

        def gather(rows: torch.Tensor) -> torch.Tensor:
            flat = rows.flatten(0, 1).index_select(0, index)
            return flat.view(batch, count, columns, *rows.shape[2:])

        offsets = gather(positions) - positions[:, :, None]
        weight = (gather(mask) & (neighbors >= 0)).to(offsets.dtype)
        return self._pool(gather(self.sender(features)), features, offsets, weight)

    def _pool(self, sent: torch.Tensor, receivers: torch.Tensor, offsets: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        """Average over the third axis: sent (B, R or 1, S, H), offsets (B, R, S, 3)."""
        scaled = offsets / self.scale
        # Under the root 1e-12: the gradient of a length is infinite at zero.
        length = (scaled.square().sum(-1, keepdim=True) + 1e-12).sqrt()
        edge = self.offset(torch.cat([scaled, length], dim=-1))
        hidden = nn.functional.silu(sent + self.receiver(receivers)[:, :, None] + edge)
        weight = weight / weight.sum(-1, keepdim=True).clamp(min=1.0)
        return self.output(torch.matmul(weight.unsqueeze(-2), hidden).squeeze(-2))
