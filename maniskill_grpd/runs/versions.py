"""Versions of the libraries that decide what a run computes."""

from __future__ import annotations

from importlib.metadata import distributions

PACKAGES = ("mani-skill", "sapien", "warp-lang", "torch", "gymnasium", "numpy")


def package_versions() -> dict[str, str]:
    """Return the installed version of each of `PACKAGES`."""
    installed = {item.metadata["Name"].replace("_", "-"): item.version for item in distributions()}
    return {name: installed.get(name, "not installed") for name in PACKAGES}
