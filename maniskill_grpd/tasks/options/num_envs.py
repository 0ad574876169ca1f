"""Choice of the number of worlds."""

from __future__ import annotations

import torch

from maniskill_grpd.physics.memory import check_memory

# ManiSkill gives each world two generators of numpy, 3,098 bytes of resident memory each, before there is an object whose
# state could be counted.
GENERATOR_BYTES = 2 * 3098


def check_num_envs(num_envs: int) -> None:
    """Check a number of worlds before anything is made for them.

    The memory of their states depends on the object; `Solver` checks it.

    Raises:
        ValueError: If it is below 1, or memory does not suffice for their random numbers, with what they need.
    """
    if num_envs < 1:
        raise ValueError(f"num_envs must be >= 1, got {num_envs}")
    check_memory(f"num_envs={num_envs} worlds", num_envs * GENERATOR_BYTES, "their random numbers", torch.device("cpu"))
