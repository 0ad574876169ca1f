"""What the metrics of tables mean and how they are written."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """A score.

    Attributes:
        label: What tables and axes call it.
        meaning: One line for the foot of a page.
        decimals: Digits after the point.
        is_time: Whether it is a time: lower is better, axes are logarithmic, tasks are not pooled.
    """

    label: str
    meaning: str
    decimals: int = 2
    is_time: bool = False


METRICS = {
    "success_at_end": Metric("success", "share of test episodes that end in success, acting with the mean"),
    "success_once": Metric("success once", "share of test episodes that are in success at some step"),
    "return": Metric("return", "mean undiscounted return of test episodes; at most 100", 1),
    "hidden_share": Metric("hidden nodes", "share of nodes that no camera sees at the end of test episodes"),
    "training_return": Metric("return over training", "mean over training of the return in evaluations: sample efficiency", 1),
    "kl_acting": Metric("KL of an update", "mean over training of the average KL(new || old) of the policy that acts [nats]", 3),
    "action_norm": Metric("action norm", "mean length of actions in the last tenth of training; motions end at 1", 2),
    "action_norm_growth": Metric("growth of the action norm", "that of the last tenth of training over that of the first", 2),
    "iteration_seconds": Metric("seconds per iteration", "median time of rollout and update", 2, True),
    "update_seconds": Metric("seconds per update", "median time of the update alone", 2, True),
}
"""Metrics of the studies, by the names under which results hold them."""
