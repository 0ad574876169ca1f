"""What of the object a graph shows."""

from __future__ import annotations

from dataclasses import dataclass

VISIBILITIES = (None, "camera")
HIDDEN_NODES = ("mask", "stale")
STATES = ("state", "state_dict")
CRITIC_OBSERVATIONS = (None, "full")


@dataclass(frozen=True)
class Visibility:
    """Whether a graph shows only the nodes that cameras see, and what becomes of the others."""

    by_camera: bool
    keeps_stale: bool
    """Whether hidden nodes stay where they were last seen, rather than being masked."""


def choose_visibility(visibility: str | None, hidden_nodes: str, beside: str | None, graph_features: str) -> Visibility:
    """Check the options `visibility` and `hidden_nodes`.

    Args:
        visibility: One of `VISIBILITIES`.
        hidden_nodes: One of `HIDDEN_NODES`.
        beside: ManiSkill's observation mode beside the graph, None without a graph.
        graph_features: What grippers tell.

    Raises:
        ValueError: If one has a value that is not allowed, there is no graph, or something else would tell what is hidden.
    """
    if visibility not in VISIBILITIES:
        raise ValueError(f"visibility must be one of {list(VISIBILITIES)}, got {visibility!r}")
    if hidden_nodes not in HIDDEN_NODES:
        raise ValueError(f"hidden_nodes must be one of {list(HIDDEN_NODES)}, got {hidden_nodes!r}")
    if visibility is None:
        if hidden_nodes != "mask":
            raise ValueError(f'hidden_nodes={hidden_nodes!r} needs visibility="camera": without it no node is hidden')
        return Visibility(by_camera=False, keeps_stale=False)
    if beside is None:
        raise ValueError('visibility="camera" is about the graph: obs_mode must have "graph"')
    if set(beside.split("+")) & set(STATES):
        raise ValueError(f'visibility="camera" cannot be joined with {beside!r}, which tells where all nodes are')
    if graph_features != "paper":
        raise ValueError(f'visibility="camera" needs graph_features="paper": with {graph_features!r} grippers tell of all nodes')
    return Visibility(by_camera=True, keeps_stale=hidden_nodes == "stale")


def check_critic_observations(critic_observations: str | None, *, is_partial: bool) -> bool:
    """Return whether graphs hold all nodes for a critic beside those that are shown.

    Raises:
        ValueError: If the option has a value that is not allowed, or the graph shows all nodes anyway.
    """
    if critic_observations not in CRITIC_OBSERVATIONS:
        raise ValueError(f"critic_observations must be one of {list(CRITIC_OBSERVATIONS)}, got {critic_observations!r}")
    if critic_observations is not None and not is_partial:
        raise ValueError(
            'critic_observations="full" needs visibility="camera" or keypoints: without them the graph shows all nodes'
        )
    return critic_observations is not None
