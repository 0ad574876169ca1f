"""Tables of the variants of an object, padded to a common length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch


def variant_table(tables: Sequence[np.ndarray], device: torch.device) -> torch.Tensor:
    """Stack tables (n_m, ...) of M variants into (M, n, ...), the short ones repeating their last rows.

    Floating point numbers become float32.
    """
    size = max(len(table) for table in tables)
    return _upload(np.stack([table[np.minimum(np.arange(size), len(table) - 1)] for table in tables]), device)


def node_table(tables: Sequence[np.ndarray], num_nodes: int, device: torch.device) -> torch.Tensor:
    """Stack tables (n_m, ...) of the nodes of M variants into (M, num_nodes, ...), the short ones with zeros behind."""
    stacked = np.zeros((len(tables), num_nodes, *tables[0].shape[1:]), tables[0].dtype)
    for rows, table in zip(stacked, tables, strict=True):
        rows[: len(table)] = table
    return _upload(stacked, device)


def _upload(table: np.ndarray, device: torch.device) -> torch.Tensor:
    return torch.as_tensor(table.astype(np.float32) if table.dtype == np.float64 else table, device=device)
