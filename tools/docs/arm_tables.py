"""Tables of docs/robots.md, from what `benchmarks/arms.py` measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tools.docs.physics_validation import insert

Row = Mapping[str, Any]


def robots_page(page: str, rows: Sequence[Row]) -> str:
    """Return docs/robots.md with its tables made anew; the rest of it is written by hand."""
    return insert("speed of arms", to_speed_table(rows), insert("success with arms", to_success_table(rows), page))


def to_success_table(rows: Sequence[Row]) -> str:
    """Return what experts and shipped policies reach with floating grippers and with arms, and what arms lose."""
    played = [row for row in rows if "success_at_end" in row]
    floating = {_case(row): row for row in played if row["grippers"] == "floating"}
    lines = [
        "Success at the end in unseen episodes:",
        "",
        "| task | grippers | actor | episodes | floating | arms | steps lost | steps refused | episodes drawn anew, mean |",
        "|---|--:|---|--:|--:|--:|--:|--:|--:|",
    ]
    for row in played:
        if row["grippers"] != "floating":
            options = "".join(f", `{option}`" for option in row["options"])
            beside = floating[_case(row)]["success_at_end"]
            lines.append(
                f"| {row['env']}{options} | {row['num']} | {row['actor']} | {row['num_episodes']} | {beside:.1%} | "
                f"{row['success_at_end']:.1%} | {row['share_lost']:.1%} | {row['share_refused']:.1%} | {row['num_redrawn']:.2f} |"
            )
    return "\n".join(lines) + "\n"


def to_speed_table(rows: Sequence[Row]) -> str:
    """Return env-steps per second with floating grippers and with arms, and those of ManiSkill's tasks."""
    timed = [row for row in rows if "env_steps_per_s" in row]
    floating = {(row["env"], row["num_worlds"]): row for row in timed if row.get("grippers") == "floating"}
    machine = timed[0]["machine"]
    lines = [
        f"Env-steps/s of processor time, two grippers, graph observations, one core ({machine['cpu']}, load {machine['load']}):",
        "",
        "| environment | worlds | floating | arms | arms / floating |",
        "|---|--:|--:|--:|--:|",
    ]
    for row in timed:
        rate, num = f"{row['env_steps_per_s']:,.0f}", row["num_worlds"]
        if row.get("grippers") == "panda":
            beside = floating[row["env"], num]["env_steps_per_s"]
            lines.append(f"| {row['env']} | {num:,} | {beside:,.0f} | {rate} | {row['ratio']:.2f} |")
        elif "grippers" not in row:
            lines.append(f"| {row['env']} | {num} |  | {rate} |  |")
    return "\n".join(lines) + "\n"


def _case(row: Row) -> tuple[Any, ...]:
    return row["env"], row["num"], row["actor"], tuple(row["options"])
