"""What several studies are made of: tasks, arms, conditions and the claims that come more than once.

Task options are small enough for two CPU cores: policies see a part of the nodes, the simulation has them all. Trainings that two
studies share, such as GRPD under BPP, are run once.
"""

from __future__ import annotations

from maniskill_grpd.experiments.claim import Claim, Side
from maniskill_grpd.experiments.study import Arm, Condition, Task, with_option
from maniskill_grpd.policies import POLICIES

ROPE_SHAPING = Task(env_id="RopeShaping-v1", options={"resolution": 41, "graph_nodes": 21})
ROPE_WRAPPING = Task(env_id="RopeWrapping-v1", options={"resolution": 41, "graph_nodes": 21})
CLOTH_FOLDING = Task(
    env_id="ClothFolding-v1", options={"resolution": 64, "graph_nodes": 25, "shapes": ["square", "triangle", "rectangle"]}
)
CLOTH_HANGING = Task(env_id="ClothHanging-v1", options={"resolution": 64, "graph_nodes": 25})
ALL_TASKS = (ROPE_SHAPING, ROPE_WRAPPING, CLOTH_FOLDING, CLOTH_HANGING)

ARMS = {name: Arm(name=name, policy=name) for name in POLICIES}
"""An arm for every policy there is, GRPD first."""
GRPD = ARMS["grpd"]
EMPN = ARMS["empn"]
HETERO_GNN = ARMS["hetero_gnn"]
TRANSFORMER = ARMS["transformer"]
BASELINES = (EMPN, HETERO_GNN, TRANSFORMER)
"""Those that the paper compares GRPD with: its claims speak of them."""
ALL_POLICIES = (GRPD, *BASELINES)


def at_resolution(num_nodes: int) -> Condition:
    """The policy sees every node of a finer object."""
    return with_option("resolution", num_nodes, graph_nodes=None)


ALL_NODES_SEEN = with_option("graph_nodes", None)
"""The object of the training, of which the policy sees every node: what changes by seeing more, not by simulating more."""


def is_better(
    text: str,
    source: str,
    than: Arm,
    task: Task | None = None,
    metric: str = "return",
    paper: str = "-",
    conditions: tuple[str, ...] = (),
    measure: str = "gain",
) -> Claim:
    """GRPD scores more than another arm."""
    name = None if task is None else task.name
    return Claim(
        text=text,
        source=source,
        paper=paper,
        measure=measure,
        metric=metric,
        at_least=0.0,
        ours=Side(GRPD.name, name, conditions),
        theirs=Side(than.name, name, conditions),
    )


def retains(
    text: str,
    source: str,
    task: Task,
    conditions: tuple[str, ...],
    arm: Arm = GRPD,
    paper: str = "-",
    at_least: float = 0.85,
    at_most: float = float("inf"),
) -> Claim:
    """An arm keeps a share of its return under other conditions; 85 % where the paper gives no figure."""
    return Claim(
        text=text,
        source=source,
        paper=paper,
        measure="ratio",
        metric="return",
        at_least=at_least,
        at_most=at_most,
        ours=Side(arm.name, task.name, conditions),
        theirs=Side(arm.name, task.name),
    )
