"""Export to PyG and networkx: the same graph, the same layer, back again."""

import sys

import pytest
import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.graphs import from_hetero_data, to_hetero_data, to_networkx
from maniskill_grpd.policies import make_policy
from maniskill_grpd.policies.layers import EdgeGeometry, SteerableConv

MESH = ("object", "mesh", "object")
BETWEEN = ("actuator", "with", "actuator")
GLOBAL = ("object", "to", "actuator")


def ragged_graph(dtype=torch.float64):
    """Three graphs of different size, with holes in the masks and NaN in the padding."""
    graph = make_graph(3, 9, 3, seed=1, dtype=dtype)
    graph["object"]["mask"][1, 4:6] = False
    graph["object"]["mask"][2, 0] = False
    graph["actuator"]["mask"][0, 1] = False
    for node_type in ("object", "actuator"):
        nodes = graph[node_type]
        for key in ("position", "vectors", "scalars"):
            nodes[key][~nodes["mask"]] = torch.nan
    return graph


@pytest.fixture
def geometric():
    return pytest.importorskip("torch_geometric")


def test_round_trip_of_full_graphs_is_exact(geometric):
    """Without masks everything comes back bit for bit, neighbours moved to the front of lists."""
    graph = make_graph(3, 9, 2)
    back = from_hetero_data(to_hetero_data(graph, SCHEMA), SCHEMA)
    assert torch.equal(back["gravity"], graph["gravity"])
    for node_type in ("object", "actuator"):
        for key in ("position", "vectors", "scalars", "mask"):
            assert torch.equal(back[node_type][key], graph[node_type][key]), key
    expected = [[[s for s in row if s >= 0] for row in rows] for rows in graph["object"]["neighbors"].tolist()]
    actual = [[[s for s in row if s >= 0] for row in rows] for rows in back["object"]["neighbors"].tolist()]
    assert actual == expected


@pytest.mark.parametrize("name", ["grpd", "empn", "hetero_gnn", "transformer"])
def test_policies_act_alike_after_a_round_trip(name, geometric):
    """Masked nodes disappear, yet the true actuators get the same actions and values."""
    graph = ragged_graph()
    back = from_hetero_data(to_hetero_data(graph, SCHEMA), SCHEMA)
    policy = make_policy(name, SCHEMA).double()
    (before, value), (after, value_after) = policy(graph), policy(back)
    torch.testing.assert_close(value_after, value)
    torch.testing.assert_close(after.mean[after.mask], before.mean[before.mask])


def test_layout_is_that_of_pyg(geometric):
    """Node and edge types, batch vectors, offsets as edge attributes; PyG's own check passes."""
    graph = ragged_graph()
    data = to_hetero_data(graph, SCHEMA)
    data.validate()
    assert data.node_types == ["object", "actuator"]
    assert data.edge_types == [MESH, BETWEEN, GLOBAL]
    assert data["object"].ptr.tolist() == [0, 9, 16, 24]
    assert data["object"].batch.tolist() == [0] * 9 + [1] * 7 + [2] * 8
    assert data["actuator"].batch.tolist() == [0, 0, 1, 1, 1, 2, 2, 2]
    assert data["object"].x.shape == (24, 3 * 2 + 4)
    assert data[GLOBAL].edge_index.shape[1] == 9 * 2 + 7 * 3 + 8 * 3
    assert data[BETWEEN].edge_index.shape[1] == 2 * 1 + 3 * 2 + 3 * 2
    for sender, _, receiver in data.edge_types:
        store = data[sender, receiver]
        s, r = store.edge_index
        assert torch.equal(data[sender].batch[s], data[receiver].batch[r])
        torch.testing.assert_close(store.edge_attr, data[sender].pos[s] - data[receiver].pos[r])
        assert torch.isfinite(store.edge_attr).all()


def test_batches_made_by_pyg_are_the_same(geometric):
    """One graph at a time, then PyG's collation: the same data, and it can be converted back."""
    graph = ragged_graph()
    whole = to_hetero_data(graph, SCHEMA)
    singles = []
    for i in range(3):
        nodes = {t: {k: v[i : i + 1] for k, v in graph[t].items()} for t in ("object", "actuator")}
        single = to_hetero_data({**nodes, "gravity": graph["gravity"][i : i + 1]}, SCHEMA)
        for node_type in ("object", "actuator"):
            del single[node_type].batch, single[node_type].ptr
        singles.append(single)
    batch = geometric.data.Batch.from_data_list(singles)
    for node_type in ("object", "actuator"):
        for key in ("pos", "x", "batch", "ptr"):
            assert torch.equal(batch[node_type][key], whole[node_type][key]), key
    for edge_type in (MESH, BETWEEN, GLOBAL):
        assert torch.equal(batch[edge_type].edge_index, whole[edge_type].edge_index)
    once, twice = from_hetero_data(whole, SCHEMA), from_hetero_data(batch, SCHEMA)
    assert torch.equal(once["object"]["neighbors"], twice["object"]["neighbors"])
    assert torch.equal(once["object"]["position"], twice["object"]["position"])


