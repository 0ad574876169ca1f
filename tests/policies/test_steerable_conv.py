"""The aggregate-then-contract convolution against one that forms every message."""

import itertools

import pytest
import torch
from random_graphs import rotation_from_quaternion

from maniskill_grpd.policies.layers import CompleteEdges, EdgeGeometry, EquivariantUpdate, NeighborEdges, SteerableConv

BATCH, SENDERS, RECEIVERS, SCALARS, VECTORS = 2, 6, 3, 5, 4
CUTOFF, SOFTENING = 0.5, 0.1


def normal(*shape):
    return torch.randn(*shape, dtype=torch.float64)


def message_by_message(conv, geometry, scalars, vectors, senders, receivers, weights):
    """Messages of eq. 2 and 6, edge by edge, in Cartesian form.

    Args:
        conv: The layer whose weights are used.
        geometry: Whose radial functions and softening are used.
        scalars: (B, S, C).
        vectors: (3, B, S, D).
        senders: Positions (B, S, 3).
        receivers: Positions (B, R, 3).
        weights: How many edges there are, (B, R, S).
    """
    batch, num_receivers, num_senders = weights.shape
    num_radial = geometry.basis.num_basis
    out_s, out_v = [], []
    for b, r in itertools.product(range(batch), range(num_receivers)):
        edges = [s for s in range(num_senders) for _ in range(int(weights[b, r, s]))]
        phi, sums = {}, [0.0] * num_radial
        for s in edges:
            p = senders[b, s] - receivers[b, r]
            soft = (p @ p + SOFTENING**2).sqrt()
            phi[s] = [float(f) for f in geometry.basis(soft - SOFTENING)]
            sums = [total + f for total, f in zip(sums, phi[s], strict=True)]
        paths_s = [[], []]
        paths_v = [[] for _ in range(2 + conv.max_degree)]
        for q in range(num_radial):
            total_s = [torch.zeros(SCALARS).double(), torch.zeros(VECTORS).double()]
            total_v = [torch.zeros(3, VECTORS).double() for _ in paths_v]
            for s in edges:
                weight = phi[s][q] / (sums[q] + 0.05 * max(len(edges), 1))
                p = senders[b, s] - receivers[b, r]
                u = p / (p @ p + SOFTENING**2).sqrt()
                v = vectors[:, b, s]
                total_s[0] += weight * scalars[b, s]
                total_s[1] += weight * 3**0.5 * (u @ v)
                total_v[0] += weight * 3**0.5 * torch.outer(u, conv.mix(scalars[b, s]))
                total_v[1] += weight * v
                total_v[2] += weight * 3**0.5 * torch.linalg.cross(u[:, None].expand_as(v), v, dim=0)
                if conv.max_degree == 2:
                    traceless = torch.outer(u, u) - (u @ u) / 3 * torch.eye(3).double()
                    total_v[3] += weight * 15**0.5 * traceless @ v
            for path, total in zip(paths_s + paths_v, total_s + total_v, strict=True):
                path.append(total)
        out_s.append(conv.to_scalars(join(paths_s)))
        out_v.append(conv.to_vectors(join(paths_v)))
    shape = (batch, num_receivers)
    s = torch.stack(out_s).view(*shape, -1)
    v = torch.stack(out_v, dim=1).view(3, *shape, -1)
    return s, v


def join(paths):
    """Channels of all paths, each a list over radial functions."""
    return torch.cat([channel for path in paths for channel in path], dim=-1)


@pytest.mark.parametrize("max_degree", [1, 2])
@pytest.mark.parametrize("num_radial", [1, 4])
def test_complete_edges_match_message_by_message(max_degree, num_radial):
    """Matrix products of moments give what a loop over edges gives; masked senders send nothing."""
    geometry = EdgeGeometry(num_radial, max_degree, CUTOFF, SOFTENING)
    conv = SteerableConv(SCALARS, VECTORS, num_radial=num_radial, max_degree=max_degree).double()
    scalars, vectors = normal(BATCH, SENDERS, SCALARS), normal(3, BATCH, SENDERS, VECTORS)
    senders, receivers = normal(BATCH, SENDERS, 3), normal(BATCH, RECEIVERS, 3)
    mask = torch.ones(BATCH, SENDERS, dtype=torch.bool)
    mask[0, 1] = False
    edges = geometry.complete(senders.movedim(-1, 0), mask, receivers.movedim(-1, 0))
    actual = conv(scalars, vectors, edges)
    weights = mask[:, None].expand(BATCH, RECEIVERS, SENDERS)
    expected = message_by_message(conv, geometry, scalars, vectors, senders, receivers, weights)
    for a, e in zip(actual, expected, strict=True):
        torch.testing.assert_close(a, e)


