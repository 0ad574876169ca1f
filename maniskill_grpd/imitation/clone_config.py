"""Options of behaviour cloning."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.options import THREADS, check_ranges, require_positive


@dataclass(frozen=True, kw_only=True)
class CloneConfig:
    """Options of behaviour cloning."""

    policy: tuple[str, ...] = ("grpd",)
    """names of the policies to train, one after the other, on the same demonstrations"""
    policy_kwargs: tuple[str, ...] = ()
    """options of the policies as key=value pairs"""
    exp_name: str | None = None
    """name of the run and of its folder under runs/; by default made of task, seed and time"""
    seed: int = 1
    """seed of the demonstrations, the weights and the minibatches"""
    env_id: str = "RopeShaping-v1"
    """id of the task"""
    env_kwargs: tuple[str, ...] = ("graph_nodes=21",)
    """options of the task as key=value pairs, other than pose_range"""
    sim_backend: str = "auto"
    """where the simulation runs: auto (cuda if there is a GPU), cpu or cuda"""
    torch_threads: int = 1
    """CPU threads PyTorch uses"""

    demonstrations: Path | None = None
    """trajectories (.h5) of ManiSkill's RecordEpisode to learn from; by default the expert acts"""
    num_episodes: int = 200
    """episodes the expert demonstrates"""
    num_steps: int = 60
    """steps of each episode that are recorded; the expert is done after about 40"""
    action_noise: float = 0.3
    """noise per axis on executed, not on recorded actions, in units of the largest action"""
    train_pose_range: Literal["full", "half", "quarter"] = "quarter"
    """share of the pose ranges that is demonstrated; see the card of the task"""
    test_pose_range: Literal["full", "half", "quarter"] = "full"
    """share of the pose ranges that the policies are also played on"""

    loss: Literal["mse", "nll"] = "mse"
    """mse: squared error of the mean, leaves the noise alone; nll: negative log-likelihood"""
    epochs: int = 16
    """passes over the demonstrations"""
    batch_size: int = 200
    """observations per gradient step"""
    learning_rate: float = 2e-3
    """step size of Adam at the start; falls to zero along a cosine"""
    validation_share: float = 0.1
    """share of the episodes that is held out"""
    num_test_episodes: int = 100
    """episodes played per pose range; 0 for none"""
    markdown: Path | None = None
    """also write the table of results to this file"""

    def __post_init__(self) -> None:
        require_positive(self, "num_episodes", "num_steps", "epochs", "batch_size")
        check_ranges(self, {"torch_threads": THREADS})
        if not 0.0 < self.validation_share < 1.0:
            raise ValueError(f"validation_share must be in (0, 1), got {self.validation_share}")
        if any(pair.startswith("pose_range=") for pair in self.env_kwargs):
            raise ValueError("give pose_range as --train_pose_range and --test_pose_range")

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain types."""
        fields = dataclasses.asdict(self)
        return {key: str(v) if isinstance(v, Path) else v for key, v in fields.items()}

    def train_config(self, policy: str) -> TrainConfig:
        """Return the options under which a training goes on from a cloned policy."""
        return TrainConfig(
            exp_name=self.exp_name,
            seed=self.seed,
            env_id=self.env_id,
            env_kwargs=self.env_kwargs,
            sim_backend=self.sim_backend,
            policy=policy,
            policy_kwargs=self.policy_kwargs,
            torch_threads=self.torch_threads,
        )
