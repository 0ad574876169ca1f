"""How many grippers a task has, and which agents drive them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

from maniskill_grpd.agents import ARMS
from maniskill_grpd.agents.arms import ARM_MODES

Team = str | tuple[str, ...]
"""One agent that drives all grippers, or one agent each for some of them."""
FLOATING_MODES = ("pd_ee_delta_pos",)
"""Control modes of floating grippers, for fixed grasps."""


def gripper_teams(counts: Sequence[int]) -> tuple[Team, ...]:
    """Return all ways to drive a number of floating grippers, as ManiSkill's `robot_uids`.

    Args:
        counts: Allowed numbers of grippers.

    Returns:
        First "floating_grippers_<count>" for every count, then tuples of several agents.
    """
    alone = tuple(_uid(count) for count in counts)
    return alone + tuple(tuple(_uid(n) for n in parts) for count in counts for parts in _splits(count) if len(parts) > 1)


def choose_team(num_grippers: int | None, robot_uids: Team | None, counts: Sequence[int], default: int) -> tuple[int, Team]:
    """Bring the two ways to say how many grippers there are together.

    Args:
        num_grippers: Number of grippers, or None.
        robot_uids: Agents, or None: a single one for all grippers. Arms have one gripper each.
        counts: Allowed numbers of grippers.
        default: Number of grippers when neither is given.

    Returns:
        Number of grippers A, and the agents that drive them.

    Raises:
        ValueError: If the number or the agents are not allowed, or contradict each other.
    """
    if num_grippers is not None and num_grippers not in counts:
        raise ValueError(f"num_grippers must be one of {list(counts)}, got {num_grippers}")
    if robot_uids is None:
        num = default if num_grippers is None else num_grippers
        return num, _uid(num)
    team = tuple(robot_uids) if isinstance(robot_uids, (list, tuple)) else robot_uids
    team = team[0] if len(team) == 1 else team
    if is_arm_team(team):
        return _count_arms(team, num_grippers, counts), team
    allowed = gripper_teams(counts)
    if team not in allowed:
        raise ValueError(f"robot_uids must be one of {list(allowed)}, or a tuple of {list(ARMS)}, got {robot_uids!r}")
    num = sum(int(uid.rpartition("_")[2]) for uid in ((team,) if isinstance(team, str) else team))
    if num_grippers not in (None, num):
        raise ValueError(f"num_grippers={num_grippers} contradicts robot_uids={robot_uids!r}")
    return num, team


def supported_robots(counts: Sequence[int]) -> tuple[Team, ...]:
    """Return `gripper_teams`, and all teams of as many arms of those that there are."""
    arms = tuple(team for count in counts for team in product(ARMS, repeat=count))
    return gripper_teams(counts) + tuple(team[0] if len(team) == 1 else team for team in arms)


def control_modes(team: Team) -> tuple[str, ...]:
    """Return the names of a team's control modes for fixed grasps, the default first."""
    return tuple(ARM_MODES) if is_arm_team(team) else FLOATING_MODES


def members(team: Team) -> tuple[str, ...]:
    """Return the agents of a team."""
    return (team,) if isinstance(team, str) else tuple(team)


def is_arm_team(team: Team) -> bool:
    """Whether all agents of a team are arms, which have one gripper each."""
    return all(uid in ARMS for uid in members(team))


def _count_arms(team: Team, num_grippers: int | None, counts: Sequence[int]) -> int:
    num = len(members(team))
    if num not in counts:
        raise ValueError(f"this task has grips for {list(counts)} arms, got {num}: robot_uids={team!r}")
    if num_grippers not in (None, num):
        raise ValueError(f"num_grippers={num_grippers} contradicts robot_uids={team!r}")
    return num


def _uid(num_grippers: int) -> str:
    return f"floating_grippers_{num_grippers}"


def _splits(total: int) -> Iterator[tuple[int, ...]]:
    """Yield all ordered ways to write a number as a sum."""
    if total == 0:
        yield ()
    for first in range(1, total + 1):
        for rest in _splits(total - first):
            yield (first, *rest)
