"""Expert of ClothHanging-v1."""

from __future__ import annotations

import torch
from mani_skill.utils.geometry.rotation_conversions import axis_angle_to_matrix, matrix_to_quaternion, quaternion_to_axis_angle

from maniskill_grpd.agents.floating_grippers import STEP_SIZE
from maniskill_grpd.experts.expert import Expert
from maniskill_grpd.experts.rigid_fit import fit_rotation, shortest_turn
from maniskill_grpd.tasks import ClothHangingEnv
from maniskill_grpd.tasks.geometry.loop_geometry import loop_centre
from maniskill_grpd.tasks.observation.node_statistics import mean_over_nodes

LARGEST_TURN = 0.1
"""Largest turn in one step [rad]: as far as a corner of the default cloth can go in one."""
PEG_CLEARANCE, BAR_CLEARANCE = 0.45, 0.6
"""Distance from the axis at which the cloth passes the hanger on its way to the front [m]."""
NARROW, WIDE = 0.2, 0.05
"""How much nearer to the axis a cloth only moves away from it, and how much nearer it already moves freely [m]."""
FRONT = 0.08
"""How far before the hanger the cloth waits until it is centred and turned [m]."""
BLEND = 0.1
"""Height over which keeping away from the axis changes into coming to it [m]."""
TURNING_BACK = (-0.08, -0.06)
"""Heights before the hanger between which a cloth that is not on it goes back [m]; not at once, as the seat lags behind."""
INSIDE = (0.03, 0.06)
"""Distances from the axis below which a cloth that comes down is centred, and above which it goes away from the hanger [m]."""
READY_ASIDE = (0.015, 0.035)
"""Distances from the axis below which the cloth comes onto the hanger, and above which it waits [m]."""
READY_ANGLE = (0.15, 0.3)
"""The same for the angle left to turn [rad]."""
PEG_DEPTH = 0.16
"""How far below the tip of a peg the plane of the grippers is brought [m]."""
BAR_DEPTH = 0.14
"""How far below a bar the plane of the grippers is brought [m]."""
BAR_PLAY = 0.05
"""How far from the middle of a bar, along it, the middle of the cloth may come down [m]."""
BAR_ASIDE = 0.1
"""Distance from there within which a cloth that lies on the bar is brought down [m]; farther away it is lifted again."""
BAR_WIDTH = 0.5
"""Share of the width of the cloth to which the grippers approach each other below a bar."""
RELEASE_DEPTH = 0.12
"""How far down a peg the hole must be before the grippers open [m]."""
RELEASE_SPEED = 0.15
"""Mean speed of the cloth below which the grippers open [m/s]."""


