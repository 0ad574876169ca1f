"""Which numbers of an action belong to which gripper."""

from __future__ import annotations

from typing import Any

import torch

from maniskill_grpd.agents import GripperAgent

POINT_MODES = ("pd_ee_delta_pos", "pd_ee_delta_pos_grip", "pd_ee_delta_pose", "pd_ee_delta_pose_grip")
"""Control modes whose first three numbers move a gripper."""
GRIP_SUFFIX = "_grip"


class ActionLayout:
    """The numbers of actions (B, D) of all agents side by side, gripper by gripper.

    Args:
        env: An environment of deformable objects, plain or wrapped.
    """

    def __init__(self, env: Any) -> None:
        base = env.unwrapped
        agents: list[GripperAgent] = list(base.agent.agents) if hasattr(base.agent, "agents") else [base.agent]
        self._solver = base.solver
        self.mode = agents[0].control_mode
        self.has_grip = self.mode.endswith(GRIP_SUFFIX)
        self.moves_points = self.mode in POINT_MODES
        sizes = [agent.NUMBERS_PER_GRIPPER[self.mode] for agent in agents for _ in range(agent.num_grippers)]
        ends = torch.tensor(sizes).cumsum(0)
        self.starts = [int(end) - size for end, size in zip(ends, sizes, strict=True)]
        """First number of each gripper, A."""
        self.ends = ends.tolist()
        """One past its last."""
        self.width = int(ends[-1])
        """Numbers of an action, D."""

    def still(self) -> torch.Tensor:
        """Return the action (B, D) with which all grippers stay where and as they are.

        Joint positions are the exception: they are told where they are.
        """
        action = torch.zeros(self._solver.num_worlds, self.width, device=self._solver.device)
        if self.has_grip:
            action[:, [end - 1 for end in self.ends]] = torch.where(self._solver.closed, 1.0, -1.0)
        return action
