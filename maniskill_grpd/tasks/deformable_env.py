"""The bridge between ManiSkill and the batched deformable solver."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.utils.structs.types import SimConfig

from maniskill_grpd.agents.arms import ARMS, arm_links
from maniskill_grpd.physics import STANDARD_GRAVITY, Collider, Model, Solver
from maniskill_grpd.tasks.observation.observed_worlds import GRAPH_FEATURES, ObservedWorlds
from maniskill_grpd.tasks.options.arm_bases import arm_bases, round_the_table
from maniskill_grpd.tasks.options.compute_device import choose_compute_device
from maniskill_grpd.tasks.options.grasp_mode import choose_grasp
from maniskill_grpd.tasks.options.gripper_teams import Team, choose_team, control_modes, members, supported_robots
from maniskill_grpd.tasks.options.material_ranges import MaterialRanges
from maniskill_grpd.tasks.options.num_envs import check_num_envs
from maniskill_grpd.tasks.options.observation_mode import needs_camera, split_observation_mode
from maniskill_grpd.tasks.options.substeps import check_substeps
from maniskill_grpd.tasks.pictures.render_device import choose_render_device
from maniskill_grpd.tasks.worlds.batched_scene import BatchedScene
from maniskill_grpd.tasks.worlds.episode_starts import EpisodeStarts
from maniskill_grpd.tasks.worlds.episode_tensors import EpisodeTensors, Kind
from maniskill_grpd.tasks.worlds.restorable_worlds import RestorableWorlds
from maniskill_grpd.tasks.worlds.seeded_worlds import SeededWorlds
from maniskill_grpd.tasks.worlds.self_contact_info import self_contact_info

POSE_RANGES = {"full": 1.0, "half": 0.5, "quarter": 0.25}
"""Share of a task's pose ranges that is sampled, by the name of the option `pose_range`."""
CONTROL_FREQ = 20
"""Control steps per second [Hz]; each is one step of the solver, which has its own substeps."""
OUT_OF_REACH = 100.0
"""How far below the origin the table of a task without one is [m]."""