class ClothHangingExpert(Expert):
    r"""Carries the frame of the grippers like a rigid body to the front of the hanger and over it.

    The rotation of the frame is fitted to the grippers. Let m be the place of the middle of the seat in that frame (not of the
    real seat, which bounces), p the tip of the peg and a its axis, h = (m - p) . a the height of m before the tip and r its
    distance from the axis. The frame is turned by the smallest rotation that makes its normal parallel to a or -a, while m goes

        behind the tip (h < 8 cm)      away from the axis to r = 45 cm, then along the peg to h = 8 cm,
        before it                      to r = 0 at h = 8 cm,
        centred (r < 1.5 cm) and turned (within 9 degrees), or threaded      down to h = -16 cm.

    Transitions are blended; there are no phases and no memory. All grippers are slowed down by the same factor, so that the
    frame stays rigid and none moves more than 3 cm.

    Over a bar the same is done with a the upward direction and p the middle of the bar, give or take 5 cm along it; the frame is
    turned by the smallest rotation after which x or y of the flat cloth is parallel to the bar, and once the cloth lies on it
    the grippers go down on both sides, to half the width of the cloth. With `release` they open when the cloth hangs and has
    come to rest.

    Limitations: a hole on the edge of the triangle of three grippers sags out of the frame (square, rectangle and circle).

    Symmetry: equivariant under rigid motions of the scene with its gravity.
    """

    task = ClothHangingEnv
    env: ClothHangingEnv

    def act(self) -> torch.Tensor:
        """See `Expert.act`; with free grasps (B, A * 4), the last number of each gripper opens or closes it."""
        grippers, layout = self.env.solver.gripper_positions, self._layout()
        rotation = fit_rotation(layout - layout.mean(dim=1, keepdim=True), grippers)
        middle = (grippers - layout @ rotation.mT).mean(dim=1)
        move = self._move_onto_peg if self.env.hole_radius is not None else self._move_over_bar
        turn, shift, stretch = move(rotation, middle)
        spokes = layout @ (_limited_rotation(turn) @ rotation).mT
        targets = (middle + shift)[:, None] + spokes @ stretch.mT
        motion = (targets - grippers) / STEP_SIZE
        longest = torch.linalg.vector_norm(motion, dim=-1).amax(dim=1)[:, None, None]
        motion = motion / longest.clamp(min=1.0)
        return motion.flatten(1) if self.env.grasp == "fixed" else self._with_grip(motion)

    def _layout(self) -> torch.Tensor:
        """Return where the grippers are relative to the middle of the seat in the flat cloth, (B, A, 3) [m]."""
        env = self.env
        variant = env.variants
        flat = env.rest_positions[variant]
        corners = env.at_start_nodes(flat)
        seat = flat.gather(1, env.seat_nodes[variant][..., None].expand(-1, -1, 3))
        return corners - loop_centre(seat)[:, None]

    def _move_onto_peg(self, rotation: torch.Tensor, middle: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the turn (B, 3) [rad], the shift of the middle (B, 3) [m] and the stretch (B, 3, 3) of the frame for a peg."""
        axis = self.env.hanger_axis
        normal = rotation[..., 2]
        turn = shortest_turn(normal * _sign((normal * axis).sum(-1)), axis)
        is_threaded = self.env.measurement.hanging.measures["is_threaded"]
        shift, _ = _shift_to_hanger(middle - self.env.hanger_point, axis, _length(turn), is_threaded, PEG_DEPTH, PEG_CLEARANCE)
        return turn, shift, torch.eye(3, device=middle.device).expand_as(rotation)

    def _move_over_bar(self, rotation: torch.Tensor, middle: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """The same for a bar."""
        solver, bar = self.env.solver, self.env.hanger_axis
        up = torch.nn.functional.normalize(-solver.gravity, dim=-1)
        up = torch.nn.functional.normalize(up - (up * bar).sum(-1, keepdim=True) * bar, dim=-1)
        side = torch.linalg.cross(bar, up)
        turn = _turn_to_bar(rotation, bar, up)
        offset = middle - self.env.hanger_point
        offset = offset - (offset * bar).sum(-1, keepdim=True).clamp(-BAR_PLAY, BAR_PLAY) * bar
        aside = _length(offset - (offset * up).sum(-1, keepdim=True) * up)
        lies = self.env.measurement.hanging.measures["lies_on_bar"] & (aside < BAR_ASIDE)
        shift, ready = _shift_to_hanger(offset, up, _length(turn), lies, BAR_DEPTH, BAR_CLEARANCE)
        narrow = (1.0 - BAR_WIDTH) * ready[:, None, None] * side[:, :, None] * side[:, None]
        return turn, shift, torch.eye(3, device=middle.device) - narrow

    def _with_grip(self, motion: torch.Tensor) -> torch.Tensor:
        """Add to motions (B, A, 3) whether grippers are closed, as (B, A * 4)."""
        solver, hanging = self.env.solver, self.env.measurement.hanging
        opens = ~solver.closed.any(dim=1)
        if self.env.release:
            speed = mean_over_nodes(_length(solver.velocities), solver.node_mask)
            rests = hanging.is_hung & (speed < RELEASE_SPEED)
            opens |= rests & (hanging.depth >= RELEASE_DEPTH) if self.env.hole_radius is not None else rests
        grip = torch.where(opens, -1.0, 1.0)[:, None, None].expand_as(motion[..., :1])
        return torch.cat([motion, grip], dim=-1).flatten(1)


def _shift_to_hanger(
    offset: torch.Tensor, axis: torch.Tensor, angle: torch.Tensor, is_on: torch.Tensor, depth: float, clearance: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return how the middle of the frame should move, (B, 3) [m], and how ready it is to come onto the hanger, in [0, 1] (B,).

    Args:
        offset: From the hanger's point to the middle, (B, 3) [m].
        axis: Direction in which the way onto the hanger comes out of it, (B, 3).
        angle: Angle left to turn, (B,) [rad].
        is_on: Whether the cloth is on the hanger, (B,) bool.
        depth: How far it is to be brought down [m].
        clearance: Distance from the axis at which to pass the hanger [m].
    """
    height = (offset * axis).sum(-1)
    outward = offset - height[:, None] * axis
    aside = _length(outward)
    outward = outward / aside.clamp(min=1e-6)[:, None]
    is_before = 1.0 - _falling(height, *TURNING_BACK)
    ready = torch.where(is_on, 1.0, is_before * _falling(aside, *READY_ASIDE) * _falling(angle, *READY_ANGLE))
    inside = torch.where(is_on, 1.0, is_before * _falling(aside, *INSIDE))
    behind = (1.0 - inside) * ((FRONT - height) / BLEND).clamp(0.0, 1.0)
    free = 1.0 - behind * _falling(aside, clearance - NARROW, clearance - WIDE)
    target = (1.0 - ready) * FRONT - ready * depth
    shift = (behind * clearance - aside)[:, None] * outward + (free * (target - height))[:, None] * axis
    return shift * (STEP_SIZE / _length(shift).clamp(min=STEP_SIZE))[:, None], ready


def _turn_to_bar(rotation: torch.Tensor, bar: torch.Tensor, up: torch.Tensor) -> torch.Tensor:
    """Return the smallest turn, (B, 3) [rad], that makes a frame level with x or y along a bar."""
    side = torch.linalg.cross(bar, up)
    turns = []
    for x, z in ((sign * direction, face * up) for direction in (bar, side) for sign in (1, -1) for face in (1, -1)):
        target = torch.stack([x, torch.linalg.cross(z, x), z], dim=-1)
        turns.append(quaternion_to_axis_angle(matrix_to_quaternion(target @ rotation.mT)))
    turns = torch.stack(turns, dim=1)
    smallest = _length(turns).argmin(dim=1)
    return turns[torch.arange(len(turns), device=turns.device), smallest]


def _limited_rotation(turn: torch.Tensor) -> torch.Tensor:
    return axis_angle_to_matrix(turn * (LARGEST_TURN / _length(turn).clamp(min=LARGEST_TURN))[:, None])


def _falling(value: torch.Tensor, low: float, high: float) -> torch.Tensor:
    """Return 1 below `low`, 0 above `high` and linear in between."""
    return ((high - value) / (high - low)).clamp(0.0, 1.0)


def _length(vectors: torch.Tensor) -> torch.Tensor:
    return torch.linalg.vector_norm(vectors, dim=-1)


def _sign(values: torch.Tensor) -> torch.Tensor:
    return torch.where(values >= 0.0, 1.0, -1.0)[:, None]
