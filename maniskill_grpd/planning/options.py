"""Options of a planner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

from maniskill_grpd.learning.options import OptionGroup


@dataclass(frozen=True, kw_only=True)
class PlannerOptions(OptionGroup):
    """Options of a planner."""

    RANGES: ClassVar[Mapping[str, str]] = {
        "horizon": "[1, inf)",
        "samples": "[8, inf)",
        "iterations": "[1, inf)",
        "first_iterations": "[1, inf)",
        "replan": "[1, inf)",
        "std": "(0, inf)",
        "noise_exponent": "[0, 10]",
        "elite_share": "(0, 1]",
        "temperature": "(0, inf)",
        "final_weight": "[0, inf)",
    }

    method: Literal["cem", "mppi"] = "cem"
    """cem: the next plans are drawn around the best ones; mppi: around the mean of all, weighted by the exponential of returns"""
    horizon: int = 20
    """steps that plans look ahead"""
    samples: int = 64
    """plans that are tried at the same time for each episode, each in a world of its own"""
    iterations: int = 4
    """times that plans are drawn and tried before one is followed"""
    first_iterations: int = 12
    """the same for the first plan of an episode, which has nothing to start from"""
    replan: int = 5
    """steps for which a plan is followed"""
    std: float = 1.0
    """standard deviation of the plans that are drawn first, per axis, in units of the largest action"""
    noise_exponent: float = 2.0
    """beta of the noise of plans, whose power falls with frequency as f^-beta: 0 is white, 2 wanders like a random walk"""
    elite_share: float = 0.1
    """cem: share of the plans that count as the best"""
    temperature: float = 0.2
    """mppi: difference of returns that weighs e times as much, in standard deviations of the returns"""
    final_weight: float = 10.0
    """steps that the reward of the last step counts for; with a value function that stands for the future it is left out"""

    def contradictions(self) -> dict[str, bool]:
        """See `OptionGroup.contradictions`."""
        return {
            **super().contradictions(),
            f"replan must not exceed horizon = {self.horizon}, got {self.replan}": self.replan > self.horizon,
            f"elite_share = {self.elite_share} of samples = {self.samples} is less than the two plans that a spread needs": (
                self.method == "cem" and self.num_elites < 2
            ),
        }

    @property
    def num_elites(self) -> int:
        """Plans that count as the best."""
        return round(self.elite_share * self.samples)
