"""Ids of tasks that come out of files."""

from __future__ import annotations


def check_env_id(env_id: object, source: str, *, allow_import: bool) -> str:
    """Refuse the id of a task, read from a file, that would run code: gymnasium imports the module before a colon.

    Args:
        env_id: What the file says.
        source: The file, for the message.
        allow_import: Whether modules may be imported all the same.

    Returns:
        The id.

    Raises:
        ValueError: If it is no id, or names a module and that is not allowed.
    """
    if not isinstance(env_id, str) or not env_id:
        raise ValueError(f"{source}: env_id must be the id of a task, got {env_id!r}")
    module, colon, _ = env_id.rpartition(":")
    if colon and not allow_import:
        raise ValueError(
            f"{source}: env_id {env_id!r} would import the Python module {module!r}; pass --allow_import if you trust the file"
        )
    return env_id
