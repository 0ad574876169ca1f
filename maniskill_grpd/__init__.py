"""Rope and cloth tasks for ManiSkill, equivariant graph policies, and trust-region training.

Importing this package registers its tasks and agents with ManiSkill. Where ManiSkill is not installed, `physics`, `graphs`,
`policies` and `learning` work without it.
"""

from importlib.util import find_spec

from maniskill_grpd.version import __version__

__all__ = ["__version__"]

if find_spec("mani_skill") is not None:
    from maniskill_grpd import agents, tasks  # noqa: F401  (imported to register)
