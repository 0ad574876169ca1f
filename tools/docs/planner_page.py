"""docs/planner.md: how planning works, and what it reached and cost, from what `benchmarks/planner.py` wrote."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

from maniskill_grpd.planning import PlannerOptions
from tools.docs.benchmark_pages import markdown_table

COMMAND = "python benchmarks/planner.py --json docs/benchmarks/planner.json"
ABOUT = """\
The simulation is fast, batched, and can be put into any state: so it can be its own model. `maniskill-grpd plan` plays a task by
trying plans in worlds that hold the state of an episode, following the best one for a few steps, and planning again. It knows
nothing of a task but its rewards, and nothing of the simulation but `get_state_dict` and `set_state_dict`: an expert for tasks
that have none, a source of demonstrations, a way to refine a policy while it acts, an answer to whether something can be done.

    maniskill-grpd plan --env_id ClothHanging-v1                                           # from nothing
    maniskill-grpd plan --checkpoint checkpoints/cloth_hanging.pt --iterations 1 --std 0.2 # from what a policy would do
    maniskill-grpd plan --env_id own_task:Mine-v1 --num_episodes 100 --record demos/mine   # demonstrations of a task of one's own
    maniskill-grpd train --env_id own_task:Mine-v1 --demonstrations demos/mine/trajectory.h5"""
METHOD = """\
## How it plans

A search draws `samples` plans of `horizon` steps around a mean, plays all of them at the same time, and moves the mean towards
the good ones, `iterations` times, in the first search of an episode `first_iterations` times. The mean itself, the best plan so
far and standing still are always among those that are played, so a search never loses what it has. The best plan is followed for
`replan` steps; what is left of it is where the next search starts.

- `--method cem`: the cross-entropy method. Mean and deviation of the next plans are those of the best `elite_share`.
- `--method mppi`: model-predictive path integral control. The mean becomes the average of all plans, weighted by
  exp(return / `temperature`), with returns in their standard deviations; the deviation stays.
- A quarter of the plans are drawn ever finer, down to a tenth of the deviation, to find the goal itself. The distribution is
  fitted to the others alone: around standing still it would gather where every way to the goal first leads down, as in folding.
- The noise of plans is coloured: its power falls with frequency as f^-`noise_exponent`, so that grippers go somewhere and do not
  tremble about where they are (Pinneri et al. 2020, iCEM).
- A plan is worth the sum of its rewards, the last of which counts `final_weight` times more: what a plan ends in goes on. With
  `--use_value` the value function of a policy stands for what follows, with the discount of its training.
- With `--checkpoint` each search starts from the mean actions of the policy.
- `--num_envs` episodes are planned at the same time. The plans of an episode depend on its seed and its state alone, and equal
  seeds give equal plans bit for bit on one machine.

An environment is refused if its state does not come back bit for bit after a step, or does not lead to the same next state twice;
so are policies whose graphs have other channels than those of the task, several agents, and control modes that are not
displacements."""
CODE = """\
## From Python

    from maniskill_grpd.learning import TrainConfig
    from maniskill_grpd.planning import PlannerOptions
    from maniskill_grpd.planning.episodes import make_planner

    task = TrainConfig(env_id="RopeShaping-v1")
    planner = make_planner(task, num_episodes=4, options=PlannerOptions())
    planner.begin(seeds=[0, 1, 2, 3])
    action = planner.act(env.unwrapped.get_state_dict())   # (4, 12), for the next step of the four worlds of env

`Planner(SampleWorlds(env, samples), options)` takes any batched environment of ManiSkill with that interface."""
RESULTS = """\
## What it reaches, and what it costs

Episodes are the first ones of `evaluate`. The policies are those of `checkpoints/`, made on an earlier solver and reward. Steps
are those of all environments, plans included; seconds those of the processor, by episode, with the start of the program. At
commit a6f2ee6 ropes, and the cloth of ClothHanging-v1, did not collide with themselves by default yet. The rows of
RopeShaping-v1 and ClothHanging-v1 were copied from what the command printed; its file was lost. Few episodes are planned
here: the rates are coarse. ClothFolding-v1 is not solved from nothing: on the way up a fold brings less than lying still."""
REACHABLE = """\
Which goal shapes of RopeShaping-v1 can be laid, S and spiral among them: [tasks.md](tasks.md)."""
NAMES = {
    "expert": "scripted expert",
    "policy": "policy",
    "cem": "plans, CEM",
    "mppi": "plans, MPPI",
    "prior": "plans from the policy, CEM",
}


def planner_page(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the page of what `benchmarks/planner.py` measured."""
    head = ["task", "agent", "episodes", "success at the end", "return", "env-steps", "CPU seconds", "commit"]
    results = markdown_table(head, [_cells(row) for row in rows], text_columns=(0, 1))
    machine = rows[0]["machine"]
    where = f"{machine['cpu']}, {machine['date']}, on a core that other programs used too"
    origin = f"`{COMMAND}`, {where}. `make docs` writes this page from the JSON file."
    parts = ["# Planning", ABOUT, METHOD, CODE, RESULTS, results, _settings(rows), REACHABLE, origin]
    return "\n\n".join(parts) + "\n"


def _cells(row: Mapping[str, Any]) -> list[str]:
    return [
        row["env"],
        NAMES[row["agent"]],
        str(row["num_episodes"]),
        f"{row['success_at_end']:.0%}",
        f"{row['return']:.1f}",
        f"{row['steps']:,.0f}",
        f"{row['cpu_seconds']:.1f}",
        row["commit"],
    ]


def _settings(rows: Sequence[Mapping[str, Any]]) -> str:
    """Say what differs from the defaults of the planner."""
    default = PlannerOptions()
    lines = []
    for row in rows:
        changed = [f"--{name} {value}" for name, value in row["planner"].items() if value != getattr(default, name)]
        if row["agent"] in ("cem", "prior"):
            task = [f"{name}={value}" for name, value in row["env_kwargs"].items()]
            changed += [f"--env_kwargs {' '.join(task)}"] if task and row["agent"] == "cem" else []
            lines.append(f"- {row['env']}, {NAMES[row['agent']]}: {' '.join(changed) or 'as by default'}")
    names = list(inspect.signature(PlannerOptions).parameters)
    shown = ", ".join(f"{name} {getattr(default, name)}" for name in names if name != "method")
    return "\n".join([f"Defaults are {shown}. What differs, MPPI as CEM:", "", *lines])
