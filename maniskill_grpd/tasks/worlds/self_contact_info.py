"""What `info` tells about contact of the object with itself."""

from __future__ import annotations

import torch

from maniskill_grpd.physics import Solver
from maniskill_grpd.physics.crossings import count_crossings


def self_contact_info(solver: Solver, *, counts_crossings: bool) -> dict[str, torch.Tensor]:
    """Return `dropped_contacts` (B,) int32 and, if asked for, `self_crossings` (B,) int64.

    Raises:
        ValueError: If crossings are to be counted of a rope, which has no surface to cross.
    """
    info = {"dropped_contacts": solver.dropped_contacts.clone()}
    if counts_crossings:
        if any(model.is_rope for model in solver.models):
            raise ValueError(
                "count_crossings counts edges of a cloth that cross its triangles; the object of this task is a rope"
            )
        info["self_crossings"] = torch.zeros(solver.num_worlds, dtype=torch.int64, device=solver.device)
        for variant in solver.variants.unique().tolist():
            worlds = torch.nonzero(solver.variants == variant)[:, 0]
            info["self_crossings"][worlds] = count_crossings(solver.models[variant], solver.positions[worlds])
    return info
