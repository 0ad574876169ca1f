"""Everything that determines a training run."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from maniskill_grpd.learning.schedule import SCHEDULES, scheduled

ALGORITHMS = ("bpp", "ppo")
"""Names `TrainConfig.algorithm` may take."""

TRUST_REGIONS = ("projection", "lagrangian", "fisher")
"""Names `TrainConfig.trust_region` may take."""

BEST_METRICS = ("success_at_end", "success_once", "return")
"""Names `TrainConfig.best_metric` may take."""

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
    """number of environments that collect in parallel, over all processes"""
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
    best_metric: str = "success_at_end"
    """evaluation metric that chooses best_ckpt.pt: success_at_end, success_once or return (which also breaks ties)"""
    position_noise: float = 0.0
    """standard deviation of noise on observed positions during training, per axis [m]"""
    velocity_noise: float = 0.0
    """standard deviation of noise on observed velocities during training, per axis [m/s]"""

    policy: str = "grpd"
    """name of the policy"""
    policy_kwargs: tuple[str, ...] = ()
    """options of the policy as key=value pairs, values in JSON: --policy_kwargs hidden_dim=64"""
    algorithm: str = "bpp"
    """bpp (KL trust region) or ppo (clipping)"""
    trust_region: str = "projection"
    """bpp: projection (differentiable), lagrangian (dual ascent) or fisher (natural gradient with line search)"""
    compile: bool = False
    """compile the policy for updates; pays in long runs, the first update then takes minutes"""
    amp: bool = False
    """matrix products of the policy in bfloat16; CUDA only"""
    total_timesteps: int = 1_000_000
    """environment steps of the whole run, over all environments"""
    learning_rate: float = 5e-4
    """step size of Adam"""
    anneal_lr: bool = False
    """let the learning rate fall linearly to zero, the same as --lr_schedule linear"""
    lr_schedule: str = "constant"
    """schedule of the learning rate: constant, or linear or cosine to zero"""
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
    noise_correlation: float = 0.0
    """correlation of the action noise between consecutive steps, in [0, 1): what explores further at the same deviation"""
    noise_schedule: str = "constant"
    """schedule of that correlation: constant, or linear or cosine to zero"""
    ent_coef: float = 0.0
    """weight of the entropy bonus"""
    ent_schedule: str = "constant"
    """schedule of that weight: constant, or linear or cosine to zero"""
    entropy_floor: float | None = None
    """projection: smallest entropy of an actuator's Gaussian [nats]; 2.2 at the initial deviation of 0.5, -1 at 0.17"""
    entropy_floor_final: float | None = None
    """projection: where the floor has come linearly by the end; by default it stays"""
    vf_coef: float = 0.5
    """weight of the value loss"""
    max_grad_norm: float = 1.0
    """largest norm of the gradient"""
    mean_bound: float = 0.05
    """bpp: largest mean part of the KL of an actuator per iteration [nats]; on average for lagrangian, fisher"""
    cov_bound: float = 0.005
    """bpp: largest covariance part of the KL of an actuator per iteration [nats]"""
    gripper_bound: float = 0.01
    """bpp: largest KL of an actuator's gripper per iteration [nats], in tasks with free grasps"""
    trust_region_coef: float = 1.0
    """projection: weight of the loss that draws the policy to its projection"""
    dual_step: float = 0.5
    """lagrangian: step of the dual ascent on the logarithm of a multiplier, per iteration"""
    max_multiplier: float = 100.0
    """lagrangian: largest multiplier; the smallest is its inverse"""
    fisher_samples: int = 1024
    """fisher: transitions the Fisher matrix is estimated with"""
    fisher_damping: float = 0.1
    """fisher: multiple of the identity added to the Fisher matrix"""
    clip_coef: float = 0.2
    """ppo: clipping of the probability ratio"""
    target_kl: float | None = None
    """stop an update once the mean KL of a minibatch exceeds this [nats]; any algorithm"""
    normalizer_freeze_steps: int | None = None
    """environment steps after which the scales of observations stay fixed; by default a running mean"""
    chunk_size: int = 0
    """most graphs in one forward pass, larger minibatches accumulate gradients; 0: 256 on a CPU, all on a GPU"""

    def __post_init__(self) -> None:
        self._check_names()
        self._check_contradictions()
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

    def coefficients(self, iteration: int) -> Coefficients:
        """Return what the schedules say after a number of finished iterations."""
        progress = iteration / self.num_iterations
        lr_schedule = "linear" if self.anneal_lr else self.lr_schedule
        floor = self.entropy_floor
        if floor is not None and self.entropy_floor_final is not None:
            floor = scheduled("linear", floor, self.entropy_floor_final, progress)
        return Coefficients(
            learning_rate=scheduled(lr_schedule, self.learning_rate, 0.0, progress),
            ent_coef=scheduled(self.ent_schedule, self.ent_coef, 0.0, progress),
            entropy_floor=floor,
            noise_correlation=scheduled(self.noise_schedule, self.noise_correlation, 0.0, progress),
        )

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

    def _check_names(self) -> None:
        choices = {
            "algorithm": ALGORITHMS,
            "trust_region": TRUST_REGIONS,
            "lr_schedule": SCHEDULES,
            "ent_schedule": SCHEDULES,
            "noise_schedule": SCHEDULES,
            "best_metric": BEST_METRICS,
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} must be one of {', '.join(allowed)}, got {getattr(self, name)!r}")

    def _check_contradictions(self) -> None:
        is_projection = self.algorithm == "bpp" and self.trust_region == "projection"
        is_fisher = self.algorithm == "bpp" and self.trust_region == "fisher"
        found = {
            "--resume continues a run and --checkpoint starts a new one; give one of them": (self.resume and self.checkpoint),
            f"--trust_region {self.trust_region} belongs to --algorithm bpp, not to ppo": (
                self.algorithm == "ppo" and self.trust_region != "projection"
            ),
            f"--anneal_lr is linear, --lr_schedule says {self.lr_schedule}; give one of them": (
                self.anneal_lr and self.lr_schedule == "cosine"
            ),
            "--ent_schedule changes --ent_coef, which is 0; set it too": (self.ent_schedule != "constant" and not self.ent_coef),
            "--noise_schedule changes --noise_correlation, which is 0; set it too": (
                self.noise_schedule != "constant" and not self.noise_correlation
            ),
            "--entropy_floor works with --algorithm bpp --trust_region projection only": (
                self.entropy_floor is not None and not is_projection
            ),
            "--entropy_floor_final needs --entropy_floor, where it starts from": (
                self.entropy_floor_final is not None and self.entropy_floor is None
            ),
            "--target_kl ends minibatch updates early; --trust_region fisher has a line search": (
                self.target_kl is not None and is_fisher
            ),
            "--compile has no second derivatives, which --trust_region fisher needs; drop one": (self.compile and is_fisher),
        }
        for message, is_wrong in found.items():
            if is_wrong:
                raise ValueError(message)

    def _check_ranges(self) -> None:
        positive = (
            "torch_threads num_envs num_eval_envs num_steps checkpoint_freq total_timesteps "
            "learning_rate num_minibatches update_epochs max_grad_norm mean_bound cov_bound "
            "gripper_bound clip_coef dual_step fisher_samples fisher_damping"
        )
        require_positive(self, *positive.split())
        if not 1.0 < self.max_multiplier < math.inf:
            raise ValueError(f"max_multiplier must be above 1, got {self.max_multiplier}")
        not_negative = "seed eval_freq chunk_size ent_coef vf_coef trust_region_coef position_noise velocity_noise"
        for name in not_negative.split():
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if not 0.0 <= self.noise_correlation < 1.0:
            raise ValueError(f"noise_correlation must lie in [0, 1), got {self.noise_correlation}")
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


@dataclass(frozen=True, kw_only=True)
class Coefficients:
    """What changes from iteration to iteration."""

    learning_rate: float
    ent_coef: float
    entropy_floor: float | None
    noise_correlation: float


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


def require_positive(options: Any, *names: str) -> None:
    """Refuse options that are not positive and finite.

    Raises:
        ValueError: Naming the first one.
    """
    for name in names:
        value = getattr(options, name)
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value}")


def _nearest_divisor(number: int, wanted: int) -> int:
    return min((d for d in range(1, number + 1) if number % d == 0), key=lambda d: abs(d - wanted))
