"""The parts of the policy benchmark that its figures rest on."""

import pytest
import torch

pytest.importorskip("mani_skill")  # `policy` lies beside scripts that need it

import policy as benchmark

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def graph():
    return benchmark.rope_graph(30, 3, CPU)


def test_graph_fits_the_schema(graph):
    benchmark.rope_schema(30).validate(graph, values=True)


def test_per_edge_form_is_the_same_policy(graph):
    """Same kernel, same weights, messages per edge: equal to rounding, gradients too."""
    subjects = benchmark.make_subjects(30, graph)
    ours, per_edge = subjects["grpd"].double(), subjects[benchmark.PER_EDGE].double()
    double = _double(graph)
    assert benchmark.check_equal(ours, per_edge, double) < 1e-12
    for policy in (ours, per_edge):
        benchmark.forward_backward(policy, double)
    gradients = [dict(policy.named_parameters()) for policy in (ours, per_edge)]
    for name, parameter in gradients[0].items():
        torch.testing.assert_close(gradients[1][name].grad, parameter.grad, rtol=1e-9, atol=1e-12, msg=name)


def test_a_different_kernel_is_noticed(graph):
    """Negative control of the comparison above."""
    subjects = benchmark.make_subjects(30, graph)
    with torch.no_grad():
        subjects[benchmark.PER_EDGE].encoder.global_round.conv.to_vectors.weight.mul_(1.1)
    with pytest.raises(RuntimeError, match="differs from GRPD"):
        benchmark.check_equal(subjects["grpd"], subjects[benchmark.PER_EDGE], graph)


def test_peak_memory_counts_what_is_alive_at_once():
    """Two tensors of 1 MiB of which one is released before the third: 2 MiB, not 3."""

    def call(policy, graph):
        one = torch.ones(2**18)
        two = one + 1.0
        del one
        return two + 1.0

    graph = {"gravity": torch.zeros(1)}
    peak = benchmark.peak_memory(call, torch.nn.Identity(), graph)
    assert peak == pytest.approx(2.0, abs=0.01)


def test_rows(monkeypatch):
    monkeypatch.setattr(benchmark, "LARGE", 200)
    rows = []
    for nodes in (100, 200):
        rows += benchmark.measure_size(nodes, 4, device=CPU, budget=0.0, repeats=1)
    assert all(("ratio" in row) == (row["policy"] != "grpd") for row in rows)
    assert all(row["ms"] > 0.0 and row["peak_mib"] > 0.0 for row in rows)
    assert {row["policy"] for row in rows} >= {"grpd", "empn", "hetero_gnn", "transformer", benchmark.PER_EDGE}


def test_outside_peer_has_the_same_message_paths(graph):
    """2 * 29 mesh edges, 30 * 3 to actuators, 3 * 2 between them, in each of the graphs."""
    edges = benchmark._homogeneous_edges(graph)
    assert edges.shape == (2, benchmark.BATCH * (58 + 90 + 6))
    assert edges.max() == benchmark.BATCH * 33 - 1


def test_outside_peer_is_equivariant(graph):
    pytest.importorskip("torch_geometric")
    peer = benchmark.make_peer(graph)
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = {"gravity": graph["gravity"] @ turn.T}
    for key in benchmark.NODES:
        moved = {name: graph[key][name] @ turn.T for name in ("position", "vectors")}
        turned[key] = {**graph[key], **moved}
    torch.testing.assert_close(peer(turned)[0], peer(graph)[0] @ turn.T, rtol=1e-4, atol=1e-5)


def _double(tree):
    if isinstance(tree, dict):
        return {key: _double(value) for key, value in tree.items()}
    return tree.double() if tree.is_floating_point() else tree
