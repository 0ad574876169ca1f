"""Small choices: observation modes, devices, seeds."""

import numpy as np
import pytest
import torch

from maniskill_grpd.tasks.options.compute_device import choose_compute_device
from maniskill_grpd.tasks.options.env_id import check_env_id
from maniskill_grpd.tasks.options.observation_mode import needs_camera, split_observation_mode
from maniskill_grpd.tasks.options.seeds import expand_seeds


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        (None, ("none", True)),
        ("graph", ("none", True)),
        ("state", ("state", False)),
        ("state+graph", ("state", True)),
        ("graph+state_dict", ("state_dict", True)),
        ("graph+rgb+depth", ("rgb+depth", True)),
        ("none", ("none", False)),
        ("graph+none", ("none", True)),
        ("pointcloud+graph", ("pointcloud", True)),
    ],
)
def test_observation_modes_are_split(mode, expected):
    assert split_observation_mode(mode) == expected


@pytest.mark.parametrize("mode", ["grpah", "graph+foo", "", "graph+", "rgb state"])
def test_unknown_observation_modes_are_refused_with_the_allowed_ones(mode):
    with pytest.raises(ValueError, match="unknown observation mode.*allowed are graph, state"):
        split_observation_mode(mode)


def test_modes_that_stand_alone_cannot_be_joined():
    with pytest.raises(ValueError, match="'rgbd' cannot be joined"):
        split_observation_mode("rgbd+state")


def test_modes_with_images_need_a_camera():
    assert [needs_camera(mode) for mode in ("none", "state", "state_dict+rgb", "pointcloud")] == [False, False, True, True]


def test_compute_devices():
    assert choose_compute_device("cpu") == choose_compute_device("physx_cpu") == torch.device("cpu")
    assert choose_compute_device("auto").type == ("cuda" if torch.cuda.is_available() else "cpu")
    for backend in ("gpu0", "cpu:1", "cuda:x", "tpu"):
        with pytest.raises(ValueError, match='unknown sim_backend .*allowed are "auto", "cpu"'):
            choose_compute_device(backend)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_cuda_without_a_gpu_is_refused():
    with pytest.raises(ValueError, match="needs a CUDA GPU"):
        choose_compute_device("cuda")


def test_seeds():
    assert expand_seeds(5, 1) == [5]
    assert expand_seeds([3, 1, 2], 3) == [3, 1, 2]
    assert expand_seeds(5, 4)[:3] == expand_seeds([5], 3)
    assert expand_seeds(5, 4)[1:] == np.random.RandomState(5).randint(2**31, size=3).tolist()  # as ManiSkill derives them
    assert len({seed for first in range(50) for seed in expand_seeds(first, 20)[1:]}) == 50 * 19
    with pytest.raises(ValueError, match="expected 1 or 3 seeds.*got 2"):
        expand_seeds([1, 2], 3)


def test_an_id_from_a_file_imports_a_module_only_when_allowed():
    assert check_env_id("RopeShaping-v1", "a.pt", allow_import=False) == "RopeShaping-v1"
    assert check_env_id("mine:Knot-v1", "a.pt", allow_import=True) == "mine:Knot-v1"
    for env_id in ("mine:Knot-v1", "os.path:Knot-v1", ":Knot-v1", "a:b:Knot-v1"):
        with pytest.raises(ValueError, match="a.pt: env_id .* would import the Python module .* --allow_import"):
            check_env_id(env_id, "a.pt", allow_import=False)
    for env_id in (None, 3, ""):
        with pytest.raises(ValueError, match="must be the id of a task"):
            check_env_id(env_id, "a.pt", allow_import=True)


@pytest.mark.parametrize("seed", [1.5, 1.0, [1, 2.5], "3", True, -1, 2**32, [[1, 2]], None])
def test_seeds_that_are_no_whole_numbers_are_refused(seed):
    """1.5 was once cut to 1."""
    with pytest.raises(ValueError, match=r"seeds must be whole numbers in \[0, 2\*\*32\), got"):
        expand_seeds(seed, 2)


@pytest.mark.parametrize("seed", [3, np.int64(3), [3], np.array([3]), torch.tensor([3])])
def test_seeds_may_come_from_anywhere(seed):
    assert expand_seeds(seed, 1) == [3]
