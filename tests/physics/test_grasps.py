"""Grippers of finite strength."""

import math

import pytest
import torch

from maniskill_grpd.physics import ClothMaterial, RopeMaterial, Solver, cloth, rope, square_outline
from maniskill_grpd.physics.fields import STANDARD_GRAVITY

WEIGHT = 0.05 * 0.8 * STANDARD_GRAVITY
ENDS = torch.tensor([0, 40])


def hanging_rope(grip_strength: float | None) -> Solver:
    """A default rope that hangs from gripper 0, damped so that it is at rest."""
    solver = Solver(rope([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0]]), 1, 1, grip_strength=grip_strength)
    solver.plane[:, 3] = -10.0
    positions = solver.positions.clone()
    positions[..., 2], positions[..., 0] = -positions[..., 0], 0.0
    solver.reset(torch.tensor([0]), positions, torch.tensor([0]))
    solver.damping[:] = 20.0
    return solver


@pytest.mark.parametrize(("strength", "holds"), [(0.9 * WEIGHT, False), (1.1 * WEIGHT, True), (None, True)])
def test_a_gripper_holds_a_weight_up_to_its_strength(strength, holds):
    solver = hanging_rope(None)
    for _ in range(200):
        solver.step()
    solver.grip_strength = strength
    for _ in range(20):
        solver.step()
    assert solver.slips.tolist() == [[0 if holds else 1]]
    assert (solver.gripper_nodes[0, 0] == 0) == holds
    assert (solver.positions[0, 0, 2] > -0.1) == holds
    assert solver.closed.all()  # on nothing


@pytest.mark.parametrize("stiffness", [500.0, 1e7])
@pytest.mark.parametrize("strength", [2.0, 20.0])
def test_what_is_pulled_apart_slips_out_without_being_torn(strength, stiffness):
    model = rope([[-0.4, 0.0, 0.0], [0.4, 0.0, 0.0]], material=RopeMaterial(stretch_stiffness=stiffness))
    solver = Solver(model, 1, 2, grip_strength=strength)
    solver.plane[:, 3] = -10.0
    solver.reset(torch.tensor([0]), gripper_nodes=ENDS)
    for _ in range(10):
        solver.gripper_targets += 0.03 * torch.tensor([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
        solver.step()
        lengths = solver.positions[0].diff(dim=0).norm(dim=-1)
        assert (lengths / torch.as_tensor(model.rest_lengths) - 1.0).max() < 1.05 * 2.0 * strength / stiffness + 1e-3
    assert solver.slips.sum() >= 1
    assert (solver.gripper_positions[0, 1] - solver.gripper_positions[0, 0]).norm() > 1.0
    assert solver.velocities.norm(dim=-1).max() < 10.0
    assert not solver.frozen.any()


def test_cloth_slips_out_and_its_tethers_with_it():
    solver = Solver(cloth(square_outline(0.3), num_nodes=49, material=ClothMaterial()), 1, 2, grip_strength=3.0)
    solver.plane[:, 3] = -10.0
    solver.reset(torch.tensor([0]), gripper_nodes=torch.tensor([0, 48]))
    for _ in range(10):
        apart = solver.gripper_positions[:, :1] - solver.gripper_positions[:, 1:]
        solver.gripper_targets += torch.cat([apart, -apart], dim=1) * 0.1
        solver.step()
    assert solver.slips.sum() >= 1
    assert ((solver.holder >= 0).sum() == (solver.gripper_nodes >= 0).sum()).all()
    assert not solver.frozen.any()


def test_a_gripper_that_has_lost_its_rope_catches_it_again_when_it_closes_anew():
    solver = hanging_rope(0.5 * WEIGHT)
    for _ in range(4):
        solver.step()
    assert solver.slips.sum() == 1
    solver.grip_strength = None
    solver.gripper_targets.copy_(solver.positions[:, :1])
    solver.velocities.zero_()
    solver.gravity.zero_()
    solver.step()
    solver.set_closed(torch.ones(1, 1, dtype=torch.bool))  # told to stay closed
    assert solver.gripper_nodes.item() == -1
    solver.set_closed(torch.zeros(1, 1, dtype=torch.bool))
    solver.set_closed(torch.ones(1, 1, dtype=torch.bool))
    assert solver.gripper_nodes.item() == 0
    solver.reset(torch.tensor([0]))
    assert solver.slips.sum() == 0


@pytest.mark.parametrize("strength", [0.0, -1.0, math.inf, math.nan])
def test_a_strength_that_is_none_is_refused(strength):
    with pytest.raises(ValueError, match="grip_strength must be finite and > 0 N, or None for unlimited, got"):
        Solver(rope([[0.0, 0.0], [1.0, 0.0]]), 1, grip_strength=strength)
