"""What a browser shows: live scenes on a server, and replays in one file. Knows meshes, and nothing of where they are from.

Live scenes need viser (the extra `viewer`); parts and replays do not.
"""

from maniskill_grpd.viewer.parts import Copies, Look, Part, Shell
from maniskill_grpd.viewer.replay import Replay

__all__ = ["Copies", "Look", "Part", "Replay", "Shell"]
