"""What clients see of the worlds of a player, and what they do in them with the mouse."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from maniskill_grpd.playing.gizmos import Gizmos
from maniskill_grpd.playing.overlays import GraphOverlay, Trails
from maniskill_grpd.playing.player import Player
from maniskill_grpd.tasks.pictures.browser_window import MOST_WORLDS
from maniskill_grpd.tasks.pictures.dragging import Dragging
from maniskill_grpd.tasks.pictures.world_parts import WorldParts
from maniskill_grpd.viewer.replay import Replay
from maniskill_grpd.viewer.scene import Scene

if TYPE_CHECKING:
    import viser

LONGEST_REPLAY = 5000
"""Most frames of a replay; four minutes of real time."""


class View:
    """Shows the worlds of a player on a server after every step, and records them.

    Args:
        player: The player; the view watches it.
        server: Where clients are.
    """

    def __init__(self, player: Player, server: viser.ViserServer) -> None:
        self._player = player
        self.scene = Scene(server)
        self.graph = GraphOverlay(server)
        self.trails = Trails(server)
        self.gizmos = Gizmos(player, server)
        self.world: int | None = None
        self.replay: Replay | None = None
        self.on_environment()
        player.watchers.append(self)

    @property
    def chosen_world(self) -> int:
        """The world that is shown alone, or the first of all."""
        return 0 if self.world is None else self.world

    def show_world(self, world: int | None) -> None:
        """Show one world alone, or all (None), at most the first 16.

        Raises:
            ValueError: If there is no such world.
        """
        count = self._player.base.num_envs
        if world is not None and not 0 <= world < count:
            raise ValueError(f"world must be in [0, {count - 1}], got {world}")
        self.world = world
        self._dragging.let_go()
        self._look()

    def start_replay(self) -> None:
        """Record every state from now on."""
        self.replay = Replay(self._title(), self._player.base.control_timestep, self.parts.towards_viewer)
        self.replay.add(self.parts.parts(), self._caption())

    def save_replay(self, path: Path) -> None:
        """Write what was recorded to an html file, which is not overwritten.

        Raises:
            ValueError: If nothing was recorded.
            FileExistsError: If there is such a file.
        """
        if self.replay is None:
            raise ValueError("nothing was recorded: start a replay first")
        if path.exists():
            raise FileExistsError(f"{path} exists; choose another name")
        self._player.tell(f"{self.replay.write(path)}: {len(self.replay)} frames")
        self.replay = None

    def close(self) -> None:
        """Let go of all that is held."""
        self._dragging.let_go()

    # ------------------------------------------------------------------ what the player tells

    def on_environment(self) -> None:
        """See `Watcher`."""
        self.world = None
        self._look()

    def on_reset(self) -> None:
        """See `Watcher`."""
        self._dragging.let_go()
        self.trails.clear()
        self.gizmos.take_over(self.chosen_world, self.parts)
        self._show()

    def on_step(self) -> None:
        """See `Watcher`."""
        self._follow_mice()
        self._show()

    def on_idle(self) -> None:
        """See `Watcher`."""
        self._follow_mice()

    def on_message(self, message: str) -> None:
        """See `Watcher`."""

    # ------------------------------------------------------------------

    def _look(self) -> None:
        base = self._player.base
        worlds = range(min(base.num_envs, MOST_WORLDS)) if self.world is None else [self.world]
        self.parts = WorldParts(base, worlds)
        self._dragging = Dragging(self.parts)
        self.trails.clear()
        self.scene.look_from(*self.parts.viewpoint)
        self.gizmos.take_over(self.chosen_world, self.parts)
        self._show()

    def _show(self) -> None:
        parts = self.parts.parts()
        self.scene.show(parts)
        self.graph.show(self._player, self.parts, self.chosen_world)
        self.trails.show(self._player.base.solver, self.parts)
        if self.replay is not None:
            self._record(parts)

    def _record(self, parts: dict) -> None:
        if len(self.replay) < LONGEST_REPLAY:
            self.replay.add(parts, self._caption())
            if len(self.replay) == LONGEST_REPLAY:
                self._player.tell(f"the replay is full: {LONGEST_REPLAY} frames; what follows is not in it")

    def _follow_mice(self) -> None:
        drags = list(self.scene.take_drags())
        if drags and self._player.recorder is not None:
            if any(drag.phase == "start" for drag in drags):
                self._player.tell("what the mouse pulls is in no recorded action: dragging is off while episodes are recorded")
            return
        for message in dict.fromkeys(self._dragging.follow(drags)):
            self._player.tell(message)

    def _title(self) -> str:
        player = self._player
        return " ".join([player.task.env_id, *player.task.env_kwargs, f"({player.agent_name})"])

    def _caption(self) -> str:
        return caption_of(self._player.moment.step, self._player.moment.reward, self._player.moment.success)


def caption_of(step: int, reward: object, success: object) -> str:
    """Return a line about a step: rewards and successes, (B,) each, None before the first."""
    if reward is None:
        return f"step {step}"
    rewards = " ".join(f"{value:.2f}" for value in reward[:4].tolist())
    return f"step {step} · reward {rewards} · solved {int(success.sum())} of {len(success)}"
