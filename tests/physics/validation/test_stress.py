"""Random control steps over all shapes, resolutions and colliders: nothing non-finite leaks, what freezes recovers."""

import pytest
import torch

from validation.stress import all_models, run_stress, stress_solver


def test_two_hundred_random_and_absurd_steps():
    solver = stress_solver(all_models((49,)), 26, self_collision=True)
    result = run_stress(solver, 200, absurd_every=4)
    assert result["frozen"] > 0  # the absurd actions were absurd enough to freeze something


def test_full_speed_alone_never_freezes_a_world():
    solver = stress_solver(all_models((49,)), 26, self_collision=False)
    result = run_stress(solver, 100, absurd_every=0)
    assert result["frozen"] == 0


def test_a_world_beside_an_absurd_one_is_untouched():
    calm, beside = (stress_solver(all_models((49,)), 13, self_collision=True) for _ in range(2))
    for step in range(5):
        for solver in (calm, beside):
            solver.gripper_targets.copy_(solver.gripper_positions + 0.01)
        beside.gripper_targets[3] = float("nan") if step == 2 else 1e3
        calm.step()
        beside.step()
    others = [world for world in range(13) if world != 3]
    assert torch.equal(calm.positions[others], beside.positions[others])


@pytest.mark.slow
@pytest.mark.parametrize("self_collision", [False, True])
def test_ten_thousand_random_and_absurd_steps(self_collision):
    """10,000 control steps of every shape, with and without hole, at 49 to 1,225 nodes, over every collider."""
    solver = stress_solver(all_models((49, 225, 1225)), 39, self_collision=self_collision)
    run_stress(solver, 10_000, absurd_every=7)
