"""Many objects in one batch, material per world, and grippers that open and close."""

import numpy as np
import pytest
import torch

from maniskill_grpd.physics import (
    ClothMaterial,
    RopeMaterial,
    Solver,
    circle_outline,
    cloth,
    hexagon_outline,
    rope,
    sphere,
    square_outline,
    triangle_outline,
)

FEATURES = [{}, {"colliders": [sphere(0.05)], "self_collision": True}]


def variants():
    return [
        cloth(square_outline(0.4), num_nodes=49),
        rope([[-0.4, 0.0, 0.0], [0.4, 0.0, 0.0]], num_nodes=81),  # needs 40 substeps, the others 20
        cloth(hexagon_outline(0.2), [circle_outline(0.05)], num_nodes=80, material=ClothMaterial(friction=0.2, damping=2.0)),
        cloth(triangle_outline(0.4), num_nodes=60, material=ClothMaterial(bend_stiffness=0.0)),
    ]


def start_above(solver: Solver, worlds: torch.Tensor, **options) -> None:
    """Put the rest shapes 0.2 m above the table, with gripper 0 at node 0."""
    solver.reset(worlds, gripper_nodes=torch.zeros(1, dtype=torch.int64), **options)
    shift = torch.tensor([0.0, 0.0, 0.2])
    solver.positions[worlds] += shift * solver.node_mask[worlds, :, None]
    solver.gripper_positions[worlds] += shift
    solver.gripper_targets[worlds] += shift


@pytest.mark.parametrize("features", FEATURES)
def test_a_variant_moves_in_a_batch_as_it_does_alone(features):
    models = variants()
    assert len({model.default_substeps for model in models}) > 1
    chosen = torch.tensor([2, 0, 1, 3, 1, 2])
    batch = Solver(models, 6, 1, **features)
    start_above(batch, torch.arange(6), variants=chosen)
    alone = [Solver(models[v], 1, 1, **features) for v in chosen]
    for solver in alone:
        start_above(solver, torch.tensor([0]))
    for step in range(15):
        for solver in (batch, *alone):
            solver.gripper_targets[..., step % 3] += 0.02
            solver.step()
    for world, solver in enumerate(alone):
        count = solver.num_nodes
        assert torch.equal(batch.positions[world, :count], solver.positions[0])
        assert torch.equal(batch.gripper_forces[world], solver.gripper_forces[0])
        assert (batch.positions[world, count:] == 0.0).all()
        assert batch.node_mask[world].sum() == count


@pytest.mark.parametrize("features", FEATURES)
def test_resetting_to_another_variant_leaves_other_worlds_and_restores_by_state(features):
    models = variants()
    disturbed, calm = Solver(models, 3, 1, **features), Solver(models, 3, 1, **features)
    for solver in (disturbed, calm):
        start_above(solver, torch.arange(3), variants=torch.tensor([0, 1, 2]))
        for _ in range(5):
            solver.step()
    start_above(disturbed, torch.tensor([1]), variants=torch.tensor([3]))
    copy = Solver(models, 3, 1, **features)
    copy.set_state(disturbed.state())
    for _ in range(5):
        for solver in (disturbed, calm, copy):
            solver.step()
    assert torch.equal(disturbed.positions[[0, 2]], calm.positions[[0, 2]])
    assert torch.equal(disturbed.positions, copy.positions)
    assert torch.equal(disturbed.node_mask, copy.node_mask)
    assert disturbed.node_mask[1].sum() == models[3].num_nodes


def test_material_factors_act_as_the_material_itself():
    """A world with factors moves as one whose model has the multiplied constants."""
    factors = {"stretch": 0.5, "bend": 4.0, "mass": 2.0, "friction": 0.4, "damping": 3.0}
    base = RopeMaterial(stretch_stiffness=100.0, bend_stiffness=1e-4, friction=0.5)
    changed = RopeMaterial(stretch_stiffness=50.0, bend_stiffness=4e-4, linear_density=0.1, friction=0.2, damping=3.0)
    curve = [[0.0, 0.0, 0.01], [0.3, 0.0, 0.1], [0.5, 0.2, 0.3]]
    scaled, direct = Solver(rope(curve, material=base), 2, 1), Solver(rope(curve, material=changed), 1, 1)
    scaled.set_material(torch.tensor([1]), **factors)
    for _ in range(10):
        scaled.step()
        direct.step()
    # Compliance and mass differ by rounding only.
    torch.testing.assert_close(scaled.positions[1], direct.positions[0], rtol=0.0, atol=1e-4)
    assert (scaled.positions[0] - direct.positions[0]).abs().max() > 1e-2
    scaled.reset(torch.tensor([1]), variants=torch.tensor([0]))
    assert scaled.friction[1] == 0.5
    assert scaled.stretch_scale[1] == 1.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.reset(torch.tensor([0]), variants=torch.tensor([4])), r"variants must be in \[0, 3\]"),
        (lambda s: s.reset(torch.tensor([0]), variants=torch.tensor([0, 1])), "variants must be"),
        (lambda s: s.set_material(torch.tensor([0]), mass=0.0), "mass"),
        (lambda s: s.set_material(torch.tensor([0]), friction=float("nan")), "friction"),
        (lambda s: s.set_closed(torch.zeros(2, 2, dtype=torch.bool)), "closed"),
        (lambda s: s.grasp(torch.tensor([0]), torch.zeros(3, dtype=torch.int64)), "gripper_nodes"),
    ],
)
def test_solver_refuses_bad_choices(call, message):
    with pytest.raises(ValueError, match=message):
        call(Solver(variants(), 2, 1))


