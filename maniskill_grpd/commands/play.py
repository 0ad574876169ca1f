"""Play in a browser: watch an agent, pull at the object with the mouse, move grippers by hand, record.

maniskill-grpd play --env_id ClothFolding-v1
maniskill-grpd play --checkpoint runs/NAME/final_ckpt.pt --num_envs 4
maniskill-grpd play --env_id ClothHanging-v1 --agent teleop --env_kwargs grasp=free

prints the address to open. It needs no GPU, no Vulkan driver and no display, and works through ssh port forwarding. Drag the
object with the left mouse button to pull at it while the agent acts; drag the background to turn the camera. The panel steers
everything else: docs/viewer.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.playing.play_config import PlayConfig
from maniskill_grpd.playing.session import Session


def play(config: PlayConfig) -> None:
    """Play until Ctrl-C."""
    torch.set_num_threads(1)
    with Session(config) as session:
        print(session.greeting(), flush=True)
        try:
            session.run()
        except KeyboardInterrupt:
            print("ended")


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(play, PlayConfig, arguments)
