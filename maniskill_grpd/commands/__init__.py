"""The command line: `maniskill-grpd COMMAND`, `python -m maniskill_grpd COMMAND`, and the forwarders in `baselines/`.

A command is a module of this package with a function `main(arguments) -> int`, which returns the exit code: it describes its
options in a dataclass, calls the library and reports (see `run_command`). `COMMANDS` lists them. A new command needs its module
and its line there.
"""

from maniskill_grpd.commands.dispatch import COMMANDS, forward, main
from maniskill_grpd.commands.run_command import run_command

__all__ = ["COMMANDS", "forward", "main", "run_command"]
