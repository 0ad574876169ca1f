"""What pixels show."""

from __future__ import annotations

from enum import IntEnum


class Label(IntEnum):
    """The classes of a segmentation."""

    NONE = 0
    TABLE = 1
    CLOTH = 2
    ROPE = 3
    GRIPPER = 4
    OBSTACLE = 5
    ARM = 6