class DeformableEnv(SeededWorlds, EpisodeStarts, RestorableWorlds, ObservedWorlds):
    """A batch of worlds in which floating grippers, or arms, manipulate a deformable object.

    The truth lives in `solver` (a batched XPBD solver on CPU or CUDA); SAPIEN, if it can draw, only
    takes pictures of it. `num_envs` is free on both devices.

    One `step(action)` goes through:
        1. `agent.set_action`          checks the action, moves the gripper targets, commands the grip
        2. `scene.step` -> `solver.step`  moves the worlds, grippers reach their targets
        3. `evaluate` -> `measure`     measures the worlds, once: success, fail, distances
        4. `get_obs` -> `object_values`, `gripper_values`, `goal_observations`
        5. `compute_dense_reward` -> `reward`

    A task names its metric of progress in `PROGRESS` and its channels in `OBJECT_CHANNELS` and `GRIPPER_CHANNELS`. It implements
    `build_models`, `candidate_gripper_nodes`, `start_episode`, `measure` and `reward`, and, where it needs them,
    `build_colliders`, `allocate_episode`, `object_values`, `gripper_values`, `goal_observations` and `drawing`
    (docs/own_task.md). Tensors that belong to an episode, such as goals, come from `episode_tensor`: they become part of the
    state and move with their world.

    Args:
        num_envs: Number of worlds B, as many as memory holds.
        obs_mode: "graph" (default), "state", "state_dict", "none", image modes of ManiSkill, or any of them joined as in
            "state+graph" and "graph+depth".
        sim_backend: "auto" (CUDA if there is a GPU, else CPU), "cpu" or "cuda".
        render_backend: "auto": image observations by a rasteriser in Warp, pictures by SAPIEN where it can draw; "warp" or
            "none": all without SAPIEN; or a backend of ManiSkill, for SAPIEN. `env.unwrapped.backend.render_backend` says which.
        num_grippers: Number of grippers A, one of `GRIPPER_COUNTS`.
        robot_uids: "floating_grippers_<A>", which drives all of them (default), or a tuple of
            agents that share them, as in ("floating_grippers_1", "floating_grippers_1"): actions
            are then a dictionary with one entry per agent. Or a tuple of arms, one for each gripper, as in ("panda", "panda")
            (docs/robots.md).
        robot_poses: Where arms stand, see `arm_bases`; where `default_arm_bases` says by default.
        arm_contact: Whether the object touches the hands, the fingers and the last two links of arms.
        grasp: "fixed" (default): grippers hold the object for the whole episode; "free": they hold
            it at the start, and the action opens and closes them.
        control_mode: "pd_ee_delta_pos" for fixed grasps, "pd_ee_delta_pos_grip" for free ones; arms have others too.
        material: Factors on the material of the object, drawn anew for each episode, by property
            ("stretch", "bend", "mass", "friction", "damping"): (smallest, largest), or a number.
        pose_range: "full", "half" or "quarter": share of the task's pose ranges that is sampled.
        graph_nodes: Number of object nodes in the graph, farthest-point sampled; all by default.
            The simulation keeps all nodes.
        graph_features: "paper" (default): grippers tell their position, velocity and status alone (eq. 43), the goal is on the
            object's nodes (eq. 42); "rich": grippers also tell the goal and summaries of the whole object.
        grip_strength: Force [N] beyond which what a gripper holds slips out of it; unlimited by
            default. `info["slips"]` counts it.
        substeps: Substeps of the solver in a control step, 1 to 1,000; by default what each variant of
            the object needs.
        self_collision: Whether the object collides with itself; by default as the task says.
        count_crossings: Whether `info["self_crossings"]` counts where a cloth passes through itself (slow).
        num_threads: CPU threads of the solver, chosen by it by default.
        settings: What the graph shows, see `ObservedWorlds`, how cameras measure, see `WorldPictures`, and further settings of
            ManiSkill's `BaseEnv`.

    Raises:
        ValueError: If an option has a value that is not allowed; says which are.
    """

    SUPPORTED_OBS_MODES = ("graph", "state", "state_dict", "none", "sensor_data", "any_textures", "pointcloud")
    GRIPPER_COUNTS: tuple[int, ...]
    """Allowed numbers of grippers."""
    DEFAULT_NUM_GRIPPERS: int
    TRAINING: Mapping[str, Any] = {}
    """Settings that `train` takes for this task where its command line is silent, by name."""
    STUDY_OPTIONS: Mapping[str, Any] = {}
    """Options with which the studies of all tasks train on it; those of the paper's tasks stand with the paper's claims."""
    SELF_COLLISION = True
    """Whether the object collides with itself by default."""

    def __init__(
        self,
        *,
        num_envs: int = 1,
        obs_mode: str | None = None,
        render_mode: str | None = None,
        sim_backend: str = "auto",
        render_backend: str | None = "auto",
        num_grippers: int | None = None,
        robot_uids: Team | None = None,
        robot_poses: Any | None = None,
        arm_contact: bool = True,
        grasp: str | None = None,
        control_mode: str | None = None,
        material: Mapping[str, float | Sequence[float]] | None = None,
        pose_range: str = "full",
        graph_nodes: int | None = None,
        graph_features: str = "paper",
        grip_strength: float | None = None,
        substeps: int | None = None,
        self_collision: bool | None = None,
        count_crossings: bool = False,
        num_threads: int | None = None,
        **settings: Any,
    ) -> None:
        self._check_hooks()
        _check_choice("pose_range", pose_range, tuple(POSE_RANGES))
        _check_choice("graph_features", graph_features, GRAPH_FEATURES)
        _check_choice("render_mode", render_mode, (None, *self.SUPPORTED_RENDER_MODES))
        check_num_envs(num_envs)
        self.num_grippers, team = choose_team(num_grippers, robot_uids, self.GRIPPER_COUNTS, self.DEFAULT_NUM_GRIPPERS)
        self._bases = arm_bases(team, robot_poses, self.default_arm_bases)
        self._links = arm_links([ARMS[uid] for uid in members(team)]) if arm_contact and self._bases is not None else ()
        self.grasp, control_mode = choose_grasp(grasp, control_mode, control_modes(team))
        self._material = MaterialRanges(material)
        base_mode, self._has_graph = split_observation_mode(obs_mode)
        self._full_obs_mode = obs_mode or "graph"
        self.pose_share = POSE_RANGES[pose_range]
        self._num_graph_nodes, self.graph_features = graph_nodes, graph_features
        self._grip_strength = grip_strength
        self._substeps = check_substeps(substeps)
        self._num_threads = num_threads
        self._self_collision = self.SELF_COLLISION if self_collision is None else self_collision
        self._counts_crossings = count_crossings
        self._compute_device = choose_compute_device(sim_backend)
        self._render_device_name = choose_render_device(render_backend, render_mode, base_mode)
        self._drawn_worlds = range(num_envs)
        self._is_drawn = render_mode is not None or needs_camera(base_mode)
        with torch.inference_mode(False):  # whoever makes an environment in that mode may use it outside
            super().__init__(
                num_envs=num_envs,
                obs_mode=base_mode,
                render_mode=render_mode,
                robot_uids=team,
                control_mode=control_mode,
                # Both are replaced in `backend`. PhysX stays empty, and on the CPU so as not to take
                # GPU memory.
                sim_backend="physx_cpu",
                render_backend="none",
                **settings,
            )
        if render_mode in ("sensors", "all") and not needs_camera(base_mode):
            self.obs_mode_struct.visual.rgb = True  # what ManiSkill's pictures of sensors show

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        if "GRIPPER_COUNTS" in cls.__dict__ and "SUPPORTED_ROBOTS" not in cls.__dict__:
            cls.SUPPORTED_ROBOTS = supported_robots(cls.GRIPPER_COUNTS)

    def _check_hooks(self) -> None:
        task = type(self)
        missing = [name for name in dir(task) if getattr(getattr(task, name), "__isabstractmethod__", False)]
        missing += [name for name in ("GRIPPER_COUNTS", "DEFAULT_NUM_GRIPPERS", "PROGRESS") if not hasattr(task, name)]
        if missing:
            raise TypeError(f"{task.__name__} must define {', '.join(missing)}; see DeformableEnv")

    # ------------------------------------------------------------------ what a task implements

    @abstractmethod
    def build_models(self) -> Sequence[Model]:
        """Build the variants of the object; every episode draws one of them."""

    def build_colliders(self) -> Sequence[Collider]:
        """Build the obstacles, the same in all worlds but for pose, size and switch; none by default."""
        return ()

    @abstractmethod
    def candidate_gripper_nodes(self, model: Model) -> np.ndarray:
        """Return the nodes of a variant at which grippers may start; a thinned graph shows them all."""

    @classmethod
    def default_arm_bases(cls, num_arms: int) -> np.ndarray:
        """Return where arms stand where `robot_poses` does not say, (A, 4, 4); round the table by default."""
        return round_the_table(num_arms)

    def allocate_episode(self) -> None:
        """Create the tensors of an episode with `episode_tensor`; none by default."""

    @abstractmethod
    def start_episode(self, worlds: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw an episode for some worlds (b,), whose variants are drawn already: write goals and obstacles.

        Random numbers come from `draw_uniform`, so that the episode of a world depends on its own
        seed alone.

        Returns:
            Positions of the nodes, (b, N, 3) [m], finite also in the padding, and the node that each
            gripper holds, (b, A) int64.
        """

    # ------------------------------------------------------------------ building the scene

    @property
    def _default_sim_config(self) -> SimConfig:
        return SimConfig(sim_freq=CONTROL_FREQ, control_freq=CONTROL_FREQ)

    @property
    def backend(self) -> Any:
        """ManiSkill's record of the backends in use: "warp_cpu" or "warp_cuda", and what draws."""
        return self._backend

    @backend.setter
    def backend(self, backend: Any) -> None:
        # ManiSkill forbids several worlds on a backend of the name "physx_cpu", which this is not.
        backend.sim_backend = f"warp_{self._compute_device.type}"
        name = self._render_device_name
        backend.render_device = None if name is None else sapien.Device(name)
        drawn = f"warp_{self._compute_device.type}" if self._is_drawn else "none"
        backend.render_backend = drawn if name is None else f"sapien_{name}"
        self._backend = backend

    def _adopt_compute_device(self) -> None:
        """Move to the device of the solver.

        Not earlier than the first reset: ManiSkill's constructor starts PhysX on the GPU when it
        meets a CUDA device.
        """
        if self.device != self._compute_device:
            self.device = self.backend.device = self._compute_device
            self._elapsed_steps = self._elapsed_steps.to(self.device)

    def _reconfigure(self, options: dict) -> None:
        with torch.inference_mode(False):
            super()._reconfigure(options)

    def _setup_scene(self) -> None:
        if self._sim_steps_per_control != 1:
            raise ValueError(
                "sim_config must have sim_freq equal to control_freq (the solver has its own "
                f"substeps), got {self._sim_freq} and {self._control_freq}"
            )
        self._set_scene_config()
        self.models = tuple(self.build_models())
        self.solver = Solver(
            self.models,
            self.num_envs,
            self.num_grippers,
            control_dt=self.control_timestep,
            substeps=self._substeps,
            grip_strength=self._grip_strength,
            device=self.device,
            num_threads=self._num_threads,
            colliders=self.build_colliders(),
            self_collision=self._self_collision,
            links=self._links,
        )
        self.start_nodes = torch.zeros(self.num_envs, self.num_grippers, dtype=torch.int64, device=self.device)
        systems: list[sapien.System] = [sapien.physx.PhysxCpuSystem()]
        if self.backend.render_device is not None:
            systems.append(sapien.render.RenderSystem(self.backend.render_device))
        self.scene = BatchedScene(
            sapien.Scene(systems),
            self.solver,
            has_free_grasps=self.grasp == "free",
            sim_config=self.sim_config,
            device=self.device,
            backend=self.backend,
        )
        self.scene.px.timestep = self.sim_timestep

    def _load_scene(self, options: dict) -> None:
        self._episode = EpisodeTensors(self.num_envs, self.device)
        self.allocate_episode()
        self._set_up_observations()
        self._set_up_graph()
        self._set_up_drawing(options)

    def episode_tensor(self, name: str, *shape: int, kind: Kind) -> torch.Tensor:
        """Return zeros (B, *shape), float32, that are part of the state of an episode and move with its world."""
        return self._episode.allocate(name, *shape, kind=kind)

    # ------------------------------------------------------------------ reset

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict) -> None:
        worlds = self._world_indices(env_idx)
        self._start_within_reach(worlds)
        self.scene.grip_commands[worlds] = True
        for agent in self._agents:
            agent.robot.place(worlds)
        self.forget_measurement()

    def _start_anywhere(self, worlds: torch.Tensor) -> None:
        """Draw an episode for some worlds (b,), and put objects and grippers where it starts."""
        solver = self.solver
        solver.gravity[worlds] = torch.tensor([0.0, 0.0, -STANDARD_GRAVITY], device=self.device)
        height = 0.0 if self.HAS_TABLE else -OUT_OF_REACH
        solver.plane[worlds] = torch.tensor([0.0, 0.0, 1.0, height], device=self.device)
        solver.reset(worlds, variants=self.draw_choice(worlds, len(self.models)))
        positions, nodes = self.start_episode(worlds)
        self._check_start(worlds, positions, nodes)
        self.start_nodes[worlds] = self._share_nodes(worlds, positions, nodes)
        if self._material.num_draws:
            (draws,) = self.draw_uniform(worlds, self._material.num_draws)
            solver.set_material(worlds, **self._material.factors(draws))
        solver.reset(worlds, positions, self.start_nodes[worlds])
        self._start_observing(worlds)

    # ------------------------------------------------------------------ one control step

    def _before_simulation_step(self) -> None:
        self.forget_measurement()
        for agent in self._agents:
            agent.robot.start_motion()

    def _after_simulation_step(self) -> None:
        for agent in self._agents:
            agent.robot.finish_motion(self.control_timestep)
        super()._after_simulation_step()

    def get_info(self) -> dict[str, torch.Tensor]:
        """Return `elapsed_steps`, what `evaluate` measures, how arms get on, `dropped_contacts` (B,) and `slips` (B, A)."""
        info = super().get_info() | self._arm_info()
        info |= self_contact_info(self.solver, counts_crossings=self._counts_crossings)
        if self.solver.grip_strength is not None:
            info["slips"] = self.solver.slips.clone()
        info["elapsed_steps"] = info["elapsed_steps"].clone()
        return info


def _check_choice(name: str, value: str | None, allowed: tuple[str | None, ...]) -> None:
    if value not in allowed:
        raise ValueError(f"{name} must be one of {list(allowed)}, got {value!r}")
