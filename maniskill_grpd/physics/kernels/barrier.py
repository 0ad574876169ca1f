"""The barrier between the phases of a thread block."""

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
