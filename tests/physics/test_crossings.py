"""Crossings are counted as they are, and contact leaves none: folds onto a free edge, drops edge first, a knot pulled tight."""

import numpy as np
import pytest
import torch

from maniskill_grpd.physics import RopeMaterial, Solver, cloth, rope, square_outline
from maniskill_grpd.physics.crossings import _crosses, count_crossings


def writhe(points: np.ndarray) -> float:
    """Return the Gauss writhe of an open polyline (N, 3)."""
    a, b = points[:-1], points[1:]
    i, j = np.triu_indices(len(a), 2)
    r13, r14, r23, r24 = a[j] - a[i], b[j] - a[i], a[j] - b[i], b[j] - b[i]
    normals = [np.cross(r13, r14), np.cross(r14, r24), np.cross(r24, r23), np.cross(r23, r13)]
    normals = [n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12) for n in normals]
    area = sum(np.arcsin(np.clip((normals[k] * normals[(k + 1) % 4]).sum(1), -1, 1)) for k in range(4))
    return float((area * np.sign((np.cross(b[j] - a[j], b[i] - a[i]) * r13).sum(1))).sum() / (2 * np.pi))


def overhand() -> np.ndarray:
    """Return the curve of an open overhand knot with straight tails, 1.59 m long."""
    u = np.linspace(-2.95, 2.95, 700)
    knot = 0.04 * np.stack([np.sin(u) + 2 * np.sin(2 * u), np.cos(u) - 2 * np.cos(2 * u), -np.sin(3 * u)], 1)
    tail = np.linspace(0, 0.25, 40)[1:, None]
    ways = [end * [1, 1, 0] / np.linalg.norm(end[:2]) for end in (knot[0], knot[-1])]
    return np.concatenate([knot[0] + tail[::-1] * ways[0], knot, knot[-1] + tail * ways[1]]) + [0, 0, 0.2]


def crossings(solver: Solver) -> int:
    return int(count_crossings(solver.model, solver.positions)[0])


def test_an_edge_through_a_triangle_crosses_it_and_one_beside_above_or_in_its_plane_does_not():
    triangle = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], dtype=torch.float64).expand(4, 3, 3)
    through, beside = [[0.2, 0.2, -1.0], [0.3, 0.3, 1.0]], [[0.8, 0.8, -1.0], [0.9, 0.9, 1.0]]
    above, within = [[0.2, 0.2, 0.1], [0.3, 0.3, 1.0]], [[-1.0, 0.2, 0.0], [1.0, 0.2, 0.0]]
    ends = torch.tensor([through, beside, above, within], dtype=torch.float64)
    assert _crosses(ends, triangle).tolist() == [True, False, False, False]
    assert _crosses(ends.flip(1), triangle.roll(1, dims=1)).tolist() == [True, False, False, False]


@pytest.mark.parametrize("num_nodes", [100, 225])
def test_a_cloth_folded_onto_its_free_edge_and_released_does_not_cross_itself(num_nodes):
    model = cloth(square_outline(0.3), num_nodes=num_nodes)
    corners = model.node_sets["corners"]
    solver = Solver(model, 1, 2, self_collision=True)
    positions = solver.positions.clone()
    positions[..., 2] = model.radius
    solver.reset(torch.tensor([0]), positions, torch.as_tensor([corners[1], corners[2]]))
    for angle in np.linspace(0, np.pi, 40)[1:]:
        solver.gripper_targets.copy_(solver.gripper_positions)
        solver.gripper_targets[0, :, 0] = 0.145 * np.cos(angle)
        solver.gripper_targets[0, :, 2] = 0.01 + 0.145 * np.sin(angle)
        solver.step()
    solver.set_closed(torch.zeros(1, 2, dtype=torch.bool))
    for _ in range(30):
        solver.step()
    assert crossings(solver) == 0


def test_a_cloth_dropped_edge_first_does_not_cross_itself():
    model = cloth(square_outline(0.3), num_nodes=100)
    rest = torch.as_tensor(model.rest_positions)
    upright = torch.stack([rest[:, 0], 0.02 * rest[:, 1], rest[:, 1] + 0.16], -1)[None]
    most, final = {}, {}
    for self_collision in (True, False):
        solver = Solver(model, 1, 1, self_collision=self_collision)
        solver.reset(torch.tensor([0]), upright)
        most[self_collision] = 0
        for _ in range(80):
            solver.step()
            final[self_collision] = crossings(solver)
            most[self_collision] = max(most[self_collision], final[self_collision])
        assert solver.dropped_contacts[0] == 0
    assert final[True] == 0
    assert most[False] > 10


def test_a_knot_pulled_tight_stays_a_knot_and_pushes_back():
    model = rope(overhand(), num_nodes=81, radius=0.006, material=RopeMaterial(bend_stiffness=1e-6, friction=0.3))
    solver = Solver(model, 1, 2, self_collision=True)
    solver.plane[:, 3] = -10.0
    solver.gravity[:] = 0.0
    solver.reset(torch.tensor([0]), gripper_nodes=torch.tensor([0, 80]))
    way = torch.sign(solver.gripper_positions[0, 1, 0] - solver.gripper_positions[0, 0, 0]) * torch.tensor([1.0, 0.0, 0.0])
    for _ in range(90):
        solver.gripper_targets.copy_(solver.gripper_positions)
        solver.gripper_targets[0, 0] -= 0.01 * way
        solver.gripper_targets[0, 1] += 0.01 * way
        solver.step()
    assert abs(writhe(solver.positions[0].double().numpy())) > 2.9
    assert solver.gripper_forces[0].norm(dim=1).min() > 5.0


def test_what_has_crossed_is_part_of_the_state_and_goes_on_bit_for_bit():
    """Two layers are put through each other within their memory: a restored state brings them back as the first did."""
    model = cloth(square_outline(0.3), num_nodes=49)
    solver, restored = (Solver(model, 1, 2, self_collision=True) for _ in range(2))
    positions = solver.positions.clone()
    positions[..., 2] += 0.02 + torch.where(positions[..., 0] > 0.0, 0.004, 0.0)
    positions[..., 0] = -positions[..., 0].abs()
    solver.reset(torch.tensor([0]), positions)
    solver.crossed_owners[0, 0], solver.crossed_elements[0, 0] = 8, 3
    for _ in range(3):
        state = solver.state()
        restored.set_state(state)
        solver.step()
        restored.step()
        assert all(torch.equal(tensor, restored.state()[name]) for name, tensor in solver.state().items())
    solver.reset(torch.tensor([0]))
    assert (solver.crossed_owners == -1).all()
