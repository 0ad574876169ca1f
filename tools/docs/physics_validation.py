"""Tables and plots of the validation of the physics, from what `measure_physics` wrote: docs/physics/*.json."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from tests.physics.validation import closed_forms
from tests.physics.validation.record import Check

COMMAND = "python -m tools.docs.measure_physics"
STRAINS = ("together", "apart", "apart_without_wrinkling", "shortest")
"""Columns of strain.json: percentiles of the strain of the edges, see `strain_percentiles`."""


def validation_page(checks: list[Check]) -> str:
    """Return docs/physics/validation.md."""
    origin = f"Measured by `{COMMAND}`; `make docs` writes this page from [validation.json](validation.json)."
    return f"# Validation, every number\n\n{origin}\n\n{to_table(checks)}"


def physics_page(page: str, checks: list[Check], strains: Sequence[Mapping[str, Any]]) -> str:
    """Return docs/physics.md with its tables made anew; the rest of it is written by hand."""
    return insert("strain table", to_strain_table(strains), insert("validation table", to_summary(checks), page))


def to_table(checks: list[Check]) -> str:
    """Return closed form, measurement and tolerance of every check."""
    lines = ["| test | quantity | closed form | expected | measured | tolerance | holds | tolerance from |"]
    lines.append("|---|---|---|--:|--:|--:|---|---|")
    for check in checks:
        numbers = f"{check.expected:.6g} | {check.measured:.6g} | {check.tolerance:.2g}"
        holds = "yes" if check.holds else "**no**"
        equation = check.equation.replace("|", "")
        lines.append(f"| {check.test} | {check.what} | {equation} | {numbers} | {holds} | {check.why} |")
    return "\n".join(lines) + "\n"


def share(check: Check) -> float:
    """Return how much of its tolerance a check uses; a vanishing tolerance is used up by any error."""
    error = abs(check.measured - check.expected)
    return error / check.tolerance if check.tolerance else float(error > 0.0) * np.inf


def to_summary(checks: list[Check]) -> str:
    """Return one line per law: of the checks with the same closed form, the one that uses most of its tolerance."""
    laws = defaultdict(list)
    for check in checks:
        laws[check.test, check.equation].append(check)
    lines = ["| test | checks that hold | the worst of them | closed form | expected | measured | tolerance |"]
    lines.append("|---|--:|---|---|--:|--:|--:|")
    for (test, equation), members in laws.items():
        worst = max(members, key=share)
        hold = f"{sum(check.holds for check in members)} of {len(members)}"
        hold = hold if all(check.holds for check in members) else f"**{hold}**"
        numbers = f"{worst.expected:.5g} | {worst.measured:.5g} | {worst.tolerance:.1g}"
        lines.append(f"| {test} | {hold} | {worst.what} | {equation.replace('|', '')} | {numbers} |")
    return "\n".join(lines) + "\n"


def to_strain_table(strains: Sequence[Mapping[str, Any]]) -> str:
    """Return one line per resolution of a cloth that is dragged by its corners."""
    lines = ["| nodes | substeps | all corners the same way | each corner its own way | without wrinkling | shortest 1 % |"]
    lines.append("|--:|--:|--:|--:|--:|--:|")
    for row in strains:
        percents = " | ".join(f"{100.0 * row[kind]:.1f} %" for kind in STRAINS)
        lines.append(f"| {row['nodes']:,} | {row['substeps']} | {percents} |")
    return "\n".join(lines) + "\n"


def insert(name: str, text: str, page: str) -> str:
    """Put a table between the markers of a page."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
    head, rest = page.split(begin)
    return head + begin + text + end + rest.split(end)[1]


def pick(checks: list[Check], start: str) -> list[Check]:
    """Return the checks whose quantity begins with a text."""
    return [check for check in checks if check.what.startswith(start)]


def number_after(text: str, key: str) -> float:
    """Return the number that follows a key in a quantity."""
    return float(text.split(key)[1].split()[0].strip(",:;"))


def plot_cantilever(checks: list[Check], path: Path) -> None:
    """Plot the master curve of the heavy elastica with ropes and strips on it."""
    gammas = np.geomspace(0.3, 64.0, 30)
    reach, drop = np.array([closed_forms.heavy_elastica(float(gamma)) for gamma in gammas]).T
    figure, axis = plt.subplots(figsize=(5.5, 3.6))
    axis.semilogx(gammas, drop, "k-", lw=1, label="drop / L, heavy elastica")
    axis.semilogx(gammas, reach, "k--", lw=1, label="X / L")
    for kind, mark in (("a cantilever", "o"), ("an overhanging strip", "^")):
        for name in ("drop/L", "X/L"):
            found = pick(checks, f"{name} of {kind}")
            x = [number_after(check.what, "Gamma = ") for check in found]
            object_name, color = ("rope", "C0") if mark == "o" else ("cloth", "C1")
            label = object_name if name == "drop/L" else None
            y, bars = [c.measured for c in found], [c.tolerance for c in found]
            axis.errorbar(x, y, bars, fmt=mark, ms=4, lw=0.8, capsize=2, label=label, color=color)
    axis.set(xlabel="Gamma = w L^3 / B", title="Cantilever under its own weight (T4, T5)")
    axis.legend(fontsize=8)
    save(figure, path)


