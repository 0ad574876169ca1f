"""The machine on which a benchmark was measured."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

from maniskill_grpd.processor import processor_name


def describe_machine(device: str = "cpu") -> dict[str, str | int]:
    """Return processor, cores, load, versions and the date."""
    machine: dict[str, str | int] = {
        "cpu": processor_name(),
        "cores": os.cpu_count() or 1,
        "cores used": num_cores(),
        "load": f"{os.getloadavg()[0]:.1f}",
        "python": platform.python_version(),
        "date": time.strftime("%Y-%m-%d"),
    }
    if device == "cuda":
        machine["gpu"] = torch.cuda.get_device_name()
    return machine | {package: installed_version(package) for package in ("torch", "warp-lang", "newton")}


def report(rows: Sequence[Mapping[str, Any]], machine: Mapping[str, str | int], path: Path | None = None) -> None:
    """Print rows, one a line, and save them if there is a file for them; `make docs` makes tables of such files."""
    for row in rows:
        sys.stdout.write(json.dumps(row) + "\n")
    sys.stdout.flush()
    save(rows, machine, path)


def save(rows: Sequence[Mapping[str, Any]], machine: Mapping[str, str | int], path: Path | None) -> None:
    """Write rows, each with the machine that it was measured on."""
    if path is not None:
        path.write_text(json.dumps([{**row, "machine": machine} for row in rows], indent=1) + "\n", encoding="utf-8")


def num_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def installed_version(package: str) -> str:
    """Return the version of a package, or that it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def measure_peaks() -> dict[str, float]:
    """Return what one core reaches at best: GFLOP/s of a matrix product, GB/s of a copy (read and write)."""
    a, b = torch.rand(1024, 1024), torch.rand(1024, 1024)
    source = torch.rand(1 << 26)
    target = torch.empty_like(source)
    product, copy = [], []
    for _ in range(5):
        start = time.perf_counter()
        torch.mm(a, b)
        product.append(time.perf_counter() - start)
        start = time.perf_counter()
        target.copy_(source)
        copy.append(time.perf_counter() - start)
    return {"gflop_per_s": 2.0 * 1024**3 / min(product) * 1e-9, "gbyte_per_s": 8.0 * len(source) / min(copy) * 1e-9}