def test_excluding_self_leaves_out_the_diagonal():
    """With exclude_self no node hears itself; a single node hears nothing."""
    geometry = EdgeGeometry(3, 1, CUTOFF, SOFTENING)
    for count in (1, 4):
        position = normal(3, BATCH, count)
        mask = torch.ones(BATCH, count, dtype=torch.bool)
        edges = geometry.complete(position, mask, position, exclude_self=True)
        weights = edges.weights.view(BATCH, 4, count, 3, count)
        assert torch.isfinite(weights).all()
        assert (weights.diagonal(dim1=2, dim2=4) == 0).all()


@pytest.mark.parametrize(("edge_degree", "max_degree"), [(1, 1), (2, 1), (2, 2)])
@pytest.mark.parametrize("num_radial", [1, 3])
@pytest.mark.parametrize("form", ["neighbor_lists", "neighbor_matrix"])
def test_neighbor_edges_match_message_by_message(form, num_radial, edge_degree, max_degree):
    """Neighbours with gaps and repetitions, and masked nodes, in either form."""
    geometry = EdgeGeometry(num_radial, edge_degree, CUTOFF, SOFTENING)
    conv = SteerableConv(SCALARS, VECTORS, num_radial=num_radial, max_degree=max_degree).double()
    scalars, vectors = normal(BATCH, SENDERS, SCALARS), normal(3, BATCH, SENDERS, VECTORS)
    position = normal(BATCH, SENDERS, 3)
    mask = torch.ones(BATCH, SENDERS, dtype=torch.bool)
    mask[1, 2] = False
    neighbors = torch.randint(-1, SENDERS, (BATCH, SENDERS, 3))
    edges = getattr(geometry, form)(position.movedim(-1, 0), mask, neighbors)
    actual = conv(scalars, vectors, edges)
    weights = torch.zeros(BATCH, SENDERS, SENDERS)
    for b, r, k in itertools.product(range(BATCH), range(SENDERS), range(3)):
        s = int(neighbors[b, r, k])
        if s >= 0 and mask[b, s]:
            weights[b, r, s] += 1
    expected = message_by_message(conv, geometry, scalars, vectors, position, position, weights)
    for a, e in zip(actual, expected, strict=True):
        torch.testing.assert_close(a, e)


@pytest.mark.parametrize("form", ["neighbor_lists", "neighbor_matrix"])
def test_receivers_apart_from_senders_hear_the_same(form):
    """Some nodes as receivers of their own lists get what they get among all; envelopes weigh."""
    geometry = EdgeGeometry(2, 1, CUTOFF, SOFTENING)
    connect = getattr(geometry, form)
    conv = SteerableConv(SCALARS, VECTORS, num_radial=2).double()
    features = normal(BATCH, SENDERS, SCALARS), normal(3, BATCH, SENDERS, VECTORS)
    position = normal(3, BATCH, SENDERS)
    mask = torch.ones(BATCH, SENDERS, dtype=torch.bool)
    neighbors = torch.randint(-1, SENDERS, (BATCH, SENDERS, 3))
    scalars, vectors = conv(*features, connect(position, mask, neighbors))
    chosen = torch.tensor([4, 1])
    envelope = torch.ones(BATCH, 2, 3, dtype=torch.float64)
    edges = connect(position, mask, neighbors[:, chosen], receivers=position[:, :, chosen], envelope=envelope)
    some_scalars, some_vectors = conv(*features, edges)
    torch.testing.assert_close(some_scalars, scalars[:, chosen])
    torch.testing.assert_close(some_vectors, vectors[:, :, chosen])
    envelope[:, :, 1:] = 0.0
    alone = neighbors.clone()
    alone[:, :, 1:] = -1
    # The floor of the normalisation counts at least one edge: a weight of zero is no edge.
    edges = connect(position, mask, neighbors[:, chosen], receivers=position[:, :, chosen], envelope=envelope)
    faded = conv(*features, edges)
    pruned = conv(*features, connect(position, mask, alone))
    torch.testing.assert_close(faded[0], pruned[0][:, chosen])
    torch.testing.assert_close(faded[1], pruned[1][:, :, chosen])


