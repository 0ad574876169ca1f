"""Measure time and memory of the policies against the number of nodes and actuators, in one run.

python benchmarks/policy.py [--quick] [--json FILE]

Subjects: the four policies at their default sizes (equal numbers of parameters within 10 %); EMPN
at GRPD's width; GRPD with messages that do not know their receiver (as wide as fits the number of
parameters), with harmonics of degree 2 or with three radial functions along mesh edges; GRPD with
the same weights and the same kernel but a message formed on every edge and then summed (eq. 2 as
written); and an outside peer, an equivariant message passing layer of PyTorch Geometric (ViS_MP of
ViSNet) of GRPD's width on the same edges, if torch_geometric is installed. Each forward pass gives
distribution and value of a batch of ropes; the backward pass is that of log-probability plus value,
to all parameters.

Other programs may run on the machine: on a CPU the time is that of one thread's own processor
time, which does not count waiting for a core; in each repeat all subjects take turns, and a ratio
is the median of the ratios within a repeat, time of the subject over time of GRPD. Peak memory is
the largest sum of the tensors alive during a call, over those before it.
"""

from __future__ import annotations

import argparse
import copy
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from machine import describe_machine, report
from torch import nn

from maniskill_grpd.graphs import Channel, GraphSchema, NodeSchema
from maniskill_grpd.policies import make_policy
from maniskill_grpd.policies.layers import CompleteEdges, NeighborEdges, SteerableConv

BATCH = 8
"""Graphs per call."""
NUM_NODES = (20, 50, 100, 200, 500, 1000, 1200)
MAX_ACTUATORS = 4
LARGE = 1000
"""Number of nodes at which the number of actuators is varied."""
REFERENCE = "grpd"
VARIANTS: dict[str, dict[str, Any]] = {
    "grpd, messages without receiver": {"receiver_gates": False, "actuator_scalar_dim": 64},
    "grpd, l = 2 on mesh edges": {"max_local_degree": 2},
    "grpd, 3 radial functions on mesh edges": {"num_local_radial": 3},
}
"""Options of GRPD beside its defaults."""
PER_EDGE = "grpd, a message per edge"
PEER = "ViS_MP (torch_geometric)"
MODES = ("forward", "forward+backward")


def rope_schema(num_nodes: int) -> GraphSchema:
    """Return the channels of RopeShaping-v1 for a rope of 0.8 m."""

    def channels(kind: str, *names: str) -> tuple[Channel, ...]:
        return tuple(Channel(name, kind, "", "benchmark") for name in names)

    vectors = channels("vector", "velocity", "goal_offset")
    return GraphSchema(
        object=NodeSchema(vectors, channels("scalar", "goal_distance", "arc", "held", "contact")),
        actuator=NodeSchema(vectors, channels("scalar", "goal_distance", "arc", "gripper_status")),
        length_scale=0.8,
        edge_length=0.8 / (num_nodes - 1),
    )


def rope_graph(num_nodes: int, num_actuators: int, device: torch.device) -> dict[str, Any]:
    """Return BATCH random ropes, held at evenly spaced nodes."""
    generator = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    def nodes(position: torch.Tensor, num_scalars: int) -> dict[str, torch.Tensor]:
        count = position.shape[1]
        return {
            "position": position,
            "vectors": 0.2 * normal(BATCH, count, 2, 3),
            "scalars": normal(BATCH, count, num_scalars),
            "mask": torch.ones(BATCH, count, dtype=torch.bool),
        }

    steps = normal(BATCH, 1, 3) + 0.5 * normal(BATCH, num_nodes, 3)
    position = (0.8 / num_nodes * nn.functional.normalize(steps, dim=-1)).cumsum(dim=1)
    held = torch.linspace(0, num_nodes - 1, num_actuators).long()
    line = torch.arange(num_nodes)
    neighbors = torch.stack([line - 1, line + 1], dim=1)
    neighbors[neighbors == num_nodes] = -1
    graph = {
        "object": nodes(position, 4) | {"neighbors": neighbors.expand(BATCH, -1, -1).contiguous()},
        "actuator": nodes(position[:, held], 3),
        "gravity": torch.tensor([0.0, 0.0, -9.81]).repeat(BATCH, 1),
    }
    return _to(graph, device)


