"""Contact of an object with itself: crossing ropes and folded cloth stay apart, and momentum is kept."""

import numpy as np
import torch

from maniskill_grpd.physics import ClothMaterial, RopeMaterial, Solver, cloth, rope, square_outline


def looped_rope(num_nodes: int = 61):
    """A rope with a loop: its two halves cross with 6 cm between them."""
    t = np.linspace(-1.0, 1.0, 200)
    curve = np.column_stack([0.4 * t - 0.5 * np.sin(np.pi * t), 0.25 * np.cos(np.pi * t), 0.03 * t + 0.1])
    return rope(curve, num_nodes=num_nodes, radius=0.008, material=RopeMaterial(bend_stiffness=1e-6))


def smallest_gap(positions: np.ndarray, skip: int) -> float:
    """Return the smallest distance between points along a rope (N, 3) that are at least `skip` segments apart."""
    fine = np.concatenate([positions[:-1] + f * np.diff(positions, axis=0) for f in np.linspace(0, 1, 9)[:-1]])
    segment = np.concatenate([np.arange(len(positions) - 1)] * 8)
    gaps = np.linalg.norm(fine[:, None] - fine[None], axis=-1)
    gaps[np.abs(segment[:, None] - segment[None]) < skip] = np.inf
    return gaps.min()


def test_a_rope_comes_to_rest_across_itself():
    model = looped_rope()
    gaps = {}
    for self_collision in (True, False):
        solver = Solver(model, 1, 1, self_collision=self_collision)
        for _ in range(40):
            solver.step()
        gaps[self_collision] = smallest_gap(solver.positions[0].numpy(), skip=8)
    # Half of the thickness is the most that a rope may be squeezed; without self-contact the strands fall into one plane.
    assert gaps[True] > 0.008
    assert gaps[False] < 0.004


def test_a_pulled_loop_tightens_but_does_not_pass_through_itself():
    """The ends of a loop are pulled apart at full speed: strands slide over each other and the loop closes."""
    model = looped_rope()
    solver = Solver(model, 1, 2, self_collision=True)
    solver.reset(torch.tensor([0]), gripper_nodes=torch.tensor([0, model.num_nodes - 1]))
    for _ in range(12):
        solver.gripper_targets.copy_(solver.gripper_positions)
        solver.gripper_targets[0, 0, 0] -= 0.015
        solver.gripper_targets[0, 1, 0] += 0.015
        solver.step()
        assert smallest_gap(solver.positions[0].numpy(), skip=8) > 0.004
    assert not solver.frozen.any()


def folded_cloth(num_nodes: int, self_collision: bool) -> Solver:
    """Lay one half of a cloth over the other with both corners of an edge."""
    model = cloth(square_outline(0.3), num_nodes=num_nodes, radius=0.004, material=ClothMaterial(bend_stiffness=2e-6))
    solver = Solver(model, 1, 2, self_collision=self_collision)
    corners = model.node_sets["corners"]
    held = torch.as_tensor([corners[1], corners[2]])  # the edge at x = +0.15
    start = solver.positions.clone()
    start[..., 2] = model.radius
    solver.reset(torch.tensor([0]), start, held)
    for angle in np.linspace(0.0, np.pi, 25)[1:]:
        solver.gripper_targets[..., 0] = 0.145 * np.cos(angle)
        solver.gripper_targets[..., 2] = 0.012 + 0.145 * np.sin(angle)
        solver.step()
    solver.set_closed(torch.zeros(1, 2, dtype=torch.bool))
    for _ in range(20):
        solver.step()
    return solver


def test_folded_cloth_stays_in_two_layers():
    heights = {}
    for self_collision in (True, False):
        solver = folded_cloth(100, self_collision)
        x = torch.as_tensor(solver.model.rest_positions[:, 0])
        upper, lower = solver.positions[0, x > 0.08, 2], solver.positions[0, x < -0.08, 2]
        heights[self_collision] = (upper.median() - lower.median()).item()
        assert not solver.frozen.any()
    # Layers lie one thickness (8 mm) apart; without self-contact both lie on the table.
    assert 0.005 < heights[True] < 0.011
    assert heights[False] < 0.001


