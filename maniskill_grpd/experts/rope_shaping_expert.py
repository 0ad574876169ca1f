"""Expert of RopeShaping-v1."""

from __future__ import annotations

import torch

from maniskill_grpd.agents.floating_grippers import STEP_SIZE
from maniskill_grpd.experts.expert import Expert
from maniskill_grpd.tasks import RopeShapingEnv

DRAG_DISTANCE = 0.25
"""How far before its goal the rope is lowered and dragged from [m]."""
LIFT_HEIGHT = 0.1
"""Height above the goal from which it is lowered [m]."""
LOOK_AHEAD = 0.06
"""How far along the path ahead of the grippers their targets are [m]."""
PATH_RADIUS = (0.03, 0.09)
"""Distances from the path below which all grippers follow it, and above which none does [m]."""
SMALLEST_BULGE = 0.01
"""Spans that bulge less than this on average [m] have no side to which they must trail."""


class RopeShapingExpert(Expert):
    r"""Lays the rope by dragging it into its goal from the side to which its free parts bulge.

    A dragged rope trails behind the grippers. The spans between them must end up on given sides of
    their chords, so that the drag comes from there. With q_v the goal of the node held by gripper
    v, m_i the mean goal of the nodes of span i and c_i the middle of its ends,

        up = sum_i L_i (m_i - c_i) / |sum_i L_i (m_i - c_i)|      (L_i: length of span i)
        w  = 0.25 m up + 0.1 m z

    The path of gripper v is the segment from q_v + w to q_v. With x_v its position relative to q_v,
    t the mean progress of all grippers along their paths and r the largest distance of any from its
    own, its target is

        q_v + w (h(r) + (1 - h(r)) max(t - 0.06 m, 0) / |w|)
        t_v = clamp(x_v . w / |w|, 0, |w|),   t = mean_v t_v,   r = max_v |x_v - t_v w / |w||

    where h rises smoothly from 0 at 3 cm to 1 at 9 cm: from afar grippers go to the start of their
    paths, on them they go to the goal, all at the same time. There are no phases: the action is a
    continuous function of the state, which a policy can imitate, and disturbed grippers come back.
    It is full speed towards the target, or what is left of the way.

    Goals whose spans bulge to opposite sides have no such direction; the drag then comes along the
    goal's chord from the first to the last node.

    Limitations: one drag in one direction lays goals whose spans are short and bulge to one side.
    Share of episodes that end in success, 64 seeds each: with 4 grippers W 100 %, V 94 %, U 100 %,
    L 98 %, O 100 %, S and spiral 0 % (mean distance 4 cm); with 3 grippers W 98 %, V 100 %,
    U 94 %, L 100 %, S, O and spiral 0 %; with 2 grippers L 30 %, V 8 %, others 5 % or less (W: mean
    distance 7 cm). All of them can be laid with 2 and with 4 grippers (docs/tasks.md).

    Symmetry: equivariant under translations of the plane and rotations about its normal.
    """

    task = RopeShapingEnv

    def act(self) -> torch.Tensor:
        """See `Expert.act`."""
        solver = self.env.solver
        goals = self.env.goal_positions
        offsets = solver.gripper_positions - self.env.at_start_nodes(goals)
        motion = (_target_offsets(offsets, self._drag_start(goals)) - offsets) / STEP_SIZE
        length = torch.linalg.vector_norm(motion, dim=-1, keepdim=True)
        return (motion / length.clamp(min=1.0)).flatten(1)

    def _drag_start(self, goals: torch.Tensor) -> torch.Tensor:
        """Where the drag starts relative to the goal, w in the class docstring, (B, 3) [m]."""
        normal = self.env.solver.plane[:, :3]
        held = self.env.start_nodes.sort(dim=1).values
        return DRAG_DISTANCE * _trailing_direction(goals, held) + LIFT_HEIGHT * normal


def _trailing_direction(goals: torch.Tensor, held: torch.Tensor) -> torch.Tensor:
    """Direction from the chords of the free spans to the spans themselves.

    Args:
        goals: Goals of the nodes in the order along the rope, (B, N, 3) [m].
        held: Nodes held by grippers, in ascending order, (B, A) int64.

    Returns:
        Unit vectors in the plane of the goals, (B, 3).
    """
    ends = goals.gather(1, held[..., None].expand(-1, -1, 3))
    # Sums over the spans, both ends included, from the sums up to each node.
    sums = goals.cumsum(dim=1).gather(1, held[..., None].expand(-1, -1, 3))
    steps = (held[:, 1:] - held[:, :-1])[..., None]
    means = (sums[:, 1:] - sums[:, :-1] + ends[:, :-1]) / (steps + 1)
    total = (steps * (means - 0.5 * (ends[:, 1:] + ends[:, :-1]))).sum(dim=1)
    bulge = torch.linalg.vector_norm(total, dim=-1, keepdim=True) / (held[:, -1:] - held[:, :1])
    direction = torch.where(bulge > SMALLEST_BULGE, total, ends[:, -1] - ends[:, 0])
    return torch.nn.functional.normalize(direction, dim=-1)


def _target_offsets(offsets: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
    """Where the grippers are to go, relative to their goals.

    Args:
        offsets: Positions relative to the goals, (B, A, 3) [m].
        start: Start of the path relative to the goals, w in the class docstring, (B, 3) [m].

    Returns:
        (B, 1, 3) [m], the same for all grippers.
    """
    length = torch.linalg.vector_norm(start, dim=-1, keepdim=True)
    axis = start / length
    along = torch.minimum((offsets @ axis[..., None])[..., 0].clamp(min=0.0), length)
    aside = torch.linalg.vector_norm(offsets - along[..., None] * axis[:, None], dim=-1)
    near, far = PATH_RADIUS
    share = ((aside.amax(dim=1, keepdim=True) - near) / (far - near)).clamp(0.0, 1.0)
    share = share.square() * (3.0 - 2.0 * share)
    ahead = (along.mean(dim=1, keepdim=True) - LOOK_AHEAD).clamp(min=0.0)
    return ((share * length + (1.0 - share) * ahead) * axis)[:, None]
