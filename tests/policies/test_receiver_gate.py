"""Messages that know their receiver: psi(h_s, h_r, p) of eq. 36, 38 and 40."""

import pytest
import torch
from random_graphs import rotation_from_quaternion

from maniskill_grpd.policies.layers import EdgeGeometry, SteerableConv
from maniskill_grpd.policies.layers import receiver_gate as module

SENDERS, RECEIVERS, RADIAL = 6, 3, 3
SENT, HEARD = (5, 4), (7, 2)
ROTATION = rotation_from_quaternion((0.1, -0.5, 0.3, 0.8))


def normal(*shape):
    return torch.randn(*shape, dtype=torch.float64)


def turned(vectors):
    return torch.einsum("ij,j...->i...", ROTATION, vectors)


def make_conv(max_degree=1):
    conv = SteerableConv(*SENT, num_radial=RADIAL, max_degree=max_degree, receiver_dims=HEARD).double()
    conv.gate.network.weight.data.mul_(3.0)  # factors far from one
    return conv


def scene():
    """Positions and features of senders, positions and features of receivers."""
    senders = normal(3, 1, SENDERS), normal(1, SENDERS, SENT[0]), normal(3, 1, SENDERS, SENT[1])
    receivers = normal(3, 1, RECEIVERS), normal(1, RECEIVERS, HEARD[0]), normal(3, 1, RECEIVERS, HEARD[1])
    return senders, receivers


def messages(conv, senders, receivers):
    """What the layer sends along all edges."""
    geometry = EdgeGeometry(RADIAL, conv.max_degree, 0.5, 0.1)
    edges = geometry.complete(senders[0], torch.ones(1, SENDERS, dtype=torch.bool), receivers[0])
    return conv(*senders[1:], edges, receivers[1:])


@pytest.mark.parametrize("max_degree", [1, 2])
def test_sum_of_messages_that_each_know_both_ends(max_degree):
    """The gates, taken out of the sum, are those of a kernel kappa_r(p) that acts on one sender at a time."""
    conv = make_conv(max_degree)
    senders, receivers = scene()
    geometry = EdgeGeometry(RADIAL, max_degree, 0.5, 0.1)
    weights = geometry.complete(senders[0], torch.ones(1, SENDERS, dtype=torch.bool), receivers[0]).weights
    weights = weights.view(1, -1, RECEIVERS, RADIAL, SENDERS)[0]
    lengths = (receivers[2].square().sum(0) + 1e-6).sqrt()
    gates = 2.0 * torch.sigmoid(conv.gate.network(torch.cat([receivers[1], lengths], dim=-1)))[0]
    paths = 4 + max_degree
    kernel, still, mixed, moved = gates.split([paths * RADIAL, SENT[0], SENT[1], SENT[1]], dim=-1)
    kernel = kernel.view(RECEIVERS, paths, RADIAL)
    expected_scalars, expected_vectors = [], []
    for r in range(RECEIVERS):
        sums = [[0.0] * RADIAL for _ in range(paths)]
        for s in range(SENDERS):
            h, v, m = senders[1][0, s], senders[2][:, 0, s], conv.mix(senders[1][0, s])
            for q in range(RADIAL):
                w = weights[:, r, q, s]
                direction = w[1:4]
                terms = [w[0] * h * still[r], (direction @ v) * moved[r]]
                terms += [torch.outer(direction, m * mixed[r]), w[0] * v * moved[r]]
                terms += [torch.linalg.cross(direction[:, None].expand_as(v), v, dim=0) * moved[r]]
                if max_degree == 2:
                    xy, yz, zz, xz, d = w[4:9]
                    t = zz / 3**0.5
                    matrix = torch.stack([torch.stack(row) for row in ((d - t, xy, xz), (xy, -d - t, yz), (xz, yz, 2 * t))])
                    terms.append(matrix @ v * moved[r])
                for path, term in enumerate(terms):
                    sums[path][q] = sums[path][q] + kernel[r, path, q] * term
        expected_scalars.append(conv.to_scalars(torch.cat([total for path in sums[:2] for total in path])))
        expected_vectors.append(conv.to_vectors(torch.cat([total for path in sums[2:] for total in path], dim=-1)))
    scalars, vectors = messages(conv, senders, receivers)
    torch.testing.assert_close(scalars[0], torch.stack(expected_scalars))
    torch.testing.assert_close(vectors[:, 0], torch.stack(expected_vectors, dim=1))


@torch.no_grad()
def turning_errors(conv):
    """How far turning everything first is from turning the messages, (scalars, vectors), relative."""
    senders, receivers = scene()
    scalars, vectors = messages(conv, senders, receivers)
    moved = [(turned(position), features, turned(directions)) for position, features, directions in (senders, receivers)]
    turned_scalars, turned_vectors = messages(conv, *moved)
    errors = (turned_scalars - scalars).norm() / scalars.norm(), (turned_vectors - turned(vectors)).norm() / vectors.norm()
    return [float(error) for error in errors]


@pytest.mark.parametrize("max_degree", [1, 2])
def test_gated_messages_are_equivariant(max_degree):
    assert max(turning_errors(make_conv(max_degree))) < 1e-13


def test_gates_of_a_component_are_not_equivariant(monkeypatch):
    """Negative control: a gate that reads a component where it should read a length breaks both kinds of messages."""
    monkeypatch.setattr(module, "vector_norms", lambda vectors: vectors[0])
    assert min(turning_errors(make_conv())) > 1e-2


def test_receivers_in_one_place_hear_different_things():
    """What eq. 36 asks for; without gates the receiver's features play no part in what it hears."""
    senders, receivers = scene()
    place = receivers[0][:, :, :1].expand(-1, -1, RECEIVERS)
    together = (place, *receivers[1:])
    scalars, vectors = messages(make_conv(), senders, together)
    assert (scalars[0, 0] - scalars[0, 1]).norm() > 0.1 * scalars[0, 0].norm()
    assert (vectors[:, 0, 0] - vectors[:, 0, 1]).norm() > 0.1 * vectors[:, 0, 0].norm()
    deaf = SteerableConv(*SENT, num_radial=RADIAL).double()
    for message in messages(deaf, senders, together):
        torch.testing.assert_close(message[..., 0, :], message[..., 1, :])
