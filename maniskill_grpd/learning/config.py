"""Everything that determines a training run."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

ALGORITHMS = ("bpp", "ppo")
"""Names `TrainConfig.algorithm` may take."""

RESUMABLE_FIELDS = frozenset(
    {
        "capture_video",
        "checkpoint",
        "eval_freq",
        "num_eval_envs",
        "resume",
        "save_model",
        "torch_threads",
        "total_timesteps",
        "track",
        "wandb_entity",
        "wandb_group",
        "wandb_project_name",
    }
)
"""Fields that may differ when a run is resumed: they do not change what earlier steps computed."""


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Options of a training run, under the names of ManiSkill's baselines."""

    exp_name: str | None = None
    """name of the run and of its folder under runs/; by default made of task, policy, seed and time"""
    seed: int = 1
    """seed of the weights, the action noise, the minibatches and the environments"""
    torch_threads: int = 1
    """CPU threads PyTorch uses; the operations are small, so more threads help only on idle cores"""
    track: bool = False
    """also log to Weights & Biases (needs the package wandb)"""
    wandb_project_name: str = "ManiSkill"
    """project of the run on Weights & Biases"""
    wandb_entity: str | None = None
    """team of the run on Weights & Biases"""
    wandb_group: str = "GRPD"
    """group of the run on Weights & Biases"""
    capture_video: bool = True
    """write a video of the trained policy after training"""
    save_model: bool = True
    """write checkpoints; without them a run cannot be resumed"""
    checkpoint: str | None = None
    """checkpoint whose weights training starts from (a new run, unlike --resume)"""
    resume: str | None = None
    """run folder to continue; its options are taken over, options given here replace them"""

    env_id: str = "RopeShaping-v1"
    """id of the task"""
    env_kwargs: tuple[str, ...] = ()
    """options of the task as key=value pairs, values in JSON: --env_kwargs num_grippers=2 shapes='["U"]'"""
    num_envs: int = 64
    """number of environments that collect in parallel"""
    num_eval_envs: int = 16
    """number of environments, and of episodes, of each evaluation during training"""
    partial_reset: bool = False
    """end an episode when its environment terminates (success or failure) instead of at the time limit"""
    num_steps: int = 100
    """steps each environment takes per iteration"""
    eval_freq: int = 10
    """iterations between evaluations; 0 for none"""
    checkpoint_freq: int = 10
    """iterations between checkpoints, after each of which all environments are reset"""
    sim_backend: str = "auto"
    """where the simulation runs: auto (cuda if there is a GPU), cpu or cuda"""

    policy: str = "grpd"
    """name of the policy"""
    policy_kwargs: tuple[str, ...] = ()
    """options of the policy as key=value pairs, values in JSON: --policy_kwargs hidden_dim=64"""
    algorithm: str = "bpp"
    """bpp (trust-region projection) or ppo (clipping)"""
    total_timesteps: int = 1_000_000
    """environment steps of the whole run, over all environments"""
    learning_rate: float = 5e-4
    """step size of Adam"""
    anneal_lr: bool = False
    """let the learning rate fall linearly to zero"""
    gamma: float = 0.99
    """discount"""
    gae_lambda: float = 0.95
    """lambda of generalised advantage estimation"""
    num_minibatches: int = 16
    """minibatches per epoch"""
    update_epochs: int = 5
    """passes over each rollout"""
    norm_adv: bool = True
    """normalise advantages within each minibatch"""
    ent_coef: float = 0.0
    """weight of the entropy bonus"""
    vf_coef: float = 0.5
    """weight of the value loss"""
    max_grad_norm: float = 1.0
    """largest norm of the gradient"""
    mean_bound: float = 0.05
    """bpp: largest mean part of the KL of an actuator per iteration [nats]"""
    cov_bound: float = 0.005
    """bpp: largest covariance part of the KL of an actuator per iteration [nats]"""
    trust_region_coef: float = 1.0
    """bpp: weight of the loss that draws the policy to its projection"""
    clip_coef: float = 0.2
    """ppo: clipping of the probability ratio"""
    target_kl: float | None = None
    """stop an update once the mean KL of a minibatch exceeds this [nats]; any algorithm"""
    normalizer_freeze_steps: int | None = None
    """environment steps after which the scales of observations stay fixed; by default a running mean"""
    chunk_size: int = 0
    """most graphs in one forward pass, larger minibatches accumulate gradients; 0: 256 on a CPU, all on a GPU"""

    def __post_init__(self) -> None:
        if self.algorithm not in ALGORITHMS:
            raise ValueError(
                f"algorithm must be one of {', '.join(ALGORITHMS)}, got {self.algorithm!r}"
            )
        self._check_ranges()
        self._check_sizes()
        # Fail now, not when the environment is made.
        parse_options("env_kwargs", self.env_kwargs)
        parse_options("policy_kwargs", self.policy_kwargs)

    @property
    def batch_size(self) -> int:
        """Transitions of one rollout."""
        return self.num_envs * self.num_steps

    @property
    def minibatch_size(self) -> int:
        """Transitions of one gradient step."""
        return self.batch_size // self.num_minibatches

    @property
    def num_iterations(self) -> int:
        """Rollouts of the whole run."""
        return self.total_timesteps // self.batch_size

    @property
    def env_options(self) -> dict[str, Any]:
        """`env_kwargs` as a dictionary."""
        return parse_options("env_kwargs", self.env_kwargs)

    @property
    def policy_options(self) -> dict[str, Any]:
        """`policy_kwargs` as a dictionary."""
        return parse_options("policy_kwargs", self.policy_kwargs)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain types that JSON and weights-only checkpoints can hold."""
        fields = dataclasses.asdict(self)
        return {key: list(v) if isinstance(v, tuple) else v for key, v in fields.items()}

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> TrainConfig:
        """Rebuild a config from `to_dict`.

        Raises:
            ValueError: If a field is unknown, or a value invalid.
        """
        known = {field.name for field in dataclasses.fields(cls)}
        unknown = sorted(set(fields) - known)
        if unknown:
            raise ValueError(f"unknown option(s) {', '.join(unknown)}; known: {sorted(known)}")
        return cls(**{k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()})

    def _check_ranges(self) -> None:
        positive = (
            "torch_threads num_envs num_eval_envs num_steps checkpoint_freq total_timesteps "
            "learning_rate num_minibatches update_epochs max_grad_norm mean_bound cov_bound "
            "clip_coef"
        )
        for name in positive.split():
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be positive, got {value}")
        for name in ("seed", "eval_freq", "chunk_size", "ent_coef", "vf_coef", "trust_region_coef"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        for name in ("gamma", "gae_lambda"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must lie in [0, 1], got {getattr(self, name)}")

    def _check_sizes(self) -> None:
        if self.batch_size % self.num_minibatches:
            raise ValueError(
                f"num_envs * num_steps = {self.num_envs} * {self.num_steps} = {self.batch_size} "
                f"must be divisible by num_minibatches = {self.num_minibatches}; "
                f"{_nearest_divisor(self.batch_size, self.num_minibatches)} would fit"
            )
        if self.norm_adv and self.minibatch_size < 2:
            raise ValueError(
                f"norm_adv needs at least 2 transitions per minibatch, got {self.minibatch_size}: "
                "lower num_minibatches or set --no-norm_adv"
            )
        if self.num_iterations < 1:
            raise ValueError(
                f"total_timesteps = {self.total_timesteps} is less than one iteration of "
                f"num_envs * num_steps = {self.batch_size} steps; raise it or lower those"
            )


def parse_options(name: str, pairs: tuple[str, ...]) -> dict[str, Any]:
    """Parse key=value pairs; a value that is not JSON is taken as a string.

    Args:
        name: The option the pairs belong to, for messages.
        pairs: Such as ("num_grippers=2", "shape=W").

    Raises:
        ValueError: If a pair has no key or no "=", or a key comes twice.
    """
    options: dict[str, Any] = {}
    for pair in pairs:
        key, separator, text = pair.partition("=")
        if not (separator and key.isidentifier()):
            raise ValueError(f"{name} takes key=value pairs, got {pair!r}")
        if key in options:
            raise ValueError(f"{name} names {key!r} twice")
        try:
            options[key] = json.loads(text)
        except json.JSONDecodeError:
            options[key] = text
    return options


def _nearest_divisor(number: int, wanted: int) -> int:
    return min((d for d in range(1, number + 1) if number % d == 0), key=lambda d: abs(d - wanted))
