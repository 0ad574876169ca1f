"""Pages of the benchmarks, from the rows that `benchmarks/*.py --json` wrote."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]

WIDTH = 16
"""Worlds in the lanes of a vector register on CPU, `maniskill_grpd.physics.kernels.lanes.WIDTH`."""
SLOPE_FROM = 100
"""Smallest number of nodes that enters the slopes; below, fixed costs dominate."""
MODES = ("forward", "forward+backward")


def env_page(rows: Sequence[Row]) -> str:
    """Return the page of `benchmarks/env.py`."""
    table = markdown_table(
        ["environment", "worlds", "env-steps/s (median)", "min - max", "times the peer"],
        [
            [row["env"], row["num_worlds"], f"{row['env_steps_per_s']:,.0f}", _spread(row), _cell(row, "ratio", ".0f")]
            for row in rows
        ],
    )
    note = (
        "The peer always has one world, whatever the number of worlds beside it: PhysX on the CPU has one world per process.\n"
        "PickCube-v1 builds visuals and therefore needs a Vulkan driver that SAPIEN accepts, although nothing is drawn. Here it\n"
        "was Mesa 25's software driver. Without any driver the peer is one Panda without visuals."
    )
    return _page("Environment throughput", "python benchmarks/env.py --json docs/benchmarks/env.json", rows, table, note)


def viewer_page(rows: Sequence[Row]) -> str:
    """Return the page of `benchmarks/viewer.py`."""
    about = (
        "States of 16 cloths of 100 nodes on ClothHanging-v1 a second, the shipped policy acting, as fast as they go. Processor\n"
        "seconds are those of the process of the viewer, all its threads; what a browser needs to draw is not in them."
    )
    frames = markdown_table(
        ["what", "worlds", "frames/s", "frames per processor second"],
        [
            [row["what"], row["num_worlds"], f"{row['frames_per_s']:.1f}", f"{row['frames_per_processor_s']:.1f}"]
            for row in rows
            if "what" in row
        ],
    )
    memory = markdown_table(
        ["seconds", "visits", "MiB after a fifth of the time", "MiB at the end", "threads", "threads at the end"],
        [
            [
                f"{row['seconds']:.0f}",
                row["visits"],
                f"{row['MiB_at_first']:.0f}",
                f"{row['MiB_at_last']:.0f}",
                row["threads_at_first"],
                row["threads_at_last"],
            ]
            for row in rows
            if "visits" in row
        ],
    )
    command = "python benchmarks/viewer.py --soak 600 --json docs/benchmarks/viewer.json"
    told = "Four worlds in real time, beside two clients that leave and come back every ten seconds:"
    soaked = (told, memory) if any("visits" in row for row in rows) else ()
    return _page("Viewer", command, rows, about, frames, *soaked)


def cameras_page(rows: Sequence[Row]) -> str:
    """Return the page of `benchmarks/cameras.py`."""
    about = (
        "Images of depth per second of one core's processor time; wrinkled square cloths that fill a quarter of the image. Both\n"
        "draw the same meshes and take turns; the ray cast updates its hierarchy for each image, as cloth moves. `ratio` is the\n"
        "median of the ratios within a turn; the last columns say how well both agree."
    )
    images = markdown_table(
        ["renderer", "nodes", "pixels", "worlds", "images/s", "ratio", "within 0.1 mm", "pixels of one alone"],
        [
            [
                row["renderer"],
                f"{row['nodes']:,}",
                f"{row['size']}x{row['size']}",
                f"{row['num_worlds']:,}",
                f"{row['images_per_s']:,.0f}",
                _cell(row, "ratio", ".0f"),
                _cell(row, "share_within_0.1_mm", ".3%"),
                _cell(row, "share_of_mask_that_differs", ".4%"),
            ]
            for row in rows
            if "renderer" in row
        ],
    )
    steps = markdown_table(
        ["environment", "observation", "worlds", "env-steps/s"],
        [[row["env"], row["obs_mode"], row["num_worlds"], f"{row['env_steps_per_s']:,.0f}"] for row in rows if "env" in row],
        text_columns=(0, 1),
    )
    pictures = markdown_table(
        ["picture of", "ms"], [[row["picture_of"], f"{row['milliseconds']:.1f}"] for row in rows if "picture_of" in row]
    )
    command = "python benchmarks/cameras.py --json docs/benchmarks/cameras.json"
    told = ('Pictures of `render_mode="rgb_array"`, 512x512 pixels, without SAPIEN:', pictures)
    drawn = told if any("picture_of" in row for row in rows) else ()
    return _page("Cameras", command, rows, about, images, "Environment steps, images of 64x64 pixels:", steps, *drawn)


def train_page(rows: Sequence[Row]) -> str:
    """Return the page of `benchmarks/train.py`."""
    shares = ("share_simulation", "share_policy", "share_update")
    table = markdown_table(
        [
            "learner",
            "env-steps/s (median)",
            "min - max",
            "simulation",
            "policy in rollout",
            "update",
            "MFLOP per step",
            "of the core's peak",
            "times the peer",
        ],
        [
            [
                row["learner"],
                f"{row['env_steps_per_s']:,.0f}",
                _spread(row),
                *(_cell(row, share, ".0%") for share in shares),
                _cell(row, "mflop_per_step", ".1f"),
                _cell(row, "share_of_peak", ".0%"),
                _cell(row, "ratio", ".2f"),
            ]
            for row in rows
        ],
    )
    return _page("Training throughput", "python benchmarks/train.py --processes --json docs/benchmarks/train.json", rows, table)


def physics_page(rows: Sequence[Row]) -> str:
    """Return the page of `benchmarks/physics.py`."""
    about = """\
