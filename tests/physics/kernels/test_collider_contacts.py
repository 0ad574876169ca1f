"""What a group of worlds passes over as far from a collider is far from it."""

import numpy as np
import pytest
import torch
import warp as wp

from maniskill_grpd.physics import Solver, box, capsule, cylinder, plane, prism, rope, sphere, triangle_mesh
from maniskill_grpd.physics.kernels.collider_contacts import bound_distance, place_collider_bounds
from maniskill_grpd.physics.kernels.colliders import collider_distance
from maniskill_grpd.physics.kernels.data import Colliders, LaneGroups
from maniskill_grpd.physics.kernels.lane_access import component

TETRAHEDRON = np.array([[0.1, 0.0, 0.0], [0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.1, 0.0, 0.1]])  # its own origin lies outside
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
COLLIDERS = [
    plane(),
    sphere(0.1),
    capsule(0.03, 0.2),
    box(0.1, 0.05, 0.2),
    cylinder(0.1, 0.05),
    prism(np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.2]]), 0.05),
    triangle_mesh(TETRAHEDRON, FACES),
]
NUM_WORLDS = 16


@wp.kernel(module="unique", enable_backward=False)
def measure(colliders: Colliders, groups: LaneGroups, bounds: wp.array3d(dtype=float), distances: wp.array3d(dtype=float)):
    place_collider_bounds(0, colliders, groups)
    for k in range(colliders.kinds.shape[0]):
        for node in range(bounds.shape[2]):
            bound = bound_distance(0, k, groups.positions[0, node], groups)
            for lane in range(groups.members.shape[1]):
                values = groups.positions[0, node]
                point = wp.vec3(values[lane], values[16 + lane], values[32 + lane])
                bounds[k, lane, node] = component(bound, lane)
                distances[k, lane, node] = collider_distance(lane, k, point, colliders)[3]


@pytest.fixture(scope="module")
def measured() -> tuple[np.ndarray, np.ndarray]:
    """Bounds and distances (K, B, N) of random points from colliders in random poses and sizes; those of world 3 are off."""
    solver = Solver(rope([[0, 0, 0], [1, 0, 0]], num_nodes=101), NUM_WORLDS, 1, colliders=COLLIDERS)
    generator = torch.Generator().manual_seed(0)
    rotations = torch.randn(NUM_WORLDS, len(COLLIDERS), 4, generator=generator)
    solver.collider_rotations.copy_(rotations / rotations.norm(dim=-1, keepdim=True))
    solver.collider_positions.copy_(0.1 * torch.randn(NUM_WORLDS, len(COLLIDERS), 3, generator=generator))
    solver.collider_sizes.mul_(0.5 + torch.rand(NUM_WORLDS, len(COLLIDERS), 1, generator=generator))
    solver.collider_active[3] = False
    groups = solver._groups.data
    points = 0.2 * torch.randn(101, 48, generator=generator)
    wp.to_torch(groups.positions)[0] = points
    bounds, distances = (wp.zeros((len(COLLIDERS), NUM_WORLDS, 101), dtype=float, device="cpu") for _ in range(2))
    wp.launch(measure, dim=1, inputs=[solver._uploaded[1], groups, bounds, distances], device="cpu")
    return bounds.numpy(), distances.numpy()


@pytest.mark.parametrize("k", range(len(COLLIDERS)), ids=[collider.kind.name for collider in COLLIDERS])
def test_the_bound_is_never_above_the_distance(measured, k):
    bounds, distances = (np.delete(values[k], 3, axis=0) for values in measured)
    known = distances < 0.2  # farther away a small mesh only says that it is far
    assert (bounds[known] <= distances[known] + 1e-6).all()
    # Nor is it a bound that passes nothing over: of what is farther than 5 cm it recognises most.
    far = distances > 0.05
    assert far.any()
    assert (bounds[far] > 0.0).mean() > 0.8


def test_a_collider_that_is_off_is_far_from_everything(measured):
    assert (measured[0][:, 3] > 1e6).all()
    assert (np.delete(measured[0], 3, axis=1) < 10.0).all()
