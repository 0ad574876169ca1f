"""Graphs that show only what cameras see (eq. 21)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import torch

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.physics import Solver
from maniskill_grpd.rendering import SolverScene
from maniskill_grpd.tasks.pictures.raster_camera import RasterCamera

HIDING_DEPTHS = {"cloth": 1.0, "rope": 2.0}
"""How many radii of the object something must be in front of a node to hide it; the nodes of a rope are inside of it."""
UNSEEN = -1.0
"""Age of nodes that have not been seen in an episode."""

Nodes = dict[str, torch.Tensor]
Allocate = Callable[..., torch.Tensor]


class Sight:
    """Tells which nodes at least one of some cameras sees."""

    def __init__(self, solver: Solver, view: SolverScene, cameras: Sequence[RasterCamera]) -> None:
        """Look at the worlds of a solver with cameras that see `view`.

        Raises:
            ValueError: If there is no camera.
        """
        if not cameras:
            raise ValueError('visibility="camera" needs a camera, and the task has none in _default_sensor_configs')
        self._solver, self._view, self._cameras = solver, view, cameras
        self._tolerance = HIDING_DEPTHS["rope" if solver.model.is_rope else "cloth"] * solver.model.radius

    def seen(self) -> torch.Tensor:
        """Return which nodes are seen now, (B, N) bool; those that grippers hold are known."""
        self._view.update()
        seen = self._solver.holder >= 0
        for camera in self._cameras:
            seen |= camera.visible(self._solver.positions, self._tolerance)
        return seen


class PartialView(Protocol):
    """Shows a part of the nodes of a graph."""

    def show(self, nodes: Nodes, seen: torch.Tensor) -> Nodes:
        """Return what is shown of nodes with tensors (B, n, ...), of which those in `seen` (B, n) bool can be seen now."""


class MaskedView:
    """Hidden nodes are masked, and nothing of them is left in the tensors."""

    def show(self, nodes: Nodes, seen: torch.Tensor) -> Nodes:
        """Return nodes with tensors (B, n, ...), of which those in `seen` (B, n) remain."""
        shown = {**nodes, "mask": nodes["mask"] & seen}
        for name in ("position", "vectors", "scalars"):
            shown[name] = nodes[name] * like_nodes(seen, nodes[name])
        return shown


class StaleView:
    """Hidden nodes stay as they were when last seen, and their last scalar is how long ago that was [s].

    Nodes that have not been seen in an episode are masked. The memory is part of the state of an episode.
    """

    def __init__(self, num_nodes: int, schema: GraphSchema, allocate: Allocate) -> None:
        """Allocate the memory of n nodes with `allocate`, see `DeformableEnv.episode_tensor`."""
        vectors, scalars = schema.object.num_vectors, schema.object.num_scalars
        self._last = {
            "position": allocate("seen_position", num_nodes, 3, kind="position"),
            "vectors": allocate("seen_vectors", num_nodes, vectors, 3, kind="vector"),
            "scalars": allocate("seen_scalars", num_nodes, scalars, kind="scalar"),
        }
        self._ages = allocate("seen_ages", num_nodes, kind="scalar")

    def forget(self, worlds: torch.Tensor) -> None:
        """Begin anew in some worlds (b,)."""
        self._ages[worlds] = UNSEEN

    def grow_older(self, duration: float) -> None:
        """Let time pass [s]."""
        self._ages += duration * (self._ages != UNSEEN)

    def show(self, nodes: Nodes, seen: torch.Tensor) -> Nodes:
        """Remember the nodes in `seen` (B, n), and return all as they are remembered; asking twice changes nothing."""
        for name, last in self._last.items():
            torch.where(like_nodes(seen, last) > 0.0, nodes[name], last, out=last)
        self._ages.masked_fill_(seen, 0.0)
        known = self._ages != UNSEEN
        shown = {**nodes, "mask": nodes["mask"] & known}
        shown |= {name: last * like_nodes(known, last) for name, last in self._last.items()}
        shown["scalars"][..., -1] = self._ages * known
        return shown


def like_nodes(mask: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """Return a mask (B, n) as numbers that broadcast over values (B, n, ...)."""
    return mask.to(values.dtype).reshape(*mask.shape, *[1] * (values.ndim - 2))
