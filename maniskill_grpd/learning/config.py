"""Everything that determines a training run."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from maniskill_grpd.learning.algorithm import ALGORITHMS
from maniskill_grpd.learning.options import THREADS, parse_options
from maniskill_grpd.learning.rotation_augmentation import Augmentation
from maniskill_grpd.learning.schedule import Coefficients, Schedule, scheduled

BestMetric = Literal["success_at_end", "success_once", "return"]
"""Evaluation metrics that may choose the best checkpoint."""

NO_RECOMMENDED = "--no_recommended"
"""Word after `train` that leaves out what the task recommends: the defaults are then those of `TrainConfig`."""

RESUMABLE_FIELDS = frozenset(
    {
        "capture_video",
        "checkpoint",
        "demonstrations",
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
class TrainConfig(*(algorithm.Options for algorithm in ALGORITHMS.values())):
    """Options of a training run, under the names of ManiSkill's baselines, and those of every algorithm."""

    RANGES: ClassVar[Mapping[str, str]] = {
        "seed": "[0, 4294967295]",
        "torch_threads": THREADS,
        "num_envs": "[1, inf)",
        "num_eval_envs": "[1, inf)",
        "num_steps": "[1, inf)",
        "eval_freq": "[0, inf)",
        "checkpoint_freq": "[1, inf)",
        "position_noise": "[0, inf)",
        "velocity_noise": "[0, inf)",
        "total_timesteps": "[1, inf)",
        "learning_rate": "(0, inf)",
        "gamma": "[0, 1]",
        "gae_lambda": "[0, 1]",
        "num_minibatches": "[1, inf)",
        "update_epochs": "[1, inf)",
        "noise_correlation": "[0, 1)",
        "ent_coef": "[0, inf)",
        "vf_coef": "[0, inf)",
        "max_grad_norm": "(0, inf)",
        "target_kl": "(0, inf)",
        "normalizer_freeze_steps": "[0, inf)",
        "chunk_size": "[0, inf)",
    }

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
    demonstrations: str | None = None
    """trajectories (.h5, from `record`) that the policy clones before it trains"""
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
    best_metric: BestMetric = "success_at_end"
    """evaluation metric that chooses best_ckpt.pt: success_at_end, success_once or return (which also breaks ties)"""
    position_noise: float = 0.0
    """standard deviation of noise on observed positions during training, per axis [m]"""
    velocity_noise: float = 0.0
    """standard deviation of noise on observed velocities during training, per axis [m/s]"""

    critic_observations: Literal["same", "full"] = "same"
    """full: where cameras or keypoints hide nodes from the policy, the value function sees all of them, in training only"""

    policy: str = "grpd"
    """name of the policy"""
    policy_kwargs: tuple[str, ...] = ()
    """options of the policy as key=value pairs, values in JSON: --policy_kwargs hidden_dim=64"""
    algorithm: Literal[tuple(ALGORITHMS)] = "bpp"  # type: ignore[valid-type]
    """bpp (KL trust region) or ppo (clipping)"""
    compile: bool = False
    """compile the policy for updates (needs a C++ compiler); the first run waits for it, later ones find its results on disk"""
    amp: bool = False
    """matrix products of the policy in bfloat16; CUDA only"""
    total_timesteps: int = 1_000_000
    """environment steps of the whole run, over all environments"""
    learning_rate: float = 5e-4
    """step size of Adam"""
    anneal_lr: bool = False
    """let the learning rate fall linearly to zero, the same as --lr_schedule linear"""
    lr_schedule: Schedule = "constant"
    """schedule of the learning rate: constant, or linear or cosine to zero"""
    gamma: float = 0.99
    """discount"""
    gae_lambda: float = 0.95
    """lambda of generalised advantage estimation"""
    num_minibatches: int = 16
    """minibatches per epoch"""
    update_epochs: int = 5
    """passes over each rollout"""
    rotation_augmentation: Augmentation = "none"
    """turn each transition of a minibatch, gravity and action with it, by a random rotation: none, vertical (about the vertical)
    or full; teaches policies without symmetry what others have built in"""
    norm_adv: bool = True
    """normalise advantages within each minibatch"""
    noise_correlation: float = 0.0
    """correlation of the action noise between consecutive steps, in [0, 1): what explores further at the same deviation"""
    noise_schedule: Schedule = "constant"
    """schedule of that correlation: constant, or linear or cosine to zero"""
    ent_coef: float = 0.0
    """weight of the entropy bonus"""
    ent_schedule: Schedule = "constant"
    """schedule of that weight: constant, or linear or cosine to zero"""
    vf_coef: float = 0.5
    """weight of the value loss"""
    popart: bool = False
    """correct the last layer of the value function when the scale of values moves, so that values stay what they were"""
    max_grad_norm: float = 1.0
    """largest norm of the gradient"""
    target_kl: float | None = None
    """stop an update once the mean KL of a minibatch exceeds this [nats]; any algorithm"""
    normalizer_freeze_steps: int | None = None
    """environment steps after which the scales of observations stay fixed; by default a running mean"""
    chunk_size: int = 0
    """most graphs in one forward pass, larger minibatches accumulate gradients; 0: 256 on a CPU, all on a GPU"""

    def __post_init__(self) -> None:
        self.check()
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

    def contradictions(self) -> dict[str, bool]:
        """See `OptionGroup.contradictions`."""
        return {
            **super().contradictions(),
            "--resume continues a run and --checkpoint starts a new one; give one of them": bool(self.resume and self.checkpoint),
            "--demonstrations clones a fresh policy and --checkpoint starts from one that is trained; give one of them": bool(
                self.demonstrations and self.checkpoint
            ),
            f"--anneal_lr is linear, --lr_schedule says {self.lr_schedule}; give one of them": (
                self.anneal_lr and self.lr_schedule == "cosine"
            ),
            "--trust_region fisher takes one step over all transitions as they are; leave out --rotation_augmentation": (
                self.rotation_augmentation != "none" and self.algorithm == "bpp" and self.trust_region == "fisher"
            ),
            "--ent_schedule changes --ent_coef, which is 0; set it too": self.ent_schedule != "constant" and not self.ent_coef,
            "--noise_schedule changes --noise_correlation, which is 0; set it too": (
                self.noise_schedule != "constant" and not self.noise_correlation
            ),
        }

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


def _nearest_divisor(number: int, wanted: int) -> int:
    return min((d for d in range(1, number + 1) if number % d == 0), key=lambda d: abs(d - wanted))
