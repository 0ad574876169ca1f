"""What a study is made of: tasks, arms that are compared on them, conditions of the test, claims of the paper."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from maniskill_grpd.experiments.claim import Claim
from maniskill_grpd.learning import TrainConfig

Options = Mapping[str, Any]

NUM_EVALUATIONS = 20
"""Evaluations during a training, the points of its learning curve."""
NUM_EVAL_EPISODES = 32
"""Episodes of each of them."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Circumstances of a test.

    Attributes:
        env_options: Options of the task that replace those of the training.
        sigma: Noise on observed positions [m] and velocities [m/s].
        factors: What tables and plots call this condition, by factor; empty: "as trained".
    """

    env_options: Options = field(default_factory=dict, hash=False)
    sigma: float = 0.0
    factors: Options = field(default_factory=dict, hash=False)

    @property
    def name(self) -> str:
        """Unique name, such as "resolution=81, sigma=0.05"."""
        return ", ".join(f"{key}={_plain(value)}" for key, value in self.factors.items()) or AS_TRAINED_NAME


AS_TRAINED_NAME = "as trained"
FACTOR_DEFAULTS: Options = {"sigma": 0.0, "pose_range": "full"}
"""Values of factors that neither a condition nor a task names."""
AS_TRAINED = Condition()
"""The test on the task of the training, on unseen seeds."""


def with_noise(sigma: float) -> Condition:
    """Return the condition of noise on all observed positions and velocities."""
    return Condition(sigma=sigma, factors={"sigma": sigma} if sigma else {})


def with_option(name: str, value: Any, **others: Any) -> Condition:
    """Return the condition of another value of an option, which names it, and of further options."""
    return Condition(env_options={name: value, **others}, factors={name: value})


def combine(first: Condition, second: Condition) -> Condition:
    """Return the condition of both."""
    return Condition(
        env_options={**first.env_options, **second.env_options},
        sigma=first.sigma + second.sigma,
        factors={**first.factors, **second.factors},
    )


@dataclass(frozen=True, kw_only=True)
class Task:
    """A task as a study trains and tests on it.

    Attributes:
        env_id: Its id.
        options: Its options in training.
        conditions: Those of the tests; the first is what claims without a condition speak of.
        label: What tables call it, unique within a study; by default the id.
    """

    env_id: str
    options: Options = field(default_factory=dict, hash=False)
    conditions: tuple[Condition, ...] = (AS_TRAINED,)
    label: str | None = None

    @property
    def name(self) -> str:
        """The label, or else the id."""
        return self.label or self.env_id

    def factor(self, name: str, condition: Condition | None = None) -> Any:
        """Return the value of a factor under a condition, or else in training; None if it has none."""
        factors = {} if condition is None else condition.factors
        return {**FACTOR_DEFAULTS, **self.options, **factors}.get(name)

    def tested(self, conditions: Iterable[Condition]) -> Task:
        """Return the task with the test as trained and further ones."""
        return dataclasses.replace(self, conditions=(AS_TRAINED, *conditions))

    def trained_with(self, label: str, **options: Any) -> Task:
        """Return the task with other options in training."""
        return dataclasses.replace(self, label=label, options={**self.options, **options})


@dataclass(frozen=True, kw_only=True)
class Arm:
    """One side of a comparison: a policy and how it is trained.

    Attributes:
        name: What tables call it, unique within a study.
        policy: Name of the policy.
        policy_options: Its options.
        algorithm: "bpp" or "ppo".
        train_options: Further fields of `TrainConfig`.
        partner: Name of the arm that it differs from in one thing; None for a reference.
        difference: That one thing, in words.
    """

    name: str
    policy: str = "grpd"
    policy_options: Options = field(default_factory=dict, hash=False)
    algorithm: str = "bpp"
    train_options: Options = field(default_factory=dict, hash=False)
    partner: str | None = None
    difference: str = ""


@dataclass(frozen=True, kw_only=True)
class Run:
    """A training: everything that determines it. Studies that need the same one share it."""

    task: Task
    arm: Arm
    seed: int
    budget: int
    train_options: Options = field(default_factory=dict, hash=False)

    @property
    def name(self) -> str:
        """Name of its folder, which says all options that are not defaults."""
        task = _slug(self.task.env_id, self.task.options)
        if self.arm == EXPERT:
            return f"{task}__{EXPERT.policy}"
        policy = _slug(self.arm.policy, self.arm.policy_options)
        algorithm = _slug(self.arm.algorithm, {**self.train_options, **self.arm.train_options})
        return f"{task}__{policy}__{algorithm}__{self.budget}__s{self.seed}"

    def train_config(self) -> TrainConfig:
        """Return the options of the training: those given, 20 evaluations and checkpoints, one thread.

        Raises:
            ValueError: If an option is not known or invalid.
        """
        given = {**self.train_options, **self.arm.train_options}
        config = TrainConfig.from_dict(
            {
                "exp_name": self.name,
                "capture_video": False,
                "num_eval_envs": NUM_EVAL_EPISODES,
                "env_id": self.task.env_id,
                "env_kwargs": to_pairs({**self.task.options, "num_threads": 1}),
                "policy": self.arm.policy,
                "policy_kwargs": to_pairs(self.arm.policy_options),
                "algorithm": self.arm.algorithm,
                "seed": self.seed,
                "total_timesteps": self.budget,
                **given,
            }
        )
        rhythm = max(1, config.num_iterations // NUM_EVALUATIONS)
        return dataclasses.replace(
            config, eval_freq=given.get("eval_freq", rhythm), checkpoint_freq=given.get("checkpoint_freq", rhythm)
        )


EXPERT = Arm(name="expert", policy="expert")
"""The scripted expert of a task, the reference line of tables and plots; not trained."""


def expert_run(task: Task) -> Run:
    """Return the "run" of the expert on a task."""
    return Run(task=task, arm=EXPERT, seed=0, budget=0)


Plot = Literal["curves", "bars", "profile", "heat_map", "lines", "action_norms"]
PILOT_SEED = 1001
"""First seed of trainings that choose settings."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """An experiment that answers one question of the paper.

    Attributes:
        name: What the command line calls it.
        title: Heading of its page.
        question: What it asks, and how it is tested, in a few sentences.
        tasks: With options and conditions.
        arms: What is compared, the reference of the paper (GRPD, BPP) first.
        claims: Statements of the paper that it tests.
        metrics: What tables show; plots show the first.
        plots: Kinds of pictures, see `plots`.
        factor: What varies along the abscissa of "lines": a factor of the conditions or an option of the tasks.
        trained_by: Name of the study whose checkpoints are tested; None: trains its own.
        budget: Environment steps of each training, where the study fixes them.
        train_options: Fields of `TrainConfig` for all arms.
        first_seed: Of its trainings; from `PILOT_SEED` up for what chooses settings.
        is_smoke_test: Whether it shows no more than that every arm runs to the end.
    """

    name: str
    title: str
    question: str
    tasks: tuple[Task, ...]
    arms: tuple[Arm, ...]
    claims: tuple[Claim, ...] = ()
    metrics: tuple[str, ...] = ("success_at_end", "return")
    plots: tuple[Plot, ...] = ("bars",)
    factor: str | None = None
    trained_by: str | None = None
    budget: int | None = None
    train_options: Options = field(default_factory=dict, hash=False)
    first_seed: int = 1
    is_smoke_test: bool = False

    def seeds(self, num: int) -> range:
        """Return the seeds of its trainings, `num` of each arm on each task."""
        return range(self.first_seed, self.first_seed + num)

    def shows(self, seed: int) -> bool:
        """Return whether a run of a seed is one of its own: pilots choose settings, and are no results."""
        return (seed >= PILOT_SEED) == (self.first_seed >= PILOT_SEED)

    def runs(self, budget: int, seeds: Iterable[int]) -> Iterator[Run]:
        """Yield the trainings it needs, all arms of a task and seed side by side.

        Args:
            budget: Environment steps of each, unless the study fixes them.
            seeds: One training of every arm on every task for each.
        """
        for task, seed, arm in itertools.product(self.tasks, seeds, self.arms):
            yield Run(task=task, arm=arm, seed=seed, budget=self.budget or budget, train_options=self.train_options)

    def restricted(self, tasks: Iterable[str], arms: Iterable[str]) -> Study:
        """Return the study with only some tasks, by id or label, and arms, by name; with all where none is given.

        Raises:
            ValueError: If there is no such task or arm, listing those there are.
        """
        tasks, arms = tuple(tasks), tuple(arms)
        _refuse_unknown("task", tasks, {name for task in self.tasks for name in (task.env_id, task.name)}, self.name)
        _refuse_unknown("arm", arms, {arm.name for arm in self.arms}, self.name)
        return dataclasses.replace(
            self,
            tasks=tuple(task for task in self.tasks if not tasks or {task.env_id, task.name} & set(tasks)),
            arms=tuple(arm for arm in self.arms if not arms or arm.name in arms),
        )


def to_pairs(options: Options) -> tuple[str, ...]:
    """Return options as the key=value pairs of the command line, values in JSON."""
    return tuple(f"{key}={json.dumps(value, separators=(',', ':'))}" for key, value in options.items())


def _slug(name: str, options: Options) -> str:
    return ",".join([name, *(f"{key}={_plain(value)}" for key, value in sorted(options.items()))])


def _plain(value: Any) -> str:
    """Return a value without the characters that file names and tables do not take."""
    if isinstance(value, Mapping):
        return "+".join(f"{key}-{_plain(entry)}" for key, entry in value.items())
    if isinstance(value, (list, tuple)):
        return "+".join(_plain(entry) for entry in value)
    return "all" if value is None else str(value)


def _refuse_unknown(kind: str, given: Iterable[str], known: Iterable[str], study: str) -> None:
    unknown = [name for name in given if name not in known]
    if unknown:
        raise ValueError(f"study {study!r} has no {kind} {', '.join(unknown)}; it has {', '.join(sorted(known))}")