def test_no_model_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        Solver([], 1)


# ---------------------------------------------------------------------- grasping


def test_a_hanging_object_weighs_on_its_gripper():
    for model in (rope([[0, 0, 0], [0, 0, -0.5]], material=RopeMaterial(damping=5.0)), cloth(square_outline(0.3), num_nodes=49)):
        solver = Solver(model, 1, 2)
        solver.plane[:, 3] = -100.0
        solver.damping.fill_(8.0)
        node = int(model.node_sets["corners"][0]) if "corners" in model.node_sets else 0
        solver.reset(torch.tensor([0]), gripper_nodes=torch.tensor([node, -1]))
        for _ in range(80):
            solver.step()
        weight = torch.tensor([0.0, 0.0, -9.81 * model.masses.sum()])
        # A substep has a float32 step of about 1e-7 m at 0.3 m: 0.02 m/s^2 of acceleration, times what still swings.
        torch.testing.assert_close(solver.gripper_forces[0, 0], weight, rtol=0.0, atol=0.02 * weight.norm().item())
        assert (solver.gripper_forces[0, 1] == 0.0).all()


def test_a_patch_is_held_rigidly_and_the_same_at_every_resolution():
    for num_nodes in (49, 225):
        model = cloth(square_outline(0.3), num_nodes=num_nodes)
        solver = Solver(model, 1, 1, patch_radius=0.06)
        corner = int(model.node_sets["corners"][0])
        solver.reset(torch.tensor([0]), gripper_nodes=torch.tensor([corner]))
        held = solver.holder[0] == 0
        distance = (solver.positions[0] - solver.positions[0, corner]).norm(dim=-1)
        assert torch.equal(held, distance <= 0.06)
        before = solver.positions[0, held].clone()
        solver.gripper_targets[0, 0] += torch.tensor([0.0, 0.01, 0.03])
        solver.step()
        torch.testing.assert_close(solver.positions[0, held], before + torch.tensor([0.0, 0.01, 0.03]), rtol=0.0, atol=1e-6)


def test_release_and_regrasp():
    model = rope([[-0.4, 0.0, 0.01], [0.4, 0.0, 0.01]], num_nodes=41)
    solver = Solver(model, 3, 2)
    solver.reset(torch.arange(3), solver.positions.clone(), torch.tensor([0, 40]))
    closed = torch.ones(3, 2, dtype=torch.bool)
    for _ in range(6):
        solver.gripper_targets[..., 2] += 0.03
        solver.step()
    assert solver.leashes[0, 0, 1] == pytest.approx(0.8)
    closed[1] = False
    solver.set_closed(closed)
    assert solver.holder[1].max() == -1
    assert solver.gripper_nodes[1].tolist() == [-1, -1]
    assert solver.leashes[1, 0, 1] > 1e3
    for _ in range(10):
        solver.step()
    assert solver.positions[1, :, 2].max() < 0.05
    assert solver.positions[0, 0, 2] > 0.15
    # World 1: gripper 0 goes to the middle and closes 4 mm beside node 20; gripper 1 closes in the air.
    solver.gripper_targets[1, 0] = solver.positions[1, 20] + torch.tensor([0.0, 0.004, 0.0])
    solver.step()
    closed[1] = True
    at = solver.positions[1, 20].clone()
    solver.set_closed(closed)
    assert solver.gripper_nodes[1].tolist() == [20, -1]
    assert solver.closed[1].tolist() == [True, True]
    solver.gripper_targets[1, 0, 2] += 0.03
    solver.step()
    torch.testing.assert_close(solver.positions[1, 20], at + torch.tensor([0.0, 0.0, 0.03]), rtol=0.0, atol=1e-6)
    assert (solver.holder[1] >= 0).sum() == 1


