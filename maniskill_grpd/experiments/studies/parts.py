"""What several studies are made of: tasks, arms, conditions and the claims that come more than once.

Task options are small enough for two CPU cores: policies see a part of the nodes, the simulation has them all. Trainings that two
studies share, such as GRPD under BPP, are run once.
"""

from __future__ import annotations

import dataclasses

from maniskill_grpd.experiments.claim import Claim, Side
from maniskill_grpd.experiments.study import Arm, Condition, Task, with_option

ROPE_SHAPING = Task(env_id="RopeShaping-v1", options={"resolution": 41, "graph_nodes": 21})
ROPE_WRAPPING = Task(env_id="RopeWrapping-v1", options={"resolution": 41, "graph_nodes": 21})
CLOTH_FOLDING = Task(
    env_id="ClothFolding-v1", options={"resolution": 64, "graph_nodes": 25, "shapes": ["square", "triangle", "rectangle"]}
)
CLOTH_HANGING = Task(env_id="ClothHanging-v1", options={"resolution": 64, "graph_nodes": 25})
ALL_TASKS = (ROPE_SHAPING, ROPE_WRAPPING, CLOTH_FOLDING, CLOTH_HANGING)


def _baseline(name: str, difference: str) -> Arm:
    return Arm(name=name, policy=name, partner="grpd", difference=difference)


def _ablation(name: str, difference: str, **options: object) -> Arm:
    return Arm(name=name, policy_options=options, partner="grpd", difference=difference)


GRPD = Arm(name="grpd")
EMPN = _baseline("empn", "an equivariant network on a homogeneous graph, deeper and of shorter reach")
HETERO_GNN = _baseline("hetero_gnn", "an MLP of raw coordinates for each edge")
TRANSFORMER = _baseline("transformer", "attention between all nodes, raw coordinates")
HEPI = _baseline("hepi", "features on a grid of 16 directions, written from its paper")
BASELINES = (EMPN, HETERO_GNN, TRANSFORMER)
"""Those that the paper compares GRPD with: its claims speak of them."""
ALL_POLICIES = (GRPD, *BASELINES)

GRPD_RAW = _ablation("grpd_raw", "the first layer of each node sees raw coordinates", coordinates="raw")
GRPD_SHARED = _ablation("grpd_shared", "one set of weights for all types of nodes and edges", weights="shared")
GRPD_BLIND = _ablation("grpd_blind", "no messages from objects to actuators (eq. 40)", object_messages=False)


def augmented(arm: Arm) -> Arm:
    """The arm trained on batches that are turned about the vertical."""
    return dataclasses.replace(
        arm,
        name=f"{arm.name}_turned",
        train_options={**arm.train_options, "rotation_augmentation": "vertical"},
        partner=arm.name,
        difference="batches are turned about the vertical",
    )


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
    ours: Arm = GRPD,
) -> Claim:
    """One arm, by default GRPD, scores more than another."""
    name = None if task is None else task.name
    return Claim(
        text=text,
        source=source,
        paper=paper,
        measure=measure,
        metric=metric,
        at_least=0.0,
        ours=Side(ours.name, name, conditions),
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
