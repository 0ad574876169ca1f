"""Convolution with a steerable kernel, aggregated before it is contracted."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import nn

from maniskill_grpd.policies.layers.edges import CompleteEdges, NeighborEdges
from maniskill_grpd.policies.layers.receiver_gate import ReceiverGate

_Moments = Sequence[Sequence[torch.Tensor]]
"""Entry [i][m]: component i of the sender vectors times harmonic m, summed over senders."""


class SteerableConv(nn.Module):
    r"""Equivariant messages m_r = sum_s kappa(p_rs) h_s, kappa(p) = sum_lb a_lb phi_b(|p|) Y_l(p).

    This is eq. 2 and 6 with the steerable kernel of eq. 29 and 30; eq. 20 and 31 as printed, a
    network on the raw direction, would not be equivariant. The kernel is separable, so messages
    never exist per edge and channel: first the moments

        M[r, b, m, :] = sum_s phi_b(|p_rs|) Y_m(p_rs) h_s

    are formed, then contracted once per receiver with learned a:

        scalars <- M0 s,  M1 . v
        vectors <- M1 s,  M0 v,  M1 x v,  M2 v   (the last with max_degree 2)

    With `receiver_dims` the kernel depends on the receiver, m_r = sum_s psi(h_s, h_r, p_rs): its invariants weigh the
    moments before they are contracted, see `ReceiverGate`.

    Complete edges form all moments as a matrix product per graph. Neighbour lists are short, so
    there only those products that survive the contraction are formed, elementwise. Both give the
    same messages for the same edges.

    Shapes:
        scalars (B, S, C), vectors (3, B, S, D) -> scalars (B, R, C_out), vectors (3, B, R, D_out)

    Symmetry: scalars invariant, vectors equivariant under SO(3) (the cross product keeps it from
    holding under reflections); invariant to the order of senders.

    Args:
        scalar_dim: Channels C of sender scalars.
        vector_dim: Channels D of sender vectors.
        num_radial: Radial functions of the edges.
        max_degree: Largest degree of the harmonics, 1 or 2; the edges must have at least that many.
        out_scalar_dim: C_out, default C.
        out_vector_dim: D_out, default D.
        receiver_dims: Scalar and vector channels of the receivers; None for messages that do not know them.
    """

    def __init__(
        self,
        scalar_dim: int,
        vector_dim: int,
        *,
        num_radial: int,
        max_degree: int = 1,
        out_scalar_dim: int | None = None,
        out_vector_dim: int | None = None,
        receiver_dims: tuple[int, int] | None = None,
    ) -> None:
        super().__init__()
        if max_degree not in (1, 2):
            raise ValueError(f"max_degree must be 1 or 2, got {max_degree}")
        self.max_degree = max_degree
        # Scalars reach vectors only as multiples of a direction: first mix them down to D channels.
        self.mix = nn.Linear(scalar_dim, vector_dim, bias=False)
        self.to_scalars = nn.Linear(num_radial * (scalar_dim + vector_dim), out_scalar_dim or scalar_dim)
        self.to_vectors = nn.Linear(num_radial * (2 + max_degree) * vector_dim, out_vector_dim or vector_dim, bias=False)
        self.gate: ReceiverGate | None = None
        if receiver_dims is not None:
            self.gate = ReceiverGate(receiver_dims, (scalar_dim, vector_dim), num_radial, 2 + max_degree)

    def forward(
        self,
        scalars: torch.Tensor,
        vectors: torch.Tensor,
        edges: CompleteEdges | NeighborEdges,
        receivers: tuple[torch.Tensor, torch.Tensor] | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Messages to all receivers of the edges from the features of all senders.

        Args:
            scalars: Of the senders, (B, S, C).
            vectors: Of the senders, (3, B, S, D).
            edges: Who hears whom.
            receivers: Scalars and vectors of the receivers, needed with `receiver_dims`.
        """
        if isinstance(edges, CompleteEdges):
            invariant, paths = self._complete(scalars, vectors, edges)
        else:
            invariant, paths = self._neighbors(scalars, vectors, edges)
        # One component at a time: the joined paths of all three would be the largest tensor here.
        components = [torch.cat(component, dim=-1) for component in zip(*paths, strict=True)]
        joined = torch.cat(invariant, dim=-1)
        if self.gate is not None:
            to_scalars, to_vectors = self.gate(*receivers)
            joined, components = joined * to_scalars, [component * to_vectors for component in components]
        return self.to_scalars(joined), torch.stack([self.to_vectors(component) for component in components])

    def _complete(
        self, scalars: torch.Tensor, vectors: torch.Tensor, edges: CompleteEdges
    ) -> tuple[list[torch.Tensor], list[Sequence[torch.Tensor]]]:
        """Invariant and, as triples of components, equivariant contractions, each (B, R, Q * F)."""
        still = edges.moments(scalars, 0, 0)[0]
        directed = edges.moments(self.mix(scalars), 1, 1)
        moments = [edges.moments(component, 0, self.max_degree) for component in vectors.unbind(0)]
        paths = [directed, [component[0] for component in moments], _cross(moments)]
        if self.max_degree == 2:
            paths.append(_quadrupole(moments))
        return [still, _dot(moments)], paths

    def _neighbors(
        self, scalars: torch.Tensor, vectors: torch.Tensor, edges: NeighborEdges
    ) -> tuple[list[torch.Tensor], list[Sequence[torch.Tensor]]]:
        """As `_complete`; each entry is (B, R, F), the radial functions of a kind in a row."""
        shape = (scalars.shape[0], edges.senders.shape[-1], -1)
        still = edges.gather(scalars.unsqueeze(0))
        directed = edges.gather(self.mix(scalars).unsqueeze(0))
        moved = edges.gather(vectors)
        count = len(still)
        x, y, z = moved[:count], moved[count : 2 * count], moved[2 * count :]
        invariants, paths = [], []
        for weights in edges.rows().unbind(2):
            one, px, py, pz = (harmonic.unbind(0) for harmonic in weights[:4].unbind(0))
            invariants.append([_sum((one, still)), _sum((px, x), (py, y), (pz, z))])
            kinds = [
                [_sum((p, directed)) for p in (px, py, pz)],
                [_sum((one, v)) for v in (x, y, z)],
                [_sum((py, z)) - _sum((pz, y)), _sum((pz, x)) - _sum((px, z)), _sum((px, y)) - _sum((py, x))],
            ]
            if self.max_degree == 2:
                rows = _traceless(weights)
                kinds.append([_sum(*zip(row, (x, y, z), strict=True)) for row in rows])
            paths.append(kinds)
        return (
            [entry.view(shape) for kind in zip(*invariants, strict=True) for entry in kind],
            [[c.view(shape) for c in path] for kind in zip(*paths, strict=True) for path in kind],
        )


