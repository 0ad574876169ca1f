"""Tasks written outside the package: the one of examples/own_task.py, and what its author may get wrong."""

import gc
import importlib.util
import runpy
import sys
from pathlib import Path

import gymnasium as gym
import pytest
import torch
from mani_skill.utils.registration import REGISTERED_ENVS

from maniskill_grpd.experts import EXPERTS, Expert, make_expert, register_expert
from maniskill_grpd.graphs import Channel
from maniskill_grpd.tasks import Measurement, Metric, check_task

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "own_task.py"
ENV_ID = "RopeClosing-v1"
NOISE = Channel("noise", "scalar", "", "")


@pytest.fixture
def task(monkeypatch):
    """Return the class of the example, registered for the time of a test."""
    monkeypatch.setattr(gc, "collect", lambda: 0)
    spec = importlib.util.spec_from_file_location("own_task", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "own_task", module)
    spec.loader.exec_module(module)
    yield module.RopeClosingEnv
    del REGISTERED_ENVS[ENV_ID], gym.registry[ENV_ID]
    EXPERTS.pop(ENV_ID, None)


def make(task, num_envs=3, **changes):
    """Make a task, some of whose attributes are changed."""
    changed = type(task.__name__, (task,), changes)
    env = changed(num_envs=num_envs, sim_backend="cpu", render_backend="none")
    env.reset(seed=0)
    return env


def test_the_example_is_short_and_keeps_its_promises(task):
    assert len(EXAMPLE.read_text().splitlines()) <= 60
    check_task(make(task))
    check_task(gym.make(ENV_ID, num_envs=2, obs_mode="state", sim_backend="cpu", render_backend="none"))


class ClosingExpert(Expert):
    """Pulls both ends straight to the point."""

    def act(self):
        """See `Expert.act`."""
        ways = (self.env.goal[:, None] - self.env.solver.gripper_positions) / 0.03
        return (ways / ways.norm(dim=-1, keepdim=True).clamp(min=1.0)).flatten(1)


def test_an_own_expert_solves_the_example(task):
    with pytest.raises(TypeError, match=r"ClosingExpert.task must be the class"):
        register_expert(ENV_ID, ClosingExpert)
    register_expert(ENV_ID, type("OwnExpert", (ClosingExpert,), {"task": task}))
    env = gym.make(ENV_ID, num_envs=8, sim_backend="cpu", render_backend="none")
    env.reset(seed=0)
    expert = make_expert(f"own_task:{ENV_ID}", env)  # as it is named where its module has to be imported
    for _ in range(40):
        info = env.step(expert.act())[4]
    assert info["success"].all()
    env.close()


def test_gallery_and_benchmarks_find_a_task_by_its_registration(task, monkeypatch):
    for folder in ("benchmarks", "tools/docs"):
        monkeypatch.syspath_prepend(str(ROOT / folder))
    benchmark, gallery = (runpy.run_path(str(ROOT / name)) for name in ("benchmarks/tasks.py", "tools/docs/task_gallery.py"))
    assert ENV_ID in benchmark["task_ids"]()
    assert ENV_ID not in gallery["episodes"]()  # nothing to show without an expert
    register_expert(ENV_ID, type("OwnExpert", (ClosingExpert,), {"task": task}))
    frames, num_steps = gallery["play_expert"](ENV_ID, gallery["episodes"]()[ENV_ID])
    assert 5 < num_steps < len(frames)
    env = benchmark["make_env"](ENV_ID, 2)
    scores = benchmark["play"](env, make_expert(ENV_ID, env).act, [0, 1])
    assert scores["success_at_end"] == 1.0


@pytest.mark.parametrize(
    ("env_id", "expert", "error", "message"),
    [
        ("RopeShaping-v1", type("Mine", (Expert,), {"task": object}), ValueError, "has an expert already, RopeShapingExpert"),
        ("Mine-v1", object, TypeError, "must be a subclass of Expert"),
    ],
)
def test_experts_that_are_none_or_too_many_are_refused(env_id, expert, error, message):
    before = dict(EXPERTS)
    with pytest.raises(error, match=message):
        register_expert(env_id, expert)
    assert before == EXPERTS


def all_worlds(method):
    """Spoil a method so that it forgets which worlds start."""

    def start_episode(self, worlds):
        positions, nodes = method(self, worlds)
        self.goal[:] = self.goal[worlds][:1]
        return positions, nodes

    return start_episode


def wrong_start(positions=lambda given: given, nodes=lambda given: given):
    def spoil(method):
        def start_episode(self, worlds):
            given = method(self, worlds)
            return positions(given[0]), nodes(given[1])

        return start_episode

    return spoil


