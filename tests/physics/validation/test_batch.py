"""T14: a world is the same alone and in a batch, bitwise; nothing passes between worlds; mixed variants included."""

import pytest
import torch

from maniskill_grpd.physics import ClothMaterial, Solver, circle_outline, cloth, hexagon_outline, rope, square_outline
from maniskill_grpd.physics.colliders import box, sphere

MODELS = [
    rope([[-0.2, 0, 0], [0.2, 0, 0]], num_nodes=41),
    cloth(square_outline(0.3), num_nodes=49),
    cloth(hexagon_outline(0.2), [circle_outline(0.05, num_points=16)], num_nodes=80, material=ClothMaterial(bend_stiffness=1e-4)),
]


def mixed_solver(num_worlds: int, first: int = 0, **options) -> Solver:
    """Worlds that hold different objects over two colliders; what world i holds follows from its index, starting at `first`."""
    solver = Solver(MODELS, num_worlds, 2, colliders=[sphere(0.08), box(0.05, 0.05, 0.05)], **options)
    index = torch.arange(first, first + num_worlds)
    variants = index % len(MODELS)
    positions = torch.zeros(num_worlds, solver.positions.shape[1], 3)
    nodes = torch.zeros(num_worlds, 2, dtype=torch.int64)
    for world, variant in enumerate(variants.tolist()):
        rest = torch.as_tensor(MODELS[variant].rest_positions)
        positions[world, : len(rest)] = rest + torch.tensor([0.0, 0.0, 0.15 + 0.01 * float(index[world] % 7)])
        nodes[world, 1] = len(rest) - 1
    solver.reset(torch.arange(num_worlds), positions, nodes, variants=variants)
    return solver


def drive(solver: Solver, num_steps: int, first: int = 0) -> None:
    for step in range(num_steps):
        for world in range(solver.num_worlds):
            generator = torch.Generator().manual_seed(1000 * (first + world) + step // 5)
            move = torch.randn(2, 3, generator=generator)
            solver.gripper_targets[world] = solver.gripper_positions[world] + 0.03 * move / move.norm(dim=-1, keepdim=True)
        solver.step()


@pytest.mark.parametrize("num_threads", [1, 3])
def test_a_world_of_a_mixed_batch_is_bitwise_the_same_alone(num_threads):
    batch = mixed_solver(65, num_threads=num_threads)
    drive(batch, 10)
    for world in (0, 31, 64):
        alone = mixed_solver(1, first=world)
        drive(alone, 10, first=world)
        assert torch.equal(alone.positions[0], batch.positions[world])
        assert torch.equal(alone.velocities[0], batch.velocities[world])


def test_worlds_at_the_same_place_do_not_feel_each_other():
    """Nodes of different worlds may overlap; with self-collision on, each world still falls as if alone."""
    pair = Solver(MODELS[1], 2, 1, self_collision=True)
    pair.positions[..., 2] = 0.5
    pair.positions[1] += torch.tensor([0.001, 0.0, 0.0005])
    alone = Solver(MODELS[1], 1, 1, self_collision=True)
    alone.positions.copy_(pair.positions[:1])
    for _ in range(10):
        pair.step()
        alone.step()
    assert torch.equal(pair.positions[0], alone.positions[0])


def test_resetting_some_worlds_leaves_the_others_bitwise_unchanged():
    disturbed, calm = mixed_solver(9), mixed_solver(9)
    drive(disturbed, 5)
    drive(calm, 5)
    disturbed.reset(torch.tensor([2, 7]), None, None, variants=torch.tensor([0, 1]))
    drive(disturbed, 5)
    drive(calm, 5)
    others = [0, 1, 3, 4, 5, 6, 8]
    assert torch.equal(disturbed.positions[others], calm.positions[others])


def test_a_poisoned_world_freezes_alone():
    sick, healthy = mixed_solver(6), mixed_solver(6)
    sick.velocities[4, 3] = float("nan")
    drive(sick, 3)
    drive(healthy, 3)
    assert sick.frozen.tolist() == [False] * 4 + [True, False]
    assert torch.isfinite(sick.positions).all()
    others = [0, 1, 2, 3, 5]
    assert torch.equal(sick.positions[others], healthy.positions[others])


def test_padding_does_not_move_and_carries_no_mass():
    solver = mixed_solver(3)
    drive(solver, 3)
    padding = ~solver.node_mask
    assert padding.any()
    assert (solver.velocities[padding] == 0.0).all()
    assert torch.isfinite(solver.positions[padding]).all()


def test_variants_may_change_in_any_order_and_number():
    """Worlds change their variant again and again, so that they are advanced beside ever different others."""
    generator = torch.Generator().manual_seed(0)
    batch = mixed_solver(37)
    for _ in range(4):
        variants = torch.randint(len(MODELS), (37,), generator=generator)
        batch.reset(torch.arange(37), variants=variants)
        for _ in range(2):
            batch.step()
    for world in (0, 17, 36):
        alone = mixed_solver(1)
        alone.reset(torch.tensor([0]), variants=variants[world : world + 1])
        for _ in range(2):
            alone.step()
        assert torch.equal(alone.positions[0], batch.positions[world])


def test_a_poisoned_world_leaves_nothing_behind_when_it_is_reset():
    """After a reset it goes on bitwise as a world that was never poisoned, whatever object it holds."""
    sick, healthy = mixed_solver(6), mixed_solver(6)
    sick.velocities[:3, 3] = float("nan")
    sick.inverse_masses[3:, 4] = float("inf")
    drive(sick, 2)
    assert sick.frozen.all()
    sick.inverse_masses.copy_(healthy.inverse_masses)
    nodes = healthy.gripper_nodes.long()
    sick.reset(torch.arange(6), healthy.positions.clone(), nodes)
    drive(sick, 3)
    drive(healthy, 3)
    assert not sick.frozen.any()
    assert torch.equal(sick.positions, healthy.positions)
