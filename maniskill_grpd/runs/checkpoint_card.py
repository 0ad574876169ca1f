"""A page about a checkpoint: where it comes from and what it reaches."""

from __future__ import annotations

import dataclasses
import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.config import NO_RECOMMENDED
from maniskill_grpd.learning.options import to_arguments
from maniskill_grpd.policies import Policy
from maniskill_grpd.runs.episodes import describe_episodes

UNIMPORTANT = frozenset({"checkpoint", "exp_name", "resume", "capture_video"})
"""Options that say nothing about what was trained."""

REPLAY_LINE = "[Replay]({link}) of the worst and the median episode: download it and open it in a browser."
"""How a card names a replay."""


def write_card(
    path: Path,
    checkpoint: Path,
    contents: Mapping[str, Any],
    policy: Policy,
    arguments: Sequence[str],
    episodes: Mapping[str, torch.Tensor],
    replay: Path | None = None,
) -> None:
    """Write the page.

    Args:
        path: Where to.
        checkpoint: The file it is about.
        contents: What that file holds.
        policy: The policy in it.
        arguments: Command line of the evaluation, without the option that asked for the page.
        episodes: Results per episode.
        replay: An html file that shows some of them.
    """
    trained = TrainConfig.from_dict(contents["train_config"])
    given = dataclasses.replace(trained, **{name: getattr(TrainConfig(), name) for name in UNIMPORTANT})
    words = ["--env_id", trained.env_id, *to_arguments(dataclasses.replace(given, env_id=TrainConfig().env_id))]
    command = shlex.join(["maniskill-grpd", "train", *words, NO_RECOMMENDED])
    shown = "" if replay is None else f"\n{REPLAY_LINE.format(link=os.path.relpath(replay, path.parent))}\n"
    size = sum(weight.numel() for weight in policy.parameters())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        f"""# {checkpoint.name}

| | |
|---|---|
| task | {" ".join([trained.env_id, *trained.env_kwargs])} |
| policy | {trained.policy}, {size:,} parameters |
| algorithm | {trained.algorithm}{f", {trained.trust_region}" if trained.algorithm == "bpp" else ""} |
| trained for | {contents["global_step"]:,} of {trained.total_timesteps:,} environment steps |
| trained with | `{command}` |

Result of `maniskill-grpd evaluate {shlex.join(arguments)}`, seeds that training never sees:

```text
{describe_episodes(episodes)}
```
{shown}""",
        encoding="utf-8",
    )
