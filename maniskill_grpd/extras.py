"""Optional libraries, and what to install where one is missing. Below everything: imports nothing of the package."""

from __future__ import annotations

import importlib
from types import ModuleType


class MissingExtraError(ImportError):
    """A library is missing that an extra of the package installs."""


def import_extra(module: str, extra: str, purpose: str) -> ModuleType:
    """Return an optional library.

    Args:
        module: Name of the module.
        extra: The extra of the package that installs it.
        purpose: What needs it, the beginning of the message.

    Raises:
        MissingExtraError: In one line that names the command which installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = error.name or module
        raise MissingExtraError(f"{purpose} needs {missing}: pip install 'maniskill-grpd[{extra}]'", name=missing) from error