def with_metrics(**metrics):
    return lambda method: lambda self: Measurement(success=self.solver.frozen, metrics=metrics)


def adding(values):
    return lambda method: lambda self, measurement: {**method(self, measurement), **values(self)}


WRONG = {
    "a start node that is none": (
        {"start_episode": wrong_start(nodes=lambda nodes: nodes + 1)},
        r"starts grippers at nodes .*21",
    ),
    "too few start nodes": ({"start_episode": wrong_start(nodes=lambda nodes: nodes[:, :1])}, r"nodes of the grippers \(3, 2\)"),
    "positions without height": (
        {"start_episode": wrong_start(lambda x: x[..., :2])},
        r"positions \(3, 21, 3\), got \(3, 21, 2\)",
    ),
    "positions that are none": ({"start_episode": wrong_start(lambda x: x * torch.nan)}, "finite positions"),
    "a start node that is no candidate": (
        {"start_episode": wrong_start(nodes=lambda nodes: nodes.clamp(1, 19))},
        "candidate_gripper_nodes",
    ),
    "a goal that other worlds share": ({"start_episode": all_worlds}, "seed of its own world|leave the others unchanged"),
    "a channel without values": ({"OBJECT_CHANNELS": (NOISE,)}, r"OBJECT_CHANNELS declares \['noise'\]"),
    "a value without a channel": ({"gripper_values": adding(lambda self: {"noise": 0})}, r"returns \['noise'\], which GRIPPER"),
    "a value of a wrong shape": (
        {"gripper_values": adding(lambda self: {"goal_distance": torch.zeros(3, 5)})},
        r"\['goal_distance'\] is a scalar and must be \(3, 2\), got \(3, 5\)",
    ),
    "a value that is not finite": (
        {"object_values": adding(lambda self: {"goal_distance": torch.full((3, 21), torch.inf)})},
        "scalars must be finite",
    ),
    "a channel of the world's frame": (
        {"object_values": adding(lambda self: {"goal_distance": self.solver.positions[..., 0]})},
        r"\['goal_distance'\], do not move with the scene",
    ),
    "a reward beyond 1": (
        {"reward": lambda method: lambda self, m: 2.0 + method(self, m)},
        r"rewards must be in \[0, 1\], got 2",
    ),
    "a reward that is none": ({"reward": lambda method: lambda self, m: method(self, m) * torch.nan}, "rewards must be in"),
    "a reward per gripper": ({"reward": lambda method: lambda self, m: torch.zeros(3, 2)}, r"must be \(3,\), got \(3, 2\)"),
    "a reward of the world's frame": (
        {"reward": lambda method: lambda self, m: self.solver.positions[:, 0, 0].sigmoid()},
        "rewards must not depend on the frame",
    ),
    "a metric of progress that is not measured": ({"PROGRESS": Metric("distance", "m")}, r"names 'distance'.*ends_distance"),
    "a metric per node": ({"measure": with_metrics(ends_distance=torch.zeros(3, 21))}, r"'ends_distance' of measure\(\)"),
    "a measurement that is none": ({"measure": lambda method: lambda self: {}}, "must return a Measurement, got dict"),
    "a drawing that is none": ({"drawing": lambda method: lambda self, world: None}, "must return a Drawing, got NoneType"),
    "a memory that is not part of the state": (
        {"reward": lambda method: lambda self, m: torch.full((3,), 0.5 * (1 - 1 / (1 + int(self._control_seed()))))},
        "restored state must go on",
    ),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_mistakes_are_named(task, mistake):
    changes, message = WRONG[mistake]
    methods = {
        name: change(getattr(task, name)) if callable(change) else getattr(task, name, ()) + change if name.isupper() else change
        for name, change in changes.items()
        if not isinstance(change, Metric)
    }
    methods |= {name: change for name, change in changes.items() if isinstance(change, Metric)}
    calls = iter(range(10**6))
    methods["_control_seed"] = lambda self: next(calls)
    with pytest.raises((ValueError, TypeError), match=message):
        check_task(make(task, **methods))


@pytest.mark.parametrize("hook", ["measure", "reward", "start_episode", "build_models", "candidate_gripper_nodes", "PROGRESS"])
def test_a_task_without_a_hook_is_refused(task, hook):
    """By name, and not by what fails later."""
    from maniskill_grpd.tasks import DeformableEnv

    names = ("GRIPPER_COUNTS", "DEFAULT_NUM_GRIPPERS", "PROGRESS", "measure", "reward", "start_episode", "build_models")
    parts = {name: task.__dict__[name] for name in (*names, "candidate_gripper_nodes") if name != hook}
    with pytest.raises(TypeError, match=f"Part must define {hook}"):
        type("Part", (DeformableEnv,), parts)(sim_backend="cpu")
