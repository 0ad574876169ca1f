"""Which commands there are, and which of them a command line means."""

from __future__ import annotations

import difflib
import importlib
import sys
from collections.abc import Sequence

from maniskill_grpd.program import PROGRAM

COMMANDS = {
    "train": "train a policy on a task, or resume a training",
    "play": "watch an agent in a browser, pull at the object, move grippers by hand",
    "evaluate": "play a checkpoint on unseen start and goal poses",
    "evaluate_expert": "play the scripted expert of a task, the reference of its policies",
    "clone": "clone the expert of a task, and compare policies by it",
    "study": "run one of the studies of the paper's claims, and write its page",
    "sweep": "train every combination of some options",
    "evaluate_study": "test a checkpoint under every condition of a study",
    "plan": "play a task by planning in the simulation, from a policy or from nothing",
    "record": "record demonstrations of an expert in ManiSkill's trajectory format",
    "replay": "replay recorded trajectories, in another observation mode for instance",
    "inspect": "draw what a policy looks at",
    "interpret": "measure where policies look, and write a page",
    "plot": "draw the learning curves of runs",
    "video": "record a video of a checkpoint",
    "demo": "train for a few minutes and show what was learned",
}
"""What each command does, by its name: that of its module in this package."""

USAGE = """usage: {program} COMMAND [OPTIONS]

Rope and cloth tasks for ManiSkill: training, evaluation and studies.

{commands}

{program} COMMAND --help explains a command and its options. One name means one thing in all of them:

  --env_id ID --env_kwargs KEY=VALUE ...   task and its options, values in JSON
  --policy NAME --policy_kwargs ...        policy and its options
  --checkpoint FILE                        policy to play, to examine or to start from
  --seed N --num_episodes N --num_envs N   first seed, number of episodes, environments in parallel
  --sim_backend auto|cpu|cuda              where the simulation runs
  --output PATH                            file or folder that the result goes to
  --json --markdown --html --video --card FILE   also write the result in that form
  --dry_run                                say what would be done, and stop
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that the arguments name, by default those of the process; return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] in ("-h", "--help"):
        print(usage())
        return 0
    name = words[0].replace("-", "_")
    if name not in COMMANDS:
        print(f"error: {describe_unknown(words[0])}", file=sys.stderr)
        return 2
    return importlib.import_module(f"{__package__}.{name}").main(words[1:])


def forward(name: str) -> None:
    """End the process as a command ends it: what the scripts of `baselines/` do."""
    sys.exit(main([name, *sys.argv[1:]]))


def usage() -> str:
    """Return what `--help` prints."""
    width = max(map(len, COMMANDS)) + 2
    lines = [f"  {name:<{width}}{purpose}" for name, purpose in COMMANDS.items()]
    return USAGE.format(program=PROGRAM, commands="\n".join(lines)).rstrip()


def describe_unknown(word: str) -> str:
    """Return a line about a word that is no command."""
    close = difflib.get_close_matches(word, COMMANDS, n=1)
    meant = f", did you mean {close[0]!r}?" if close else ";"
    return f"unknown command {word!r}{meant} Commands are {', '.join(COMMANDS)}"
