"""Recorded episodes are replayed exactly, each by itself."""

import gc
import json
import subprocess
import sys

import gymnasium as gym
import h5py
import numpy as np
import pytest
import torch
from mani_skill.utils.registration import REGISTERED_ENVS
from mani_skill.utils.wrappers import RecordEpisode

import maniskill_grpd  # noqa: F401  (registers)
from maniskill_grpd.tasks import DeformableEnv, RopeShapingEnv
from maniskill_grpd.trajectory.episode_recorder import EpisodeRecorder
from maniskill_grpd.trajectory.replay import main, replay

TASKS = sorted(uid for uid, spec in REGISTERED_ENVS.items() if issubclass(spec.cls, DeformableEnv))


@pytest.fixture(autouse=True)
def no_garbage_collection(monkeypatch):
    """ManiSkill collects garbage whenever it builds or closes a scene: most of the tests' time."""
    monkeypatch.setattr(gc, "collect", lambda: 0)


def record(folder, env_id="RopeShaping-v1", *, seeds=(4, 5, 6), lengths=5, **options):
    """Record episodes of random actions, as long as `lengths` says in turn, and return the path of the .h5 file."""
    num = len(seeds)
    env = gym.make(env_id, num_envs=num, obs_mode="graph", sim_backend="cpu", max_episode_steps=int(np.max(lengths)), **options)
    env = EpisodeRecorder(env, folder, trajectory_name="trajectory", save_video=False, save_on_reset=False)
    env.reset(seed=list(seeds))
    generator = torch.Generator().manual_seed(0)
    for step in range(np.max(lengths)):
        env.step(0.6 * torch.randn(num, *env.get_wrapper_attr("single_action_space").shape, generator=generator))
        env.keep(np.flatnonzero(np.broadcast_to(lengths, num) == step + 1))
    env.close()
    return folder / "trajectory.h5"


def replayed(path, *flags, mode="state"):
    """Replay and return the new file."""
    replay(["--traj-path", str(path), "--save-traj", "-o", mode, *flags])
    return next(file for file in path.parent.glob(f"trajectory.{mode}.*.h5"))


def episodes_of(path):
    """Return the episodes of a recording by their seeds, each with its entry and its data."""
    entries = json.loads(path.with_suffix(".json").read_text())["episodes"]
    with h5py.File(path) as file:
        return {entry["episode_seed"]: (entry, read(file[f"traj_{entry['episode_id']}"])) for entry in entries}


def read(group):
    return {key: read(value) if isinstance(value, h5py.Group) else value[:] for key, value in group.items()}


def assert_equal(tree, other):
    assert tree.keys() == other.keys()
    for key, value in tree.items():
        if isinstance(value, dict):
            assert_equal(value, other[key])
        else:
            np.testing.assert_array_equal(value, other[key], err_msg=key)


@pytest.mark.parametrize("flags", [[], ["--use-env-states"], ["--use-first-env-state"]])
@pytest.mark.parametrize("env_id", TASKS)
def test_replayed_episodes_are_bitwise_those_that_were_recorded(env_id, flags, tmp_path):
    """States once came a step late when they were replayed, rewards with them."""
    path = record(tmp_path, env_id)
    old, new = (
        episodes_of(path),
        episodes_of(replayed(path, "--allow-failure", "--record-rewards", "-n", "2", *flags, mode="graph")),
    )
    assert new.keys() == old.keys()
    for seed, (entry, data) in old.items():
        assert new[seed][0]["elapsed_steps"] == entry["elapsed_steps"] == 5
        assert_equal(new[seed][1], data)


@pytest.mark.parametrize("num_envs", [1, 2, 3, 4])
@pytest.mark.parametrize("outcomes", ["FTFT", "TFFT", "FFTF", "FFFF"])
def test_an_episode_that_fails_is_not_glued_to_the_next_one_that_succeeds(tmp_path, monkeypatch, outcomes, num_envs):
    path = record(tmp_path, seeds=(1, 2, 3, 4), lengths=[3, 5, 4, 5])
    good = [seed for seed, outcome in enumerate(outcomes, start=1) if outcome == "T"]
    evaluate = RopeShapingEnv.evaluate

    def judged_by_seed(self):
        seeds = torch.as_tensor(np.asarray(self._episode_seed))
        return evaluate(self) | {"success": torch.isin(seeds, torch.tensor(good))}

    monkeypatch.setattr(RopeShapingEnv, "evaluate", judged_by_seed)
    old, new = episodes_of(path), episodes_of(replayed(path, "-n", str(num_envs), mode="graph"))
    assert sorted(new) == good
    for seed in good:
        np.testing.assert_array_equal(new[seed][1]["actions"], old[seed][1]["actions"])
        assert_equal(new[seed][1]["env_states"], old[seed][1]["env_states"])


