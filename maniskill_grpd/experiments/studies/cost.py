"""What a training costs."""

from __future__ import annotations

from maniskill_grpd.experiments.claim import Claim, Side
from maniskill_grpd.experiments.studies.parts import ALL_POLICIES
from maniskill_grpd.experiments.study import Study, Task

_SIZES = {
    num: Task(env_id=env_id, options={"resolution": num, "graph_nodes": None}, conditions=(), label=f"{env_id}, {num:,} nodes")
    for env_id, nums in (("RopeShaping-v1", (25, 50, 100, 200)), ("ClothHanging-v1", (400, 1225)))
    for num in nums
}


def _takes(text: str, source: str, paper: str, ours: Side, theirs: Side, at_most: float) -> Claim:
    return Claim(
        text=text,
        source=source,
        paper=paper,
        measure="ratio",
        metric="iteration_seconds",
        ours=ours,
        theirs=theirs,
        at_most=at_most,
    )


COST = Study(
    name="cost",
    title="Cost of training",
    question="How long does an iteration take, rollout and update, and how does that grow with the number of nodes? Small "
    "rollouts and one epoch; all nodes are seen.",
    tasks=tuple(_SIZES.values()),
    arms=ALL_POLICIES,
    metrics=("iteration_seconds", "update_seconds"),
    plots=("lines",),
    factor="resolution",
    budget=1200,
    train_options={"num_envs": 8, "num_steps": 50, "num_minibatches": 8, "update_epochs": 1, "eval_freq": 0},
    claims=(
        _takes(
            "At most 1.2 times the time of EMPN",
            "III.G",
            "1.2x",
            Side("grpd", _SIZES[200].name),
            Side("empn", _SIZES[200].name),
            1.2,
        ),
        _takes(
            "Faster than the Transformer at 1,225 nodes",
            "III.G",
            "significantly",
            Side("grpd", _SIZES[1225].name),
            Side("transformer", _SIZES[1225].name),
            1.0,
        ),
        _takes(
            "Grows no faster than the nodes from 400 to 1,225",
            "III.G",
            "linear",
            Side("grpd", _SIZES[1225].name),
            Side("grpd", _SIZES[400].name),
            1225 / 400,
        ),
    ),
)
