"""On-policy training: BPP, PPO, rollouts, checkpoints. Knows tensors and graphs, not tasks."""

from maniskill_grpd.learning.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from maniskill_grpd.learning.config import TrainConfig
from maniskill_grpd.learning.evaluate import evaluate_policy
from maniskill_grpd.learning.finite import NonFiniteError
from maniskill_grpd.learning.projection import project_gaussian
from maniskill_grpd.learning.protocols import ActorCritic, GraphVecEnv
from maniskill_grpd.learning.stopping import TrainingStoppedError
from maniskill_grpd.learning.trainer import Trainer

__all__ = [
    "ActorCritic",
    "CheckpointError",
    "GraphVecEnv",
    "NonFiniteError",
    "TrainConfig",
    "Trainer",
    "TrainingStoppedError",
    "evaluate_policy",
    "load_checkpoint",
    "project_gaussian",
    "save_checkpoint",
]
