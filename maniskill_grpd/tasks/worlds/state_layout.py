"""Conversion between nested state dictionaries and flat state vectors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch

StateDict = dict[str, Any]
"""Nested dictionary whose leaves are tensors (B, D)."""


def read_rows(state: Mapping[str, Any], template: StateDict, num_rows: int) -> StateDict:
    """Bring a state dictionary into the form of `template`, with one float32 row per world.

    Args:
        state: Nested dictionary; leaves are numpy or torch, (num_rows, D), or (D,) for one world.
        template: State dictionary of the environment, its leaves (B, D) on the wanted device.
        num_rows: Number of worlds that the state is for.

    Returns:
        Nested dictionary in the order of `template`, leaves (num_rows, D).

    Raises:
        ValueError: If an entry is missing or unknown, or a leaf has the wrong shape or is not
            finite.
    """
    given = dict(_leaves(state))
    expected = dict(_leaves(template))
    missing, unknown = (sorted(expected.keys() - given.keys()), sorted(given.keys() - expected.keys()))
    if missing or unknown:
        raise ValueError(f"the state does not fit this environment: missing {missing}, unknown {unknown}")
    rows: StateDict = {}
    for path, leaf in expected.items():
        row = _as_rows("/".join(path), given[path], num_rows, leaf.shape[1]).to(leaf)
        _nest(rows, path, row)
    return rows


def read_flat(flat: Any, template: StateDict, num_rows: int) -> StateDict:
    """Undo the flattening of a state dictionary; inverse of ManiSkill's `flatten_state_dict`.

    Args:
        flat: numpy or torch, (num_rows, D), or (D,) for one world.
        template: As in `read_rows`.
        num_rows: As in `read_rows`.

    Raises:
        ValueError: If the shape is wrong or a value is not finite.
    """
    leaves = list(_leaves(template))
    widths = [leaf.shape[1] for _, leaf in leaves]
    columns = _as_rows("flat state", flat, num_rows, sum(widths)).split(widths, dim=1)
    rows: StateDict = {}
    for (path, leaf), column in zip(leaves, columns, strict=True):
        _nest(rows, path, column.to(leaf))
    return rows


def _leaves(tree: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, (*path, key))
        else:
            yield (*path, key), value


def _nest(tree: StateDict, path: tuple[str, ...], leaf: torch.Tensor) -> None:
    for key in path[:-1]:
        tree = tree.setdefault(key, {})
    tree[path[-1]] = leaf


def _as_rows(name: str, value: Any, num_rows: int, width: int) -> torch.Tensor:
    tensor = value if isinstance(value, torch.Tensor) else torch.from_numpy(np.array(value))
    if tensor.ndim == 1 and num_rows == 1:
        tensor = tensor[None]
    if tuple(tensor.shape) != (num_rows, width):
        raise ValueError(f"{name} must be ({num_rows}, {width}), one row per world, got {tuple(tensor.shape)}")
    if not torch.isfinite(tensor).all():
        raise ValueError(f"{name} must be finite, got NaN or infinity")
    return tensor
