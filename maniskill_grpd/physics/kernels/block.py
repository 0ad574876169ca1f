"""What the threads of a block share: the barrier between phases, and counters."""

import warp as wp


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
"""
)
def synchronize_block():
    """Wait until all threads of the block have arrived; nothing to do for the single thread of the CPU."""


@wp.func_native("return wp::atomic_add(counts, i, j, 1);")
def count_up(counts: wp.array2d(dtype=int), i: int, j: int) -> int:
    """Add one to a counter that threads share; return what it was."""
    ...
