"""Replays of all tasks: the expert, the shipped policy, and an episode that fails, each one html file.

python -m tools.docs.replays [--folder docs/replays]

Writes <id of the task>_<who>.html, and replays.json, from which `python -m tools.docs` makes links on the pages of the tasks; and
one replay for each shipped checkpoint, of the worst and the median of some episodes, with a line on its card.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from pathlib import Path

import torch

from maniskill_grpd.experts import EXPERTS, make_expert
from maniskill_grpd.imitation.expert_actor import ExpertActor
from maniskill_grpd.learning import TrainConfig, evaluate_policy, load_checkpoint
from maniskill_grpd.runs.checkpoint_card import REPLAY_LINE
from maniskill_grpd.runs.environments import make_env
from maniskill_grpd.runs.evaluation import EvaluationConfig, evaluate, record_worst_and_median
from maniskill_grpd.runs.replays import Filming, record_replay
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED

CHECKPOINTS = Path("checkpoints")
NUM_EPISODES = 24
"""Episodes among which a failure, and the worst and the median, are looked for."""
NUM_SHOWN = 4
"""Episodes of an expert or a policy that are shown side by side."""


class RandomActor:
    """Random actions, for tasks whose policy does not fail."""

    def __init__(self, width: int) -> None:
        self._width, self._generator = width, torch.Generator().manual_seed(0)

    def act(self, graph: dict, **_: object) -> torch.Tensor:
        """Return actions in [-1, 1]."""
        count = len(graph["object"]["position"])
        return 2.0 * torch.rand(count, self._width, generator=self._generator) - 1.0


def shipped_policies() -> dict[str, Path]:
    """Return the checkpoints by the id of their task."""
    return {load_checkpoint(path)["train_config"]["env_id"]: path for path in sorted(CHECKPOINTS.glob("*.pt"))}


def film_expert(env_id: str, folder: Path) -> dict[str, str]:
    """Record the expert of a task."""
    env = make_env(TrainConfig(env_id=env_id, sim_backend="cpu"), NUM_SHOWN)
    filming = Filming(env, range(NUM_SHOWN), f"{env_id}: the expert")
    seeds = range(FIRST_TEST_SEED, FIRST_TEST_SEED + NUM_SHOWN)
    evaluate_policy(ExpertActor(make_expert(env_id, env)), env, seeds, on_step=filming.shoot)
    env.close()
    return _entry(env_id, "expert", filming.replay.write(folder / f"{env_id}_expert.html"))


def film_policy(env_id: str, checkpoint: Path, folder: Path) -> Iterator[dict[str, str]]:
    """Record the shipped policy of a task, an episode in which it fails, and the worst and the median for its card."""
    card = folder / f"{checkpoint.stem}.html"
    config = EvaluationConfig(
        checkpoint=checkpoint, num_episodes=NUM_EPISODES, num_envs=NUM_EPISODES, sim_backend="cpu", html=card
    )
    found = evaluate(config)
    record_worst_and_median(config, found)
    seeds = range(config.seed, config.seed + NUM_SHOWN)
    path = folder / f"{env_id}_policy.html"
    record_replay(found.policy, found.task, seeds, path, f"{env_id}: the policy {checkpoint.name}")
    yield _entry(env_id, "shipped policy", path)
    path = folder / f"{env_id}_failure.html"
    failed = (~found.episodes["success_at_end"]).nonzero()[:, 0]
    if len(failed):
        seed = config.seed + int(failed[0])
        record_replay(found.policy, found.task, [seed], path, f"{env_id}: {checkpoint.name} fails, seed {seed}")
        yield _entry(env_id, "a failure of the policy", path)
    else:
        env = make_env(found.task, 1)
        actor = RandomActor(env.action_space.shape[-1])
        env.close()
        title = f"{env_id}: random actions, which fail; the policy did not in {NUM_EPISODES} episodes"
        record_replay(actor, found.task, [config.seed], path, title)
        yield _entry(env_id, "random actions, which fail", path)


def name_on_card(checkpoint: Path, replay: Path) -> None:
    """Put a link to a replay at the end of the card of a checkpoint, in place of the one that is there."""
    card = checkpoint.with_suffix(".md")
    line = REPLAY_LINE.format(link=os.path.relpath(replay, card.parent))
    start = REPLAY_LINE.partition("(")[0]
    kept = [text for text in card.read_text(encoding="utf-8").splitlines() if not text.startswith(start)]
    card.write_text("\n".join(kept).rstrip() + f"\n\n{line}\n", encoding="utf-8")


def _entry(env_id: str, who: str, path: Path) -> dict[str, str]:
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")
    return {"env": env_id, "who": who, "file": path.name}


def main() -> None:
    """Parse the command line, play and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("docs/replays"), help="where to write the replays")
    folder = parser.parse_args().folder
    torch.set_num_threads(1)
    policies, rows = shipped_policies(), []
    for env_id in sorted(EXPERTS):
        rows.append(film_expert(env_id, folder))
        if env_id in policies:
            rows += film_policy(env_id, policies[env_id], folder)
            name_on_card(policies[env_id], folder / f"{policies[env_id].stem}.html")
    (folder / "replays.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
