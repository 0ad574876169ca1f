"""Draw what a policy looks at.

maniskill-grpd inspect --checkpoint runs/NAME/final_ckpt.pt --steps 0 15 30

Plays one episode and writes to the folder of the checkpoint, or to --output:

sensitivity.png    per actuator and step, how its mean action changes when an object node moves, |d a_v / d p_u| (eq. 11, 47),
                   drawn on the object; the node's goal stays fixed in space, so that its offset from the goal changes too
contribution.png   per actuator and step, how far its mean action changes when an object node is taken out of the graph
embedding.png      features of the object nodes after message passing, all steps of the episode, on their first two principal
                   components; coloured by place along the object, distance to the goal and step

and prints how evenly the influence of the nodes is spread. Works for every policy.
"""

from __future__ import annotations

from collections.abc import Sequence

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.runs.policy_inspection import InspectionConfig, inspect_policy


def inspect_and_report(config: InspectionConfig) -> None:
    """Examine, and say what was found and where the pictures are."""
    lines, paths = inspect_policy(config)
    print("\n".join(lines))
    print("pictures: " + ", ".join(map(str, paths)))


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(inspect_and_report, InspectionConfig, arguments)
