"""The page about what policies look at, and its pictures."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.options import require_positive
from maniskill_grpd.policies import policy_from_config
from maniskill_grpd.runs.checkpoints import load_policy
from maniskill_grpd.runs.fingerprint import describe_task
from maniskill_grpd.runs.inspection import play_episode
from maniskill_grpd.runs.inspection_figures import write_inspection
from maniskill_grpd.runs.interpretation import KINDS, interpret
from maniskill_grpd.runs.play import change_task
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED

READING = """\
How much one node of a group moves an action, over what an average node does; 1 is no preference. *Sensitivity*: the change of the
mean action when the node moves and its goal stays; *contribution*: what the action changes when the node is taken out of the
graph. *Alike*: how far the features of the group's nodes after message passing are from each other, over how far from all others;
below 1 they cluster. Untrained: the same network with fresh weights, which shows what is learned and what lies in the graph. The
paper (B.F) says that grippers focus on near nodes and corners, that nodes on fold lines have similar features, and that every
action is influenced by a large part of the object.

One policy each is an example, not a statistic. Checkpoints are of the code that trained them; the code named is that which played
them."""
KINDS_OF_PICTURES = ("sensitivity", "contribution", "embedding")


@dataclass(frozen=True, kw_only=True)
class InterpretationConfig:
    """Options of an interpretation."""

    checkpoint: tuple[Path, ...]
    """checkpoints to look into, each on the task of its training"""
    output: Path = Path("runs/interpretation")
    """folder of the page, its pictures and its data"""
    num_episodes: int = 5
    """episodes of each policy"""
    seed: int = FIRST_TEST_SEED
    """seed of the first episode"""
    steps: tuple[int, ...] = (0, 10, 20, 40)
    """steps of each episode that are looked at"""

    def __post_init__(self) -> None:
        require_positive(self, "num_episodes")
        if not self.checkpoint or not self.steps or min(self.steps) < 0:
            raise ValueError(f"checkpoint and steps need at least one each, steps >= 0; got {self.checkpoint} and {self.steps}")


def write_interpretation(config: InterpretationConfig) -> Path:
    """Look into the policies, trained and untrained, and write data, pictures and page.

    Returns:
        The page, interpretation.md.

    Raises:
        CheckpointError: If a file is no checkpoint, or of a policy for other observations than its task gives.
    """
    torch.set_num_threads(1)
    rows = [row for path in config.checkpoint for row in _look_into(path, config)]
    config.output.mkdir(parents=True, exist_ok=True)
    (config.output / "interpretation.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    page = config.output / "interpretation.md"
    page.write_text(to_page(rows), encoding="utf-8")
    return page


def _look_into(path: Path, config: InterpretationConfig) -> list[dict[str, Any]]:
    """Return a row for a policy and one for its untrained twin, and draw an episode of the first."""
    policy, contents = load_policy(path)
    task = change_task(TrainConfig.from_dict(contents["train_config"]), sim_backend="cpu")
    torch.manual_seed(0)
    untrained = policy_from_config(contents["policy"])
    untrained.normalizer.load_state_dict(policy.normalizer.state_dict())
    seeds = range(config.seed, config.seed + config.num_episodes)
    graphs = play_episode(policy, task, config.seed)
    steps = sorted({min(step, len(graphs) - 1) for step in config.steps})
    write_inspection(policy, graphs, steps, config.output / f"interpretation_{path.stem}")
    facts = {
        "checkpoint": path.name,
        "env_id": task.env_id,
        "env_kwargs": list(task.env_kwargs),
        "policy": policy.name,
        "global_step": contents["global_step"],
        "num_episodes": config.num_episodes,
        "steps": list(config.steps),
        "fingerprint": describe_task(task)["fingerprint"],
    }
    looks = {"trained": policy, "untrained": untrained}
    return [
        {**facts, "weights": name, **dataclasses.asdict(interpret(one, task, seeds, config.steps))} for name, one in looks.items()
    ]


def to_page(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the page of rows, those of a checkpoint together."""
    parts = [
        "# What policies look at",
        "Written by `maniskill-grpd interpret`, with its pictures, from policies that play the task of their training.",
        READING,
    ]
    for name in dict.fromkeys(row["checkpoint"] for row in rows):
        found = {row["weights"]: row for row in rows if row["checkpoint"] == name}
        parts += _section(name, found)
    return "\n\n".join(parts) + "\n"


def _section(name: str, found: Mapping[str, Mapping[str, Any]]) -> list[str]:
    first = found["trained"]
    options = " ".join([first["env_id"], *first["env_kwargs"]])
    head = f"{options}; {first['policy']}, trained for {first['global_step']:,} steps, {first['num_episodes']} episodes, "
    head += f"steps {', '.join(map(str, first['steps']))}; code {first['fingerprint']['code']}."
    spread = ", ".join(f"{row['effective_nodes']:.1f} of {row['nodes']} {weights}" for weights, row in found.items())
    lines = ["| nodes | " + " | ".join(f"{kind}, {weights}" for kind in (*KINDS, "alike") for weights in found) + " |"]
    lines.append("|---" + "|--:" * (len(lines[0].split("|")) - 3) + "|")
    for group in first["shares"]:
        cells = [f"{row['shares'][group][kind]:.2f}" for kind in KINDS for row in found.values() if group in row["shares"]]
        cells += [f"{row['alikeness'][group]:.2f}" if group in row["alikeness"] else "-" for row in found.values()]
        lines.append(f"| {group} | " + " | ".join(cells) + " |")
    pictures = [
        f"![{kind}](interpretation_{Path(name).stem}/{kind}.png)" for kind in ("sensitivity", "contribution", "embedding")
    ]
    return [f"## {name}", head, f"Nodes that count for an action: {spread}.", "\n".join(lines), *pictures]
