"""Options of playing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.options import parse_options, require_positive
from maniskill_grpd.playing.agents import AgentName
from maniskill_grpd.runs.checkpoints import load_policy
from maniskill_grpd.runs.play import change_task
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED
from maniskill_grpd.viewer.server import HOST, PORT


@dataclass(frozen=True, kw_only=True)
class PlayConfig:
    """Options of playing."""

    checkpoint: Path | None = None
    """a policy to play; its task is taken unless another is given"""
    env_id: str | None = None
    """id of the task; RopeShaping-v1 without a checkpoint"""
    env_kwargs: tuple[str, ...] = ()
    """options of the task as key=value pairs, values in JSON"""
    agent: AgentName | None = None
    """who acts; the policy where there is a checkpoint, else the expert"""
    num_envs: int = 1
    """number of worlds, side by side"""
    seed: int = FIRST_TEST_SEED
    """seed of the first episode; the following worlds and episodes have the following seeds"""
    checkpoints: Path | None = None
    """folder whose checkpoints can be chosen in the panel; that of the checkpoint by default, else checkpoints"""
    host: str = HOST
    """address to listen on; 0.0.0.0 lets other machines in"""
    port: int = PORT
    """port to listen on; the next free one where it is in use"""
    share: bool = False
    """also make a public address through a server of viser's authors, which sees all that is shown"""
    record: Path | None = None
    """write everything that is shown to this html file when the player ends"""
    demonstrations: Path | None = None
    """folder of recorded episodes of tele-operation; demos/{env_id} by default"""
    sim_backend: str | None = None
    """where the simulation runs (auto, cpu, cuda); as in training with a checkpoint, else auto"""
    allow_import: bool = False
    """whether the id of the task in the checkpoint may be of the form module:id, which runs the code of that module"""

    def __post_init__(self) -> None:
        require_positive(self, "num_envs")
        if self.agent == "policy" and self.checkpoint is None:
            raise ValueError("--agent policy needs a --checkpoint")
        parse_options("env_kwargs", self.env_kwargs)

    @property
    def first_agent(self) -> AgentName:
        """Who acts first."""
        return self.agent or ("policy" if self.checkpoint is not None else "expert")

    def task(self) -> TrainConfig:
        """Return what names the task: that of the checkpoint, changed as asked for.

        Raises:
            CheckpointError: If the checkpoint is none.
        """
        if self.checkpoint is None:
            return TrainConfig(
                env_id=self.env_id or TrainConfig().env_id, env_kwargs=self.env_kwargs, sim_backend=self.sim_backend or "auto"
            )
        _, contents = load_policy(self.checkpoint, allow_import=self.allow_import)
        trained = TrainConfig.from_dict(contents["train_config"])
        return change_task(trained, self.env_id, self.env_kwargs, self.sim_backend)
