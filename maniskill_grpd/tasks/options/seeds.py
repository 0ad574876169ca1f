"""Seeds of the worlds of a batch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def expand_seeds(seed: int | Sequence[int], num_worlds: int) -> list[int]:
    """Return one seed per world.

    A single number is the seed of the first world; the others are derived from it as ManiSkill
    does.

    Raises:
        ValueError: If a seed is not a whole number in [0, 2**32), or a sequence has neither one seed nor one per world.
    """
    given = np.atleast_1d(np.asarray(seed))
    is_whole = not given.size or given.dtype.kind in "iu"
    if given.ndim != 1 or not is_whole or not all(0 <= value < 2**32 for value in given.tolist()):
        raise ValueError(f"seeds must be whole numbers in [0, 2**32), got {seed!r}")
    seeds = given.tolist()
    if len(seeds) == num_worlds:
        return seeds
    if len(seeds) != 1:
        raise ValueError(f"expected 1 or {num_worlds} seeds, one per world being reset, got {len(seeds)}")
    return [*seeds, *np.random.RandomState(seeds[0]).randint(2**31, size=max(num_worlds - 1, 0)).tolist()][:num_worlds]
