"""The shirt of examples/garment.py is sewn where it should be, its layers apart."""

import pytest
import torch

pytest.importorskip("mani_skill")

from examples.garment import count_crossings, sew_shirt


def test_a_shirt_has_two_layers_and_four_openings():
    shirt = sew_shirt(100)
    # A sphere with four holes: hem, neck and two sleeves.
    assert shirt.num_nodes - len(shirt.mesh_edges) + len(shirt.faces) == 2 - 4
    assert sum(name.startswith("loop_") for name in shirt.node_sets) == 4
    assert count_crossings(shirt, torch.as_tensor(shirt.rest_positions)[None]).item() == 0