Every solver moves the same springs, masses, hinges and table through the same motion: two held nodes are dragged at 0.6 m/s
in directions that change every half second. The largest edge strain that ours reaches with its default substeps is the
target, but no less than 1 %; Newton's substeps and iterations are searched for the cheapest setting that stays below it.
What it then reaches is often clearly below the target (5.3 % against our 6.6 % on the 10x10 cloth, 9.3 % against 19.6 % on
the 15x15 cloth): its stretch is at most ours, not equal to it. All take turns, each on one thread, pinned by `taskset`; on
CPU the time of the processor counts, so that other processes do not. `ratio` is ours over the faster of Newton's two;
"springs only" leaves out bending and table, which ours computes. Needs the extra `newton`; without it only ours is
measured."""
    solved = [row for row in rows if "solver" in row]
    table = markdown_table(
        ["scene", "worlds", "solver", "substeps x iterations", "largest stretch", "env-steps/s (median)", "min - max"]
        + ["ns per projection", "ratio", "to springs only"],
        [
            [
                row["scene"],
                f"{row['num_worlds']:,}",
                row["solver"],
                f"{row['substeps']} x {row['iterations']}",
                f"{100 * row['largest_stretch']:.1f} %",
                f"{row['env_steps_per_s']:,.0f}",
                _spread(row),
                f"{row['ns_per_projection']:.1f}",
                _cell(row, "ratio", ".1f"),
                _cell(row, "ratio_to_springs_only", ".1f"),
            ]
            for row in sorted(solved, key=lambda row: (row["scene"], row["num_worlds"]))
        ],
        text_columns=(0, 2),
    )
    command = "taskset -c 0 python benchmarks/physics.py --json docs/benchmarks/physics.json"
    return _page("Physics throughput", command, rows, about, table, "## What bounds it", *_bounds(rows))


def _bounds(rows: Sequence[Row]) -> list[str]:
    """Say what limits ours, from counted bytes and operations."""
    peaks = next(row for row in rows if "peak_gflop_per_s" in row)
    table = markdown_table(
        ["scene", "working set of a group of worlds", "flop per byte", "GFLOP/s", "GB/s in caches"],
        [
            [
                row["scene"],
                f"{(row['work_state'] * WIDTH + row['work_constants']) / 1024:,.0f} KiB",
                f"{row['work_flops'] / row['work_bytes']:.2f}",
                f"{row['gflop_per_s']:.1f}",
                f"{row['gbyte_per_s']:.1f}",
            ]
            for row in rows
            if row.get("solver") == "ours" and row["num_worlds"] == 64
        ],
    )
    product, copy = f"{peaks['peak_gflop_per_s']:.0f} GFLOP/s", f"{peaks['peak_gbyte_per_s']:.1f} GB/s"
    text = f"""\
