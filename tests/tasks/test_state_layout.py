"""State dictionaries and flat vectors."""

import numpy as np
import pytest
import torch
from mani_skill.utils import common

from maniskill_grpd.tasks.worlds.state_layout import read_flat, read_rows

TEMPLATE = {"solver": {"x": torch.zeros(3, 4), "y": torch.zeros(3, 1)}, "goal": torch.zeros(3, 2)}


def make_state(num_rows):
    return {"solver": {"x": torch.rand(num_rows, 4), "y": torch.rand(num_rows, 1)}, "goal": torch.rand(num_rows, 2)}


def assert_equal(state, other):
    assert torch.equal(common.flatten_state_dict(state, use_torch=True), common.flatten_state_dict(other, use_torch=True))


@pytest.mark.parametrize("num_rows", [1, 2, 3])
def test_flat_vectors_are_the_inverse_of_flattening(num_rows):
    state = make_state(num_rows)
    flat = common.flatten_state_dict(state, use_torch=True)
    assert_equal(read_flat(flat, TEMPLATE, num_rows), state)
    assert_equal(read_flat(flat.numpy(), TEMPLATE, num_rows), state)


def test_dictionaries_may_be_numpy_unbatched_and_in_any_order():
    state = make_state(1)
    given = {"goal": state["goal"][0].numpy(), "solver": {"y": state["solver"]["y"][0], "x": state["solver"]["x"]}}
    assert_equal(read_rows(given, TEMPLATE, 1), state)


def test_read_only_arrays_are_copied():
    flat = np.arange(7, dtype=np.float32)
    flat.flags.writeable = False
    rows = read_flat(flat, TEMPLATE, 1)
    rows["goal"] += 1
    assert flat[-1] == 6


def test_misfits_are_refused():
    state = make_state(2)
    with pytest.raises(ValueError, match=r"solver/x must be \(3, 4\).*got \(2, 4\)"):
        read_rows(state, TEMPLATE, 3)
    with pytest.raises(ValueError, match=r"flat state must be \(2, 7\).*got \(2, 6\)"):
        read_flat(torch.zeros(2, 6), TEMPLATE, 2)
    del state["goal"]
    state["other"] = torch.zeros(2, 1)
    with pytest.raises(ValueError, match=r"missing \[\('goal',\)\], unknown \[\('other',\)\]"):
        read_rows(state, TEMPLATE, 2)
    bad = make_state(2)
    bad["goal"][0, 1] = float("nan")
    with pytest.raises(ValueError, match="goal must be finite"):
        read_rows(bad, TEMPLATE, 2)
