"""Settings of the whole suite."""

import os

import pytest
import torch
from hypothesis import settings

# One thread per process: the tensors here are small, and a busy machine makes idle OpenMP threads spin.
torch.set_num_threads(1)
os.environ.setdefault("OMP_NUM_THREADS", "1")

settings.register_profile("reproducible", derandomize=True, deadline=None, max_examples=25)
settings.load_profile("reproducible")


@pytest.fixture(autouse=True)
def _fixed_global_seed():
    """Let no test depend on the order of the others through the global generator."""
    torch.manual_seed(0)