def test_self_contact_keeps_momentum_and_is_reproducible():
    """Two halves of a folded sheet fly into each other in free space: impulses cancel in pairs."""
    model = cloth(square_outline(0.3), num_nodes=100, radius=0.004, material=ClothMaterial(damping=0.0, friction=0.3))
    angle = np.clip(model.rest_positions[:, 0] / 0.02, -np.pi / 2, np.pi / 2)
    beyond = np.abs(model.rest_positions[:, 0]) - 0.02 * np.pi / 2
    start = np.column_stack(
        [0.02 * np.cos(angle) - np.maximum(beyond, 0.0), model.rest_positions[:, 1], 0.02 * np.sin(angle)]
    ).astype(np.float32)
    results = []
    for _ in range(2):
        solver = Solver(model, 1, 1, self_collision=True)
        solver.gravity.zero_()
        solver.plane[:, 3] = -100.0
        solver.reset(torch.tensor([0]), torch.as_tensor(start)[None])
        solver.velocities[0, :, 2] = torch.as_tensor(-0.5 * np.sign(start[:, 2]), dtype=torch.float32)
        masses = torch.as_tensor(model.masses)[:, None]
        before = (masses * solver.velocities[0]).sum(0)
        for _ in range(6):
            solver.step()
        after = (masses * solver.velocities[0]).sum(0)
        results.append(solver.positions.clone())
    scale = model.masses.sum() * 0.5
    # Float32 positions of 0.1 m over a substep of 2.5 ms: 3e-6 m/s per node and substep.
    assert (after - before).norm() < 2e-4 * scale
    assert torch.equal(*results)
    # They met and did not pass: what was above is above.
    middle = np.abs(model.rest_positions[:, 0]) > 0.06
    above = results[0][0, middle & (model.rest_positions[:, 0] > 0), 2].mean()
    below = results[0][0, middle & (model.rest_positions[:, 0] < 0), 2].mean()
    assert above > below


def test_contacts_without_room_are_counted_until_the_reset():
    """All triangles of a crumpled cloth lie within its thickness: far more contacts than a node has room for."""
    model = cloth(square_outline(0.4), num_nodes=400, radius=0.02)
    solver = Solver(model, 2, 1, self_collision=True)
    crumpled = torch.as_tensor(model.rest_positions) * 0.1 + torch.tensor([0.0, 0.0, 0.5])
    solver.reset(torch.tensor([1]), crumpled[None])
    solver.step()
    assert solver.dropped_contacts[0] == 0
    assert solver.dropped_contacts[1] > 0
    solver.reset(torch.tensor([1]))
    assert solver.dropped_contacts.tolist() == [0, 0]


def crumpled_cloths(num_worlds: int) -> torch.Tensor:
    """Return where cloths are whose corners two grippers have moved to and fro at full speed."""
    model = cloth(square_outline(0.3), num_nodes=64)
    solver = Solver(model, num_worlds, 2, self_collision=True)
    corners = torch.as_tensor(model.node_sets["corners"][:2])
    solver.reset(torch.arange(num_worlds), solver.positions + torch.tensor([0.0, 0.0, 0.1]), gripper_nodes=corners)
    generator = torch.Generator().manual_seed(0)
    for _ in range(30):
        motion = torch.randn(32, 2, 3, generator=generator)[:num_worlds]
        solver.gripper_targets += 0.03 * motion / motion.norm(dim=-1, keepdim=True)
        solver.step()
    assert solver._uploaded[-1].masses.numpy().any()
    return solver.positions


def test_when_pairs_are_searched_changes_no_bit(monkeypatch):
    """Lists that reach twice as far are made less often, and hold more; what acts follows from positions alone."""
    positions = crumpled_cloths(20)
    monkeypatch.setattr("maniskill_grpd.physics.upload.EDGE_MARGIN", 0.4)
    assert torch.equal(positions, crumpled_cloths(20))
    assert torch.equal(positions[:3], crumpled_cloths(3))


def test_held_ends_that_meet_throw_nothing():
    """Two grippers bring the ends of a rope to one point: what is held almost entirely does not push the free rest away."""
    model = rope(np.linspace([-0.2, 0.0, 0.1], [0.2, 0.0, 0.1], 21), num_nodes=21)
    solver = Solver(model, 1, 2, self_collision=True)
    solver.reset(torch.tensor([0]), gripper_nodes=torch.tensor([0, 20]))
    for step in range(80):
        solver.gripper_targets[0, :, 0] = torch.tensor([-0.2, 0.2]) * max(0.0, 1.0 - step / 40.0)
        solver.step()
        assert not solver.frozen.any()
        assert solver.velocities.norm(dim=-1).max() < 3.0
