"""Processes that train one policy together, each on its share of the environments.

Started by torchrun, every process collects with `num_envs / size` environments and computes the
gradient of its share of each minibatch. What is exchanged are sums: gradients, moments of
advantages and returns, statistics of the normaliser. All processes therefore hold the same weights
at every moment, and a minibatch is as large as with one process.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
import torch.distributed as dist

T = TypeVar("T")

_FEW = 4
"""Most processes that swap whole gradients; what each receives grows with their number."""


@dataclass(frozen=True)
class Workers:
    """The processes of a run, as one of them sees them; by default there is only this one.

    Attributes:
        rank: Number of this process.
        size: Number of processes.
    """

    rank: int = 0
    size: int = 1

    @property
    def is_first(self) -> bool:
        """Whether this process writes logs and checkpoints and evaluates."""
        return self.rank == 0

    def share(self, name: str, total: int) -> int:
        """Return the part of a number that falls to each process.

        Args:
            name: What is shared, for the message.
            total: The number of all processes together.

        Raises:
            ValueError: If it cannot be shared evenly.
        """
        if total % self.size:
            raise ValueError(
                f"{name} = {total} must be divisible by the {self.size} processes; "
                f"{total - total % self.size or self.size} would fit"
            )
        return total // self.size

    def sum(self, tensor: torch.Tensor) -> torch.Tensor:
        """Return the sum of a tensor over the processes, in place."""
        if self.size > 1:
            dist.all_reduce(tensor)
        return tensor

    def max(self, tensor: torch.Tensor) -> torch.Tensor:
        """Return the largest of a tensor over the processes, in place."""
        if self.size > 1:
            dist.all_reduce(tensor, op=dist.ReduceOp.MAX)
        return tensor

    def average_gradients(self, parameters: Iterable[torch.Tensor]) -> None:
        """Replace gradients by their means over the processes, in one message."""
        if self.size == 1:
            return
        gradients = [p.grad for p in parameters if p.grad is not None]
        flat = torch.cat([gradient.reshape(-1) for gradient in gradients])
        if flat.device.type == "cpu" and self.size <= _FEW:
            # All swap whole gradients at once: gloo's ring of partial sums takes three times as long.
            parts = [torch.empty_like(flat) for _ in range(self.size)]
            dist.all_gather(parts, flat)
            flat = torch.stack(parts).sum(dim=0) / self.size
        else:
            flat = self.sum(flat) / self.size
        sizes = [gradient.numel() for gradient in gradients]
        for gradient, mean in zip(gradients, flat.split(sizes), strict=True):
            gradient.copy_(mean.view_as(gradient))

    def average_metrics(self, metrics: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Return means over the processes; of `*_max` the largest.

        Args:
            metrics: Scalars, the same names in every process.
        """
        if self.size == 1 or not metrics:
            return metrics
        values = torch.stack([value.detach() for value in metrics.values()])
        means, largest = self.sum(values.clone()) / self.size, self.max(values)
        return {name: largest[i] if name.endswith("_max") else means[i] for i, name in enumerate(metrics)}

    def gather(self, value: T) -> list[T]:
        """Return a value of every process, in the order of their ranks."""
        if self.size == 1:
            return [value]
        found: list[Any] = [None] * self.size
        dist.all_gather_object(found, value)
        return found

    def broadcast(self, tensors: Iterable[torch.Tensor]) -> None:
        """Overwrite tensors with those of the first process."""
        if self.size > 1:
            for tensor in tensors:
                dist.broadcast(tensor, src=0)


def join_workers(device: torch.device | str) -> Workers:
    """Join the processes that torchrun started; without torchrun there is one.

    Args:
        device: Where this process computes: "nccl" connects GPUs, "gloo" processors.
    """
    size = int(os.environ.get("WORLD_SIZE", "1"))
    if size == 1:
        return Workers()
    if not dist.is_initialized():
        if sys.platform == "linux" and os.environ.get("LOCAL_WORLD_SIZE") == str(size):
            # All on this machine: not through its network card.
            os.environ.setdefault("GLOO_SOCKET_IFNAME", "lo")
        dist.init_process_group("nccl" if torch.device(device).type == "cuda" else "gloo")
    return Workers(dist.get_rank(), size)


def leave_workers() -> None:
    """Close the connections that `join_workers` opened."""
    if dist.is_initialized():
        dist.destroy_process_group()