def test_states_are_kept_where_the_physics_differs(tmp_path, monkeypatch):
    """The point of replaying states: another machine's arithmetic, here another gravity, changes nothing."""
    path = record(tmp_path, "ClothHanging-v1")
    step = DeformableEnv._before_simulation_step

    def step_in_a_wind(self):
        step(self)
        self.solver.gravity[:, 0] = 5.0

    monkeypatch.setattr(DeformableEnv, "_before_simulation_step", step_in_a_wind)
    old = episodes_of(path)
    by_states = episodes_of(replayed(path, "--allow-failure", "--record-rewards", "--use-env-states", "-n", "3", mode="graph"))
    by_actions = episodes_of(replayed(path, "--allow-failure", "-n", "3", mode="graph+state"))
    for seed, (_, data) in old.items():
        assert_equal(by_states[seed][1], data)
        assert (by_actions[seed][1]["env_states"]["solver"]["positions"] != data["env_states"]["solver"]["positions"]).any()


def test_episodes_of_several_agents_are_recorded_and_replayed(tmp_path):
    """ManiSkill's own recorder stops at the first reset: 'dict' object has no attribute 'repeat'."""
    team = ("floating_grippers_1", "floating_grippers_3")
    path = record(tmp_path, robot_uids=team)
    old, new = episodes_of(path), episodes_of(replayed(path, "--allow-failure", "-n", "2", "--record-rewards", mode="graph"))
    for seed, (_, data) in old.items():
        assert data["actions"].shape == (5, 12)
        assert_equal(new[seed][1], data)


def test_actions_of_several_agents_are_recorded_side_by_side(tmp_path):
    env = gym.make("RopeShaping-v1", num_envs=2, sim_backend="cpu", robot_uids=("floating_grippers_1", "floating_grippers_3"))
    recorder = EpisodeRecorder(env, tmp_path, trajectory_name="trajectory", save_video=False)
    recorder.reset(seed=[1, 2])
    actions = {"floating_grippers_1-0": torch.rand(2, 3), "floating_grippers_3-1": torch.rand(2, 9)}
    recorder.step(actions)
    recorder.close()
    for world, (_, data) in enumerate(episodes_of(tmp_path / "trajectory.h5").values()):
        np.testing.assert_array_equal(data["actions"][0], torch.cat([part[world] for part in actions.values()]))


def test_recordings_of_maniskills_own_wrapper_are_replayed(tmp_path):
    env = gym.make("RopeShaping-v1", num_envs=1, obs_mode="graph", sim_backend="cpu")
    env = RecordEpisode(env, tmp_path, trajectory_name="trajectory", save_video=False)
    env.reset(seed=7)
    for _ in range(2):
        env.step(env.action_space.sample())
    env.close()
    path = tmp_path / "trajectory.h5"
    assert_equal(episodes_of(replayed(path, "--allow-failure", "--record-rewards", mode="graph"))[7][1], episodes_of(path)[7][1])


def test_videos_show_the_batches_that_hold_something_wanted(tmp_path, monkeypatch):
    path = record(tmp_path, seeds=(1, 2, 3))
    evaluate = RopeShapingEnv.evaluate
    monkeypatch.setattr(
        RopeShapingEnv,
        "evaluate",
        lambda self: evaluate(self) | {"success": torch.as_tensor(np.asarray(self._episode_seed) == 2)},
    )
    assert replay(["--traj-path", str(path), "--save-video", "--no-save-traj"]) == 1
    assert len(list(tmp_path.glob("*.mp4"))) == 1


# ---------------------------------------------------------------- what is refused


def edit(path, change):
    """Rewrite the .json file of a recording."""
    record = json.loads(path.with_suffix(".json").read_text())
    change(record)
    path.with_suffix(".json").write_text(json.dumps(record))


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


