"""Self-attention over all nodes of a graph."""

from __future__ import annotations

import torch
from torch import nn


class AttentionBlock(nn.Module):
    r"""Pre-norm transformer block (Vaswani et al. 2017; Xiong et al. 2020).

        h <- h + W_o attention(LayerNorm(h)),   h <- h + W_2 gelu(W_1 LayerNorm(h))

    The last map of either branch starts smaller by the square root of the number of branches in the
    network, so that the sum of all branches has the scale of one. Cost is quadratic in the number
    of nodes in time; the fused kernel never stores the matrix of weights.

    Shapes: h (B, n, C), mask (B, n) -> (B, n, C).
    Symmetry: equivariant under permutations of nodes.

    Args:
        dim: C.
        num_heads: Attention heads; a divisor of C.
        hidden_dim: Width of the second branch.
        num_blocks: Blocks in the network.
    """

    def __init__(self, dim: int, num_heads: int, hidden_dim: int, num_blocks: int) -> None:
        super().__init__()
        self.num_heads = num_heads
        self.attention_norm = nn.LayerNorm(dim)
        self.query_key_value = nn.Linear(dim, 3 * dim)
        self.attention_output = nn.Linear(dim, dim)
        self.hidden_norm = nn.LayerNorm(dim)
        self.hidden = nn.Linear(dim, hidden_dim)
        self.hidden_output = nn.Linear(hidden_dim, dim)
        for linear in (self.query_key_value, self.hidden):
            nn.init.xavier_uniform_(linear.weight)
            nn.init.zeros_(linear.bias)
        for linear in (self.attention_output, self.hidden_output):
            nn.init.xavier_uniform_(linear.weight, gain=(2 * num_blocks) ** -0.5)
            nn.init.zeros_(linear.bias)

    def forward(self, features: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """New features of nodes; masked nodes are not attended to."""
        features = features + self._attend(self.attention_norm(features), mask)
        hidden = nn.functional.gelu(self.hidden(self.hidden_norm(features)))
        return features + self.hidden_output(hidden)

    def _attend(self, features: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        heads = self.query_key_value(features).unflatten(-1, (3, self.num_heads, -1))
        query, key, value = heads.permute(2, 0, 3, 1, 4).unbind(0)  # (B, heads, n, C / heads)
        mixed = nn.functional.scaled_dot_product_attention(query, key, value, attn_mask=mask[:, None, None])
        return self.attention_output(mixed.transpose(1, 2).flatten(2))
