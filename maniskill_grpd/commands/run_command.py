"""The one way in which commands parse their options, run, and report what the user can fix."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import io
import itertools
import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import tyro

from maniskill_grpd.extras import MissingExtraError
from maniskill_grpd.learning import CheckpointError, NonFiniteError
from maniskill_grpd.program import PROGRAM

Config = TypeVar("Config")

USER_ERRORS = (ValueError, OSError, CheckpointError, NonFiniteError, MissingExtraError)
"""What the library raises where the user can help: the message says what was given and what is allowed."""

SIDES, RULES = " │", "─-"
"""Sides of the frame that tyro draws around its messages, and what separates their parts, with and without Unicode."""


REMEDIES = {
    **dict.fromkeys(
        (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR),
        "if that was to be written, work in a folder where you may write; caches go where WARP_CACHE_PATH and XDG_CACHE_HOME say",
    ),
    errno.ENOSPC: "free some space, or work in a folder of another disk",
}
"""What a user can do about errors of the system."""


class UsageError(Exception):
    """The options of a command cannot be read."""


def run_command(function: Callable[[Config], Any], config: type[Config], arguments: Sequence[str]) -> int:
    """Parse the options of a command, run it, and report errors in one line instead of a traceback.

    Args:
        function: The command, in a module whose docstring explains it and whose name is the command's.
        config: Dataclass of its options; the docstrings of the fields explain them.
        arguments: The words after the command.

    Returns:
        The exit code: 0 or what the function returns as an int, 1 if it failed, 2 for a wrong option, 130 if it was interrupted.
    """
    return report_errors(lambda: function(parse_options(function.__module__, config, arguments)))


def report_errors(run: Callable[[], Any]) -> int:
    """Call a function, report what the user can fix in one line, and return the exit code, see `run_command`."""
    try:
        result = run()
    except UsageError as error:
        return _report(error, 2)
    except USER_ERRORS as error:
        return _report(error, 1)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    return result if isinstance(result, int) else 0


def parse_options(module: str, config: type[Config], arguments: Sequence[str], default: Any = tyro.MISSING_NONPROP) -> Config:
    """Parse the words after a command.

    Args:
        module: Name of the command's module.
        config: Dataclass of its options.
        arguments: The words.
        default: The options that stand where the words are silent, if not the defaults of the class.

    Raises:
        UsageError: In one line: what is wrong and what is allowed.
        SystemExit: After `--help`.
    """
    command = f"{PROGRAM} {module.rpartition('.')[2]}"
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                config,
                prog=command,
                description=sys.modules[module].__doc__,
                args=list(arguments),
                default=default,
                use_underscores=True,
            )
    except SystemExit as stop:
        if not stop.code:
            raise
        message = _unframed(complaint.getvalue())
        if message.startswith("Unrecognized"):
            message += f"; {command} takes {' '.join(_flags(config))}"
        raise UsageError(message) from None


def _flags(config: type) -> list[str]:
    return [f"--{field.name}" for field in dataclasses.fields(config)]


def _unframed(text: str) -> str:
    """Return the first part of what tyro says below a title, in one line."""
    lines = [line.strip(SIDES) for line in text.splitlines()[1:]]
    parts = [list(part) for is_text, part in itertools.groupby(lines, lambda line: bool(line.strip(RULES))) if is_text]
    return " ".join(parts[0]) if parts else text


def _report(error: Exception, code: int) -> int:
    remedy = REMEDIES.get(error.errno) if isinstance(error, OSError) else None
    message = f"{error}; {remedy}" if remedy else str(error)
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    return code
