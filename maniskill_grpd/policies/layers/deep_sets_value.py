"""State value from a set of nodes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn

from maniskill_grpd.policies.layers.equivariant_update import vector_norms


class DeepSetsValue(nn.Module):
    r"""V = MLP_out(mean_v MLP_in(h_v)) over the nodes of each type (eq. 8).

    The mean, per node type, takes the place of the printed sum so that a value holds for any number
    of nodes. h_v are the invariants of node v: scalar features and lengths of vector features. The
    last linear map of MLP_in commutes with the mean and is therefore the first of MLP_out.

    Shapes: per node type scalars (B, n, C), vectors (3, B, n, D), mask (B, n) -> (B,).
    Symmetry: invariant under O(3) and under permutations of the nodes of a type.

    Args:
        node_dims: (C, D) of each node type.
        inner_dim: Width of MLP_in, which runs at every node.
        outer_dim: Width of MLP_out, which runs once per graph.
    """

    def __init__(self, node_dims: Sequence[tuple[int, int]], inner_dim: int, outer_dim: int) -> None:
        super().__init__()
        self.inner = nn.ModuleList(nn.Linear(c + d, inner_dim) for c, d in node_dims)
        self.outer = nn.Sequential(
            nn.Linear(len(node_dims) * inner_dim, outer_dim),
            nn.LayerNorm(outer_dim),
            nn.SiLU(),
            nn.Linear(outer_dim, outer_dim),
            nn.SiLU(),
            nn.Linear(outer_dim, 1),
        )
        nn.init.orthogonal_(self.outer[-1].weight, 0.1)
        nn.init.zeros_(self.outer[-1].bias)

    @torch.no_grad()
    def rescale(self, factor: float, shift: float) -> None:
        """Change the last layer so that every value V becomes factor * V + shift."""
        last = self.outer[-1]
        last.weight.mul_(factor)
        last.bias.mul_(factor).add_(shift)

    def forward(self, nodes: Sequence[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]) -> torch.Tensor:
        """Value of each graph.

        Args:
            nodes: (scalars, vectors, mask) of each node type.

        Returns:
            (B,).
        """
        pooled = []
        for inner, (scalars, vectors, mask) in zip(self.inner, nodes, strict=True):
            invariant = torch.cat([scalars, vector_norms(vectors)], dim=-1)
            hidden = nn.functional.silu(inner(invariant))
            share = mask.to(hidden.dtype)
            share = share / share.sum(-1, keepdim=True).clamp(min=1.0)
            pooled.append(torch.bmm(share.unsqueeze(-2), hidden).squeeze(-2))
        return self.outer(torch.cat(pooled, dim=-1)).squeeze(-1)
