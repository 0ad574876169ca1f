"""What grippers hold: they close at nodes or where they are, open again, and lose what pulls harder than they can hold."""

from __future__ import annotations

import torch

from maniskill_grpd.physics.leashes import NO_LEASH, direct_leashes, leash_stretch
from maniskill_grpd.physics.world_state import WorldState


class Grasps(WorldState):
    """The state of all worlds, and what changes the grasps in it; see `Solver`."""

    def set_grippers(self, patch_radius: float, capture_radius: float, grip_strength: float | None) -> None:
        """Give all grippers their size [m], reach [m] and strength [N], see `Solver`."""
        self.patch_radius = patch_radius
        self.capture_radius = capture_radius
        self.grip_strength = grip_strength
        stretches = [leash_stretch(model, grip_strength) for model in self.models]
        self._leash_lengths = self._geodesics * torch.tensor(stretches, device=self.device)[:, None, None]

    def grasp(self, world_idx: torch.Tensor, gripper_nodes: torch.Tensor) -> None:
        """Let grippers of some worlds move to nodes and close there; what they held before is let go.

        A gripper holds the node, and all nodes within `patch_radius` of it through the material, at their places relative to it.

        Args:
            world_idx: Worlds, (b,) int64.
            gripper_nodes: Node of each gripper, (A,) or (b, A) int64; -1 opens it and leaves it where it is.

        Raises:
            ValueError: If the shape does not fit.
        """
        shapes = ((self.num_grippers,), (len(world_idx), self.num_grippers))
        if tuple(gripper_nodes.shape) not in shapes:
            raise ValueError(f"gripper_nodes must be {shapes[0]} or {shapes[1]}, got {tuple(gripper_nodes.shape)}")
        nodes = gripper_nodes.to(self.device, torch.int64).expand(len(world_idx), -1)
        variant = self.variants[world_idx].long()
        positions = self.positions[world_idx]
        closes = nodes >= 0
        pivots = torch.gather(positions, 1, nodes.clamp(min=0)[..., None].expand(-1, -1, 3))
        for points in (self.gripper_positions, self.gripper_targets):
            points[world_idx] = torch.where(closes[..., None], pivots, points[world_idx])
        distance = self._geodesics[variant[:, None], nodes.clamp(min=0)]
        patches = (distance <= self.patch_radius) & closes[..., None]
        self._hold(world_idx, patches, pivots, torch.full_like(self.holder[world_idx], -1))
        self.gripper_nodes[world_idx] = nodes.to(torch.int32)
        self.closed[world_idx] = closes
        self.leashes[world_idx] = direct_leashes(self._leash_lengths, variant, nodes)

    def set_closed(self, closed: torch.Tensor) -> None:
        """Open and close grippers where they are, between two steps and without synchronising with the host.

        A gripper that closes catches the nearest free node within `capture_radius`, and all others within `patch_radius`, and
        holds them at their places relative to it. A gripper that opens lets go of what it held. The others are left as they are.

        Args:
            closed: Which grippers are closed from now on, (B, A) bool.
        """
        if tuple(closed.shape) != tuple(self.closed.shape):
            raise ValueError(f"closed must be {tuple(self.closed.shape)}, got {tuple(closed.shape)}")
        closed = closed.to(self.device, torch.bool)
        opens, closes = self.closed & ~closed, closed & ~self.closed
        releases = (self.holder >= 0) & torch.gather(opens, 1, self.holder.clamp(min=0).long())
        holder = torch.where(releases, -1, self.holder)
        gaps = (self.positions[:, None] - self.gripper_positions[:, :, None]).norm(dim=-1)
        gaps = gaps.masked_fill(((holder >= 0) | ~self.node_mask)[:, None], torch.inf)
        nearest_gap, nearest = gaps.min(dim=-1)
        catches = closes & (nearest_gap <= self.capture_radius)
        reach = torch.where(catches, nearest_gap.clamp(min=self.patch_radius), -1.0)
        everywhere = torch.arange(self.num_worlds, device=self.device)
        self._hold(everywhere, gaps <= reach[..., None], self.gripper_positions, holder)
        kept = torch.where(opens, -1, self.gripper_nodes)
        self.gripper_nodes.copy_(torch.where(catches, nearest.to(torch.int32), kept))
        self.closed.copy_(closed)
        self._renew_leashes((opens | closes).any(dim=1))

    def _let_slip(self, strength: float) -> None:
        """Let go of what pulled at grippers with more than their strength [N] in the last step."""
        slips = (self.gripper_forces.norm(dim=-1) > strength) & (self.gripper_nodes >= 0)
        free = (self.holder >= 0) & torch.gather(slips, 1, self.holder.clamp(min=0).long())
        self.holder.copy_(torch.where(free, -1, self.holder))
        self.gripper_nodes.copy_(torch.where(slips, -1, self.gripper_nodes))
        self.slips += slips
        self._renew_leashes(slips.any(dim=1))

    def _hold(self, world_idx: torch.Tensor, patches: torch.Tensor, grippers: torch.Tensor, holder: torch.Tensor) -> None:
        """Let grippers at (b, A, 3) hold the nodes of their patches (b, A, N) that are free in `holder` (b, N)."""
        positions = self.positions[world_idx]
        offsets = torch.where((holder >= 0)[..., None], self.hold_offsets[world_idx], 0.0)
        for gripper in range(self.num_grippers):
            takes = patches[:, gripper] & (holder < 0) & self.node_mask[world_idx]
            offsets = torch.where(takes[..., None], positions - grippers[:, gripper, None], offsets)
            holder = torch.where(takes, gripper, holder)
        self.holder[world_idx] = holder.to(torch.int32)
        self.hold_offsets[world_idx] = offsets

    def _renew_leashes(self, worlds: torch.Tensor) -> None:
        """Recompute the leashes of worlds (B,) whose grasps changed.

        A gripper does not sit on its node exactly: what it is off shortens its leashes, but never below the present distance.
        """
        nodes = self.gripper_nodes.long()
        leashes = direct_leashes(self._leash_lengths, self.variants.long(), nodes)
        pivots = torch.gather(self.positions, 1, nodes.clamp(min=0)[..., None].expand(-1, -1, 3))
        off = (pivots - self.gripper_positions).norm(dim=-1)
        apart = (self.gripper_positions[:, :, None] - self.gripper_positions[:, None]).norm(dim=-1)
        shortened = torch.maximum(leashes - off[:, :, None] - off[:, None], apart)
        leashes = torch.where(leashes < NO_LEASH, shortened, leashes)
        self.leashes.copy_(torch.where(worlds[:, None, None], leashes, self.leashes))
