"""The machine on which a benchmark was measured."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

import torch

from maniskill_grpd.processor import processor_name


def describe_machine(device: str = "cpu") -> dict[str, str | int]:
    """Return processor, cores, load and versions."""
    machine: dict[str, str | int] = {
        "cpu": processor_name(),
        "cores": os.cpu_count() or 1,
        "cores used": num_cores(),
        "load": f"{os.getloadavg()[0]:.1f}",
        "python": platform.python_version(),
    }
    if device == "cuda":
        machine["gpu"] = torch.cuda.get_device_name()
    return machine | {package: installed_version(package) for package in ("torch", "warp-lang", "newton")}


def machine_line(machine: Mapping[str, str | int]) -> str:
    """Return what `describe_machine` says as part of a sentence."""
    return ", ".join(f"{key} {value}" for key, value in machine.items())


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
