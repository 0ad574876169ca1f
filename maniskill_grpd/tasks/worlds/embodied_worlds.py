"""Worlds whose grippers have bodies: floating ones, or arms that must be able to reach what they do."""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np
import torch
from mani_skill.agents.multi_agent import MultiAgent
from mani_skill.agents.registration import REGISTERED_AGENTS
from mani_skill.envs.sapien_env import BaseEnv

from maniskill_grpd.agents import ARMS, ArmAgent, ArmBodies, GripperAgent
from maniskill_grpd.agents.arms.arm_bodies import REACHED
from maniskill_grpd.physics import Solver
from maniskill_grpd.tasks.options.gripper_teams import is_arm_team, members
from maniskill_grpd.tasks.worlds.batched_scene import BatchedScene

MOST_DRAWS = 200
"""How often an episode is drawn until arms reach where it starts and ends."""


class EmbodiedWorlds(BaseEnv):
    """The part of an environment that makes its agents, and starts episodes within the reach of arms."""

    agent: GripperAgent | MultiAgent
    scene: BatchedScene
    solver: Solver
    num_grippers: int
    start_nodes: torch.Tensor
    num_redrawn: torch.Tensor
    """How often the present episode of each world was drawn anew because arms could not reach it, (B,) int64."""
    _bases: np.ndarray | None

    def points_to_reach(self, worlds: torch.Tensor, nodes: torch.Tensor) -> torch.Tensor:
        """Return where the grippers of some worlds (b,) that hold nodes (b, A) will have to come, (b, A, P, 3) [m].

        None by default, P = 0; arms also reach the nodes at which they start.
        """
        return self.solver.positions.new_zeros(*nodes.shape, 0, 3)

    @property
    def _agents(self) -> list[GripperAgent]:
        """The agents, in the order of their grippers."""
        return list(self.agent.agents) if isinstance(self.agent, MultiAgent) else [self.agent]

    def _load_agent(self, options: dict) -> None:
        team = members(self.robot_uids)
        self.num_redrawn = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
        if is_arm_team(team):
            self.scene.arms = ArmBodies([ARMS[uid] for uid in team], self.solver, self._bases)
        agents = [self._make_agent(uid, index if len(team) > 1 else None) for index, uid in enumerate(team)]
        self.agent = agents[0] if len(agents) == 1 else MultiAgent(agents)
        for agent in agents:
            agent.robot.set_floor(self.solver.plane, self.solver.model.radius)

    def _make_agent(self, uid: str, index: int | None) -> GripperAgent:
        settings = (self.scene, self._control_freq, self._control_mode, index)
        return ArmAgent(ARMS[uid], *settings) if uid in ARMS else REGISTERED_AGENTS[uid].agent_cls(*settings)

    # ------------------------------------------------------------------ reach of arms

    def _share_nodes(self, worlds: torch.Tensor, positions: torch.Tensor, nodes: torch.Tensor) -> torch.Tensor:
        """Give each arm one of the nodes (b, A) at which grippers start, so that it is near where they start and have to come.

        The sum of the squared distances from the bases is least. Floating grippers take them as they come.
        """
        arms = self.scene.arms
        if arms is None:
            return nodes
        arms.bases[worlds] = arms.default_bases
        starts = positions.gather(1, nodes[..., None].expand(-1, -1, 3))
        points = torch.cat([starts[:, :, None], self.points_to_reach(worlds, nodes)], dim=2)
        squares = (arms.bases[worlds][:, :, None, None, :3] - points[:, None]).square().sum((-2, -1))
        orders = torch.tensor(_orders(self.num_grippers), device=nodes.device)
        costs = squares[:, torch.arange(self.num_grippers, device=nodes.device), orders].sum(-1)
        return nodes.gather(1, orders[costs.argmin(dim=1)])

    def _place_arms(self, worlds: torch.Tensor) -> torch.Tensor:
        """Bring arms of some worlds (b,) to their grippers; return whether each reaches all it has to, (b,) bool."""
        arms = self.scene.arms
        if arms is None:
            return torch.ones_like(worlds, dtype=torch.bool)
        qpos, gaps = arms.solve(worlds, self.solver.gripper_positions[worlds])
        arms.set_qpos(worlds, slice(None), qpos)
        reached = (gaps < REACHED).all(dim=1)
        for points in self.points_to_reach(worlds, self.start_nodes[worlds]).unbind(2):
            reached &= (arms.solve(worlds, points)[1] < REACHED).all(dim=1)
        return reached

    def _start_within_reach(self, worlds: torch.Tensor) -> None:
        """Draw episodes for some worlds (b,) until arms reach where they start and end.

        Raises:
            ValueError: If that does not come about.
        """
        self.num_redrawn[worlds] = 0
        for _ in range(MOST_DRAWS):
            self._start_anywhere(worlds)
            worlds = worlds[~self._place_arms(worlds)]
            if not len(worlds):
                return
            self.num_redrawn[worlds] += 1
        raise ValueError(
            f"robot_uids={self.robot_uids!r} do not reach where episodes start and end: not in {MOST_DRAWS} draws for world "
            f"{worlds[0].item()}; bases elsewhere (robot_poses), pose_range='quarter' or other arms may"
        )

    def _arm_info(self) -> dict[str, torch.Tensor]:
        """Return what `info` says of arms, as copies: nothing where there are none."""
        if self.scene.arms is None:
            return {}
        arms = self.scene.arms
        return {
            "tracking_error": arms.errors.amax(dim=1),
            "num_refused": arms.refused.sum(dim=1),
            "num_redrawn": self.num_redrawn.clone(),
        }


@cache
def _orders(count: int) -> list[tuple[int, ...]]:
    return list(permutations(range(count)))