def test_small_graphs_become_matrices():
    """The form follows the number of senders per listed neighbour."""
    geometry = EdgeGeometry(2, 1, CUTOFF, SOFTENING)
    for count, form in ((36, CompleteEdges), (37, NeighborEdges)):
        mask = torch.ones(BATCH, count, dtype=torch.bool)
        neighbors = torch.randint(-1, count, (BATCH, count, 3))
        assert isinstance(geometry.neighbors(normal(3, BATCH, count), mask, neighbors), form)


@pytest.mark.parametrize("normalize", [False, True])
def test_update_is_equivariant_and_safe_at_zero(normalize):
    """Also with `VectorNorm`: unit RMS length, and a finite gradient at zero."""
    update = EquivariantUpdate(SCALARS, VECTORS, 6, normalize_vectors=normalize).double()
    scalars, messages = normal(BATCH, SENDERS, SCALARS), normal(BATCH, SENDERS, 6)
    vectors, pushes = normal(3, BATCH, SENDERS, VECTORS), normal(3, BATCH, SENDERS, VECTORS)
    rotation = rotation_from_quaternion((0.1, -0.5, 0.3, 0.8))

    def rotate(vector):
        return torch.einsum("ij,j...->i...", rotation, vector)

    s, v = update(scalars, vectors, messages, pushes)
    s_moved, v_moved = update(scalars, rotate(vectors), messages, rotate(pushes))
    torch.testing.assert_close(s_moved, s)
    torch.testing.assert_close(v_moved, rotate(v))
    if normalize:
        rms = v.square().sum(0).mean(-1)
        torch.testing.assert_close(rms, torch.ones_like(rms), rtol=1e-4, atol=0.0)
    zero = torch.zeros_like(vectors, requires_grad=True)
    s, v = update(scalars, zero, messages, torch.zeros_like(pushes))
    assert (v == 0).all()
    (s.sum() + v.sum()).backward()
    assert torch.isfinite(zero.grad).all()


@pytest.mark.parametrize("max_degree", [1, 2])
def test_layer_is_equivariant(max_degree):
    """Rotating positions and vectors rotates vector messages and leaves scalar messages."""
    geometry = EdgeGeometry(4, max_degree, CUTOFF, SOFTENING)
    conv = SteerableConv(SCALARS, VECTORS, num_radial=4, max_degree=max_degree).double()
    scalars, vectors = normal(BATCH, SENDERS, SCALARS), normal(3, BATCH, SENDERS, VECTORS)
    senders, receivers = normal(3, BATCH, SENDERS), normal(3, BATCH, RECEIVERS)
    mask = torch.ones(BATCH, SENDERS, dtype=torch.bool)
    rotation = rotation_from_quaternion((0.1, -0.5, 0.3, 0.8))

    def rotate(vector):
        return torch.einsum("ij,j...->i...", rotation, vector)

    s, v = conv(scalars, vectors, geometry.complete(senders, mask, receivers))
    moved = geometry.complete(rotate(senders), mask, rotate(receivers))
    s_moved, v_moved = conv(scalars, rotate(vectors), moved)
    torch.testing.assert_close(s_moved, s)
    torch.testing.assert_close(v_moved, rotate(v))


def test_moments_do_not_depend_on_resolution():
    """A curve sampled four times as densely sends the same messages, to the sampling error."""
    geometry = EdgeGeometry(5, 1, 1.0, 0.05)
    conv = SteerableConv(2, 2, num_radial=5).double()

    def sample(count):
        t = ((torch.arange(count) + 0.5) / count).double()
        position = torch.stack([t, t.square(), t.sin()])[:, None]
        scalars = torch.stack([t, t.cos()], dim=-1)[None]
        vectors = torch.stack([position, position.square()], dim=-1)
        mask = torch.ones(1, count, dtype=torch.bool)
        return conv(scalars, vectors, geometry.complete(position, mask, torch.zeros(3, 1, 1).double()))

    # Midpoint sampling: the error falls with the square of the spacing.
    for coarse, fine in zip(sample(40), sample(160), strict=True):
        torch.testing.assert_close(coarse, fine, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("max_degree", [0, 3])
def test_degree_out_of_range_is_refused(max_degree):
    with pytest.raises(ValueError, match=f"got {max_degree}"):
        SteerableConv(2, 2, num_radial=1, max_degree=max_degree)