class PerEdgeConv(nn.Module):
    """`SteerableConv` with its own weights and kernel, but with messages per edge and channel.

    The reference for what aggregating before contracting saves: first the message kappa(p_rs) h_s
    of every edge is formed, (receivers, senders, channels), then messages are summed.

    Args:
        conv: The layer whose weights are used; degree 1.
    """

    def __init__(self, conv: SteerableConv) -> None:
        super().__init__()
        if conv.max_degree != 1:
            raise ValueError(f"max_degree must be 1, got {conv.max_degree}")
        self.mix, self.to_scalars, self.to_vectors, self.gate = conv.mix, conv.to_scalars, conv.to_vectors, conv.gate

    def forward(
        self,
        scalars: torch.Tensor,
        vectors: torch.Tensor,
        edges: CompleteEdges | NeighborEdges,
        receivers: tuple[torch.Tensor, torch.Tensor] | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """See `SteerableConv.forward`."""
        if isinstance(edges, CompleteEdges):
            batch, count, rows, senders = edges.weights.shape
            factors = edges.weights.view(batch, count, -1, edges.num_radial, senders)
            factors = factors.permute(1, 0, 2, 4, 3).unsqueeze(-1)  # (M, B, R, S, Q, 1)
            scalars, vectors = scalars[:, None], vectors[:, :, None]
        else:
            batch = scalars.shape[0]
            factors = edges.weights.permute(1, 0, 4, 2, 3).unsqueeze(-1)  # (M, B, R, K, Q, 1)
            first = torch.arange(batch, device=scalars.device)[:, None, None] * scalars.shape[1]
            index = edges.senders.transpose(1, 2) + first  # (B, R, K)
            scalars = scalars.flatten(0, 1)[index]
            vectors = vectors.flatten(1, 2)[:, index]
        still, *direction = factors
        mixed = self.mix(scalars)
        x, y, z = vectors.unbind(0)
        px, py, pz = direction
        dot = _times(px, x) + _times(py, y) + _times(pz, z)
        invariant = torch.cat([_times(still, scalars), dot], dim=-1)
        cross = (_times(py, z) - _times(pz, y), _times(pz, x) - _times(px, z), _times(px, y) - _times(py, x))
        paths = [
            torch.cat([_times(p, mixed), _times(still, v), c], dim=-1) for p, v, c in zip(direction, vectors, cross, strict=True)
        ]
        if self.gate is not None:
            to_scalars, to_vectors = (factor[:, :, None] for factor in self.gate(*receivers))
            invariant, paths = invariant * to_scalars, [path * to_vectors for path in paths]
        messages = [self.to_vectors(path).sum(dim=2) for path in paths]
        # The bias belongs to the receiver, not to each of its messages.
        sent = nn.functional.linear(invariant, self.to_scalars.weight).sum(dim=2)
        return sent + self.to_scalars.bias, torch.stack(messages)


def _times(factor: torch.Tensor, feature: torch.Tensor) -> torch.Tensor:
    """Kernel factors (..., Q, 1) times features (..., F), (..., Q * F)."""
    return (factor * feature.unsqueeze(-2)).flatten(-2)


def with_messages_per_edge(policy: nn.Module) -> nn.Module:
    """Return a copy of a policy whose convolutions form messages per edge."""
    policy = copy.deepcopy(policy)
    for module in list(policy.modules()):
        for name, child in module.named_children():
            if isinstance(child, SteerableConv):
                setattr(module, name, PerEdgeConv(child))
    return policy


def make_peer(graph: Mapping[str, Any]) -> nn.Module | None:
    """Return a policy around one message passing layer of PyTorch Geometric; None without it."""
    try:
        from torch_geometric.nn.models.visnet import ViS_MP
    except ImportError:
        return None
    return PeerPolicy(ViS_MP, graph)


class PeerPolicy(nn.Module):
    """One ViS_MP layer between linear embeddings and linear heads, GRPD's width and message paths.

    Mesh edges, edges between actuators and from all objects to all actuators, in one homogeneous
    graph whose edge index is built once and not timed.

    Args:
        layer: The class ViS_MP.
        graph: Gives the numbers of nodes and channels.
        hidden: Scalar and vector channels.
        num_radial: Radial functions.
    """

    def __init__(self, layer: type, graph: Mapping[str, Any], hidden: int = 32, num_radial: int = 6) -> None:
        super().__init__()
        self.centers = [i / (num_radial - 1) for i in range(num_radial)]
        self.scalars = nn.ModuleDict({key: nn.Linear(graph[key]["scalars"].shape[-1], hidden) for key in NODES})
        self.vectors = nn.ModuleDict({key: nn.Linear(graph[key]["vectors"].shape[2], hidden, bias=False) for key in NODES})
        self.edge = nn.Linear(num_radial, hidden)
        self.layer = layer(4, hidden, 100.0, None, False, last_layer=True)
        self.mean = nn.Linear(hidden, 1, bias=False)
        self.value = nn.Linear(hidden, 1)
        self.register_buffer("edges", _homogeneous_edges(graph))

    def forward(self, graph: Mapping[str, Any]) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean actions (B, A, 3) and values (B,)."""
        position = torch.cat([graph[key]["position"] for key in NODES], dim=1)
        batch, count, _ = position.shape
        x = torch.cat([self.scalars[k](graph[k]["scalars"]) for k in NODES], dim=1).flatten(0, 1)
        vec = torch.cat([self.vectors[k](graph[k]["vectors"].transpose(2, 3)) for k in NODES], dim=1).flatten(0, 1)
        position = position.flatten(0, 1)
        offset = position[self.edges[0]] - position[self.edges[1]]
        distance = (offset.square().sum(-1) + 1e-8).sqrt()
        radial = torch.stack([torch.exp(-((distance - c) * 5.0).square()) for c in self.centers], -1)
        change, turn, _ = self.layer(x, vec, self.edges, distance, self.edge(radial), offset / distance[:, None])
        x, vec = (x + change).view(batch, count, -1), (vec + turn).view(batch, count, 3, -1)
        num_actuators = graph["actuator"]["position"].shape[1]
        mean = self.mean(vec[:, -num_actuators:]).squeeze(-1)
        return mean, self.value(x.mean(dim=1)).squeeze(-1)


NODES = ("object", "actuator")


def _homogeneous_edges(graph: Mapping[str, Any]) -> torch.Tensor:
    """Senders and receivers of all edges of a batch, (2, E)."""
    count, tools = (graph[key]["position"].shape[1] for key in NODES)
    neighbors = graph["object"]["neighbors"][0]
    receiver, slot = (neighbors >= 0).nonzero(as_tuple=True)
    mesh = torch.stack([neighbors[receiver, slot], receiver])
    first = torch.arange(count + tools, device=mesh.device)
    last = first[count:]
    complete = torch.cartesian_prod(first, last).t()
    complete = complete[:, complete[0] != complete[1]]
    one = torch.cat([mesh, complete], dim=1)
    shift = torch.arange(BATCH, device=mesh.device) * (count + tools)
    return (one[:, None] + shift[:, None]).flatten(1)


def make_subjects(num_nodes: int, graph: Mapping[str, Any]) -> dict[str, nn.Module]:
    """Return everything that is measured, on the device of the graph."""
    torch.manual_seed(0)
    schema = rope_schema(num_nodes)
    subjects: dict[str, nn.Module | None] = {
        name: make_policy(name, schema) for name in (REFERENCE, "empn", "hetero_gnn", "transformer")
    }
    options = subjects[REFERENCE].config["options"]
    width = {key: options[key] for key in ("scalar_dim", "vector_dim")}
    subjects["empn, width of grpd"] = make_policy("empn", schema, **width)
    subjects |= {name: make_policy(REFERENCE, schema, **kwargs) for name, kwargs in VARIANTS.items()}
    subjects[PER_EDGE] = with_messages_per_edge(subjects[REFERENCE])
    subjects[PEER] = make_peer(graph)
    device = graph["gravity"].device
    return {name: s.to(device) for name, s in subjects.items() if s is not None}


def check_equal(ours: nn.Module, per_edge: nn.Module, graph: Mapping[str, Any]) -> float:
    """Return how far the two forms of GRPD are apart, relative to the mean action.

    Raises:
        RuntimeError: If it is more than rounding: then they are not the same policy.
    """
    with torch.no_grad():
        one, other = (policy(graph)[0].mean for policy in (ours, per_edge))
    error = float((one - other).norm() / one.norm())
    if not error < 1e-4:
        raise RuntimeError(f"the per-edge form differs from GRPD by {error:.1e}")
    return error


def forward(policy: nn.Module, graph: Mapping[str, Any]) -> None:
    """Distribution and value without gradients."""
    with torch.no_grad():
        policy(graph)


def forward_backward(policy: nn.Module, graph: Mapping[str, Any]) -> None:
    """Distribution, value and the gradient of their loss."""
    policy.zero_grad(set_to_none=True)
    output, value = policy(graph)
    # The peer has no distribution, only mean actions.
    is_peer = isinstance(output, torch.Tensor)
    score = output.square() if is_peer else output.log_prob(torch.zeros_like(output.mean))
    (score.sum() + value.sum()).backward()


CALLS: dict[str, Callable[[nn.Module, Mapping[str, Any]], None]] = dict(zip(MODES, (forward, forward_backward), strict=True))


def seconds_per_call(call: Callable[..., None], policy: nn.Module, graph: Mapping[str, Any], budget: float) -> float:
    """Return the time of one call, over about `budget` seconds of calls."""
    device, count = graph["gravity"].device, 0
    clock = time.perf_counter if device.type == "cuda" else time.process_time
    start = clock()
    while True:
        call(policy, graph)
        count += 1
        if clock() - start > budget:
            _synchronize(device)
            return (clock() - start) / count


def peak_memory(call: Callable[..., None], policy: nn.Module, graph: Mapping[str, Any]) -> float:
    """Return the largest sum of tensors alive during a call, over those before it [MiB]."""
    device = graph["gravity"].device
    if device.type == "cuda":
        policy.zero_grad(set_to_none=True)
        torch.cuda.reset_peak_memory_stats(device)
        before = torch.cuda.memory_allocated(device)
        call(policy, graph)
        return (torch.cuda.max_memory_allocated(device) - before) / 2**20
    policy.zero_grad(set_to_none=True)
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU], profile_memory=True) as profile:
        call(policy, graph)
    # Allocations and releases in order of time.
    events = [e for e in profile.profiler.kineto_results.events() if e.name() == "[memory]"]
    alive = peak = 0
    for event in sorted(events, key=lambda e: e.start_ns()):
        alive += event.nbytes()
        peak = max(peak, alive)
    return peak / 2**20


def measure_size(
    num_nodes: int, num_actuators: int, *, device: torch.device, budget: float, repeats: int
) -> list[dict[str, Any]]:
    """Return one row per subject and mode for graphs of one size."""
    graph = rope_graph(num_nodes, num_actuators, device)
    subjects = make_subjects(num_nodes, graph)
    check_equal(subjects[REFERENCE], subjects[PER_EDGE], graph)
    rows = []
    for mode, call in CALLS.items():
        for policy in subjects.values():  # warm-up
            seconds_per_call(call, policy, graph, 0.0)
        times: dict[str, list[float]] = {name: [] for name in subjects}
        for _ in range(repeats):
            for name, policy in subjects.items():
                times[name].append(seconds_per_call(call, policy, graph, budget))
        for name, policy in subjects.items():
            row = {
                "policy": name,
                "parameters": sum(p.numel() for p in policy.parameters()),
                "nodes": num_nodes,
                "actuators": num_actuators,
                "mode": mode,
                "ms": 1e3 * statistics.median(times[name]),
                "min": 1e3 * min(times[name]),
                "max": 1e3 * max(times[name]),
                "peak_mib": peak_memory(call, policy, graph),
            }
            if name != REFERENCE:
                paired = zip(times[name], times[REFERENCE], strict=True)
                row |= {"peer": name, "ratio": statistics.median(a / b for a, b in paired)}
            rows.append(row)
    return rows


def measure(*, device: torch.device, quick: bool) -> list[dict[str, Any]]:
    """Return the rows of all sizes: nodes with all actuators, then actuators at LARGE nodes."""
    settings = {"budget": 0.05 if quick else 0.1, "repeats": 2 if quick else 5, "device": device}
    nodes = (20, 100, 400, LARGE) if quick else NUM_NODES
    sizes = [(count, MAX_ACTUATORS) for count in nodes]
    sizes += [(LARGE, tools) for tools in ((1,) if quick else range(1, MAX_ACTUATORS))]
    rows = []
    for num_nodes, num_actuators in sizes:
        sys.stderr.write(f"{num_nodes} nodes, {num_actuators} actuators\n")
        rows += measure_size(num_nodes, num_actuators, **settings)
    if not any(row["policy"] == PEER for row in rows):
        sys.stdout.write("torch_geometric is not installed: the outside peer is skipped\n")
    return rows


def _synchronize(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def _to(graph: Any, device: torch.device) -> Any:
    if isinstance(graph, dict):
        return {key: _to(value, device) for key, value in graph.items()}
    return graph.to(device)


def main() -> None:
    """Parse the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few sizes and short measurements, for a look")
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--json", type=Path, help="file for the rows")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    device = torch.device(arguments.device)
    rows = measure(device=device, quick=arguments.quick)
    report(rows, describe_machine(device.type), arguments.json)


if __name__ == "__main__":
    main()
