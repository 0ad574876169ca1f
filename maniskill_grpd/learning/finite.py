"""Stopping on the first non-finite number, with its name and place."""

from __future__ import annotations

import torch

from maniskill_grpd.learning.rollout import Graph, graph_items


class NonFiniteError(ArithmeticError):
    """Training met a NaN or an infinity. The checkpoints on disk are from before it."""


def check_finite(name: str, tensor: torch.Tensor, where: str) -> None:
    """Raise if a per-environment tensor holds a non-finite number.

    Args:
        name: What the tensor is, for the message.
        tensor: (B, ...).
        where: When in training this is, for the message.

    Raises:
        NonFiniteError: Naming `name`, `where` and the environments concerned.
    """
    finite = torch.isfinite(tensor)
    if finite.all():
        return
    rows = (~finite).reshape(tensor.shape[0], -1).any(-1).nonzero().flatten().tolist()
    listed = ", ".join(map(str, rows[:8])) + (", ..." if len(rows) > 8 else "")
    raise NonFiniteError(
        f"{name} is not finite {where}, in environment(s) {listed} ({len(rows)} of "
        f"{tensor.shape[0]}). Training stopped; the last checkpoint is untouched."
    )


def check_graph_finite(graph: Graph, where: str) -> None:
    """Raise if an observation graph holds a non-finite number in a node that is not padding.

    Args:
        graph: Observation graphs, (B, ...) per tensor.
        where: When in training this is, for the message.

    Raises:
        NonFiniteError: Naming the tensor.
    """
    masks = {name: tensor for name, tensor in graph_items(graph) if name.endswith("mask")}
    for name, tensor in graph_items(graph):
        if not tensor.is_floating_point():
            continue
        mask = masks.get(f"{name.rpartition('.')[0]}.mask")
        if mask is not None:
            tensor = torch.where(mask.reshape(mask.shape + (1,) * (tensor.ndim - mask.ndim)), tensor, 0.0)
        check_finite(f"observation {name}", tensor, where)
