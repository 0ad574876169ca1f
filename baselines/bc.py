"""Clone an expert: a fast check that a policy can represent a solution, and a warm start.

python baselines/bc.py --policy grpd --env_id RopeShaping-v1 --num_episodes 200
python baselines/bc.py --policy grpd empn hetero_gnn transformer --markdown FILE

Demonstrations come from the task's expert, at poses from `train_pose_range`, or from a file that
ManiSkill's RecordEpisode wrote. Every policy learns from the same ones and is then played on
unseen seeds: at poses of that range; at such poses with the whole scene turned, in orientations
that no demonstration had; and at poses of `test_pose_range`. Each goes to
runs/{exp_name}/{policy}/: config.json, results.json and final_ckpt.pt, which
baselines/evaluate.py plays and baselines/train.py --checkpoint goes on from.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np
import torch
import tyro
from demonstrations import Demonstrations, load_demonstrations, record_demonstrations
from run_setup import make_env, write_run_record
from tqdm import tqdm
from turned_scene import TurnedScene

from maniskill_grpd.experts import make_expert
from maniskill_grpd.learning import CheckpointError, TrainConfig, evaluate_policy, save_checkpoint
from maniskill_grpd.learning.config import require_positive
from maniskill_grpd.learning.value_scale import ValueScale
from maniskill_grpd.policies import ActionDistribution, Policy, make_policy

RUNS = Path("runs")
FIRST_TEST_SEED = 1_000_000
"""Demonstrations use seeds from 2**30 up, as training does."""
MAX_GRAD_NORM = 1.0
EVALUATION_CHUNK = 1000
"""Observations per forward pass of the validation."""


@dataclass(frozen=True, kw_only=True)
class BCConfig:
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
    """share of the pose ranges that is demonstrated; quarter: start and goal within 45 degrees"""
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
        require_positive(self, "num_episodes", "num_steps", "epochs", "batch_size", "torch_threads")
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


def clone(config: BCConfig) -> list[dict[str, Any]]:
    """Run behaviour cloning as configured.

    Returns:
        One dictionary of results per policy.

    Raises:
        ValueError: If a policy, an option or the demonstrations do not fit.
    """
    torch.set_num_threads(config.torch_threads)
    base = config.train_config(config.policy[0])
    seed_env = make_env(base, 1)
    schema = seed_env.unwrapped.graph_schema
    seed_env.close()
    # Before anything is recorded: a misspelt name should not cost a minute.
    policies = {name: _make_policy(config, name, schema) for name in config.policy}
    demonstrations = obtain_demonstrations(config, schema)
    run_name = config.exp_name or f"{config.env_id}__bc__{config.seed}__{int(time.time())}"
    results = []
    for name, policy in policies.items():
        run_dir = RUNS / run_name / name
        result = {"policy": name, "num_parameters": _count_parameters(policy)}
        result |= train_policy(policy, demonstrations, config)
        result["rollouts"] = play(lambda env, actor=policy: actor, config)
        write_run_record(run_dir, config, torch.device("cpu"))
        (run_dir / "results.json").write_text(json.dumps(result, indent=1) + "\n")
        print(f"{name}: {summarize(result)}\n  {run_dir / 'final_ckpt.pt'}")
        _save(run_dir / "final_ckpt.pt", policy, config, demonstrations)
        results.append(result)
    if config.markdown is not None:
        expert = play(lambda env: ExpertActor(config.env_id, env), config)
        config.markdown.parent.mkdir(parents=True, exist_ok=True)
        config.markdown.write_text(to_markdown(config, results, expert, demonstrations))
    return results


def obtain_demonstrations(config: BCConfig, schema: Any) -> Demonstrations:
    """Record or load what is to be learned."""
    if config.demonstrations is not None:
        return load_demonstrations(config.demonstrations, schema)
    num_envs = min(100, config.num_episodes)
    env = _make_posed_env(config, num_envs, config.train_pose_range)
    state = np.random.SeedSequence([config.seed, 0]).generate_state(config.num_episodes)
    demonstrations = record_demonstrations(
        env,
        config.env_id,
        (2**30 + state % 2**30).tolist(),
        num_steps=config.num_steps,
        action_noise=config.action_noise,
        generator=torch.Generator().manual_seed(config.seed),
    )
    env.close()
    return demonstrations


def train_policy(policy: Policy, demonstrations: Demonstrations, config: BCConfig) -> dict[str, Any]:
    """Fit the distribution of a policy to demonstrated actions.

    Args:
        policy: Changed in place; its normaliser takes its scales from the training episodes.
        demonstrations: What to learn.
        config: Options of the training.

    Returns:
        Errors on training and held-out episodes, processor seconds, gradient steps.
    """
    generator = torch.Generator().manual_seed(config.seed)
    num_held_out = max(1, round(config.validation_share * demonstrations.num_episodes))
    train, held_out = demonstrations.split(num_held_out, generator)
    if not len(train):
        raise ValueError(f"all {num_held_out} episodes are held out; give more episodes or a smaller validation_share")
    policy.normalizer.update(demonstrations.select(train)[0])
    optimizer = torch.optim.Adam(policy.parameters(), lr=config.learning_rate)
    num_batches = -(-len(train) // config.batch_size)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.epochs * num_batches)
    start, history = time.process_time(), []
    with tqdm(range(config.epochs), desc=policy.name, unit="epoch") as progress:
        for _ in progress:
            order = train[torch.randperm(len(train), generator=generator)]
            for index in order.split(config.batch_size):
                gradient_step(policy, optimizer, *demonstrations.select(index), config.loss)
                schedule.step()
            history.append(relative_error(policy, demonstrations, held_out))
            progress.set_postfix_str(f"validation error {history[-1]:.1%}")
    return {
        "validation_error": history[-1],
        "train_error": relative_error(policy, demonstrations, train),
        "validation_history": history,
        "gradient_steps": config.epochs * num_batches,
        "cpu_seconds": time.process_time() - start,
    }


def gradient_step(
    policy: Policy, optimizer: torch.optim.Optimizer, graph: dict[str, Any], actions: torch.Tensor, loss: str
) -> None:
    """Take one step on M demonstrated actions (M, A, 3)."""
    optimizer.zero_grad(set_to_none=True)
    LOSSES[loss](policy.distribution(graph), actions).backward()
    torch.nn.utils.clip_grad_norm_(policy.parameters(), MAX_GRAD_NORM)
    optimizer.step()


def mean_squared_error(dist: ActionDistribution, actions: torch.Tensor) -> torch.Tensor:
    """Mean of |mean - action|^2 over all actuators that are not masked; a scalar."""
    return (dist.mean - actions).square().sum(-1)[dist.mask].mean()


def negative_log_likelihood(dist: ActionDistribution, actions: torch.Tensor) -> torch.Tensor:
    """Mean negative log-likelihood of the joint actions [nats]; a scalar."""
    return -dist.log_prob(actions).mean()


LOSSES = {"mse": mean_squared_error, "nll": negative_log_likelihood}


@torch.no_grad()
def relative_error(policy: Policy, demonstrations: Demonstrations, index: torch.Tensor) -> float:
    """Root mean square of |mean - action| over that of |action|; 1 for standing still."""
    error = size = 0.0
    for part in index.split(EVALUATION_CHUNK):
        graph, actions = demonstrations.select(part)
        dist = policy.distribution(graph)
        error += (dist.mean - actions).square().sum(-1)[dist.mask].sum().item()
        size += actions.square().sum(-1)[dist.mask].sum().item()
    return (error / size) ** 0.5


def play(make_actor: Callable[[gym.Env], Any], config: BCConfig) -> dict[str, dict[str, float]]:
    """Play unseen seeds, at poses like those demonstrated, in turned scenes and at other poses.

    Args:
        make_actor: Takes the environment and returns what acts in it, as `evaluate_policy` asks.
        config: Names the task and the pose ranges.

    Returns:
        Means over the episodes, by the name of the poses.
    """
    if not config.num_test_episodes:
        return {}
    seeds = range(FIRST_TEST_SEED, FIRST_TEST_SEED + config.num_test_episodes)
    num_envs = min(50, config.num_test_episodes)
    poses = {
        config.train_pose_range: (config.train_pose_range, False),
        f"{config.train_pose_range} turned": (config.train_pose_range, True),
        config.test_pose_range: (config.test_pose_range, False),
    }
    means = {}
    for name, (pose_range, is_turned) in poses.items():
        env = _make_posed_env(config, num_envs, pose_range)
        env = TurnedScene(env) if is_turned else env
        episodes = evaluate_policy(make_actor(env), env, seeds)
        env.close()
        means[name] = {key: v.double().mean().item() for key, v in episodes.items()}
    return means


class ExpertActor:
    """Lets `evaluate_policy` play an expert, which looks at the environment and not at graphs."""

    def __init__(self, env_id: str, env: gym.Env) -> None:
        self._expert = make_expert(env_id, env)

    def act(self, graph: Any, deterministic: bool = True, generator: Any = None) -> torch.Tensor:
        """Return the expert's action."""
        return self._expert.act()


