"""docs/results/demonstrations.md: BPP and PPO from one clone, from what `examples/start_from_demonstrations.py` wrote."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from tools.docs.benchmark_pages import markdown_table

COMMAND = "python examples/start_from_demonstrations.py --json docs/results/demonstrations.json"
CURVES = "demonstrations_curves.png"
ALGORITHMS = ("bpp", "ppo")
ABOUT = """\
`train --demonstrations FILE` clones the demonstrations, evaluates the clone, and goes on with reinforcement learning. The value
function learns the returns of the demonstrations meanwhile; *untrained* are runs in which it did not. Exploration is *small* by
default, a deviation of 0.05 without correlation; *large* is 0.15 with the correlation of 0.5 that ClothHanging-v1 recommends for
trainings from nothing. BPP and PPO start from the same clone, with their default settings and what the task recommends."""

FOUND = """\
What this says, with one seed, 20 episodes in each evaluation and four iterations:

- With small exploration the trust region protects the start: the first iteration of BPP costs 0.9 of a return of 43.8, that of
  PPO 20.9, and the return of BPP is above that of PPO in each of the four evaluations. It does not hold all of it: BPP falls to
  27.6 in the third iteration and is at 38.0 in the fourth.
- With large exploration it does not. What learns is the policy that acts with its noise, and that one succeeds in no more than
  12 % of its episodes at first, with a return of 14 where its mean actions reach 44 to 48. Steps of 0.1 nats lead away from the
  start as those of 0.3 do, only more slowly, and PPO is back sooner. Fitted values do not change that. This is why
  demonstrations are followed by little noise.
- On RopeWrapping-v1 (40 episodes of the expert, large exploration, values untrained) the clone succeeds in all episodes, and
  neither algorithm lost that in the evaluations that were made, five of BPP and two of PPO: nothing to protect there."""


def demonstrations_page(runs: Sequence[Mapping[str, Any]]) -> str:
    """Return the page of what the example wrote."""
    head = [
        "exploration",
        "values",
        "seed",
        "algorithm",
        "clone",
        "lowest afterwards",
        "at the end",
        "return of the clone",
        "lowest",
        "at the end",
        "largest KL",
    ]
    rows = [_cells(run) for run in sorted(runs, key=_kind)]
    text = markdown_table(head, rows, text_columns=(0, 1, 2, 3))
    commits = ", ".join(sorted({run["commit"][:10] for run in runs if run["commit"]}))
    origin = (
        f"`{COMMAND}`, commit {commits} (also with `--exploration large` and `--untrained_values`). `make docs` writes this page."
    )
    figure = f"![Success and return after cloning]({CURVES})"
    parts = [
        "# From demonstrations: BPP and PPO from one clone",
        ABOUT,
        figure,
        "Success at the end of the episode, and return:",
        text,
    ]
    return "\n\n".join([*parts, FOUND, origin]) + "\n"


def draw_demonstrations(runs: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Draw the evaluations of all runs over environment steps."""
    figure = Figure(figsize=(8.4, 4.0), layout="constrained")
    for axis, (name, label) in zip(
        figure.subplots(1, 2), {"success_at_end": "success at the end", "return": "return"}.items(), strict=True
    ):
        for run in runs:
            index = ALGORITHMS.index(run["algorithm"])
            steps, values = zip(*((point["step"], point[name]) for point in run["evaluations"]), strict=True)
            shown = f"{run['algorithm'].upper()}, {run['exploration']} exploration, values {run['values']}"
            style = "-" if run["exploration"] == "small" else "--" if run["values"] == "fitted" else ":"
            axis.plot(steps, values, style, color=f"C{index}", marker="o", ms=3, lw=1.5, alpha=0.8, label=shown)
        axis.set_xlabel("environment steps after cloning")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    handles, labels = axis.get_legend_handles_labels()
    by_label = dict(zip(labels, handles, strict=True))
    figure.legend(by_label.values(), by_label.keys(), fontsize=8, loc="outside lower center", ncols=2)
    figure.savefig(folder / CURVES, dpi=150)


def _cells(run: Mapping[str, Any]) -> list[str]:
    cells = [run["exploration"], run["values"], str(run["seed"]), run["algorithm"].upper()]
    for name, form in (("success_at_end", ".0%"), ("return", ".1f")):
        values = [point[name] for point in run["evaluations"]]
        cells += [format(value, form) for value in (values[0], min(values[1:]), values[-1])]
    return [*cells, f"{max(run['kl']):.2f}"]


def _kind(run: Mapping[str, Any]) -> tuple[str, str, int, str]:
    return run["exploration"], run["values"], run["seed"], run["algorithm"]
