"""Updating the scales of observations from rollouts that several processes hold."""

from __future__ import annotations

import torch

from maniskill_grpd.graphs import GraphNormalizer
from maniskill_grpd.graphs.schema import NODE_TYPES
from maniskill_grpd.learning.rollout import Graph
from maniskill_grpd.learning.workers import Workers


@torch.no_grad()
def update_normalizer(normalizer: GraphNormalizer, graph: Graph, workers: Workers) -> None:
    """Add the graphs of all processes to the statistics; all end with the same ones.

    Every process adds its own to what all share; sums are then count * mean square, and the sum
    over processes of what each has added is what they add together.

    Args:
        normalizer: Changed in place; the same in every process.
        graph: Raw graphs of this process, any leading batch size.
        workers: The processes.
    """
    before = {name: buffer.clone() for name, buffer in normalizer.named_buffers()}
    normalizer.update(graph)
    if workers.size == 1:
        return
    buffers = dict(normalizer.named_buffers())
    for node_type in NODE_TYPES:
        old_count = before[f"{node_type}_count"]
        count = buffers[f"{node_type}_count"]
        added = workers.sum(count - old_count)
        for name in (f"{node_type}_vectors_mean_square", f"{node_type}_scalars_mean_square"):
            old_sum = before[name].double() * old_count
            own = buffers[name].double() * count - old_sum
            total = old_sum + workers.sum(own)
            buffers[name].copy_(total / (old_count + added).clamp(min=1))
        count.copy_(old_count + added)
