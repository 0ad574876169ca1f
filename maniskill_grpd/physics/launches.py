"""Recorded launches of the fused kernel, and the threads that run them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch
import warp as wp

# Below this many worlds a second thread costs more than it brings.
MIN_WORLDS_PER_THREAD = 16
# Threads of a block on CUDA: more only pay when a colour has more constraints than threads.
SMALL_BLOCK_DIM, LARGE_BLOCK_DIM, LARGE_OBJECT = 64, 256, 200


class Launches:
    """One launch for each host thread; together they advance all groups of worlds by one control step.

    A process that was forked has none of its parent's threads, so the pool belongs to the process that made it and is made anew
    in every other one.
    """

    def __init__(self, commands: Sequence[wp.Launch], device: torch.device) -> None:
        """Take launches that can run side by side.

        Args:
            commands: Recorded launches; on CUDA a single one.
            device: Where they run.
        """
        self._commands = commands
        self._device = device
        self._pool: ThreadPoolExecutor | None = None
        self._pool_process = 0

    def run(self) -> None:
        """Run all launches and wait for them; on CUDA enter the one there is into PyTorch's stream."""
        if self._device.type == "cuda":
            self._commands[0].launch(stream=wp.stream_from_torch(torch.cuda.current_stream(self._device)))
        elif len(self._commands) == 1:
            self._commands[0].launch()
        else:
            for launched in [self._own_pool().submit(command.launch) for command in self._commands]:
                launched.result()

    def _own_pool(self) -> ThreadPoolExecutor:
        if self._pool is None or self._pool_process != os.getpid():
            self._pool, self._pool_process = ThreadPoolExecutor(len(self._commands)), os.getpid()
        return self._pool


def choose_num_threads(num_threads: int | None, num_worlds: int, device: torch.device) -> int:
    """Return how many host threads share the worlds: those wanted, or by default as many as pay."""
    if device.type == "cuda":
        return 1
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    wanted = num_threads or min(available, num_worlds // MIN_WORLDS_PER_THREAD)
    return max(1, min(wanted, num_worlds))


def choose_block_dim(num_nodes: int, device: torch.device) -> int:
    """Return how many threads advance one group of worlds."""
    if device.type != "cuda":
        return 1
    return LARGE_BLOCK_DIM if num_nodes > LARGE_OBJECT else SMALL_BLOCK_DIM


@contextmanager
def quiet_warp() -> Iterator[None]:
    """Keep Warp from greeting and from reporting every module that it loads, unless its log level was set to say more."""
    level = wp.config.log_level
    if level == wp.LOG_INFO:  # Warp's own default
        wp.config.log_level = wp.LOG_WARNING
    try:
        yield
    finally:
        wp.config.log_level = level