def _traceless(weights: torch.Tensor) -> list[list[Sequence[torch.Tensor]]]:
    """Matrix sqrt(15) (p p^T - |p|^2 / 3) of harmonics (M, K, ...), each entry K weights."""
    xy, yz, zz, xz, xx_yy = weights[4:9].unbind(0)
    third = 1.0 / math.sqrt(3.0)
    matrix = [[xx_yy - third * zz, xy, xz], [xy, -xx_yy - third * zz, yz], [xz, yz, (2.0 * third) * zz]]
    return [[entry.unbind(0) for entry in row] for row in matrix]


def _sum(*products: tuple[Sequence[torch.Tensor], Sequence[torch.Tensor]]) -> torch.Tensor:
    """Sum weight * feature over all pairs of all products, without a temporary per pair."""
    pairs = [pair for product in products for pair in zip(*product, strict=True)]
    total = pairs[0][0] * pairs[0][1]
    for weight, feature in pairs[1:]:
        total = torch.addcmul(total, weight, feature)
    return total


def _dot(moments: _Moments) -> torch.Tensor:
    """Contract degree 1 with the vector to a scalar: sum_s p . v."""
    x, y, z = moments
    return x[1] + y[2] + z[3]


def _cross(moments: _Moments) -> list[torch.Tensor]:
    """Contract degree 1 with the vector to a vector: sum_s p x v."""
    x, y, z = moments
    return [z[2] - y[3], x[3] - z[1], y[1] - x[2]]


def _quadrupole(moments: _Moments) -> list[torch.Tensor]:
    """Contract degree 2 with the vector to a vector: sum_s sqrt(15) (p p^T - |p|^2 / 3) v."""
    x, y, z = moments
    xy, yz, zz, xz, xx_yy = range(4, 9)
    third = 1.0 / math.sqrt(3.0)
    return [
        x[xx_yy] - third * x[zz] + y[xy] + z[xz],
        x[xy] - y[xx_yy] - third * y[zz] + z[yz],
        x[xz] + y[yz] + (2.0 * third) * z[zz],
    ]