def scatter_convolution(conv, geometry, scalars, vectors, store, num_receivers):
    """`SteerableConv` by the recipe of PyG: a message per edge, then a scatter to the receivers.

    Args:
        conv: The layer whose weights are used.
        geometry: Whose radial functions and softening are used.
        scalars: Sender scalars, (n, C).
        vectors: Sender vectors, (n, D, 3).
        store: Edge store with edge_index and edge_attr.
        num_receivers: Number of receivers.
    """
    sender, receiver = store.edge_index
    soft = (store.edge_attr.square().sum(-1) + geometry.softening**2).sqrt()
    direction = 3**0.5 * store.edge_attr / soft[:, None]
    radial = torch.stack(geometry.basis(soft - geometry.softening), dim=-1)  # (E, Q)

    def scatter(messages):
        shape = (num_receivers, *messages.shape[1:])
        return messages.new_zeros(shape).index_add_(0, receiver, messages)

    degree = scatter(torch.ones_like(soft)).clamp(min=1.0)
    share = scatter(radial) + 0.05 * degree[:, None]
    radial = radial / share[receiver]
    s, v, mixed = scalars[sender], vectors[sender], conv.mix(scalars)[sender]
    along = (v * direction[:, None]).sum(-1)
    turned = torch.linalg.cross(direction[:, None].expand_as(v), v, dim=-1)
    pushed = mixed[..., None] * direction[:, None]
    invariant = [scatter(radial[:, :, None] * part[:, None]) for part in (s, along)]
    paths = [scatter(radial[..., None, None] * part[:, None]) for part in (pushed, v, turned)]
    # Complete edges join channels path by path, and radial functions within a path.
    out = conv.to_scalars(torch.cat([part.flatten(1) for part in invariant], dim=-1))
    joined = torch.cat([part.flatten(1, 2) for part in paths], dim=1)  # (R, channels, 3)
    return out, conv.to_vectors(joined.transpose(1, 2))


@pytest.mark.parametrize(("edge_type", "num_radial"), [(MESH, 1), (GLOBAL, 4), (BETWEEN, 3)])
def test_layer_equals_a_scatter_implementation(edge_type, num_radial, geometric):
    """One convolution on dense tensors and on the exported edges; a wrong edge would show."""
    graph = ragged_graph()
    data = to_hetero_data(graph, SCHEMA)
    sender, _, receiver = edge_type
    normalized = make_policy("grpd", SCHEMA).double().normalizer(graph)
    senders, receivers = normalized[sender], normalized[receiver]
    num_scalars = senders["scalars"].shape[-1]
    geometry = EdgeGeometry(num_radial, 1, 0.5, 0.1)
    conv = SteerableConv(num_scalars, 2, num_radial=num_radial).double()
    places = [nodes["position"].movedim(-1, 0) for nodes in (senders, receivers)]
    if edge_type == MESH:
        edges = geometry.neighbors(places[0], senders["mask"], senders["neighbors"])
    else:
        edges = geometry.complete(places[0], senders["mask"], places[1], exclude_self=edge_type == BETWEEN)
    scalars, vectors = conv(senders["scalars"], senders["vectors"].permute(3, 0, 1, 2), edges)
    store = data[edge_type]
    features = data[sender].scalars, data[sender].vectors
    count = len(data[receiver].pos)
    expected = scatter_convolution(conv, geometry, *features, store, count)
    mask = receivers["mask"]
    torch.testing.assert_close(scalars[mask], expected[0])
    torch.testing.assert_close(vectors.permute(1, 2, 0, 3)[mask], expected[1])
    store.edge_index = store.edge_index[:, 1:]
    store.edge_attr = store.edge_attr[1:]
    wrong = scatter_convolution(conv, geometry, *features, store, count)
    assert not torch.allclose(scalars[mask], wrong[0])


def test_networkx_graph_has_the_channels_and_edges():
    pytest.importorskip("networkx")
    graph = ragged_graph()
    result = to_networkx(graph, SCHEMA, index=1)
    assert result.number_of_nodes() == 7 + 3
    node = result.nodes["object", 2]
    assert node["type"] == "object"
    assert node["velocity"] == graph["object"]["vectors"][1, 2, 0].tolist()
    assert node["arc"] == graph["object"]["scalars"][1, 2, 1].item()
    kinds = [kind for _, _, kind in result.edges(data="type")]
    assert kinds.count("to") == 7 * 3
    assert kinds.count("with") == 3 * 2
    mesh = {(s[1], r[1]) for s, r, kind in result.edges(data="type") if kind == "mesh"}
    present = set(graph["object"]["mask"][1].nonzero().flatten().tolist())
    lists = graph["object"]["neighbors"][1].tolist()
    assert mesh == {(s, r) for r in present for s in lists[r] if s in present}


@pytest.mark.parametrize(
    ("convert", "package", "extra"), [(to_hetero_data, "torch_geometric", "pyg"), (to_networkx, "networkx", "networkx")]
)
def test_missing_package_names_the_install_line(convert, package, extra, monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"pip install 'maniskill-grpd\[{extra}\]'"):
        convert(make_graph(), SCHEMA)


def test_misfits_are_refused_by_name(geometric):
    graph = make_graph()
    narrow = {**graph, "object": {**graph["object"], "scalars": graph["object"]["scalars"][..., 1:]}}
    with pytest.raises(ValueError, match=r"object.scalars must have shape .*4.* got .*3"):
        to_hetero_data(narrow, SCHEMA)
    data = to_hetero_data(graph, SCHEMA)
    del data["actuator"].vectors
    with pytest.raises(ValueError, match=r"data\['actuator'\] .* lacks \['vectors'\]"):
        from_hetero_data(data, SCHEMA)
    data = to_hetero_data(graph, SCHEMA)
    del data.gravity
    with pytest.raises(ValueError, match="gravity"):
        from_hetero_data(data, SCHEMA)