def plot_pendulum(checks: list[Check], path: Path) -> None:
    """Plot the period over the amplitude and the modes of a heavy rope."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.4))
    degrees = np.linspace(1.0, 100.0, 100)
    left.plot(degrees, [closed_forms.pendulum_period_ratio(np.radians(value)) for value in degrees], "k-", lw=1)
    for check in pick(checks, "T / T0"):
        amplitude = number_after(check.what, "released at ")
        left.errorbar(amplitude, check.measured, check.tolerance, fmt="o", ms=4, color="C0", capsize=2)
        left.plot(amplitude, check.expected, "x", color="C1")
    title = "pendulum: mean of 10 s (o), closed form\nat its decaying amplitudes (x), undamped (line)"
    left.set(xlabel="amplitude at release [deg]", ylabel="T / T0", title=title)
    for check in pick(checks, "omega sqrt(L/g)"):
        nodes, mode = check.what.split(", ")[1].split()[0], number_after(check.what, "of mode ")
        error, bar = check.measured / check.expected - 1.0, check.tolerance / check.expected
        right.errorbar(float(nodes), error, bar, fmt="o-", ms=4, capsize=2, color=f"C{int(mode) - 1}")
    right.axhline(0.0, color="k", lw=0.8)
    right.set(xlabel="nodes", ylabel="relative error of frequency", title="modes 1, 2, 3 of a heavy rope\n(bars: tolerance)")
    save(figure, path)


def plot_resolution(checks: list[Check], path: Path) -> None:
    """Plot elongation over resolution and the sag of chains."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.4))
    for start, label in (("elongation of a hanging rod", "rope"), ("elongation of a hanging sheet", "cloth")):
        found = [check for check in pick(checks, start) if "nodes" in check.what]
        nodes = [float(check.what.split(" nodes")[0].split()[-1]) for check in found]
        errors, bars = zip(*[(c.measured / c.expected - 1.0, c.tolerance / c.expected) for c in found], strict=True)
        left.errorbar(nodes, errors, bars, fmt="o", ms=4, capsize=2, label=label)
    left.axhline(0.0, color="k", lw=0.8)
    left.set(xlabel="nodes", xscale="log", ylabel="relative error", title="elongation under own weight (T1)")
    left.legend(fontsize=8)
    for slack in ("1.05", "1.5", "2"):
        found = pick(checks, f"sag of a chain, L/d = {slack},")
        links = [float(check.what.split(" links")[0].split()[-1]) for check in found]
        right.loglog(links, [abs(c.measured / c.expected - 1.0) for c in found], "o-", ms=4, label=f"L/d = {slack}")
    right.set(xlabel="links", ylabel="relative error of the sag", title="hanging chain against the catenary (T3)")
    right.legend(fontsize=8)
    save(figure, path)


def plot_friction(checks: list[Check], path: Path) -> None:
    """Plot friction angle, capstan ratio and overhang over the coefficient."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.4))
    friction = np.linspace(0.01, 1.05, 50)
    turns = np.exp(np.pi * np.minimum(friction, 0.55))
    panels = (
        ("slope at which sliding starts", np.degrees(np.arctan(friction)), "deg", "friction angle: arctan(mu)"),
        ("tension ratio", turns, "T2 / T1", "capstan, half a turn: exp(mu pi)"),
    )
    for axis, (start, curve, unit, title) in zip(axes, panels, strict=True):
        axis.plot(np.minimum(friction, 0.55) if start.startswith("tension") else friction, curve, "k-", lw=1)
        for check in pick(checks, start):
            mu = number_after(check.what, "mu = ")
            axis.errorbar(mu, check.measured, check.tolerance, fmt="o", ms=4, capsize=2, color="C0")
        axis.set(xlabel="mu", ylabel=unit, title=title)
    save(figure, path)


def save(figure: plt.Figure, path: Path) -> None:
    """Write a figure."""
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    plt.close(figure)


def draw_plots(checks: list[Check], folder: Path) -> None:
    """Draw the four plots of docs/physics.md."""
    plot_resolution(checks, folder / "resolution.png")
    plot_cantilever(checks, folder / "cantilever.png")
    plot_pendulum(checks, folder / "pendulum.png")
    plot_friction(checks, folder / "friction.png")
