"""Normalisation with one number per channel."""

import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.graphs import GraphNormalizer


def test_scales_are_root_mean_squares():
    """Two nodes with |v| = 3 and 6: E[|v|^2] / 3 = (9 + 36) / 6 = 7.5."""
    graph = make_graph(1, 2, 1)
    graph["object"]["vectors"][0, :, 0] = torch.tensor([[3.0, 0.0, 0.0], [0.0, 6.0, 0.0]])
    graph["object"]["scalars"][0, :, 0] = torch.tensor([1.0, 7.0])
    normalizer = GraphNormalizer(SCHEMA)
    normalizer.update(graph)
    torch.testing.assert_close(normalizer.root_mean_square("object", "vectors")[0], torch.tensor(7.5**0.5))
    # (1 + 49) / 2 = 25.
    torch.testing.assert_close(normalizer.root_mean_square("object", "scalars")[0], torch.tensor(5.0))
    scaled = normalizer(graph)
    torch.testing.assert_close(scaled["object"]["scalars"][0, :, 0], torch.tensor([0.2, 1.4]))
    torch.testing.assert_close(scaled["object"]["vectors"][0, 0, 0], torch.tensor([3.0, 0, 0]) / 7.5**0.5)


def test_parts_add_up_to_the_whole():
    """Batches of different sizes give the statistics of their union."""
    whole = make_graph(10)
    normalizer, pieces = GraphNormalizer(SCHEMA), GraphNormalizer(SCHEMA)
    normalizer.update(whole)
    for part in (slice(0, 1), slice(1, 4), slice(4, 10)):
        pieces.update(
            {key: value[part] if key == "gravity" else {k: v[part] for k, v in value.items()} for key, value in whole.items()}
        )
    for name, buffer in normalizer.state_dict().items():
        torch.testing.assert_close(pieces.state_dict()[name], buffer)


def test_masked_nodes_do_not_count():
    graph = make_graph()
    expected = GraphNormalizer(SCHEMA)
    expected.update({**graph, "object": {k: v[:, :5] for k, v in graph["object"].items()}})
    graph["object"]["mask"][:, 5:] = False
    graph["object"]["vectors"][:, 5:] = torch.nan
    graph["object"]["scalars"][:, 5:] = torch.nan
    actual = GraphNormalizer(SCHEMA)
    actual.update(graph)
    for name, buffer in expected.state_dict().items():
        torch.testing.assert_close(actual.state_dict()[name], buffer)
    scaled = actual(graph)["object"]
    assert (scaled["vectors"][:, 5:] == 0).all()
    assert (scaled["scalars"][:, 5:] == 0).all()


def test_fresh_and_silent_channels_are_left_alone():
    """No data, or only zeros: scale one, not infinity."""
    graph = make_graph()
    normalizer = GraphNormalizer(SCHEMA)
    torch.testing.assert_close(normalizer(graph)["object"]["scalars"], graph["object"]["scalars"])
    graph["object"]["scalars"][..., 3] = 0.0
    normalizer.update(graph)
    assert (normalizer(graph)["object"]["scalars"][..., 3] == 0.0).all()


def test_batch_without_nodes_changes_nothing():
    graph = make_graph()
    normalizer = GraphNormalizer(SCHEMA)
    normalizer.update(graph)
    before = {name: buffer.clone() for name, buffer in normalizer.state_dict().items()}
    graph["object"]["mask"][:] = False
    graph["actuator"]["mask"][:] = False
    normalizer.update(graph)
    for name, buffer in normalizer.state_dict().items():
        assert torch.equal(buffer, before[name])


def test_outliers_are_shortened_along_their_direction():
    graph = make_graph(1, 2, 1)
    normalizer = GraphNormalizer(SCHEMA, clip=2.0)
    graph["object"]["vectors"][0, 0, 0] = torch.tensor([3.0, 0.0, -4.0])
    graph["object"]["scalars"][0, 0, 0] = -7.0
    scaled = normalizer(graph)["object"]
    torch.testing.assert_close(scaled["vectors"][0, 0, 0], torch.tensor([1.2, 0.0, -1.6]))
    assert scaled["scalars"][0, 0, 0] == -2.0


def test_input_is_not_changed_and_gravity_is_in_standard_units():
    graph = make_graph()
    copies = {key: value.clone() for key, value in graph["object"].items()}
    normalizer = GraphNormalizer(SCHEMA)
    normalizer.update(graph)
    scaled = normalizer(graph)
    assert all(torch.equal(graph["object"][key], value) for key, value in copies.items())
    assert torch.equal(scaled["object"]["position"], graph["object"]["position"])
    torch.testing.assert_close(scaled["gravity"][0], torch.tensor([0.0, 0.0, -1.0]))
