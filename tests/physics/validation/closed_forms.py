"""Closed forms and exact discrete solutions, in float64, independent of the solver."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.integrate import solve_bvp, solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import ellipk, jn_zeros

GRAVITY = 9.81
FLOAT32_ULP = 2.0**-23


def catenary(length: float, span: float) -> tuple[float, float]:
    """Return sag and parameter a [m] of an inextensible chain: L = 2 a sinh(d / 2a), sag = a (cosh(d / 2a) - 1)."""
    a = brentq(lambda a: 2.0 * a * np.sinh(span / (2.0 * a)) - length, 1e-2 * span, 1e2 * span)
    return a * (np.cosh(span / (2.0 * a)) - 1.0), a


def discrete_catenary_sag(length: float, span: float, num_links: int) -> float:
    """Return the sag [m] of a chain of rigid links with half masses at its ends.

    The horizontal force H is constant, the vertical one grows by the weight of a node: link k (from the middle) has the slope
    V_k / H with V_k = w (k - (n - 1) / 2), in units of the weight of a link.
    """
    link = length / num_links
    vertical = np.abs(np.arange(num_links) - (num_links - 1) / 2.0)

    def width(force: float) -> float:
        return float((link * force / np.hypot(force, vertical)).sum())

    force = brentq(lambda force: width(force) - span, 1e-3, 1e4)
    drops = link * vertical / np.hypot(force, vertical)
    return float(drops[: num_links // 2].sum())


@cache
def heavy_elastica(gamma: float) -> tuple[float, float]:
    """Return reach X / L and drop / L of a clamped beam under its own weight.

    B theta'' = -w (L - s) cos(theta), theta(0) = 0, theta'(L) = 0, with the one parameter gamma = w L^3 / B.
    """
    s = np.linspace(0.0, 1.0, 400)
    shape = np.zeros((2, s.size))
    solution = None
    for load in np.geomspace(min(0.1, gamma), gamma, 12):  # continuation: strong loads need a bent first guess
        solution = solve_bvp(
            lambda s, y, load=load: np.array([y[1], -load * (1.0 - s) * np.cos(y[0])]),
            lambda start, end: np.array([start[0], end[1]]),
            s,
            shape,
            tol=1e-9,
            max_nodes=100_000,
        )
        s, shape = solution.x, solution.y
    fine = np.linspace(0.0, 1.0, 4001)
    theta = -solution.sol(fine)[0]
    sign = np.sign(theta[-1])
    return float(np.trapezoid(np.cos(theta), fine)), float(sign * np.trapezoid(np.sin(theta), fine))


def pendulum_period_ratio(amplitude: float) -> float:
    """Return T / T0 = (2 / pi) K(sin^2(amplitude / 2)) of a point pendulum, amplitude in rad."""
    return float(2.0 / np.pi * ellipk(np.sin(amplitude / 2.0) ** 2))


def heavy_rope_frequency(mode: int) -> float:
    """Return omega sqrt(L / g) of a hanging rope: half the zeros of the Bessel function J0; modes count from 0."""
    return float(jn_zeros(0, mode + 1)[mode] / 2.0)


def discrete_heavy_rope_frequency(mode: int, num_nodes: int) -> float:
    """Return omega sqrt(L / g) of a hanging chain with a half mass at its free end, from its linear eigenproblem."""
    count = num_nodes - 1  # free nodes, from the top
    masses = np.full(count, 1.0 / count)
    masses[-1] *= 0.5
    tensions = np.cumsum(masses[::-1])[::-1]  # of the link above each node, in units of g
    stiffness = np.zeros((count, count))
    for node, tension in enumerate(tensions * count):
        stiffness[node, node] += tension
        if node > 0:
            stiffness[node - 1, node - 1] += tension
            stiffness[node, node - 1] -= tension
            stiffness[node - 1, node] -= tension
    return float(np.sqrt(eigh(stiffness, np.diag(masses), eigvals_only=True)[mode]))


def sliding_overhang(friction: float, length: float, radius: float) -> float:
    """Return the hanging fraction at which a rope slides off a table whose edge is rounded with `radius`.

    Over the edge, dT / dphi = mu (T + w R cos phi) - w R sin phi (capstan with weight), from T = mu w L_table to T = w L_hanging;
    for R -> 0 without friction at the edge it is mu / (1 + mu). What lies on the round edge counts as neither hanging nor lying.
    """

    def excess(fraction: float) -> float:
        start = friction * ((1.0 - fraction) * length - 0.5 * np.pi * radius)
        arc = solve_ivp(
            lambda phi, t: friction * (t + radius * np.cos(phi)) - radius * np.sin(phi), (0.0, 0.5 * np.pi), [start], rtol=1e-8
        )
        return fraction * length - arc.y[0, -1]

    return brentq(excess, 0.01, 0.9)


def bend_softening(bend_stiffness: float, linear_density: float, segment: float, dt: float) -> float:
    """Return the relative extra compliance of bending that one coloured sweep per substep leaves.

    At rest, constraint i of the first colour does not see its four later neighbours, whose part of J W J^T is
    w (-4 - 4 + 1 + 1) = -6 w for a smooth moment; the second colour misses -3 w, the third nothing: 3 w on average, against the
    compliance l^3 / (EI dt^2), with w = 1 / (rho l).
    """
    return 3.0 * bend_stiffness * dt**2 / (linear_density * segment**4)
