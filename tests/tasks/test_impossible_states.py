"""States that are finite and yet impossible are refused as a whole."""

import pytest
import torch
from mani_skill.utils import common

ENV_ID = "RopeWrapping-v1"
IMPOSSIBLE = [
    ("solver", "holder", 1e9),
    ("solver", "gripper_nodes", 1000.0),
    ("solver", "inverse_masses", -1.0),
    ("episode", "start_nodes", 1000.0),
    ("episode", "start_nodes", -1.0),
    ("episode", "start_nodes", 0.5),
]


def test_a_value_out_of_its_range_is_refused_before_anything_is_written(make_env):
    env = make_env(2).unwrapped
    before = env.get_state()
    for group, name, value in IMPOSSIBLE:
        state = env.get_state_dict()
        state["solver"]["positions"] += 1.0
        state["episode"]["start_nodes"] = state["episode"]["start_nodes"].roll(1, dims=1)
        state[group][name][:] = value
        flat = common.flatten_state_dict(state, use_torch=True)
        for restore, given in ((env.set_state_dict, state), (env.set_state, flat)):
            with pytest.raises(ValueError, match=name):
                restore(given)
            assert torch.equal(env.get_state(), before)