def summarize(result: dict[str, Any]) -> str:
    """Return the results of a policy in one line."""
    played = ", ".join(
        f"success at {poses} poses {means['success_at_end']:.0%} (mean distance {100 * means['mean_distance']:.1f} cm)"
        for poses, means in result["rollouts"].items()
    )
    return (
        f"validation error {result['validation_error']:.1%} after {result['gradient_steps']} steps "
        f"({result['cpu_seconds']:.0f} CPU s); {played}"
    )


def to_markdown(
    config: BCConfig, results: list[dict[str, Any]], expert: dict[str, dict[str, float]], demonstrations: Demonstrations
) -> str:
    """Format the results of all policies, and what they can be held against, as a page."""
    ranges = list(expert)
    lines = [
        "| policy | parameters | validation error | "
        + " | ".join(f"success, {name} | mean distance, {name} [cm]" for name in ranges)
        + " | training, CPU s |",
        "|---|--:|--:|" + "--:|--:|" * len(ranges) + "--:|",
    ]
    for result in results:
        cells = [result["policy"], f"{result['num_parameters']:,}", f"{result['validation_error']:.1%}"]
        cells += _rollout_cells(result["rollouts"], ranges)
        cells.append(f"{result['cpu_seconds']:.0f}")
        lines.append("| " + " | ".join(cells) + " |")
    lines.append("| " + " | ".join(["(expert)", "", "", *_rollout_cells(expert, ranges), ""]) + " |")
    return PAGE.format(
        command="python baselines/bc.py " + " ".join(sys.argv[1:]),
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
- *{train_pose_range} turned*: poses of the demonstrated range, then rope and goal turned together by 90 to 270 degrees: no
  demonstration had such an orientation, and nothing else differs.
- *{test_pose_range}*: start and goal are drawn independently from the {test_pose_range} range: other orientations, and also
  larger ways and angles between start and goal than were demonstrated.
- *CPU s*: processor time of one thread, validation included.
"""


def _describe_source(config: BCConfig, demonstrations: Demonstrations) -> str:
    if config.demonstrations is not None:
        return f"{demonstrations.num_episodes} episodes in {config.demonstrations.name}"
    return (
        f"{demonstrations.num_episodes} episodes of the expert (the first {config.num_steps} steps "
        f"of each; start and goal from the {config.train_pose_range} pose range, a quarter being "
        f"within 45 degrees and 3.75 cm of the middle; noise of {config.action_noise} of the "
        "largest action on executed, not on recorded actions)"
    )


def _rollout_cells(rollouts: dict[str, dict[str, float]], ranges: list[str]) -> list[str]:
    cells = []
    for name in ranges:
        means = rollouts[name]
        cells += [f"{means['success_at_end']:.0%}", f"{100 * means['mean_distance']:.1f}"]
    return cells


def _make_policy(config: BCConfig, name: str, schema: Any) -> Policy:
    torch.manual_seed(config.seed)
    return make_policy(name, schema, **config.train_config(name).policy_options)


def _count_parameters(policy: Policy) -> int:
    return sum(parameter.numel() for parameter in policy.parameters())


def _make_posed_env(config: BCConfig, num_envs: int, pose_range: str) -> gym.Env:
    return make_env(config.train_config(config.policy[0]), num_envs, pose_range=pose_range)


def _save(path: Path, policy: Policy, config: BCConfig, demonstrations: Demonstrations) -> None:
    """Write a checkpoint that evaluation plays and training starts from."""
    contents = {
        "policy": policy.config,
        "weights": policy.state_dict(),
        # A training that starts from here has an optimizer and scales of returns of its own.
        "optimizer": {},
        "value_scale": ValueScale().state_dict(),
        "generators": {},
        "train_config": config.train_config(policy.name).to_dict(),
        "iteration": 0,
        "global_step": len(demonstrations.episode),
        "best_score": None,
    }
    save_checkpoint(path, contents)


def main(arguments: Sequence[str]) -> int:
    """Clone; report what the user can mend in one line instead of a traceback."""
    try:
        clone(tyro.cli(BCConfig, args=list(arguments), description=__doc__))
    except (ValueError, OSError, CheckpointError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