DAMAGES = {
    "no .h5": (lambda path: path.unlink(), r"trajectory\.h5 is missing"),
    "no .json": (lambda path: path.with_suffix(".json").unlink(), r"trajectory\.json is missing"),
    "cut .h5": (cut, r"trajectory\.h5 is not whole"),
    "empty .h5": (lambda path: path.write_bytes(b""), r"trajectory\.h5 is not whole"),
    "cut .json": (lambda path: cut(path.with_suffix(".json")), r"trajectory\.json is not whole"),
    "a list": (lambda path: path.with_suffix(".json").write_text("[]"), "must hold an object, got list"),
    "no env_info": (lambda path: edit(path, lambda record: record.pop("env_info")), "has no 'env_info'"),
    "null env_info": (lambda path: edit(path, lambda record: record.update(env_info=None)), "has no 'env_info'"),
    "no env_kwargs": (lambda path: edit(path, lambda record: record["env_info"].pop("env_kwargs")), "has no 'env_kwargs'"),
    "no env_id": (lambda path: edit(path, lambda record: record["env_info"].pop("env_id")), "env_id must be the id of a task"),
    "odd limit": (lambda path: edit(path, lambda r: r["env_info"].update(max_episode_steps="5")), "must be a positive number"),
    "foreign task": (lambda path: edit(path, lambda r: r["env_info"].update(env_id="PickCube-v1")), "none of the tasks"),
    "unknown task": (lambda path: edit(path, lambda r: r["env_info"].update(env_id="Knot-v1")), "none of the tasks"),
    "odd option": (lambda path: edit(path, lambda r: r["env_info"]["env_kwargs"].update(colour=1)), "cannot be made.*colour"),
    "bad option": (lambda path: edit(path, lambda r: r["env_info"]["env_kwargs"].update(pose_range=7)), "pose_range must be"),
    "no episodes": (lambda path: edit(path, lambda record: record.update(episodes=[])), "lists no episodes"),
    "without episodes": (lambda path: edit(path, lambda record: record.pop("episodes")), "has no 'episodes'"),
    "odd episode": (lambda path: edit(path, lambda record: record.update(episodes=[5])), "an episode needs episode_id"),
    "odd seed": (
        lambda path: edit(path, lambda record: record["episodes"][0].update(episode_seed="x")),
        "must be a whole number",
    ),
    "other episode": (lambda path: edit(path, lambda r: r["episodes"][0].update(episode_id=9)), "lacks the actions .* traj_9"),
}


@pytest.fixture(scope="module")
def pristine(tmp_path_factory):
    return record(tmp_path_factory.mktemp("pristine"), seeds=(1,), lengths=2)


@pytest.fixture
def copied(pristine, tmp_path):
    """Return the path of a copy of a short recording, to be damaged."""
    for file in (pristine, pristine.with_suffix(".json")):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path / pristine.name


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_recordings_are_refused_in_one_line(copied, damage, capsys):
    do, message = DAMAGES[damage]
    do(copied)
    before = {file.name for file in copied.parent.iterdir()}
    assert main(["--traj-path", str(copied), "--save-traj", "-o", "state"]) == 1
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    with pytest.raises((OSError, ValueError), match=message):
        replay(["--traj-path", str(copied)])
    assert "Traceback" not in error
    assert {file.name for file in copied.parent.iterdir()} == before


def test_states_that_do_not_fit_leave_no_half_written_output(copied):
    with h5py.File(copied, "a") as file:
        del file["traj_0/env_states/solver/velocities"]
    with pytest.raises(ValueError, match="velocities"):
        replay(["--traj-path", str(copied), "--save-traj", "-o", "state", "--use-env-states"])
    with h5py.File(copied, "a") as file:
        del file["traj_0/env_states"]
    with pytest.raises(ValueError, match="has no states of traj_0"):
        replay(["--traj-path", str(copied), "--save-traj", "-o", "state", "--use-first-env-state"])
    assert len(list(copied.parent.iterdir())) == 2


def test_modules_named_by_a_recording_are_imported_only_when_allowed(copied, monkeypatch):
    """Gymnasium imports what stands before the colon of an id: a file could run code."""
    (copied.parent / "planted.py").write_text("from pathlib import Path\nPath(__file__).with_suffix('.ran').touch()\n")
    monkeypatch.syspath_prepend(str(copied.parent))
    edit(copied, lambda record: record["env_info"].update(env_id="planted:RopeShaping-v1"))
    with pytest.raises(ValueError, match=r"would import the Python module 'planted'.*--allow_import"):
        replay(["--traj-path", str(copied)])
    assert not (copied.parent / "planted.ran").exists()
    replay(["--traj-path", str(copied), "--allow_import"])
    assert (copied.parent / "planted.ran").exists()


def test_outputs_are_not_overwritten(copied):
    output = replayed(copied, "--allow-failure")
    before = output.read_bytes()
    with pytest.raises(FileExistsError, match="exists; move it away"):
        replayed(copied, "--allow-failure")
    with pytest.raises(FileExistsError, match="exists; move it away"):
        replay(["--traj-path", str(output), "--save-traj", "-o", "state"])  # onto itself
    assert output.read_bytes() == before


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["-b", "tpu"], "unknown sim_backend 'tpu'"),
        (["-n", "0"], "num_envs must be >= 1, got 0"),
        (["--count", "0"], "count must be >= 1, got 0"),
        (["-c", "pd_ee_delta_pos_grip"], "cannot be converted from one control mode to another"),
    ],
)
def test_options_that_do_not_fit_are_refused(copied, flags, message):
    with pytest.raises(ValueError, match=message):
        replay(["--traj-path", str(copied), *flags])


def test_the_command_reports_errors_without_a_traceback(tmp_path):
    command = [sys.executable, "-m", "maniskill_grpd.trajectory.replay", "--traj-path", str(tmp_path / "nothing.h5")]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert "error: no recorded trajectory" in result.stderr
    assert "Traceback" not in result.stderr