One core of the same machine: {product} (float32 matrix product), {copy} (copy of a large array). A thread advances {WIDTH}
worlds in the lanes of its vector registers. Bytes are counted as every projection moves them; a working set that fits the
second cache comes from main memory once per control step, so its bandwidth does not limit. Of the arithmetic, an edge of a
line takes five divisions and a square root of all lanes, two of the divisions in the recursion of the elimination: they
bound what fits the cache, well below the throughput of multiplications and additions that the matrix product shows."""
    return [table, text]


def policy_page(rows: Sequence[Row]) -> str:
    """Return the page of `benchmarks/policy.py`: summary, then time and memory against nodes and actuators."""
    names = list(dict.fromkeys(row["policy"] for row in rows))
    actuators = max(row["actuators"] for row in rows)
    large = _reference_size(rows, actuators)
    mode = MODES[1]
    summary = []
    for name in names:
        row = _find(rows, name, large, actuators, mode)
        slopes = (f"{slope(rows, name, mode, key):.2f}" for key in ("ms", "peak_mib"))
        summary.append(
            [
                name,
                f"{row['parameters']:,}",
                f"{row['ms']:.1f}",
                f"{row.get('ratio', 1.0):.2f}",
                f"{row['peak_mib']:.1f}",
                *slopes,
            ]
        )
    parts = [
        f"Forward and backward, {large:,} nodes, {actuators} actuators, 8 graphs:",
        markdown_table(["policy", "parameters", "ms", "times grpd", "peak MiB", "slope of time", "slope of memory"], summary),
        f"Slopes are d log / d log(nodes) from {SLOPE_FROM} nodes up.",
    ]
    for mode in MODES:
        for title, key in (("median ms (times grpd)", "ms"), ("peak MiB", "peak_mib")):
            parts += [f"{mode}, {title}:", _grid(rows, names, mode, key)]
    return _page("Cost of policies", "python benchmarks/policy.py --json docs/benchmarks/policy.json", rows, *parts)


def slope(rows: Sequence[Row], policy: str, mode: str, key: str = "ms") -> float:
    """Return d log(key) / d log(nodes) from SLOPE_FROM nodes up, with the most actuators, by least squares."""
    actuators = max(row["actuators"] for row in rows)
    points = [
        (math.log(row["nodes"]), math.log(row[key]))
        for row in rows
        if row["policy"] == policy and row["mode"] == mode and row["actuators"] == actuators and row["nodes"] >= SLOPE_FROM
    ]
    return statistics.linear_regression(*zip(*points, strict=True)).slope


def _reference_size(rows: Sequence[Row], actuators: int) -> int:
    """Return the number of nodes at which the number of actuators was varied, else the largest."""
    varied = [row["nodes"] for row in rows if row["actuators"] != actuators]
    return max(varied or (row["nodes"] for row in rows))


def _grid(rows: Sequence[Row], names: Sequence[str], mode: str, key: str) -> str:
    sizes = list(dict.fromkeys((row["nodes"], row["actuators"]) for row in rows))
    lines = []
    for name in names:
        cells = [name]
        for nodes, actuators in sizes:
            row = _find(rows, name, nodes, actuators, mode)
            cells.append(f"{row[key]:.1f}" + (f" ({row['ratio']:.1f})" if key == "ms" and "ratio" in row else ""))
        lines.append(cells)
    return markdown_table(["policy", *(f"N={nodes}, A={actuators}" for nodes, actuators in sizes)], lines)


def _find(rows: Sequence[Row], policy: str, nodes: int, actuators: int, mode: str) -> Row:
    wanted = {"policy": policy, "nodes": nodes, "actuators": actuators, "mode": mode}
    return next(row for row in rows if wanted.items() <= row.items())


def _page(title: str, command: str, rows: Sequence[Row], *parts: str) -> str:
    machine = ", ".join(f"{key} {value}" for key, value in rows[0]["machine"].items())
    origin = f"Measured by `{command}` on: {machine}. `make docs` writes this page from the JSON file."
    return "\n\n".join([f"# {title}", origin, *parts]) + "\n"


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[Any]], text_columns: Sequence[int] = (0,)) -> str:
    """Return a table in Markdown; columns are numbers, right-aligned, unless they are among the text columns."""
    rule = "|" + "".join("---|" if column in text_columns else "--:|" for column in range(len(head)))
    return "\n".join([_line(head), rule, *map(_line, rows)])


def _line(cells: Sequence[Any]) -> str:
    return "| " + " | ".join(map(str, cells)) + " |"


def _spread(row: Row) -> str:
    return f"{row['min']:,.0f} - {row['max']:,.0f}"


def _cell(row: Row, key: str, form: str) -> str:
    return format(row[key], form) if key in row else ""
