"""Playing with tasks in a browser: agents that act, a panel to steer, mice that pull, gizmos to tele-operate, recordings.

One thread, that of the player, owns the environment. What clients do arrives from the threads of the server and waits in a queue.
"""

from maniskill_grpd.playing.notebook import show_notebook
from maniskill_grpd.playing.play_config import PlayConfig
from maniskill_grpd.playing.player import Player

__all__ = ["PlayConfig", "Player", "show_notebook"]
