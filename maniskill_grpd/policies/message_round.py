"""One round of equivariant message passing."""

from __future__ import annotations

from torch import nn

from maniskill_grpd.policies.encoded_policy import Features
from maniskill_grpd.policies.layers import CompleteEdges, EquivariantUpdate, NeighborEdges, SteerableConv


class MessageRound(nn.Module):
    """Convolution along one edge type, then the update of its receivers (eq. 2, 3).

    Symmetry: scalars invariant, vectors equivariant under SO(3).

    Args:
        sender_dims: Scalar and vector channels of the senders.
        receiver_dims: The same of the receivers.
        num_radial: Radial functions of the edges.
        max_degree: Largest degree of the harmonics.
        receiver_gates: Whether messages depend on their receiver.
        normalize_vectors: Whether vector features are normalised afterwards.
    """

    def __init__(
        self,
        sender_dims: tuple[int, int],
        receiver_dims: tuple[int, int],
        num_radial: int,
        max_degree: int,
        *,
        receiver_gates: bool,
        normalize_vectors: bool,
    ) -> None:
        super().__init__()
        self.conv = SteerableConv(
            *sender_dims,
            num_radial=num_radial,
            max_degree=max_degree,
            out_scalar_dim=receiver_dims[0],
            out_vector_dim=receiver_dims[1],
            receiver_dims=receiver_dims if receiver_gates else None,
        )
        self.update = EquivariantUpdate(*receiver_dims, message_dim=receiver_dims[0], normalize_vectors=normalize_vectors)

    def forward(self, senders: Features, receivers: Features, edges: CompleteEdges | NeighborEdges) -> Features:
        """New features of the receivers."""
        return self.update(*receivers, *self.conv(*senders, edges, receivers))