def test_grippers_that_hold_apart_share_a_layered_cloth_by_distance():
    model = cloth(square_outline(0.3), num_nodes=100)
    solver = Solver(model, 1, 2, patch_radius=0.05)
    solver.reset(torch.tensor([0]))
    solver.gripper_positions[0] = solver.positions[0, torch.as_tensor(model.node_sets["corners"][:2])]
    solver.gripper_targets.copy_(solver.gripper_positions)
    solver.set_closed(torch.ones(1, 2, dtype=torch.bool))
    for gripper in range(2):
        held = solver.holder[0] == gripper
        assert held.sum() >= 3
        assert (solver.positions[0, held] - solver.gripper_positions[0, gripper]).norm(dim=-1).max() <= 0.05
    assert solver.leashes[0, 0, 1] == pytest.approx(0.3, rel=1e-5)


@pytest.mark.parametrize("features", FEATURES)
def test_absurd_commands_stay_in_their_world(features):
    """Teleports and a hundred times the speed for one world, calm for the others: nothing leaks, and a reset recovers."""
    models = variants()
    solver, calm = Solver(models, 3, 2, **features), Solver(models, 3, 2, **features)
    for each in (solver, calm):
        each.reset(torch.arange(3), gripper_nodes=torch.tensor([0, 20]), variants=torch.tensor([0, 1, 2]))
    generator = torch.Generator().manual_seed(0)
    for step in range(60):
        solver.gripper_targets[1] = 10.0 ** (step % 7 - 1) * torch.randn(2, 3, generator=generator)
        if step % 5 == 4:
            closed = solver.closed.clone()
            closed[1] = ~closed[1]
            solver.set_closed(closed)
        solver.step()
        calm.step()
        assert torch.isfinite(solver.positions).all()
        assert torch.isfinite(solver.velocities).all()
        if solver.frozen[1]:
            solver.reset(torch.tensor([1]), gripper_nodes=torch.tensor([0, 20]))
    assert torch.equal(solver.positions[[0, 2]], calm.positions[[0, 2]])
    solver.reset(torch.tensor([1]), gripper_nodes=torch.tensor([0, 20]))
    solver.step()
    assert not solver.frozen.any()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.gpu
@pytest.mark.parametrize("features", FEATURES)
def test_cuda_follows_the_cpu_with_everything_on(features):
    models = variants()
    cpu, cuda = (Solver(models, 8, 1, device=device, **features) for device in ("cpu", "cuda"))
    chosen = torch.arange(8) % 4
    cpu.reset(torch.arange(8), gripper_nodes=torch.zeros(1, dtype=torch.int64), variants=chosen)
    cuda.reset(torch.arange(8).cuda(), gripper_nodes=torch.zeros(1, dtype=torch.int64).cuda(), variants=chosen.cuda())
    for step in range(10):
        for solver in (cpu, cuda):
            solver.gripper_targets[..., step % 3] += 0.02
            solver.step()
    # Fused multiply-adds round differently; contacts of thin layers may flip, so the bulk is compared.
    difference = (cuda.positions.cpu() - cpu.positions).norm(dim=-1)
    assert torch.quantile(difference.flatten(), 0.95) < 2e-3


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.gpu
def test_cuda_step_can_be_captured_in_a_graph_and_is_reproducible():
    solvers = [Solver(variants(), 8, 1, device="cuda", self_collision=True) for _ in range(2)]
    for solver in solvers:
        start_above(solver, torch.arange(8).cuda(), variants=torch.arange(8).cuda() % 4)
    solvers[0].step()
    solvers[1].step()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        solvers[0].step()
    for _ in range(5):
        graph.replay()
        solvers[1].step()
    torch.cuda.synchronize()
    assert torch.equal(solvers[0].positions, solvers[1].positions)


def test_self_contact_and_colliders_do_not_depend_on_batch_or_threads():
    models = variants()[:3]
    options = {"colliders": [sphere(0.06)], "self_collision": True}
    batch = Solver(models, 20, 1, num_threads=3, **options)
    chosen = torch.arange(20) % 3
    start_above(batch, torch.arange(20), variants=chosen)
    for _ in range(6):
        batch.step()
    for world in (0, 7, 19):
        alone = Solver(models, 1, 1, **options)
        start_above(alone, torch.tensor([0]), variants=chosen[world : world + 1])
        for _ in range(6):
            alone.step()
        assert torch.equal(alone.positions[0], batch.positions[world])


def test_the_rest_shapes_of_padded_worlds_are_exact():
    models = variants()
    solver = Solver(models, 4, 1)
    solver.reset(torch.arange(4), variants=torch.arange(4))
    for world, model in enumerate(models):
        np.testing.assert_array_equal(solver.positions[world, : model.num_nodes], model.rest_positions)
