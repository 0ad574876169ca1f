"""The viewer inside a notebook."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

from maniskill_grpd.playing.agents import AgentName
from maniskill_grpd.playing.play_config import PlayConfig
from maniskill_grpd.playing.session import Session

HEIGHT = 600
"""Height of the frame [pixels]."""


class NotebookViewer(Session):
    """A session that a notebook shows in a frame; the environment belongs to it until `close`."""

    def _repr_html_(self) -> str:
        return f'<iframe src="{html.escape(self.address)}" width="100%" height="{HEIGHT}" style="border: 0"></iframe>'


def show_notebook(
    env: Any, agent: AgentName = "expert", *, checkpoint: Path | str | None = None, port: int = 8080
) -> NotebookViewer:
    """Play in an environment, in a frame below the cell whose last line this is.

    The notebook and the browser must be on one machine, or the port forwarded.

    Args:
        env: An environment of deformable objects with graph observations; it is the viewer's until `close()`.
        agent: Who acts first.
        checkpoint: A policy, for the agent "policy".
        port: Port to listen on; the next free one where it is in use.

    Returns:
        What the notebook shows; `close()` gives the environment back.

    Raises:
        ValueError: If the environment has no graph observations, or the agent cannot act in it.
    """
    path = None if checkpoint is None else Path(checkpoint)
    viewer = NotebookViewer(PlayConfig(agent=agent, checkpoint=path, port=port, num_envs=env.unwrapped.num_envs), env)
    viewer.start()
    return viewer
