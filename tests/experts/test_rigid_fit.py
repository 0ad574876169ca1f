"""Rigid motions of sets of points."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from maniskill_grpd.experts.rigid_fit import fit_rotation, shortest_turn

SQUARE = torch.tensor([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]], dtype=torch.float64)


def random_rotations(num):
    return torch.as_tensor(Rotation.random(num, random_state=0).as_matrix())


@pytest.mark.parametrize("layout", [SQUARE, SQUARE[:3] - SQUARE[:3].mean(0), SQUARE * torch.tensor([1.0, 0.3, 1.0])])
def test_rotations_of_flat_layouts_are_found_exactly(layout):
    rotations = random_rotations(50)
    points = layout @ rotations.mT + torch.tensor([3.0, 1.0, -2.0])
    torch.testing.assert_close(fit_rotation(layout.expand(50, -1, -1), points), rotations, atol=1e-9, rtol=0)


def test_disturbed_points_still_give_a_rotation_close_to_theirs():
    rotations = random_rotations(50)
    noise = 0.05 * torch.randn(50, 4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    fitted = fit_rotation(SQUARE.expand(50, -1, -1), SQUARE @ rotations.mT + noise)
    torch.testing.assert_close(fitted @ fitted.mT, torch.eye(3, dtype=torch.float64).expand(50, 3, 3), atol=1e-9, rtol=0)
    torch.testing.assert_close(torch.linalg.det(fitted), torch.ones(50, dtype=torch.float64))
    angle = Rotation.from_matrix((fitted @ rotations.mT).numpy()).magnitude()
    assert angle.max() < 0.15  # 3 sigma of 0.05 over arms of sqrt(2), four of them


def test_shortest_turn_takes_one_direction_to_the_other_about_their_normal():
    generator = torch.Generator().manual_seed(0)
    start, end = torch.nn.functional.normalize(torch.randn(2, 50, 3, dtype=torch.float64, generator=generator), dim=-1)
    turn = shortest_turn(start, end)
    turned = torch.as_tensor(Rotation.from_rotvec(turn.numpy()).apply(start.numpy()))
    torch.testing.assert_close(turned, end, atol=1e-7, rtol=0)
    np.testing.assert_allclose((turn * start).sum(-1), 0.0, atol=1e-9)
    assert shortest_turn(start, start).abs().max() < 1e-7
