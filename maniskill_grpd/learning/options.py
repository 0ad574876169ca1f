"""Groups of options: what a value may be is stated beside the option and checked in one place."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args, get_origin, get_type_hints

THREADS = "[1, 1024]"
"""Range of `--torch_threads` of all commands; PyTorch crashes on numbers that the system cannot start."""


@dataclass(frozen=True, kw_only=True)
class OptionGroup:
    """Options that belong together; a config inherits from all groups that it consists of.

    Class attributes:
        RANGES: Interval of each numeric option, such as "(0, inf)" or "[0, 1]"; options that are None are not checked.
    """

    RANGES: ClassVar[Mapping[str, str]] = {}

    def contradictions(self) -> dict[str, bool]:
        """Return messages, each with whether it applies: which options do not go together."""
        return {}

    def check(self) -> None:
        """Refuse what is outside its range, is no choice or contradicts another option.

        Raises:
            ValueError: Naming the first option, its value and what is allowed.
        """
        check_choices(self)
        for message, is_wrong in self.contradictions().items():
            if is_wrong:
                raise ValueError(message)
        for cls in type(self).__mro__:
            check_ranges(self, vars(cls).get("RANGES", {}))


def check_choices(options: Any) -> None:
    """Refuse values of `Literal` fields of a dataclass that are not among the choices.

    Raises:
        ValueError: Naming the first one.
    """
    for name, hint in get_type_hints(type(options)).items():
        if get_origin(hint) is Literal and getattr(options, name) not in get_args(hint):
            raise ValueError(f"{name} must be one of {', '.join(get_args(hint))}, got {getattr(options, name)!r}")


def check_ranges(options: Any, ranges: Mapping[str, str]) -> None:
    """Refuse numbers outside their intervals.

    Args:
        options: Has the numbers as attributes; None is let through.
        ranges: Interval by name, such as "(0, inf)": a round bracket leaves the end out.

    Raises:
        ValueError: Naming the first one, with the interval.
    """
    for name, interval in ranges.items():
        value = getattr(options, name)
        if value is not None and not _lies_in(value, interval):
            raise ValueError(f"{name} must lie in {interval}, got {value}")


def _lies_in(value: float, interval: str) -> bool:
    low, high = (float(end) for end in interval[1:-1].split(","))
    is_above = value > low if interval[0] == "(" else value >= low
    is_below = value < high if interval[-1] == ")" else value <= high
    return is_above and is_below


def require_positive(options: Any, *names: str) -> None:
    """Refuse options that are not positive and finite.

    Raises:
        ValueError: Naming the first one.
    """
    for name in names:
        value = getattr(options, name)
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value}")


def parse_options(name: str, pairs: tuple[str, ...]) -> dict[str, Any]:
    """Parse key=value pairs; a value that is not JSON is taken as a string.

    Args:
        name: The option the pairs belong to, for messages.
        pairs: Such as ("num_grippers=2", "shape=W").

    Raises:
        ValueError: If a pair has no key or no "=", or a key comes twice.
    """
    options: dict[str, Any] = {}
    for pair in pairs:
        key, separator, text = pair.partition("=")
        if not (separator and key.isidentifier()):
            raise ValueError(f"{name} takes key=value pairs, got {pair!r}")
        if key in options:
            raise ValueError(f"{name} names {key!r} twice")
        try:
            options[key] = json.loads(text)
        except json.JSONDecodeError:
            options[key] = text
    return options


def to_arguments(config: Any) -> list[str]:
    """Return the words of a command line that give the options of a dataclass that are not at their defaults."""
    arguments = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if value == field.default:
            continue
        if isinstance(value, bool):
            arguments.append(f"--{field.name}" if value else f"--no_{field.name}")
        else:
            arguments += [f"--{field.name}", *(map(str, value) if isinstance(value, tuple) else [str(value)])]
    return arguments
