"""Choice of the device that the worlds live on."""

from __future__ import annotations

import torch

CPU_BACKENDS = ("cpu", "physx_cpu", "warp_cpu")
CUDA_BACKENDS = ("cuda", "gpu", "physx_cuda", "warp_cuda")


def choose_compute_device(sim_backend: str) -> torch.device:
    """Return the torch device for a simulation backend.

    Args:
        sim_backend: "auto" (CUDA if there is a GPU, else CPU), "cpu", or "cuda", which may name a
            GPU as in "cuda:1". ManiSkill's names "physx_cpu", "physx_cuda" and "gpu" mean the same
            here.

    Raises:
        ValueError: If the backend is unknown, or is CUDA where torch finds no GPU.
    """
    name, _, index = sim_backend.partition(":")
    if sim_backend == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name in CPU_BACKENDS and not index:
        return torch.device("cpu")
    if name not in CUDA_BACKENDS or (index and not index.isdigit()):
        raise ValueError(f'unknown sim_backend {sim_backend!r}; allowed are "auto", "cpu", "cuda" and "cuda:<n>"')
    if not torch.cuda.is_available():
        raise ValueError(f'sim_backend {sim_backend!r} needs a CUDA GPU, torch finds none; use "cpu"')
    return torch.device("cuda", int(index)) if index else torch.device("cuda")
