"""A player with its server, view and panel: all that `maniskill-grpd play` runs."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Any

from maniskill_grpd.playing.panel import Panel
from maniskill_grpd.playing.play_config import PlayConfig
from maniskill_grpd.playing.player import Player
from maniskill_grpd.playing.view import View
from maniskill_grpd.viewer.server import address_of, open_server

PATIENCE = 60.0
"""How long a session waits for its thread to finish a step [s]."""


class Session:
    """Plays in the thread that calls `run`, or in one of its own after `start`.

    Args:
        config: Options.
        env: An environment to play in, which is not closed; one is made for the options by default.

    Raises:
        ValueError: If the task, an option, the agent, or the address to listen on does not exist.
        CheckpointError: If the checkpoint is none, or its policy was trained on other observations.
        OSError: If no port is free.
    """

    def __init__(self, config: PlayConfig, env: Any = None) -> None:
        if config.record is not None and config.record.exists():
            raise FileExistsError(f"{config.record} exists; choose another --record")
        self.config = config
        self.player = Player(config, env)
        self.server = open_server(config.host, config.port)
        self.view = View(self.player, self.server)
        self.panel = Panel(self.player, self.view, self.server)
        self.address = address_of(self.server)
        """Where a browser on this machine finds it."""
        self._thread: threading.Thread | None = None
        if config.record is not None:
            self.view.start_replay()

    def greeting(self) -> str:
        """Return lines that say where to look."""
        config, port = self.config, self.server.get_port()
        lines = [f"open {self.address} in a browser; Ctrl-C ends"]
        if port != config.port:
            lines.insert(0, f"port {config.port} is in use, {port} is taken instead")
        if config.host == "127.0.0.1":
            lines.append(f"from another machine: ssh -L {port}:127.0.0.1:{port} THIS_MACHINE")
        if config.share:
            url = self.server.request_share_url(verbose=False)
            lines.append("no public address could be had" if url is None else f"open to everybody at {url}")
        return "\n".join(lines)

    def run(self) -> None:
        """Play until the player is stopped."""
        self.player.run()

    def start(self) -> None:
        """Play in a thread; `close` ends it."""
        self._thread = threading.Thread(target=self.run, name="player", daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether its own thread plays."""
        return self._thread is not None and self._thread.is_alive()

    def close(self) -> None:
        """End playing, write the replay that was asked for, stop the server; an environment that was given stays open."""
        self.player.stop()
        if self._thread is not None:
            self._thread.join(PATIENCE)
        self.view.close()
        try:
            if self.config.record is not None and self.view.replay is not None:
                self.view.save_replay(self.config.record)
        finally:
            self.server.stop()
            self.player.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()
