"""Pictures of what a policy looks at."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.learning.rollout import Graph
from maniskill_grpd.policies import Policy
from maniskill_grpd.runs.inspection import (
    describe_spread,
    node_contribution,
    node_embedding,
    node_sensitivity,
    principal_components,
    vector_index,
)

COLOR_MAP = "viridis"


def write_inspection(policy: Policy, graphs: list[Graph], steps: list[int], folder: Path) -> tuple[list[Path], list[str]]:
    """Examine a policy along an episode, and draw sensitivity, contribution and embedding.

    Args:
        policy: The policy.
        graphs: The observation graph of every step of the episode, B = 1.
        steps: Steps at which single nodes are examined.
        folder: Of the pictures; made where it is missing.

    Returns:
        The pictures, and for each of the steps a line that says how evenly influence is spread.
    """
    examined = [graphs[step] for step in steps]
    sensitivities = [node_sensitivity(policy, graph) for graph in examined]
    contributions = [node_contribution(policy, graph) for graph in examined]
    embeddings = torch.cat([node_embedding(policy, graph) for graph in graphs])
    figures = {
        "sensitivity": draw_on_object(policy, examined, steps, sensitivities, "|d a / d p| [largest action / cm]", 0.01),
        "contribution": draw_on_object(policy, examined, steps, contributions, "change of a without the node [largest action]"),
        "embedding": draw_embedding(policy, graphs, embeddings),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=110)
    influences = zip(steps, sensitivities, contributions, strict=True)
    lines = [f"step {step:>3}: {describe_spread(sensitivity, contribution)}" for step, sensitivity, contribution in influences]
    return [folder / f"{name}.png" for name in figures], lines


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
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(graphs), num, squeeze=False, sharex=True, sharey=True)
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
    figure = Figure(figsize=(4.2 * len(colorings), 3.8), layout="constrained")
    axes = figure.subplots(1, len(colorings), squeeze=False)
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
    offset = vector_index(schema, "goal_offset")
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
