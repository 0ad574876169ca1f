"""Measure env-steps/s of whole training iterations, beside a learner in the style of ManiSkill's stock PPO.

python benchmarks/train.py [--quick] [--processes] [--older FOLDER] [--json FILE]

Three learners take turns on one core with the same task, environments and steps per iteration: grpd with bpp, grpd with ppo, and
dense networks on the flat state, ManiSkill's baseline as in examples/maniskill_ppo.py. Share of each phase: simulation, policy
in the rollout, update; floating-point operations of the matrix products per step, and which share of what one core reaches in a
large product they are. --processes also runs grpd with bpp in two processes on the same batch, in turns with one process, as
torchrun would. --older runs whole trainings in turns with those of another checkout of this repository, on the same tasks,
options and seed.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
import torch
from machine import describe_machine, measure_peaks, report
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv
from torch.utils.flop_counter import FlopCounterMode

from maniskill_grpd.learning import TrainConfig, Trainer
from maniskill_grpd.learning.allocator import keep_freed_memory
from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.policies import make_policy
from maniskill_grpd.runs.environments import make_vector_env

ROOT = Path(__file__).resolve().parents[1]

EXAMPLE = ROOT / "examples" / "maniskill_ppo.py"
"""The peer: an example, and so no module of a package."""

PEER = "dense networks, ppo (stock style)"

SIZES = {"env_id": "RopeShaping-v1", "num_envs": 64, "eval_freq": 0, "save_model": False, "capture_video": False}

TASKS = {
    "RopeShaping-v1": ["--num_envs", "16", "--num_minibatches", "4"],
    "ClothHanging-v1": ["--num_envs", "16", "--num_minibatches", "4", "--env_kwargs", "resolution=64", "graph_nodes=25"],
}
"""Trainings that are compared with those of an older checkout, with all that the two might have different defaults for."""


def load_peer() -> ModuleType:
    """Import the example, which belongs to no package."""
    spec = importlib.util.spec_from_file_location("maniskill_ppo", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look for their annotations
    spec.loader.exec_module(module)
    return module


maniskill_ppo = load_peer()


def make_ours(algorithm: str, folder: str, **options: Any) -> Trainer:
    """Make the trainer of a run with default options."""
    config = TrainConfig(algorithm=algorithm, **SIZES, **options)
    envs = make_vector_env(config, config.num_envs, partial_reset=False)
    torch.manual_seed(1)
    trainer = Trainer(config, make_policy("grpd", envs.unwrapped.graph_schema), envs, None, folder)
    trainer.prepare()
    return trainer


class Peer:
    """ManiSkill's baseline on the same task, seen as a flat state, with its numbers of epochs and minibatches.

    Args:
        num_steps: Steps of a rollout.

    Attributes:
        times: Seconds of the last iteration: rollout, env (its share of the rollout), update.
    """

    def __init__(self, num_steps: int) -> None:
        self.config = maniskill_ppo.PpoConfig(
            num_envs=SIZES["num_envs"], num_steps=num_steps, update_epochs=4, num_minibatches=32, target_kl=math.inf
        )
        torch.manual_seed(1)
        env = gym.make(SIZES["env_id"], num_envs=SIZES["num_envs"], obs_mode="state")
        self.envs = TimedEnvs(ManiSkillVectorEnv(env, ignore_terminations=True, record_metrics=True))
        self.state, _ = self.envs.reset(seed=0)
        self.agent = maniskill_ppo.MlpAgent(self.state.shape[1], self.envs.single_action_space.shape[0])
        self.optimizer = torch.optim.Adam(self.agent.parameters(), lr=self.config.learning_rate, eps=1e-5)
        self.times: dict[str, float] = {}

    def run_iteration(self) -> None:
        """Collect and learn once."""
        self.envs.seconds = 0.0
        start = time.perf_counter()
        rollout, self.state = maniskill_ppo.collect(self.agent, self.envs, self.state, self.config)
        self.times = {"rollout": time.perf_counter() - start, "env": self.envs.seconds}
        maniskill_ppo.update(self.agent, self.optimizer, rollout, self.config)
        self.times["update"] = time.perf_counter() - start - self.times["rollout"]


class TimedEnvs:
    """A vector environment that counts the seconds its steps take."""

    def __init__(self, envs: Any) -> None:
        self.envs = envs
        self.seconds = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.envs, name)

    def step(self, action: torch.Tensor) -> Any:
        """Step the worlds."""
        start = time.perf_counter()
        result = self.envs.step(action)
        self.seconds += time.perf_counter() - start
        return result


def measure(repeats: int, options: dict[str, Any]) -> list[dict[str, Any]]:
    """Return one row per learner, ours with the ratio to the peer."""
    steps = TrainConfig(**SIZES).batch_size
    with tempfile.TemporaryDirectory() as bpp, tempfile.TemporaryDirectory() as ppo:
        learners = {
            "grpd, bpp": make_ours("bpp", bpp, **options),
            "grpd, ppo": make_ours("ppo", ppo, **options),
            PEER: Peer(TrainConfig(**SIZES).num_steps),
        }
        for learner in learners.values():
            learner.run_iteration()  # warm-up
        timings: dict[str, list[dict[str, float]]] = {name: [] for name in learners}
        for _ in range(repeats):
            for name, learner in learners.items():
                learner.run_iteration()
                timings[name].append(dict(learner.times))
        flops = {name: count_flops(learner) for name, learner in learners.items()}
        learners["grpd, bpp"].close()
        learners["grpd, ppo"].close()
    peak = measure_peaks()["gflop_per_s"]
    rows = [summarize(name, times, steps) | use_of_core(flops[name], times, steps, peak) for name, times in timings.items()]
    peer = next(row for row in rows if row["learner"] == PEER)
    for row in rows:
        if row is not peer:
            row |= {"peer": PEER, "ratio": row["env_steps_per_s"] / peer["env_steps_per_s"]}
    return rows


def count_flops(learner: Trainer | Peer) -> float | None:
    """Return the floating-point operations of the matrix products of an iteration; None where the counter cannot see them."""
    if isinstance(learner, Trainer) and learner.config.compile:
        return None
    with FlopCounterMode(display=False) as counter:
        learner.run_iteration()
    return counter.get_total_flops()


def use_of_core(flops: float | None, timings: list[dict[str, float]], steps: int, peak: float) -> dict[str, float]:
    """Return operations per step, and their rate as a share of the peak [GFLOP/s]."""
    if flops is None:
        return {}
    seconds = statistics.median(times["rollout"] + times["update"] for times in timings)
    return {"mflop_per_step": flops / steps * 1e-6, "share_of_peak": flops / seconds * 1e-9 / peak}


def summarize(name: str, timings: list[dict[str, float]], steps: int) -> dict[str, Any]:
    """Return rate and shares of the phases of a learner."""
    rates = [steps / (times["rollout"] + times["update"]) for times in timings]
    totals = {phase: sum(times[phase] for times in timings) for phase in ("rollout", "env", "update")}
    whole = totals["rollout"] + totals["update"]
    return {
        "learner": name,
        "env_steps_per_s": statistics.median(rates),
        "min": min(rates),
        "max": max(rates),
        "share_simulation": totals["env"] / whole,
        "share_policy": (totals["rollout"] - totals["env"]) / whole,
        "share_update": totals["update"] / whole,
    }


def measure_processes(repeats: int) -> list[dict[str, Any]]:
    """Return a row for one process and one for two, which take turns with the same global batch."""
    options = ["--num_envs", str(SIZES["num_envs"]), "--num_minibatches", "16"]
    names = {count: f"grpd, bpp, {count} process(es)" for count in (1, 2)}
    return take_turns(
        {name: lambda count=count: run_training(SIZES["env_id"], options, count=count) for count, name in names.items()}, repeats
    )


def measure_older(folder: Path, repeats: int, options: Sequence[str]) -> list[dict[str, Any]]:
    """Return two rows per task: trainings of another checkout, and ours, which take turns."""
    rows = []
    for task, sizes in TASKS.items():
        ours = [*sizes, "--no_recommended", *options]
        trainings = {
            f"{task}, older checkout": lambda task=task, sizes=sizes: run_training(task, sizes, root=folder),
            f"{task}, this checkout": lambda task=task, ours=ours: run_training(task, ours),
        }
        rows += take_turns(trainings, repeats)
    return rows


def take_turns(trainings: Mapping[str, Callable[[], float]], repeats: int) -> list[dict[str, Any]]:
    """Return the rates of two trainings, the second with its ratio to the first."""
    rates: dict[str, list[float]] = {name: [] for name in trainings}
    for _ in range(repeats):
        for name, run in trainings.items():
            rates[name].append(run())
    rows = [
        {"learner": name, "env_steps_per_s": statistics.median(found), "min": min(found), "max": max(found)}
        for name, found in rates.items()
    ]
    rows[1] |= {"peer": rows[0]["learner"], "ratio": rows[1]["env_steps_per_s"] / rows[0]["env_steps_per_s"]}
    return rows


def run_training(task: str, options: Sequence[str], *, root: Path = ROOT, count: int = 1, iterations: int = 5) -> float:
    """Return env-steps/s of a training of grpd with bpp, without its start and first iteration.

    Args:
        task: Its id.
        options: More of the command line, number of environments first.
        root: The checkout whose code trains.
        count: Number of processes.
        iterations: How many are timed.
    """
    steps = int(options[1]) * TrainConfig().num_steps
    command = [sys.executable]
    if count > 1:
        command += ["-m", "torch.distributed.run", "--standalone", f"--nproc_per_node={count}"]
    command += [str(root / "baselines" / "train.py"), "--env_id", task, "--exp_name", "benchmark", "--eval_freq", "0"]
    command += ["--no_save_model", "--no_capture_video", "--total_timesteps", str(steps * (iterations + 1)), *options]
    env = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(root)}
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(command, cwd=folder, env=env, check=True, capture_output=True)
        rows = read_rows(Path(folder) / "runs" / "benchmark" / "metrics.jsonl", "train")
    return steps / statistics.median(row["time/rollout_time"] + row["time/update_time"] for row in rows[1:])


def main(arguments: Sequence[str]) -> None:
    """Parse the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="short measurements, for a look rather than for the record")
    parser.add_argument("--processes", action="store_true", help="also compare two processes with one")
    parser.add_argument("--older", type=Path, help="another checkout of this repository, to compare trainings with")
    parser.add_argument("--compile", action="store_true", help="compile the policy for updates")
    parser.add_argument("--json", type=Path, help="file for the rows")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    keep_freed_memory()
    repeats = 1 if options.quick else 5
    rows = measure(repeats, {"compile": options.compile, **({"update_epochs": 1} if options.quick else {})})
    if options.processes:
        rows += measure_processes(repeats)
    if options.older is not None:
        rows += measure_older(options.older.resolve(), repeats, ["--compile"] if options.compile else [])
    report(rows, describe_machine(), options.json)


if __name__ == "__main__":
    main(sys.argv[1:])
