"""The kernel compiles for CUDA on machines without a GPU, so that the GPU path cannot break unnoticed."""

import sys

import pytest
import warp as wp

from maniskill_grpd.physics.kernels.data import Features
from maniskill_grpd.physics.kernels.step import build_step_kernel

EVERYTHING = Features(ropes=True, bends=True, hinges=True, folds=True, tethers=True, colliders=True, self_contact=True)


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler there")
@pytest.mark.parametrize(
    "features", [Features(ropes=True, bends=True), pytest.param(EVERYTHING, marks=pytest.mark.slow)], ids=["rope", "everything"]
)
def test_the_step_compiles_for_cuda(features, tmp_path):
    outputs = wp.compile_aot_module(build_step_kernel(features, in_lanes=False).module, arch=80, module_dir=tmp_path)
    assert outputs
    assert all(path.stat().st_size > 0 for path in outputs)
