"""HEPi: exactly equivariant under what maps its grid of directions onto itself, and as good as the grid under the rest."""

import math

import pytest
import torch
from random_graphs import SCHEMA, make_graph, rotation_from_quaternion
from test_equivariance import symmetry_errors, trained_looking_policy

from maniskill_grpd.policies import make_policy
from maniskill_grpd.policies.layers import orientation_grid

SHIFT = torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64)


@pytest.mark.parametrize("count", [4, 16, 64])
def test_directions_are_spread_evenly(count):
    grid = orientation_grid(count).double()
    assert grid.shape == (count, 3)
    torch.testing.assert_close(grid.norm(dim=-1), torch.ones(count, dtype=torch.float64))
    assert grid.mean(0).abs().max() < 1e-6
    if count >= 16:  # the mean of o o^T over the sphere is a third of the identity
        torch.testing.assert_close(grid.t() @ grid / count, torch.eye(3, dtype=torch.float64) / 3, atol=0.03, rtol=0)


@pytest.mark.parametrize("count", [0, 6, -4])
def test_other_numbers_of_directions_are_refused(count):
    with pytest.raises(ValueError, match="multiple of 4"):
        orientation_grid(count)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_quarter_turns_about_the_vertical_and_shifts_are_exact(turns):
    angle = turns * math.pi / 2
    rotation = rotation_from_quaternion((math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)))
    for seed in range(5):
        policy = trained_looking_policy(torch.float64, seed, name="hepi")
        # The grid is kept in single precision.
        assert max(symmetry_errors(policy, make_graph(seed=seed, dtype=torch.float64), rotation, SHIFT).values()) < 1e-6


def mean_error(policy_name, **options):
    errors = []
    rng = torch.Generator().manual_seed(0)
    for seed in range(12):
        policy = trained_looking_policy(torch.float64, seed, name=policy_name, **options)
        rotation = rotation_from_quaternion(torch.randn(4, generator=rng).tolist())
        errors.append(symmetry_errors(policy, make_graph(seed=seed, dtype=torch.float64), rotation, SHIFT)["mean"])
    return sum(errors) / len(errors)


def test_other_rotations_are_as_exact_as_the_grid():
    coarse, usual, fine = (mean_error("hepi", num_directions=count) for count in (4, 16, 64))
    assert 1e-6 < fine < usual / 2
    assert usual < coarse / 2
    assert usual < mean_error("hetero_gnn") / 5


def test_hepi_has_as_many_parameters_as_grpd():
    grpd, hepi = (sum(p.numel() for p in make_policy(name, SCHEMA).parameters()) for name in ("grpd", "hepi"))
    assert hepi == pytest.approx(grpd, rel=0.05)


@torch.no_grad()
def test_actuators_hear_all_of_the_object_at_once():
    """Eq. 40's one step: a change of any node, however far, changes every action."""
    policy = trained_looking_policy(torch.float64, 0, name="hepi")
    graph = make_graph(1, nodes=12, dtype=torch.float64)
    before = policy(graph)[0].mean
    for node in range(12):
        changed = make_graph(1, nodes=12, dtype=torch.float64)
        changed["object"]["scalars"][0, node] += 1.0
        assert ((policy(changed)[0].mean - before).abs().amax(-1) > 1e-9).all()
