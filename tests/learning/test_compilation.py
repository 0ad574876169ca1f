"""Compiling is refused where nothing could compile."""

import pytest
import torch

from maniskill_grpd.learning.compilation import compiled


def test_a_missing_compiler_is_told_before_training(monkeypatch):
    """The message names the compiler and the way round; on a GPU none is needed."""
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(ValueError, match="no-such-compiler.*leave --compile out"):
        compiled(torch.sin, torch.device("cpu"))
    compiled(torch.sin, torch.device("cuda"))
