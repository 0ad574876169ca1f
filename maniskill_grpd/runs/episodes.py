"""Results of episodes, as a table and as a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch


def describe_episodes(episodes: Mapping[str, torch.Tensor]) -> str:
    """Return a table of per-episode results: rates for yes/no, mean and quantiles for numbers."""
    lines = [f"{'':<18}{'mean':>11}{'5 %':>11}{'25 %':>11}{'median':>11}{'75 %':>11}{'95 %':>11}"]
    quantiles = torch.tensor([0.05, 0.25, 0.5, 0.75, 0.95], dtype=torch.float64)
    for name, values in episodes.items():
        cells = [values.double().mean()]
        if values.dtype != torch.bool:
            cells += torch.quantile(values.double(), quantiles)
        lines.append(f"{name:<18}" + "".join(f"{cell.item():>11.4g}" for cell in cells))
    return "\n".join(lines)


def write_episodes(path: Path, facts: Mapping[str, Any], episodes: Mapping[str, torch.Tensor], indent: int | None = None) -> None:
    """Write results as JSON: what was played, means, and the values of every episode.

    Args:
        path: Where to; folders that are missing are made.
        facts: What was played, in plain types.
        episodes: Results per episode, (E,) each.
        indent: Of the JSON.
    """
    results = {
        **facts,
        "mean": {name: values.double().mean().item() for name, values in episodes.items()},
        "episodes": {name: values.tolist() for name, values in episodes.items()},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=indent) + "\n", encoding="utf-8")
