"""A ManiSkill scene that holds many deformable worlds and at most one SAPIEN scene to draw them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import sapien
import torch
from mani_skill.envs.scene import ManiSkillScene

if TYPE_CHECKING:
    from mani_skill.utils.building.actor_builder import ActorBuilder

    from maniskill_grpd.physics import Solver


class BatchedScene(ManiSkillScene):
    """Scene whose worlds live in a deformable solver.

    ManiSkill counts worlds by SAPIEN sub-scenes and allows a single one on CPU. Here `num_envs` is
    the number of worlds of the solver; the only sub-scene is a stage on which one world at a time
    is mirrored to take its picture. Nothing dynamic lives in PhysX.

    Attributes:
        solver: The deformable worlds; agents find their grippers in it.
    """

    def __init__(self, stage: sapien.Scene, solver: Solver, **settings: Any) -> None:
        """Wrap a solver.

        Args:
            stage: SAPIEN scene to draw in.
            solver: The deformable worlds.
            settings: Settings of `ManiSkillScene` (sim_config, device, backend).
        """
        self.solver = solver
        super().__init__([stage], **settings)
        self._reset_mask = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)

    @property
    def num_envs(self) -> int:
        """Number of worlds."""
        return self.solver.num_worlds

    def can_render(self) -> bool:
        """Tell whether SAPIEN draws. ManiSkill says so of every scene on macOS."""
        return self.backend.render_device is not None

    def step(self) -> None:
        """Advance all worlds by one control step."""
        self.solver.step()

    def create_actor_builder(self) -> ActorBuilder:
        """Create a builder of actors on the stage; they have a batch size of one."""
        return super().create_actor_builder().set_scene_idxs([0])
