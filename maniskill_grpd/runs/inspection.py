"""What a policy looks at: the influence of every object node on every action."""

from __future__ import annotations

import torch

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.rollout import Graph, map_graph
from maniskill_grpd.policies import Policy
from maniskill_grpd.runs.checkpoints import check_schema
from maniskill_grpd.runs.environments import make_env


def play_episode(policy: Policy, task: TrainConfig, seed: int) -> list[Graph]:
    """Play one episode with mean actions and return the observation graph of every step, B = 1."""
    env = make_env(task, 1)
    check_schema(policy, env)
    obs, _ = env.reset(seed=[seed])
    graphs, is_over = [], False
    while not is_over:
        graphs.append(obs["graph"])
        obs, _, _, truncated, _ = env.step(policy.act(obs["graph"], deterministic=True))
        is_over = bool(torch.as_tensor(truncated).all())
    env.close()
    return graphs


def node_sensitivity(policy: Policy, graph: Graph) -> torch.Tensor:
    """Frobenius norm of the Jacobian of each mean action with respect to each node's position.

    The goal of the node stays where it is: its channels goal_offset and goal_distance, where the
    schema has them, move along with its position.

    Args:
        policy: The policy.
        graph: A raw graph, B = 1, N nodes, A actuators.

    Returns:
        (A, N) [largest action / m].
    """
    position = graph["object"]["position"].detach().clone().requires_grad_()
    mean = policy.distribution(_move_nodes(policy.schema, graph, position)).mean[0]
    rows = []
    for entry in mean.flatten():
        (gradient,) = torch.autograd.grad(entry, position, retain_graph=True, materialize_grads=True)
        rows.append(gradient[0])
    jacobian = torch.stack(rows).view(*mean.shape, -1, 3)  # (A, 3, N, 3)
    return jacobian.square().sum(dim=(1, 3)).sqrt()


@torch.no_grad()
def node_contribution(policy: Policy, graph: Graph) -> torch.Tensor:
    """Distance between each mean action and what it is without a node.

    Args:
        policy: The policy.
        graph: A raw graph, B = 1, N nodes, A actuators.

    Returns:
        (A, N) [largest action].
    """
    count = graph["object"]["position"].shape[1]
    copies = map_graph(lambda tensor: tensor.expand(count, *tensor.shape[1:]), graph)
    mask = copies["object"]["mask"] & ~torch.eye(count, dtype=torch.bool)
    without = policy.distribution({**copies, "object": {**copies["object"], "mask": mask}}).mean
    whole = policy.distribution(graph).mean
    return torch.linalg.vector_norm(without - whole, dim=-1).t()


@torch.no_grad()
def node_embedding(policy: Policy, graph: Graph) -> torch.Tensor:
    """Invariant features of the object nodes after message passing, (N, C + D), B = 1."""
    scalars, vectors = policy.encoder(policy.prepare(graph))[0]
    return torch.cat([scalars[0], torch.linalg.vector_norm(vectors[:, 0], dim=0)], dim=-1)


def principal_components(features: torch.Tensor, num: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    """Project rows (M, F) on their first principal components.

    Returns:
        (M, num), and the share of the variance that each component holds, (num,).
    """
    centred = (features - features.mean(dim=0)).double()
    left, values, _ = torch.linalg.svd(centred, full_matrices=False)
    share = values.square() / values.square().sum().clamp(min=1e-30)
    return left[:, :num] * values[:num], share[:num]


def describe_spread(sensitivity: torch.Tensor, contribution: torch.Tensor) -> str:
    """Say how evenly influence (A, N) is spread: smallest over largest, and by how many nodes."""
    parts = []
    for name, influence in (("sensitivity", sensitivity), ("contribution", contribution)):
        share = influence / influence.sum(dim=1, keepdim=True).clamp(min=1e-30)
        effective = (1.0 / share.square().sum(dim=1).clamp(min=1e-30)).mean()
        lowest = (influence.amin(dim=1) / influence.amax(dim=1).clamp(min=1e-30)).min()
        parts.append(f"{name}: {effective:.1f} of {influence.shape[1]} nodes count, weakest / strongest {lowest:.1e}")
    return "; ".join(parts)


def _move_nodes(schema: GraphSchema, graph: Graph, position: torch.Tensor) -> Graph:
    """Return the graph with its nodes at `position`, whose goals stay where they are."""
    nodes = dict(graph["object"])
    shift = position - nodes["position"]
    offset = vector_index(schema, "goal_offset")
    if offset is not None:
        moved = nodes["vectors"][:, :, offset] - shift
        nodes["vectors"] = _replace(nodes["vectors"], offset, moved)
        names = [channel.name for channel in schema.object.scalars]
        if "goal_distance" in names:
            # The root has no gradient at zero: nodes exactly at their goal keep a tiny distance.
            distance = (moved.square().sum(-1) + 1e-16).sqrt()
            nodes["scalars"] = _replace(nodes["scalars"], names.index("goal_distance"), distance)
    return {**graph, "object": {**nodes, "position": position}}


def _replace(channels: torch.Tensor, index: int, value: torch.Tensor) -> torch.Tensor:
    parts = list(channels.unbind(2))
    parts[index] = value
    return torch.stack(parts, dim=2)


def vector_index(schema: GraphSchema, name: str) -> int | None:
    """Return the place of a vector channel of the object, None if there is none."""
    names = [channel.name for channel in schema.object.vectors]
    return names.index(name) if name in names else None
