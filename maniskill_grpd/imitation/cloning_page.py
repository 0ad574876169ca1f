"""Results of behaviour cloning, as a line and as a page."""

from __future__ import annotations

import shlex
from typing import Any

from maniskill_grpd.imitation.clone_config import CloneConfig
from maniskill_grpd.imitation.demonstrations import Demonstrations
from maniskill_grpd.learning.options import to_arguments
from maniskill_grpd.tasks.measurement import Metric


def summarize(result: dict[str, Any], progress: Metric) -> str:
    """Return the results of a policy in one line, with what measures the progress of its task."""
    played = ", ".join(
        f"success at {poses} poses {means['success_at_end']:.0%} ({progress.format(means[progress.name])})"
        for poses, means in result["rollouts"].items()
    )
    return (
        f"validation error {result['validation_error']:.1%} after {result['gradient_steps']} steps "
        f"({result['cpu_seconds']:.0f} CPU s); {played}"
    )


def to_markdown(
    config: CloneConfig,
    results: list[dict[str, Any]],
    expert: dict[str, dict[str, float]],
    demonstrations: Demonstrations,
    progress: Metric,
) -> str:
    """Format the results of all policies, and what they can be held against, as a page.

    Args:
        config: Options of the cloning.
        results: Those of each policy.
        expert: Means of the expert's episodes, by the name of the poses.
        demonstrations: What was learned.
        progress: What measures the progress of the task.
    """
    ranges = list(expert)
    lines = [
        "| policy | parameters | validation error | "
        + " | ".join(f"success, {name} | {progress.label}, {name}" for name in ranges)
        + " | training, CPU s |",
        "|---|--:|--:|" + "--:|--:|" * len(ranges) + "--:|",
    ]
    for result in results:
        cells = [result["policy"], f"{result['num_parameters']:,}", f"{result['validation_error']:.1%}"]
        cells += _rollout_cells(result["rollouts"], ranges, progress)
        cells.append(f"{result['cpu_seconds']:.0f}")
        lines.append("| " + " | ".join(cells) + " |")
    lines.append("| " + " | ".join(["(expert)", "", "", *_rollout_cells(expert, ranges, progress), ""]) + " |")
    return PAGE.format(
        command="maniskill-grpd clone " + shlex.join(to_arguments(config)),
        demonstrated=_describe_source(config, demonstrations),
        task=" ".join(config.env_kwargs),
        num_observations=len(demonstrations.episode),
        table="\n".join(lines),
        **config.to_dict(),
    )


PAGE = """# Behaviour cloning

Written by `{command}`.

Every policy learned from the same {demonstrated} of {env_id} ({task}),
{num_observations:,} observations. Training: {epochs} epochs of Adam, {batch_size} observations per step, learning rate
{learning_rate} falling to zero along a cosine, loss {loss}, seed {seed}, one seed only.

{table}

- *validation error*: root mean square of |mean - expert's action| on held-out episodes, over that of the expert's action.
- *success*: share of {num_test_episodes} episodes, on unseen seeds, that end in success, acting with the mean.
- *{train_pose_range} turned*: poses of the demonstrated range, then the whole scene turned by 90 to 270 degrees: no
  demonstration had such an orientation, and nothing else differs.
- *{test_pose_range}*: start and goal are drawn independently from the {test_pose_range} range: other orientations, and also
  larger ways and angles between start and goal than were demonstrated.
- *CPU s*: processor time of one thread, validation included.
"""


def _describe_source(config: CloneConfig, demonstrations: Demonstrations) -> str:
    if config.demonstrations is not None:
        return f"{demonstrations.num_episodes} episodes in {config.demonstrations.name}"
    return (
        f"{demonstrations.num_episodes} episodes of the expert (the first {config.num_steps} steps "
        f"of each; start and goal from the {config.train_pose_range} pose range; noise of {config.action_noise} of the "
        "largest action on executed, not on recorded actions)"
    )


def _rollout_cells(rollouts: dict[str, dict[str, float]], ranges: list[str], progress: Metric) -> list[str]:
    cells = []
    for name in ranges:
        means = rollouts[name]
        cells += [f"{means['success_at_end']:.0%}", f"{means[progress.name]:.3g}"]
    return cells
