"""A ManiSkill scene that holds many deformable worlds and at most one SAPIEN scene to draw them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import sapien
import torch
from mani_skill.envs.scene import ManiSkillScene

if TYPE_CHECKING:
    from mani_skill.utils.building.actor_builder import ActorBuilder

    from maniskill_grpd.agents import ArmBodies
    from maniskill_grpd.physics import Solver


class BatchedScene(ManiSkillScene):
    """Scene whose worlds live in a deformable solver.

    ManiSkill counts worlds by SAPIEN sub-scenes and allows a single one on CPU. Here `num_envs` is
    the number of worlds of the solver; the only sub-scene is a stage on which one world at a time
    is mirrored to take its picture. Nothing dynamic lives in PhysX.

    Attributes:
        solver: The deformable worlds; agents find their grippers in it.
        grip_commands: Whether each gripper is to be closed, (B, A) bool; obeyed where grasps are free.
        arms: The arms whose tools the grippers are, or None where grippers float.
    """

    def __init__(self, stage: sapien.Scene, solver: Solver, *, has_free_grasps: bool, **settings: Any) -> None:
        """Wrap a solver.

        Args:
            stage: SAPIEN scene to draw in.
            solver: The deformable worlds.
            has_free_grasps: Whether grippers open and close when told to.
            settings: Settings of `ManiSkillScene` (sim_config, device, backend).
        """
        self.solver = solver
        self.grip_commands = torch.ones_like(solver.closed)
        self.arms: ArmBodies | None = None
        self._has_free_grasps = has_free_grasps
        self._num_claimed_grippers = 0
        super().__init__([stage], **settings)
        self._reset_mask = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)

    @property
    def num_envs(self) -> int:
        """Number of worlds."""
        return self.solver.num_worlds

    def claim_grippers(self, num: int) -> slice:
        """Give the next `num` grippers of the solver to an agent.

        Raises:
            ValueError: If fewer are left.
        """
        first, self._num_claimed_grippers = self._num_claimed_grippers, self._num_claimed_grippers + num
        if self._num_claimed_grippers > self.solver.num_grippers:
            raise ValueError(
                f"the scene has {self.solver.num_grippers} grippers, its agents drive more: {self._num_claimed_grippers}"
            )
        return slice(first, self._num_claimed_grippers)

    def can_render(self) -> bool:
        """Tell whether SAPIEN draws. ManiSkill says so of every scene on macOS."""
        return self.backend.render_device is not None

    def step(self) -> None:
        """Open and close grippers as commanded, let arms shorten their motion, then advance all worlds by one control step."""
        if self._has_free_grasps:
            self.solver.set_closed(self.grip_commands)
        if self.arms is not None:
            self.arms.follow()
        self.solver.step()

    def create_actor_builder(self) -> ActorBuilder:
        """Create a builder of actors on the stage; they have a batch size of one."""
        return super().create_actor_builder().set_scene_idxs([0])
