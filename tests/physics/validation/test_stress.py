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
@pytest.mark.parametrize(("num_nodes", "num_steps"), [(49, 10_000), (225, 770), (1225, 770)])
def test_ten_thousand_random_and_absurd_steps(num_nodes, num_steps, self_collision):
    """10,000 control steps of all shapes, with and without hole, over every collider; 10,000 world-steps at finer resolutions."""
    solver = stress_solver(all_models((num_nodes,)), 13, self_collision=self_collision)
    result = run_stress(solver, num_steps, absurd_every=7)
    assert result["world_steps"] >= 10_000
    assert result["frozen"] > 0
