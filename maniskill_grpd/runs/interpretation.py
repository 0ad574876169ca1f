"""Where on a cloth or rope a policy looks, and which nodes it takes for alike (B.F), in figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import torch

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.rollout import Graph
from maniskill_grpd.policies import Policy
from maniskill_grpd.runs.inspection import node_contribution, node_embedding, node_sensitivity, play_episode

NEAREST_SHARE = 0.25
"""Share of the nodes that count as near a gripper."""
_AT_A_CORNER = 0.99
"""Least value of the channel `corner` of a node that is one."""


@dataclass(frozen=True, kw_only=True)
class Interpretation:
    """What a policy looks at, averaged over grippers, steps and episodes.

    Attributes:
        nodes: Object nodes of a graph.
        effective_nodes: Nodes among which the sensitivity of a gripper would have to be shared equally to be as spread as it is.
        shares: By group of nodes, the influence of one of them over that of an average node: by sensitivity
            |d a / d p| and by what the action changes without the node. 1 is no preference.
        alikeness: By group, the mean distance of its nodes' features from each other over that from all other nodes; below 1 they
            cluster.
    """

    nodes: int
    effective_nodes: float
    shares: dict[str, dict[str, float]] = field(default_factory=dict)
    alikeness: dict[str, float] = field(default_factory=dict)


def interpret(policy: Policy, task: TrainConfig, seeds: Iterable[int], steps: Sequence[int]) -> Interpretation:
    """Play episodes with a policy and look at some of their steps.

    Args:
        policy: The policy.
        task: Where it acts.
        seeds: One episode for each.
        steps: Those looked at; an episode that is shorter gives its last.
    """
    looks: list[Interpretation] = []
    for seed in seeds:
        graphs = play_episode(policy, task, seed)
        looks += [look(policy, graphs[step]) for step in sorted({min(step, len(graphs) - 1) for step in steps})]
    groups = sorted(set().union(*(each.shares for each in looks)))
    return Interpretation(
        nodes=looks[0].nodes,
        effective_nodes=_mean(each.effective_nodes for each in looks),
        shares={
            group: {kind: _mean(each.shares[group][kind] for each in looks if group in each.shares) for kind in KINDS}
            for group in groups
        },
        alikeness={
            group: _mean(each.alikeness[group] for each in looks if group in each.alikeness)
            for group in groups
            if any(group in each.alikeness for each in looks)
        },
    )


KINDS = ("sensitivity", "contribution")


def look(policy: Policy, graph: Graph) -> Interpretation:
    """Examine one graph, B = 1."""
    influences = {"sensitivity": node_sensitivity(policy, graph), "contribution": node_contribution(policy, graph)}
    groups = node_groups(policy.schema, graph)
    share = influences["sensitivity"] / influences["sensitivity"].sum(dim=1, keepdim=True).clamp(min=1e-30)
    features = node_embedding(policy, graph)
    return Interpretation(
        nodes=share.shape[1],
        effective_nodes=float((1.0 / share.square().sum(dim=1).clamp(min=1e-30)).mean()),
        shares={
            name: {kind: relative_share(influence, members) for kind, influence in influences.items()}
            for name, members in groups.items()
        },
        alikeness={
            name: alikeness(features, members[0])
            for name, members in groups.items()
            if 2 <= int(members[0].sum()) < len(features) and bool((members == members[0]).all())
        },
    )


def node_groups(schema: GraphSchema, graph: Graph) -> dict[str, torch.Tensor]:
    """Return which object nodes are special to each gripper, (A, N) bool by name; groups that have no node are left out.

    Corners, held nodes and, where the task has a crease, nodes along it (which have a neighbour on its other side) are the same
    for all grippers; near ones are the quarter nearest to each.
    """
    nodes, tools = graph["object"], graph["actuator"]["position"][0]
    scalars = {channel.name: nodes["scalars"][0, :, index] for index, channel in enumerate(schema.object.scalars)}
    found: dict[str, torch.Tensor] = {}
    if "corner" in scalars:
        found["corners"] = scalars["corner"] >= _AT_A_CORNER
    if "held" in scalars:
        found["held"] = scalars["held"] > 0.5
    if "is_moving" in scalars:
        side, neighbors = scalars["is_moving"] > 0.5, nodes["neighbors"][0]
        found["fold line"] = ((side[neighbors.clamp(min=0)] != side[:, None]) & (neighbors >= 0)).any(dim=1)
    groups = {name: members.expand(len(tools), -1) for name, members in found.items()}
    distance = torch.cdist(tools, nodes["position"][0])
    nearest = distance.topk(max(1, int(NEAREST_SHARE * distance.shape[1])), largest=False).indices
    groups["near the gripper"] = torch.zeros_like(distance, dtype=torch.bool).scatter(1, nearest, True)
    return {name: members for name, members in groups.items() if bool(members.any(dim=1).all())}


def relative_share(influence: torch.Tensor, members: torch.Tensor) -> float:
    """Return the mean influence of the members over that of all nodes, both (A, N), averaged over grippers."""
    inside = (influence * members).sum(dim=1) / members.sum(dim=1)
    return float((inside / influence.mean(dim=1).clamp(min=1e-30)).mean())


def alikeness(features: torch.Tensor, members: torch.Tensor) -> float:
    """Return the mean distance of members (N,) from each other over that from all others, of features (N, F) of equal spread."""
    scaled = (features - features.mean(dim=0)) / features.std(dim=0).clamp(min=1e-6)
    distance = torch.cdist(scaled, scaled)
    count = int(members.sum())
    within = distance[members][:, members].sum() / (count * (count - 1))
    return float(within / distance[members][:, ~members].mean().clamp(min=1e-30))


def _mean(values: Iterable[float]) -> float:
    found = list(values)
    return sum(found) / len(found)
