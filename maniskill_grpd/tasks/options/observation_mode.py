"""Observation modes: ManiSkill's own, joined with "+" to the graph of the scene."""

from __future__ import annotations

GRAPH = "graph"
STATE_MODES = ("state", "state_dict", "none")
IMAGE_MODES = ("rgb", "depth", "segmentation", "position", "normal", "albedo", "rgbd", "pointcloud", "sensor_data")
STAND_ALONE_MODES = ("none", "rgbd", "sensor_data")
"""Modes that ManiSkill cannot join with another one of its own."""


def split_observation_mode(mode: str | None) -> tuple[str, bool]:
    """Split a mode such as "graph+rgb" into ManiSkill's part and whether a graph is wanted.

    Returns:
        ("rgb", True) for "graph+rgb"; ("none", True) for "graph" and None, the default.

    Raises:
        ValueError: If a word of the mode is unknown or the words cannot be joined.
    """
    words = (GRAPH if mode is None else mode).split("+")
    allowed = (GRAPH, *STATE_MODES, *IMAGE_MODES)
    unknown = [word for word in words if word not in allowed]
    if unknown:
        raise ValueError(
            f"unknown observation mode {unknown[0]!r} in {mode!r}; allowed are {', '.join(allowed)}"
            ' and combinations joined by "+"'
        )
    rest = [word for word in words if word != GRAPH]
    alone = [word for word in rest if word in STAND_ALONE_MODES]
    if alone and len(rest) > 1:
        raise ValueError(f"observation mode {alone[0]!r} cannot be joined with another in {mode!r}")
    return "+".join(rest) or "none", GRAPH in words


def needs_camera(mode: str) -> bool:
    """Tell whether ManiSkill's part of a mode contains images."""
    return any(word in IMAGE_MODES for word in mode.split("+"))
