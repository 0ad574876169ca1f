"""Expert of RopeShaping-v1."""

from __future__ import annotations

import torch

from maniskill_grpd.agents.floating_grippers import STEP_SIZE
from maniskill_grpd.experts.expert import Expert
from maniskill_grpd.tasks import RopeShapingEnv

DRAG_DISTANCE = 0.2
"""How far before its goal the rope is lowered and dragged from [m]."""
LIFT_HEIGHT = 0.1
"""Height above the goal from which it is lowered [m]."""
ENTRY_RADIUS = 0.02
"""Grippers this near the start of the drag are taken to have arrived [m]."""
FUNNEL_SLOPE = 0.15
"""How much wider the path becomes per metre of drag: a gripper that is pushed aside goes on."""
SMALLEST_BULGE = 0.01
"""Spans that bulge less than this on average [m] have no side to which they must trail."""


class RopeShapingExpert(Expert):
    r"""Lays the rope by dragging it into its goal from the side to which its free parts bulge.

    A dragged rope trails behind the grippers. The spans between them must end up on given sides of
    their chords, so that the drag comes from there. With q_v the goal of the node held by gripper
    v, m_i the mean goal of the nodes of span i and c_i the middle of its ends,

        up = sum_i L_i (m_i - c_i) / |sum_i L_i (m_i - c_i)|      (L_i: length of span i)
        w  = 0.2 m up + 0.1 m z

    Far from the goal every gripper moves straight to q_v + w. Once all grippers are on the path,
    the segment from q_v + w to q_v, each moves straight to q_v. "On the path" is a funnel around
    the segment, 2 cm wide at its start; being on it or not is a fact of the positions, so that the
    expert has no memory. The last step of each motion is as long as what is left.

    Goals whose spans bulge to opposite sides (S with any number of grippers) have no such
    direction; the drag then comes along the goal's chord from the first to the last node, which
    keeps the rope on its own line.

    Symmetry: equivariant under translations of the plane and rotations about its normal.
    """

    task = RopeShapingEnv

    def act(self) -> torch.Tensor:
        """See `Expert.act`."""
        solver = self.env.solver
        goals = self.env.goal_positions
        held = goals[:, self.env._gripper_nodes]
        start = self._drag_start(goals)[:, None]
        offsets = solver.gripper_positions - held
        is_laying = _is_on_path(offsets, start).all(dim=1)
        targets = torch.where(is_laying[:, None, None], held, held + start)
        motion = (targets - solver.gripper_positions) / STEP_SIZE
        length = torch.linalg.vector_norm(motion, dim=-1, keepdim=True)
        return (motion / length.clamp(min=1.0)).flatten(1)

    def _drag_start(self, goals: torch.Tensor) -> torch.Tensor:
        """Where the drag starts relative to the goal, w in the class docstring, (B, 3) [m]."""
        normal = self.env.solver.plane[:, :3]
        return DRAG_DISTANCE * _trailing_direction(goals, self.env._gripper_nodes.tolist()) + (
            LIFT_HEIGHT * normal
        )


def _trailing_direction(goals: torch.Tensor, held: list[int]) -> torch.Tensor:
    """Direction from the chords of the free spans to the spans themselves.

    Args:
        goals: Goals of the nodes in the order along the rope, (B, N, 3) [m].
        held: Nodes held by grippers.

    Returns:
        Unit vectors in the plane of the goals, (B, 3).
    """
    nodes = sorted(held)
    total = torch.zeros_like(goals[:, 0])
    for first, last in zip(nodes[:-1], nodes[1:], strict=True):
        span = goals[:, first : last + 1]
        total += (last - first) * (span.mean(dim=1) - 0.5 * (span[:, 0] + span[:, -1]))
    chord = goals[:, nodes[-1]] - goals[:, nodes[0]]
    bulge = torch.linalg.vector_norm(total, dim=-1, keepdim=True) / (nodes[-1] - nodes[0])
    direction = torch.where(bulge > SMALLEST_BULGE, total, chord)
    return torch.nn.functional.normalize(direction, dim=-1)


def _is_on_path(offsets: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
    """Whether grippers are inside the funnel around the segment from `start` to zero.

    Args:
        offsets: Positions relative to the goals, (B, A, 3) [m].
        start: Start of the segments, (B, 1, 3) [m].

    Returns:
        (B, A) bool.
    """
    length = torch.linalg.vector_norm(start, dim=-1)
    axis = start / length[..., None]
    along = (offsets * axis).sum(-1)
    aside = torch.linalg.vector_norm(offsets - along[..., None] * axis, dim=-1)
    radius = ENTRY_RADIUS + FUNNEL_SLOPE * (length - along).clamp(min=0.0)
    return (aside <= radius) & (along <= length + ENTRY_RADIUS)
