"""Random actions in a task, like ManiSkill's demo of that name, whose flags and printed output these are.

python examples/demo_random_action.py -e ClothFolding-v1 -n 4 --record-dir demo
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import tyro
from mani_skill.examples.demo_random_action import Args, main

import maniskill_grpd  # noqa: F401  (registers the tasks)


def demo(arguments: Sequence[str]) -> None:
    """Run ManiSkill's demo with defaults that suit these tasks."""
    main(tyro.cli(Args, args=list(arguments), default=Args(env_id="RopeShaping-v1", render_backend="auto")))


if __name__ == "__main__":
    demo(sys.argv[1:])
