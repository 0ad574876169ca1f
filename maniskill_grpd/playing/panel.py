"""The panel beside the scene: buttons, sliders, plots and messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from maniskill_grpd.playing.agents import AgentName, Teleoperator
from maniskill_grpd.playing.player import MATERIAL, Player
from maniskill_grpd.playing.plots import Plots
from maniskill_grpd.playing.view import View

if TYPE_CHECKING:
    import viser

ALL, NONE = "all", "none"
SHOWN_MESSAGES = 4
FACTORS = (0.1, 5.0, 0.1)
"""Smallest and largest factor on a property of the material, and the step between."""
STANDARD_GRAVITY, LARGEST_GRAVITY, LARGEST_NOISE = 9.81, 20.0, 0.05
"""[m/s^2], [m/s^2], [m]."""


class Panel:
    """Steers a player and its view. Callbacks run on threads of the server: they only ask the player.

    Args:
        player: The player; the panel watches it.
        view: What it shows.
        server: Where clients are.
    """

    def __init__(self, player: Player, view: View, server: viser.ViserServer) -> None:
        self._player, self._view, self._gui = player, view, server.gui
        self._messages: deque[str] = deque(maxlen=SHOWN_MESSAGES)
        self._status = self._gui.add_markdown("")
        self._log = self._gui.add_markdown("")
        for title, build, is_open in (
            ("Play", self._build_play, True),
            ("Who acts", self._build_agent, True),
            ("By hand", self._build_hand, False),
            ("Task", self._build_task, False),
            ("Physics and noise", self._build_physics, False),
            ("Show", self._build_show, False),
            ("Replay", self._build_replay, False),
        ):
            with self._gui.add_folder(title, expand_by_default=is_open):
                build()
        with self._gui.add_folder("Plots", expand_by_default=True):
            self._plots = Plots(self._gui)
        player.watchers.append(self)
        self._show_state()

    # ------------------------------------------------------------------ what the player tells

    def on_environment(self) -> None:
        """See `Watcher`."""
        self._world.options, self._gripper.options = self._worlds(), self._grippers()
        self._options.value = " ".join(self._player.task.env_kwargs)
        self._plots.clear()
        self._show_state()

    def on_reset(self) -> None:
        """See `Watcher`."""
        self._seed.value = self._player.seed
        self._plots.clear()
        self._show_state()

    def on_step(self) -> None:
        """See `Watcher`."""
        self._plots.add(self._player.moment)
        self._show_state()

    def on_idle(self) -> None:
        """See `Watcher`."""
        self._show_state()

    def on_message(self, message: str) -> None:
        """See `Watcher`."""
        self._messages.append(message)
        self._log.content = "\n\n".join(f"*{_plain(line)}*" for line in self._messages)

    # ------------------------------------------------------------------ building

    def _build_play(self) -> None:
        gui, player = self._gui, self._player
        self._play = gui.add_button("Pause")
        self._on_click(self._play, self._toggle)
        self._on_click(gui.add_button("Step"), self._step)
        self._on_click(gui.add_button("Reset"), player.reset)
        self._speed = gui.add_slider("speed", min=0.05, max=1.0, step=0.05, initial_value=1.0, hint="1 is real time")
        self._on_change(self._speed, self._set_speed)
        self._unbraked = gui.add_checkbox("as fast as it can", initial_value=False)
        self._on_change(self._unbraked, self._set_speed)
        self._seed = gui.add_number("seed", initial_value=player.seed, min=0, max=2**31 - 1, step=1)
        self._on_change(self._seed, player.reset)
        self._world = gui.add_dropdown("world", options=self._worlds(), initial_value=ALL)
        self._on_change(self._world, lambda word: self._view.show_world(None if word == ALL else int(word)))
        repeat = gui.add_checkbox("new episodes by themselves", initial_value=player.repeats)
        self._on_change(repeat, lambda wanted: setattr(player, "repeats", bool(wanted)))

    def _build_agent(self) -> None:
        gui = self._gui
        self._agent = gui.add_dropdown("agent", options=get_args(AgentName), initial_value=self._player.agent_name)
        self._on_change(self._agent, self._choose_agent)
        self._checkpoint = gui.add_dropdown("checkpoint", options=self._checkpoints(), initial_value=self._checkpoint_name())
        self._on_change(self._checkpoint, self._choose_checkpoint)
        self._on_click(gui.add_button("Look for checkpoints"), self._look_for_checkpoints)

    def _build_task(self) -> None:
        self._gui.add_markdown(f"**{self._player.task.env_id}**")
        self._options = self._gui.add_text("options", initial_value=" ".join(self._player.task.env_kwargs), hint="key=value ...")
        make = self._gui.add_button("Make it anew")
        self._on_click(make, lambda: self._player.change_options(tuple(str(self._options.value).split())))

    def _build_physics(self) -> None:
        gui, player = self._gui, self._player
        low, high, step = FACTORS
        for name in MATERIAL:
            slider = gui.add_slider(f"{name} x", min=low, max=high, step=step, initial_value=1.0)
            self._on_change(slider, lambda factor, name=name: player.set_material(name, factor))
        gravity = gui.add_slider("gravity [m/s^2]", min=0.0, max=LARGEST_GRAVITY, step=0.01, initial_value=STANDARD_GRAVITY)
        self._on_change(gravity, player.set_gravity)
        noise = gui.add_slider(
            "noise [m]", min=0.0, max=LARGEST_NOISE, step=0.001, initial_value=0.0, hint="on what policies see"
        )
        self._on_change(noise, player.set_noise)

    def _build_show(self) -> None:
        self._on_change(self._gui.add_checkbox("graph", initial_value=False), self._view.graph.switch)
        self._on_change(self._gui.add_checkbox("trails", initial_value=False), self._view.trails.switch)

    def _build_replay(self) -> None:
        gui, view = self._gui, self._view
        name = gui.add_text("file", initial_value="replay.html", hint="in the folder of the program")
        self._on_click(gui.add_button("Start recording"), view.start_replay)
        self._on_click(gui.add_button("Save"), lambda: view.save_replay(_inside(str(name.value), ".html")))

    def _build_hand(self) -> None:
        gui, player = self._gui, self._player
        gui.add_markdown("The agent *teleop* goes where its gizmos are.")
        self._gripper = gui.add_dropdown("gripper", options=self._grippers(), initial_value="0")
        for label, is_closed in (("Open", False), ("Close", True)):
            click = lambda is_closed=is_closed: self._view.gizmos.grip(int(self._gripper.value), is_closed)  # noqa: E731
            self._on_click(gui.add_button(label), click)
        self._on_click(gui.add_button("Record episodes"), player.start_recording)
        self._on_click(gui.add_button("Keep this episode"), player.keep_episode)
        self._on_click(gui.add_button("Stop recording"), player.stop_recording)

    def _on_click(self, handle: Any, what: Callable[[], object]) -> None:
        @handle.on_click
        async def _(_: Any) -> None:
            self._player.ask(what)

    def _on_change(self, handle: Any, what: Callable[[Any], object]) -> None:
        @handle.on_update
        async def _(event: Any) -> None:
            if event.client is not None:  # not what the panel itself has set
                value = event.target.value
                self._player.ask(lambda: what(value))

    # ------------------------------------------------------------------ what is asked for, on the player's thread

    def _toggle(self) -> None:
        self._player.is_playing = not self._player.is_playing
        self._show_state()

    def _step(self) -> None:
        self._player.is_playing = False
        self._player.step()

    def _set_speed(self, _: Any) -> None:
        self._player.speed = 0.0 if self._unbraked.value else max(float(self._speed.value), 0.01)

    def _choose_agent(self, name: AgentName) -> None:
        try:
            self._player.choose_agent(name)
        finally:
            self._agent.value = self._player.agent_name
            self._view.gizmos.take_over(self._view.chosen_world, self._view.parts)

    def _choose_checkpoint(self, name: str) -> None:
        if name == NONE:
            return
        try:
            self._player.choose_agent("policy", _inside(name, ".pt", self._folder()))
            self._player.tell(f"{name} acts")
        finally:
            self._agent.value, self._checkpoint.value = self._player.agent_name, self._checkpoint_name()
            self._view.gizmos.take_over(self._view.chosen_world, self._view.parts)

    def _look_for_checkpoints(self) -> None:
        self._checkpoint.options = self._checkpoints()
        self._checkpoint.value = self._checkpoint_name()

    # ------------------------------------------------------------------

    def _folder(self) -> Path:
        config = self._player.config
        return config.checkpoints or (config.checkpoint.parent if config.checkpoint is not None else Path("checkpoints"))

    def _checkpoints(self) -> tuple[str, ...]:
        folder = self._folder()
        return (NONE, *sorted(str(path.relative_to(folder)) for path in folder.glob("**/*.pt")))

    def _checkpoint_name(self) -> str:
        path = self._player.checkpoint
        names = self._checkpoints()
        name = NONE if path is None or not path.is_relative_to(self._folder()) else str(path.relative_to(self._folder()))
        return name if name in names else NONE

    def _worlds(self) -> tuple[str, ...]:
        return (ALL, *map(str, range(self._player.base.num_envs)))

    def _grippers(self) -> tuple[str, ...]:
        return tuple(map(str, range(self._player.base.num_grippers)))

    def _show_state(self) -> None:
        label = "Pause" if self._player.is_playing else "Play"
        if self._play.label != label:
            self._play.label = label
        moment, notes = self._player.moment, []
        if self._player.recorder is not None:
            notes.append("**episodes are recorded**")
        if self._view.replay is not None:
            notes.append("**a replay is recorded**")
        if isinstance(self._player.agent, Teleoperator):
            notes.append(f"world {self._player.agent.world} is tele-operated")
        solved = "" if moment.success is None else f", {int(moment.success.sum())} of {len(moment.success)} solved"
        text = " · ".join([f"step {moment.step}{solved}", *notes])
        if self._status.content != text:
            self._status.content = text


def _plain(text: str) -> str:
    """Return a line without what markdown would take for marks."""
    return "".join("\\" + letter if letter in "\\`*_[]<>#" else letter for letter in " ".join(text.split()))


def _inside(name: str, suffix: str, folder: Path = Path()) -> Path:
    """Return the path of a file within a folder; ValueError if it leads out of it or has another suffix."""
    path = Path(name)
    if not name.endswith(suffix) or path.is_absolute() or ".." in path.parts:
        raise ValueError(f"a file must be below {folder.resolve()} and end in {suffix}, got {name!r}")
    return folder / path
