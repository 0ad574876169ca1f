"""Graphs of detected keypoints in place of all nodes."""

from __future__ import annotations

from dataclasses import dataclass

FEWEST = 2
"""Smallest number of keypoints: an edge needs two."""


@dataclass(frozen=True, kw_only=True)
class Keypoints:
    """How many keypoints are found, and how badly."""

    num: int
    noise: float
    """Standard deviation of their positions per axis [m]."""
    dropout: float
    """Share of them, drawn anew for each observation, that is not found."""


def choose_keypoints(
    num: int | None, noise: float, dropout: float, *, has_graph: bool, hidden_nodes: str, graph_features: str
) -> Keypoints | None:
    """Check the options `keypoints`, `keypoint_noise` and `keypoint_dropout`; None without keypoints.

    Raises:
        ValueError: If one has a value that is not allowed, or they do not fit the other options.
    """
    if num is None:
        if noise or dropout:
            raise ValueError("keypoint_noise and keypoint_dropout need keypoints, how many there are")
        return None
    if isinstance(num, bool) or not isinstance(num, int) or num < FEWEST:
        raise ValueError(f"keypoints must be a whole number >= {FEWEST}, got {num!r}")
    if not 0.0 <= noise < float("inf"):
        raise ValueError(f"keypoint_noise must be a finite length >= 0 [m], got {noise!r}")
    if not 0.0 <= dropout < 1.0:
        raise ValueError(f"keypoint_dropout must be in [0, 1), got {dropout!r}")
    if not has_graph:
        raise ValueError('keypoints are nodes of the graph: obs_mode must have "graph"')
    if hidden_nodes != "mask":
        raise ValueError(f"keypoints are found anew at every step: hidden_nodes must be 'mask', got {hidden_nodes!r}")
    if graph_features != "paper":
        raise ValueError(f'keypoints need graph_features="paper": with {graph_features!r} grippers tell of all nodes')
    return Keypoints(num=num, noise=noise, dropout=dropout)
