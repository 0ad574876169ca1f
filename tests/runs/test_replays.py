"""Replays of evaluations and demonstrations show the episodes that they say."""

import json
import re
from pathlib import Path

import pytest
import torch

from maniskill_grpd.imitation.recording import RecordConfig, record
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.environments import make_env
from maniskill_grpd.runs.evaluation import EvaluationConfig, evaluate, record_worst_and_median
from maniskill_grpd.runs.replays import Filming, worst_and_median

CHECKPOINT = Path(__file__).parents[2] / "checkpoints" / "rope_shaping_w.pt"


def header_of(path: Path) -> dict:
    found = re.search(r'<script id="header"[^>]*>(.*?)</script>', path.read_text(encoding="utf-8"), re.DOTALL)
    return json.loads(found.group(1))


def test_worst_and_median_of_an_odd_and_an_even_number_of_episodes():
    assert worst_and_median(torch.tensor([3.0, 1.0, 2.0])) == (1, 2)
    assert worst_and_median(torch.tensor([4.0, 3.0, 1.0, 2.0])) == (2, 3)
    assert worst_and_median(torch.tensor([5.0])) == (0, 0)


def test_an_evaluation_shows_its_worst_and_its_median_episode(tmp_path):
    config = EvaluationConfig(checkpoint=CHECKPOINT, num_episodes=5, num_envs=5, sim_backend="cpu", html=tmp_path / "replay.html")
    found = evaluate(config)
    record_worst_and_median(config, found)
    header = header_of(config.html)
    order = found.episodes["return"].argsort()
    for name, which in (("worst", int(order[0])), ("median", int(order[2]))):
        assert f"{name} episode: seed {config.seed + which}, return {found.episodes['return'][which]:.1f}" in header["title"]
    assert header["numFrames"] == 101
    solved = int(found.episodes["success_at_end"][order[[0, 2]]].sum())
    assert header["captions"][-1] == f"step 100 · solved {solved} of 2"
    assert config.html.stat().st_size < 2_000_000


def test_without_a_file_there_is_no_replay():
    config = EvaluationConfig(checkpoint=CHECKPOINT, num_episodes=1, num_envs=1, sim_backend="cpu")
    with pytest.raises(ValueError, match="--html"):
        record_worst_and_median(config, evaluate(config))


def test_demonstrations_show_their_first_episodes_once(tmp_path):
    config = RecordConfig(
        env_id="RopeShaping-v1",
        env_kwargs=("max_episode_steps=5",),
        num_episodes=4,
        num_envs=2,
        output=tmp_path,
        html=tmp_path / "demos.html",
        keep_failures=True,
        sim_backend="cpu",
    )
    assert record(config)[1] == 4
    header = header_of(tmp_path / "demos.html")
    assert header["captions"] == [f"step {step} · solved 0 of 2" for step in range(6)]
    with pytest.raises(FileExistsError):
        record(RecordConfig(output=tmp_path / "other", html=tmp_path / "demos.html"))


def test_a_film_has_a_frame_for_every_state(tmp_path):
    env = make_env(TrainConfig(env_id="RopeShaping-v1", sim_backend="cpu"), 3)
    env.reset(seed=[1, 2, 3])
    filming = Filming(env, [2], "one of three")
    filming.shoot()
    for _ in range(4):
        env.step(torch.zeros(3, env.action_space.shape[-1]))
        filming.shoot()
    assert len(filming.replay) == 5
    assert header_of(filming.replay.write(tmp_path / "one.html"))["captions"][-1] == "step 4 · solved 0 of 1"
    env.close()
