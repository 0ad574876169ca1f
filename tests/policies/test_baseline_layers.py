"""Layers of the policies without symmetry, against plain implementations."""

import itertools

import torch
from random_graphs import make_graph

from maniskill_grpd.policies.layers import AttentionBlock, MLPMessages


def mlp_message(layer, sender, receiver, offset):
    """One message of eq. 24 before the average, by a network of the joined inputs."""
    weight = torch.cat([layer.sender.weight, layer.receiver.weight, layer.offset.weight], dim=1)
    scaled = offset / layer.scale
    inputs = torch.cat([sender, receiver, scaled, scaled.norm()[None]])
    hidden = torch.nn.functional.silu(weight @ inputs + layer.receiver.bias)
    return layer.output(hidden)


def test_complete_messages_match_a_loop_over_edges():
    torch.manual_seed(0)
    layer = MLPMessages(5, 4, 8, 6, 0.3).double()
    senders, receivers = torch.randn(2, 7, 5).double(), torch.randn(2, 3, 4).double()
    points, tools = torch.randn(2, 7, 3).double(), torch.randn(2, 3, 3).double()
    mask = torch.ones(2, 7, dtype=torch.bool)
    mask[0, 2] = False
    actual = layer.complete(senders, receivers, points, tools, mask)
    for b, r in itertools.product(range(2), range(3)):
        messages = [
            mlp_message(layer, senders[b, s], receivers[b, r], points[b, s] - tools[b, r]) for s in range(7) if mask[b, s]
        ]
        torch.testing.assert_close(actual[b, r], torch.stack(messages).mean(0))


def test_neighbor_messages_match_a_loop_over_edges():
    torch.manual_seed(0)
    layer = MLPMessages(5, 5, 8, 6, 0.3).double()
    nodes = make_graph(2, 7, 1, dtype=torch.float64)["object"]
    nodes["mask"][0, 2] = False
    features = torch.randn(2, 7, 5).double()
    place = nodes["position"]
    actual = layer.neighbors(features, place, nodes["mask"], nodes["neighbors"])
    for b, r in itertools.product(range(2), range(7)):
        listed = [s for s in nodes["neighbors"][b, r].tolist() if s >= 0 and nodes["mask"][b, s]]
        messages = [mlp_message(layer, features[b, s], features[b, r], place[b, s] - place[b, r]) for s in listed]
        expected = torch.stack(messages).mean(0) if messages else layer.output.bias
        torch.testing.assert_close(actual[b, r], expected)


def test_attention_matches_a_plain_softmax():
    """Scores over unmasked nodes only, one head after the other."""
    torch.manual_seed(0)
    block = AttentionBlock(8, 2, 16, 3).double()
    features = torch.randn(2, 5, 8).double()
    mask = torch.ones(2, 5, dtype=torch.bool)
    mask[1, 3] = False
    normed = block.attention_norm(features)
    query, key, value = block.query_key_value(normed).chunk(3, dim=-1)
    mixed = []
    for head in (slice(0, 4), slice(4, 8)):
        scores = query[..., head] @ key[..., head].transpose(1, 2) / 2.0
        weights = scores.masked_fill(~mask[:, None], -torch.inf).softmax(-1)
        mixed.append(weights @ value[..., head])
    attended = features + block.attention_output(torch.cat(mixed, dim=-1))
    hidden = torch.nn.functional.gelu(block.hidden(block.hidden_norm(attended)))
    torch.testing.assert_close(block(features, mask), attended + block.hidden_output(hidden))


def test_branches_start_small_in_deep_networks():
    """The last map of a branch shrinks with the root of the number of branches."""
    torch.manual_seed(0)
    shallow, deep = (AttentionBlock(64, 4, 64, depth) for depth in (1, 16))
    for name in ("attention_output", "hidden_output"):
        ratio = getattr(deep, name).weight.std() / getattr(shallow, name).weight.std()
        torch.testing.assert_close(float(ratio.detach()), 0.25, rtol=0.05, atol=0.0)
