"""Checking of policy options given by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

T = TypeVar("T")


def parse_options(cls: type[T], options: Mapping[str, Any]) -> T:
    """Build an options dataclass, refusing what it does not know.

    Args:
        cls: A dataclass whose fields are of type bool, int, float, str or Literal, with defaults.
        options: Values by field name.

    Returns:
        An instance of cls.

    Raises:
        ValueError: For an unknown name, a value of another type or one that is not among the
            choices; the message lists what is allowed.
    """
    hints = get_type_hints(cls)
    for name, value in options.items():
        if name not in hints:
            raise ValueError(f"unknown option {name!r}; allowed are:\n{describe_options(cls)}")
        if not _fits(value, hints[name]):
            raise ValueError(
                f"option {name!r} must be {_type_name(hints[name])}, got {value!r}; allowed are:\n{describe_options(cls)}"
            )
    return cls(**options)


def describe_options(cls: type) -> str:
    """One line `name: type = default` per option."""
    hints = get_type_hints(cls)
    return "\n".join(
        f"  {entry.name}: {_type_name(hints[entry.name])}" + ("" if entry.default is MISSING else f" = {entry.default!r}")
        for entry in fields(cls)
    )


def _fits(value: Any, hint: Any) -> bool:
    if get_origin(hint) is Literal:
        return value in get_args(hint)
    if isinstance(value, bool):
        return hint is bool
    if hint is float:
        return isinstance(value, (int, float))
    return isinstance(value, hint)


def _type_name(hint: Any) -> str:
    if get_origin(hint) is Literal:
        return "one of " + ", ".join(repr(choice) for choice in get_args(hint))
    return hint.__name__
