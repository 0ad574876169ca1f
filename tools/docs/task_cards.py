"""docs/tasks.md: the task cards, from the docstrings of the tasks, and what was measured in them."""

from __future__ import annotations

import inspect
import statistics
from typing import Any

from mani_skill.utils.registration import REGISTERED_ENVS

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.tasks import DeformableEnv

COMMAND = "python benchmarks/tasks.py --json docs/benchmarks/tasks.json"
GOAL_SHAPES_COMMAND = (
    "python examples/goal_shape_reachability.py --iterations 3 --shapes W S spiral --seeds 1000000 1000001 "
    "--json docs/benchmarks/goal_shapes.json"
)
POLICIES = ("random", "still", "push", "expert")
EXPERT_LIMITS = """\
The expert of RopeShaping-v1 was measured on the W, its default goal. Other shapes it lays less well: of 50 episodes each
it lays no S and no spiral, of W, U, L and O 98 to 100 % ([measured earlier](results/earlier/unseen_shapes.md)). An S can
be laid: a policy trained on the W does so in 89 % of 200 episodes ([measured earlier](results/earlier/rope_shaping.md)).
No policy has laid a spiral reliably. On an earlier solver open plans, of waypoints relative to the goals, laid all seven
shapes with two and with four grippers, in 55 of 56 episodes. Before ropes collided with themselves the planner below, with four
iterations, ended four of four other episodes of the S in success and three of four of the spiral, with four grippers."""


def tasks_page(rows: list[dict[str, Any]], searches: list[dict[str, Any]], replays: list[dict[str, str]]) -> str:
    """Return the page.

    Args:
        rows: What `benchmarks/tasks.py` measured.
        searches: What `examples/goal_shape_reachability.py` found.
        replays: What `python -m tools.docs.replays` recorded.
    """
    cards = [
        card(uid, [row for row in replays if row["env"] == uid])
        for uid, spec in sorted(REGISTERED_ENVS.items())
        if issubclass(spec.cls, DeformableEnv)
    ]
    return "\n\n".join(["# Tasks", tables(rows), goal_shapes(searches), *cards]) + "\n"


def card(uid: str, replays: list[dict[str, str]]) -> str:
    """Return the card of a task in the form of ManiSkill's documentation, with links to replays."""
    spec = REGISTERED_ENVS[uid]
    task = spec.cls
    facts = [
        f"- gripper counts: {', '.join(map(str, task.GRIPPER_COUNTS))} (default {task.DEFAULT_NUM_GRIPPERS})",
        _arms(task),
        f"- reward modes: {', '.join(task.SUPPORTED_REWARD_MODES)}",
        f"- max episode steps: {spec.max_episode_steps}",
    ]
    picture = f"![{uid}: the expert](images/{uid}.gif)"
    options = inspect.getdoc(task.__init__).partition("Args:")[2].partition("Raises:")[0]
    lines = [" ".join(line.split()) if not line.startswith("    ") else line.strip() for line in options.strip().splitlines()]
    shown = ", ".join(f"[{row['who']}](replays/{row['file']})" for row in replays)
    shown = [f"Replays from all sides, to be downloaded and opened in a browser: {shown}."] if replays else []
    return "\n\n".join(
        [f"## {uid}", picture, *shown, "\n".join(facts), inspect.cleandoc(task.__doc__), "**Options:**", _bullets(lines)]
    )


def _arms(task: type[DeformableEnv]) -> str:
    """Return where arms stand by default, and which episodes they get."""
    num = task.DEFAULT_NUM_GRIPPERS
    places = ", ".join("(" + ", ".join(f"{x:.2f}" for x in base[:3, 3] + 0.0) + ")" for base in task.default_arm_bases(num))
    return f"- arms, one for each gripper: {num} stand at {places} m; episodes that they do not reach are drawn anew"


def tables(rows: list[dict[str, Any]]) -> str:
    """Return the tables of success, return and speed."""
    played = [row for row in rows if "policy" in row]
    timed = [row for row in rows if "env_steps_per_s" in row]
    machine = rows[0]["machine"]
    lines = [
        f"Success at the end, and return, of {played[0]['num_episodes']} episodes on seeds that nothing was tuned on.",
        "Blind policies do not look: random actions, no motion, one random direction at full speed.",
        "",
        "| task | " + " | ".join(POLICIES) + " |",
        "|---|" + "--:|" * len(POLICIES),
    ]
    for name, row_of in _by_configuration(played).items():
        cells = [f"{row_of[p]['success_at_end']:.0%} ({row_of[p]['return']:.1f})" if p in row_of else "-" for p in POLICIES]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    lines += [
        "",
        EXPERT_LIMITS,
        "",
        f"Speed with {timed[0]['num_worlds']} worlds, graph observations and random actions on the CPU "
        f"({machine['cpu']}, {machine['cores']} cores, load {machine['load']}):",
        "",
        f"| task | env-steps/s (median) | min - max | relative to {timed[0]['peer']} |",
        "|---|--:|--:|--:|",
    ]
    for row in timed:
        spread = f"{row['min']:,.0f} - {row['max']:,.0f}"
        lines.append(f"| {row['env']} | {row['env_steps_per_s']:,.0f} | {spread} | {row['ratio']:.2f} |")
    return "\n".join(
        [*lines, "", f"Measured by `{COMMAND}`; `make docs` writes this page from it and from the docstrings of the tasks."]
    )


def goal_shapes(searches: list[dict[str, Any]]) -> str:
    """Return the table of the goal shapes of RopeShaping-v1: what the expert reaches, and what can be reached at all."""
    counts = sorted({row["num_grippers"] for row in searches}, reverse=True)
    lines = [
        "The expert of RopeShaping-v1 is made for W and shapes like it: its 100% above are those of W with four grippers. By",
        "goal shape: its success in 64 episodes; in how many episodes a planner that knows the reward alone",
        "([planner.md](planner.md)) ends in success, and in how many it succeeds at some time; median final mean distance.",
        "",
        "| goal shape | " + " | ".join(f"expert, {n} grippers | at the end | once | distance" for n in counts) + " |",
        "|---|" + "--:|" * 4 * len(counts),
    ]
    for shape in dict.fromkeys(row["shape"] for row in searches):
        cells = [_reached([row for row in searches if (row["shape"], row["num_grippers"]) == (shape, n)]) for n in counts]
        lines.append(f"| {shape} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", f"`{GOAL_SHAPES_COMMAND}`"])


def _reached(rows: list[dict[str, Any]]) -> str:
    ended, once = (sum(row[name] for row in rows) for name in ("success_at_end", "success_once"))
    distance = 100.0 * statistics.median(row["mean_distance"] for row in rows)
    return f"{rows[0]['expert']:.0%} | {ended} of {len(rows)} | {once} of {len(rows)} | {distance:.1f} cm"


def _by_configuration(rows: list[dict[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        options = ", ".join(f"{key}={value!r}" for key, value in row["options"].items())
        found.setdefault(f"{row['env']}" + (f", `{options}`" if options else ""), {})[row["policy"]] = row
    return found


def _bullets(lines: list[str]) -> str:
    """Return the entries of a Google-style section as a list; continued lines are joined."""
    entries: list[str] = []
    for line in lines:
        name = line.split(":")[0]
        if name.isidentifier() and ":" in line:
            entries.append(f"- `{name}`:{line.partition(':')[2]}")
        else:
            entries[-1] += f" {line}"
    return "\n".join(entries)
