"""Contact of objects with links of arms: capsules that move while a control step lasts."""

import numpy as np
import pytest
import torch

from maniskill_grpd.physics import Link, Solver, cloth, rope, square_outline
from maniskill_grpd.physics.links import MOST_LINKS

RADIUS = 0.05
LINKS = (Link(0, RADIUS),)


def make_rope(num_worlds=1, links=LINKS):
    """Return a straight rope in the air, without gravity, held at its first node by one gripper."""
    solver = Solver(rope([[-0.4, 0], [0.4, 0]], num_nodes=41), num_worlds, 1, links=links, num_threads=1)
    solver.gravity.zero_()
    solver.plane[:, 3] = -10.0
    solver.reset(torch.arange(num_worlds), gripper_nodes=torch.zeros(1, dtype=torch.int64))
    return solver


def sweep(solver, start, motion, steps=1):
    """Move a link along y by a motion in each step; `start` are both ends of its axis."""
    ends = torch.as_tensor(start, dtype=torch.float32)
    for _ in range(steps):
        solver.link_motions.starts[:, 0] = ends
        ends = ends + torch.as_tensor(motion)
        solver.link_motions.ends[:, 0] = ends
        solver.step()
    return ends


def gap_to_link(solver, ends):
    """Return how far nodes and middles of edges of world 0 are from the axis of a link, in excess of both radii [m]."""
    nodes = solver.positions[0].double()
    points = torch.cat([nodes, 0.5 * (nodes[1:] + nodes[:-1])])
    a, along = ends[0].double(), (ends[1] - ends[0]).double()
    share = (((points - a) @ along) / along.dot(along)).clamp(0, 1)
    return (points - a - share[:, None] * along).norm(dim=1) - RADIUS - solver.model.radius


def test_a_link_pushes_a_rope_before_itself_and_does_not_pass_through():
    solver = make_rope()
    ends = sweep(solver, [[0.0, -0.2, -0.1], [0.0, -0.2, 0.1]], [0.0, 0.03, 0.0], steps=10)
    assert gap_to_link(solver, ends).min() > -1e-3
    assert solver.positions[0, 20, 1] > 0.1  # it has gone 30 cm, and stands at 10 cm
    through = make_rope(links=())
    through.step()
    assert (through.positions[0, :, 1].abs() < 1e-6).all()  # control: without links nothing moves it


def test_an_edge_touches_between_its_nodes():
    solver = Solver(rope([[-0.4, 0], [0.4, 0]], num_nodes=5), 1, 1, links=(Link(0, 0.02),), num_threads=1)
    solver.gravity.zero_()
    solver.plane[:, 3] = -10.0
    sweep(solver, [[0.1, -0.1, -0.1], [0.1, -0.1, 0.1]], [0.0, 0.02, 0.0], steps=8)
    assert solver.positions[0, 2, 1] > 0.02  # the nodes are 10 cm away from where it goes


def test_what_lies_between_the_fingers_does_not_touch_them_and_the_rest_does():
    for gripper_nodes, moves in ((20, False), (0, True)):
        solver = make_rope(links=(Link(0, 0.02),))
        solver.reset(torch.arange(1), gripper_nodes=torch.tensor([gripper_nodes]))
        start = torch.tensor([[0.0, -0.015, -0.1], [0.0, -0.015, 0.1]])
        solver.link_motions.starts[:, 0] = solver.link_motions.ends[:, 0] = start
        before = solver.positions.clone()
        solver.step()
        pinched = slice(19, 22)
        assert ((solver.positions - before)[0, pinched].abs() > 1e-4).any() == moves


def test_what_starts_inside_comes_out_slowly():
    solver = make_rope()
    solver.reset(torch.arange(1))
    start = torch.tensor([[0.0, -0.01, -0.1], [0.0, -0.01, 0.1]])
    solver.link_motions.starts[:, 0] = solver.link_motions.ends[:, 0] = start
    for _ in range(10):
        solver.step()
        assert solver.velocities.norm(dim=-1).max() < 2.0  # at once it would be 24 m/s
    assert gap_to_link(solver, start).min() > -2e-3


def test_friction_carries_what_lies_on_a_link():
    """A cloth on a horizontal capsule goes with it where there is friction, and stays behind where there is none."""
    moved = []
    for friction in (1.0, 0.0):
        solver = Solver(cloth(square_outline(0.3), num_nodes=64), 1, 1, links=(Link(0, RADIUS),), num_threads=1)
        solver.plane[:, 3] = -10.0
        solver.friction[:] = friction
        top = torch.tensor([[-0.3, 0.0, -RADIUS - 0.012], [0.3, 0.0, -RADIUS - 0.012]])
        ends = sweep(solver, top, [0.0, 0.0, 0.0], steps=8)
        before = solver.positions[0].mean(dim=0)
        sweep(solver, ends, [0.01, 0.0, 0.0], steps=10)
        moved.append((solver.positions[0].mean(dim=0) - before)[0].item())
    assert moved[0] > 0.05
    assert abs(moved[1]) < 0.01


def test_far_links_change_nothing_and_worlds_do_not_depend_on_the_batch():
    plain, far, many = make_rope(links=()), make_rope(), make_rope(17)
    far.link_motions.starts[:] = far.link_motions.ends[:] = 5.0
    near = torch.tensor([[0.0, -0.03, -0.1], [0.0, -0.03, 0.1]])
    many.link_motions.starts[:], many.link_motions.ends[:] = 5.0, 5.0
    many.link_motions.starts[9, 0] = many.link_motions.ends[9, 0] = near
    alone = make_rope()
    alone.link_motions.starts[:, 0] = alone.link_motions.ends[:, 0] = near
    for solver in (plain, far, many, alone):
        solver.gripper_targets.add_(torch.tensor([0.02, 0.01, 0.0]))
        solver.step()
    assert torch.equal(plain.positions, far.positions)
    assert torch.equal(many.positions[3], far.positions[0])
    assert torch.equal(many.positions[9], alone.positions[0])
    assert not torch.equal(alone.positions, far.positions)


def test_turning_rope_and_link_turns_the_motion():
    turn = torch.as_tensor(np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0], dtype=torch.float32)
    turn[:, 0] *= torch.linalg.det(turn).sign()
    solvers = make_rope(), make_rope()
    solvers[1].positions.copy_(solvers[0].positions @ turn.T)
    for points in (solvers[1].gripper_positions, solvers[1].gripper_targets):
        points.copy_(points @ turn.T)
    solvers[1].plane[:, 3] = -100.0
    start, motion = torch.tensor([[0.05, -0.09, -0.1], [0.0, -0.08, 0.1]]), torch.tensor([0.0, 0.02, 0.0])
    sweep(solvers[0], start, motion, 4)
    sweep(solvers[1], start @ turn.T, motion @ turn.T, 4)
    torch.testing.assert_close(solvers[1].positions, solvers[0].positions @ turn.T, atol=1e-4, rtol=0)


def test_links_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="must be finite and > 0 m, got 0.0"):
        Link(0, 0.0)
    with pytest.raises(ValueError, match=f"at most {MOST_LINKS} links, got 32"):
        make_rope(links=(Link(0, 0.1),) * 32)
