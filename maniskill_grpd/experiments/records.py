"""What the folder of a run tells, as rows of plain values."""

from __future__ import annotations

import json
import statistics
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from maniskill_grpd.experiments.curves import Curve, mean_over_training
from maniskill_grpd.learning.run_log import read_rows

Row = dict[str, Any]

FINGERPRINT = ("solver", "task", "learner", "code")
"""Parts of a fingerprint, and the columns that hold them."""
CURVE_METRICS = ("return", "success_once", "success_at_end")
"""Scores of the evaluations during training that are kept."""
TEST_FOLDER = "tests"
"""Folder of a run in which each test leaves a file."""


def run_row(name: str, run_dir: Path, state: str) -> Row:
    """Return what determined a run and what its training came to.

    Args:
        name: Name of the run.
        run_dir: Its folder.
        state: "finished" or "failed".

    Returns:
        One row: identity, every option as JSON, machine, versions, commit, fingerprint and the metrics of training (see
        `training_metrics`).
        A run that failed before it had begun has little to tell.
    """
    row: Row = {"run": name, "state": state}
    record_path = run_dir / "config.json"
    if not record_path.exists():
        return row
    record = read_json(record_path)
    config, git = record["config"], record["git"] or {}
    row |= {
        "env_id": config["env_id"],
        "policy": config["policy"],
        "algorithm": config["algorithm"],
        "seed": config["seed"],
        "budget": config["total_timesteps"],
        "config": json.dumps(config, sort_keys=True),
        "device": record["device"],
        "device_name": record["device_name"],
        "python": record["python"],
        "versions": json.dumps(record["versions"], sort_keys=True),
        "commit": git.get("commit", ""),
        "dirty": git.get("dirty", ""),
        **_fingerprint_columns([*record.get("earlier_fingerprints", []), record.get("fingerprint") or {}]),
    }
    return row | training_metrics(read_rows(run_dir / "metrics.jsonl"))


def training_metrics(rows: Iterable[Row]) -> Row:
    """Return metrics of a whole training from its log.

    Returns:
        `training_return`: mean over the training of the return in evaluations.
        `iteration_seconds`, `update_seconds`, `rollout_seconds`: medians over iterations.
        `kl_acting`: mean over iterations of the average KL(new || old) of the policy that acts next [nats].
        `kl_projected`: the same of the policy whose surrogate is maximised in the last epoch, which is the projection of the
        policy or, without projection, the policy itself.
        `action_norm`: mean length of actions over the last tenth of the iterations; `action_norm_growth`: over that of the first.
        Those whose data are not there are left out.
    """
    rows = list(rows)
    train = [row for row in rows if row["kind"] == "train"]
    metrics: Row = {}
    curve = _curve([row for row in rows if row["kind"] == "eval"], "eval/return")
    if curve is not None:
        metrics["training_return"] = mean_over_training(curve)
    updates, rollouts = ([row[f"time/{part}_time"] for row in train] for part in ("update", "rollout"))
    if train:
        metrics["iteration_seconds"] = statistics.median(u + r for u, r in zip(updates, rollouts, strict=True))
        metrics["update_seconds"] = statistics.median(updates)
        metrics["rollout_seconds"] = statistics.median(rollouts)
    metrics |= _action_norms([row["charts/action_norm"] for row in train if "charts/action_norm" in row])
    divergences = {
        "kl_acting": [row.get("losses/kl_acting") for row in train],
        "kl_projected": [row.get("losses/kl_projected", row.get("losses/kl_raw")) for row in train],
    }
    return metrics | {name: statistics.fmean(found) for name, found in divergences.items() if found and None not in found}


def _action_norms(norms: list[float]) -> Row:
    if not norms:
        return {}
    tenth = max(1, len(norms) // 10)
    first, last = statistics.fmean(norms[:tenth]), statistics.fmean(norms[-tenth:])
    return {"action_norm": last, **({"action_norm_growth": last / first} if first > 0.0 else {})}


def curve_rows(name: str, run_dir: Path) -> Iterator[Row]:
    """Yield a row for each evaluation during the training of a run, with the norm of the actions of its iteration."""
    norms = {row["global_step"]: row.get("charts/action_norm", "") for row in read_rows(run_dir / "metrics.jsonl", "train")}
    for row in read_rows(run_dir / "metrics.jsonl", "eval"):
        scores = {metric: row[f"eval/{metric}"] for metric in CURVE_METRICS if f"eval/{metric}" in row}
        yield {"run": name, "step": row["global_step"], "action_norm": norms.get(row["global_step"], ""), **scores}


def test_rows(name: str, run_dir: Path) -> Iterator[Row]:
    """Yield a row for each test of a run: condition, episodes and the mean of every metric over them, or why it failed."""
    for path in sorted((run_dir / TEST_FOLDER).glob("*.json")):
        test = read_json(path)
        yield {
            "run": name,
            "condition": test["condition"],
            "sigma": test["sigma"],
            "env_kwargs": json.dumps(test["env_kwargs"], sort_keys=True),
            "num_episodes": test["num_episodes"],
            "first_seed": test["first_seed"],
            "global_step": test["global_step"],
            "error": test.get("error", ""),
            **_fingerprint_columns([test.get("fingerprint") or {}]),
            **test.get("mean", {}),
        }


def is_played(path: Path, plan: Row) -> bool:
    """Return whether a file holds the results of the test that is planned."""
    if not path.exists():
        return False
    found = read_json(path)
    return "error" not in found and all(found.get(key) == value for key, value in plan.items())


def read_json(path: Path) -> Row:
    """Read a file that holds one JSON object.

    Raises:
        ValueError: Naming file and line, if it is damaged.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}, line {error.lineno}: damaged ({error.msg}); move it away") from error
    if not isinstance(found, dict):
        raise ValueError(f"{path}, line 1: damaged (no JSON object); move it away")
    return found


def _fingerprint_columns(fingerprints: Iterable[Row]) -> Row:
    """Return the parts of a fingerprint; of a run that went on with other code all that it had, joined by "+"."""
    fingerprints = list(fingerprints)
    return {part: "+".join(dict.fromkeys(found.get(part, "") for found in fingerprints)) for part in FINGERPRINT}


def _curve(rows: list[Row], tag: str) -> Curve | None:
    points = [(row["global_step"], row[tag]) for row in rows if tag in row]
    return Curve(*np.array(points, float).T) if points else None
