"""Ropes whose segments have different lengths."""

import numpy as np
import pytest
import torch
from validation import closed_forms
from validation.rope_statics import balanced_substeps, drift_bound, free_solver, settle

from maniskill_grpd.physics import RopeMaterial, Solver, rope

SEGMENTS = np.array([1.5, 1.0] * 5)


def uneven(length, segments=SEGMENTS, **options):
    at = np.concatenate([[0.0], np.cumsum(segments)]) * length / segments.sum()
    return rope(np.column_stack([at, 0.0 * at, 0.0 * at]), num_nodes=None, **options)


def test_an_even_curve_gives_the_rope_of_its_length():
    line = np.column_stack([np.arange(9.0) / 8.0, np.zeros(9), np.zeros(9)])
    by_points, by_number = rope(line, num_nodes=None), rope(line, num_nodes=9)
    for name in ("rest_positions", "masses", "rest_lengths", "stretch_compliances", "bends", "bend_compliances", "arc"):
        np.testing.assert_array_equal(getattr(by_points, name), getattr(by_number, name), err_msg=name)
    assert len(by_points.hinges) == 0


def test_an_uneven_rope_hangs_as_far_as_its_stiffness_says():
    """The elongation is rho g L^2 / (2 EA), exact for any segments with half of each at its nodes."""
    model = uneven(1.0, material=RopeMaterial(stretch_stiffness=20.0, damping=4.0))
    solver = free_solver(model)
    solver.inverse_masses[:, 0] = 0.0
    solver.positions[0] = solver.positions[0, :, [2, 1, 0]] * torch.tensor([1.0, 1.0, -1.0])
    settle(solver, 6.0)
    assert -solver.positions[0, -1, 2].item() - 1.0 == pytest.approx(0.05 * 9.81 / 40.0, rel=2e-3)


@pytest.mark.parametrize("gamma", [4.0, 16.0])
def test_an_uneven_cantilever_is_the_heavy_elastica(gamma):
    """The clamp of the continuous beam lies half of the first segment behind the first hinge."""
    length = 0.5
    total = length * SEGMENTS.sum() / (SEGMENTS.sum() - 0.5 * SEGMENTS[0])
    weight = 0.05 * 9.81
    stiffness = weight * length**3 / gamma
    model = uneven(total, material=RopeMaterial(stretch_stiffness=2e3 * weight * length, bend_stiffness=stiffness, damping=6.0))
    substeps = balanced_substeps(gamma, length, model.num_nodes)
    solver = free_solver(model, substeps=substeps)
    solver.inverse_masses[:, :2] = 0.0
    settle(solver, 6.0)
    reach, drop = closed_forms.heavy_elastica(gamma)
    softer = closed_forms.heavy_elastica(gamma * (1.0 + 1e-3))
    softening = 1e3 * closed_forms.bend_softening(stiffness, 0.05, model.rest_lengths.mean(), 0.05 / substeps)
    # As in T4: hinges lump curvature and weight, of relative order (l / L)^2.
    lumping = (model.rest_lengths.max() / length) ** 2 * (1.0 + min(gamma, 8.0) ** 2 / 96.0)
    tip = (solver.positions[0, -1] / length).tolist()
    clamp = 0.5 * model.rest_lengths[0] / length
    for measured, expected, change in ((-tip[2], drop, softer[1] - drop), (tip[0] - clamp, reach, softer[0] - reach)):
        tolerance = float(lumping * expected + abs(change) * softening + 1e-3 + drift_bound(solver) / length)
        assert tolerance < 0.03
        assert measured == pytest.approx(expected, abs=tolerance)


def test_an_uneven_straight_rope_rests_and_touches_itself_nowhere():
    model = uneven(0.5, np.array([6.0, 0.4, 0.4, 6.0, 1.0, 1.0, 3.0]))
    solver = Solver(model, 1, 1, self_collision=True)
    solver.gravity.zero_()
    solver.plane[:, 3] = -1.0
    for _ in range(10):
        solver.step()
    assert (solver.positions[0] - torch.as_tensor(model.rest_positions)).abs().max() < 1e-6


@pytest.mark.parametrize(
    ("curve", "message"),
    [
        ([[0.0, 0.0], [1.0, 0.0]], "at least 3 nodes, got a curve of 2 points"),
        ([[0.0, 0.0], [0.5, 0.0], [0.5, 0.0], [1.0, 0.0]], "the one between points 1 and 2 is 0 m"),
        ([[0.0, 0.0], [0.01, 0.0], [1.0, 0.0]], "longer than 0.05 of the longest, 0.99 m"),
        ([[0.0, 0.0], [np.nan, 0.0], [1.0, 0.0]], "must be finite"),
    ],
)
def test_curves_that_cannot_be_nodes_are_refused(curve, message):
    with pytest.raises(ValueError, match=message):
        rope(curve, num_nodes=None)
