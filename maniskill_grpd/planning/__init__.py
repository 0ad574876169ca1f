"""Planning by sampling: plans are tried in worlds that hold the state of an episode, and refined towards the best.

Nothing here knows a task: states come from `get_state_dict`, plans are judged by the rewards of the task alone.
"""

from maniskill_grpd.planning.options import PlannerOptions
from maniskill_grpd.planning.planner import Planner
from maniskill_grpd.planning.policy_prior import PolicyPrior
from maniskill_grpd.planning.sample_worlds import SampleWorlds

__all__ = ["Planner", "PlannerOptions", "PolicyPrior", "SampleWorlds"]
