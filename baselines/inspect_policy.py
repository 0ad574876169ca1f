"""Draw what a policy looks at.

python baselines/inspect_policy.py --checkpoint runs/NAME/final_ckpt.pt --steps 0 15 30

Plays one episode and writes to the folder of the checkpoint, or to --out:

sensitivity.png    per actuator and step, how its mean action changes when an object node moves,
                   |d a_v / d p_u| (eq. 11, 47), drawn on the object; the node's goal stays fixed in
                   space, so that its offset from the goal changes too
contribution.png   per actuator and step, how far its mean action changes when an object node is
                   taken out of the graph
embedding.png      features of the object nodes after message passing, all steps of the episode, on
                   their first two principal components; coloured by place along the object,
                   distance to the goal and step

and prints how evenly the influence of the nodes is spread. Works for every policy.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # a training machine has no display

import matplotlib.pyplot as plt
import torch
import tyro
from evaluate import EvalConfig, task_config
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from run_setup import check_schema, load_policy, make_env

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.learning import CheckpointError, TrainConfig
from maniskill_grpd.learning.rollout import Graph, map_graph
from maniskill_grpd.policies import Policy

COLOR_MAP = "viridis"


@dataclass(frozen=True, kw_only=True)
class InspectConfig:
    """Options of an inspection."""

    checkpoint: str
    """the checkpoint of the policy"""
    out: Path | None = None
    """folder of the pictures; by default that of the checkpoint"""
    seed: int = 1_000_000
    """seed of the episode"""
    steps: tuple[int, ...] = (0, 15, 30)
    """steps of the episode at which nodes are examined"""
    env_id: str | None = None
    """id of the task, if not the one of the training"""
    env_kwargs: tuple[str, ...] = ()
    """options of the task as key=value pairs that replace or extend those of the training"""
    allow_import: bool = False
    """whether the id of the task in the checkpoint may be of the form module:id, which runs the code of that module"""
    sim_backend: str = "cpu"
    """where the simulation runs"""

    def __post_init__(self) -> None:
        if not self.steps or min(self.steps) < 0:
            raise ValueError(f"steps must be at least one number >= 0, got {self.steps}")


def inspect(config: InspectConfig) -> dict[str, Path]:
    """Examine a policy as configured.

    Returns:
        The files that were written, by name.
    """
    torch.set_num_threads(1)
    policy, contents = load_policy(config.checkpoint, allow_import=config.allow_import)
    graphs = play_episode(policy, config, TrainConfig.from_dict(contents["train_config"]))
    last = len(graphs) - 1
    steps = sorted({min(step, last) for step in config.steps})
    examined = [graphs[step] for step in steps]
    sensitivities = [node_sensitivity(policy, graph) for graph in examined]
    contributions = [node_contribution(policy, graph) for graph in examined]
    embeddings = torch.cat([node_embedding(policy, graph) for graph in graphs])
    figures = {
        "sensitivity": draw_on_object(policy, examined, steps, sensitivities, "|d a / d p| [largest action / cm]", 0.01),
        "contribution": draw_on_object(policy, examined, steps, contributions, "change of a without the node [largest action]"),
        "embedding": draw_embedding(policy, graphs, embeddings),
    }
    folder = config.out or Path(config.checkpoint).parent
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=110)
        plt.close(figure)
    for step, sensitivity, contribution in zip(steps, sensitivities, contributions, strict=True):
        print(f"step {step:>3}: " + describe_spread(sensitivity, contribution))
    paths = {name: folder / f"{name}.png" for name in figures}
    print("pictures: " + ", ".join(map(str, paths.values())))
    return paths


def play_episode(policy: Policy, config: InspectConfig, trained: TrainConfig) -> list[Graph]:
    """Play one episode with mean actions and return the observation graph of every step, B = 1."""
    options = EvalConfig(
        checkpoint=config.checkpoint, env_id=config.env_id, env_kwargs=config.env_kwargs, sim_backend=config.sim_backend
    )
    env = make_env(task_config(options, trained), 1)
    check_schema(policy, env)
    obs, _ = env.reset(seed=[config.seed])
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
    scalars, vectors = policy.encoder(policy.normalizer(graph))[0]
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


def draw_on_object(
    policy: Policy, graphs: list[Graph], steps: list[int], values: list[torch.Tensor], label: str, scale: float = 1.0
) -> Figure:
    """Draw one number per node and actuator on the object, seen from above.

    Args:
        policy: Whose mean actions are drawn as arrows.
        graphs: One per row, B = 1.
        steps: Step of each.
        values: (A, N) for each.
        label: Of the colour bar.
        scale: Factor on the values.

    Returns:
        A figure with one row per step and one column per actuator.
    """
    num = values[0].shape[0]
    size = (3.0 * num + 1.2, 3.2 * len(graphs) + 0.5)
    figure, axes = plt.subplots(len(graphs), num, figsize=size, squeeze=False, layout="constrained", sharex=True, sharey=True)
    for row, (graph, step, value) in enumerate(zip(graphs, steps, values, strict=True)):
        mean = policy.distribution(graph).mean[0].detach()
        for actuator, axis in enumerate(axes[row]):
            largest = max(float(value[actuator].max()), 1e-30)
            points = _draw_nodes(axis, policy.schema, graph, value[actuator] / largest)
            _draw_actuators(axis, graph, mean, actuator)
            axis.set_title(f"step {step}, actuator {actuator + 1}; largest {largest * scale:.2g}", fontsize=8)
    _set_square_limits(axes[0, 0], policy.schema, graphs)
    figure.colorbar(points, ax=axes, label="share of the largest in the panel", shrink=0.6)
    figure.suptitle(f"{policy.name}: {label}; arrow: mean action, grey line: goal", fontsize=10)
    return figure


def draw_embedding(policy: Policy, graphs: list[Graph], features: torch.Tensor) -> Figure:
    """Draw node features (T * N, F) of T graphs on their first two principal components."""
    points, share = principal_components(features)
    colorings = {
        name: torch.cat([graph["object"]["scalars"][0, :, index] for graph in graphs])
        for index, name in enumerate(c.name for c in policy.schema.object.scalars)
        if name in ("arc", "goal_distance")
    }
    count = graphs[0]["object"]["position"].shape[1]
    colorings["step"] = torch.arange(len(graphs)).repeat_interleave(count)
    figure, axes = plt.subplots(1, len(colorings), figsize=(4.2 * len(colorings), 3.8), squeeze=False, layout="constrained")
    for axis, (name, colors) in zip(axes[0], colorings.items(), strict=True):
        drawn = axis.scatter(points[:, 0], points[:, 1], c=colors, s=5, cmap=COLOR_MAP)
        figure.colorbar(drawn, ax=axis, label=name)
        axis.set_xlabel(f"component 1 ({share[0]:.0%})")
        axis.set_ylabel(f"component 2 ({share[1]:.0%})")
    figure.suptitle(f"{policy.name}: features of object nodes", fontsize=10)
    return figure


def _draw_nodes(axis: Axes, schema: GraphSchema, graph: Graph, colors: torch.Tensor) -> Any:
    nodes = {key: value[0] for key, value in graph["object"].items()}
    position, goal = nodes["position"], _goals(schema, graph)
    if goal is not None:
        axis.add_collection(_mesh_lines(goal, nodes["neighbors"], "0.7", "solid"))
    axis.add_collection(_mesh_lines(position, nodes["neighbors"], "0.3", "solid"))
    axis.set_aspect("equal")
    return axis.scatter(position[:, 0], position[:, 1], c=colors, vmin=0.0, vmax=1.0, cmap=COLOR_MAP, s=30, zorder=3)


def _goals(schema: GraphSchema, graph: Graph) -> torch.Tensor | None:
    """Goal positions of the nodes (N, 3), if the task has them."""
    offset = _channel(schema, "goal_offset")
    nodes = graph["object"]
    return None if offset is None else nodes["position"][0] + nodes["vectors"][0, :, offset]


def _set_square_limits(axis: Axes, schema: GraphSchema, graphs: list[Graph]) -> None:
    """Show the same square in all panels, which share their axes: around nodes and goals."""
    points = [graph["object"]["position"][0] for graph in graphs]
    points += [goal for graph in graphs if (goal := _goals(schema, graph)) is not None]
    low, high = (torch.cat(points)[:, :2].amin(dim=0), torch.cat(points)[:, :2].amax(dim=0))
    centre, half = (low + high) / 2.0, float((high - low).max()) / 2.0 + 0.05
    axis.set_xlim(float(centre[0]) - half, float(centre[0]) + half)
    axis.set_ylim(float(centre[1]) - half, float(centre[1]) + half)


def _mesh_lines(position: torch.Tensor, neighbors: torch.Tensor, color: str, style: str) -> LineCollection:
    first, slot = (neighbors >= 0).nonzero(as_tuple=True)
    ends = position[torch.stack([first, neighbors[first, slot]], dim=1), :2]
    return LineCollection(ends.tolist(), colors=color, linestyles=style, linewidths=1.0, zorder=1)


def _draw_actuators(axis: Axes, graph: Graph, mean: torch.Tensor, selected: int) -> None:
    position = graph["actuator"]["position"][0]
    axis.scatter(position[:, 0], position[:, 1], s=90, facecolors="none", edgecolors="0.5", zorder=2)
    x, y = position[selected, :2].tolist()
    dx, dy = (0.1 * mean[selected, :2]).tolist()
    axis.scatter([x], [y], s=110, facecolors="none", edgecolors="red", linewidths=2.0, zorder=4)
    axis.annotate("", (x + dx, y + dy), (x, y), arrowprops={"arrowstyle": "->", "color": "red", "lw": 1.5})


def _move_nodes(schema: GraphSchema, graph: Graph, position: torch.Tensor) -> Graph:
    """Return the graph with its nodes at `position`, whose goals stay where they are."""
    nodes = dict(graph["object"])
    shift = position - nodes["position"]
    offset = _channel(schema, "goal_offset")
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


def _channel(schema: GraphSchema, name: str) -> int | None:
    names = [channel.name for channel in schema.object.vectors]
    return names.index(name) if name in names else None


def main(arguments: Sequence[str]) -> int:
    """Inspect; report what the user can mend in one line instead of a traceback."""
    try:
        inspect(tyro.cli(InspectConfig, args=list(arguments), description=__doc__))
    except (ValueError, OSError, CheckpointError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
