"""The command-line scripts on a tiny rope task."""

import json
import shlex

import imageio.v2 as imageio
import numpy as np
import pytest
import torch
import tyro

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import evaluate, plot, train
from maniskill_grpd.learning import TrainConfig, load_checkpoint, save_checkpoint
from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.runs import demo, video
from maniskill_grpd.runs.checkpoint_card import UNIMPORTANT

SIZES = "--num_envs 4 --num_steps 5 --num_minibatches 2 --update_epochs 1 --num_eval_envs 2"
RHYTHM = "--eval_freq 1 --checkpoint_freq 2 --no-capture_video"
TASK = "--env_kwargs resolution=20 num_grippers=2"
TINY = f"{SIZES} {RHYTHM} {TASK}".split()


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    """Train for four iterations of 20 steps."""
    folder = tmp_path_factory.mktemp("work")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert train.main([*TINY, "--exp_name", "whole", "--total_timesteps", "80"]) == 0
    return folder / "runs" / "whole"


def test_training_leaves_a_complete_folder(run_dir):
    names = {path.name for path in run_dir.iterdir()}
    assert names >= {"config.json", "metrics.jsonl", "last.pt", "best_ckpt.pt", "final_ckpt.pt", "learning_curve.png"}
    record = json.loads((run_dir / "config.json").read_text())
    assert record["config"]["env_id"] == "RopeShaping-v1"
    assert record["versions"]["torch"].startswith(torch.__version__.split("+")[0])
    if not torch.cuda.is_available():
        assert torch.backends.cpu.get_cpu_capability() in record["device_name"]
    assert len(read_rows(run_dir / "metrics.jsonl", "eval")) == 4


def test_a_run_that_stopped_half_way_ends_like_one_that_did_not(run_dir, monkeypatch):
    monkeypatch.chdir(run_dir.parents[1])
    assert train.main([*TINY, "--exp_name", "half", "--total_timesteps", "40"]) == 0
    assert train.main(["--resume", "runs/half", "--total_timesteps", "80"]) == 0
    whole, half = (load_checkpoint(f"runs/{name}/final_ckpt.pt") for name in ("whole", "half"))
    for key in ("weights", "optimizer", "value_scale", "generators"):
        torch.testing.assert_close(whole[key], half[key], rtol=0, atol=0)


def test_an_existing_run_is_not_overwritten(run_dir, monkeypatch, capsys):
    monkeypatch.chdir(run_dir.parents[1])
    assert train.main([*TINY, "--exp_name", "whole", "--total_timesteps", "80"]) == 1
    assert "continue it with --resume runs/whole" in capsys.readouterr().err


def test_resuming_a_folder_that_is_no_run_is_one_line(tmp_path, capsys):
    assert train.main(["--resume", str(tmp_path)]) == 1
    assert "not the folder of a run" in capsys.readouterr().err


def test_resuming_cannot_change_the_task(run_dir, monkeypatch, capsys):
    monkeypatch.chdir(run_dir.parents[1])
    assert train.main(["--resume", "runs/whole", "--gamma", "0.5"]) == 1
    assert "gamma: the checkpoint has 0.99, here it is 0.5" in capsys.readouterr().err


def test_bad_options_are_explained(capsys):
    assert train.main(["--algorithm", "trpo"]) == 2
    assert "Expected one of ('bpp', 'ppo')" in capsys.readouterr().err


def test_free_grasps_are_trained_and_played_with_a_gripper_output(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = [*TINY, "grasp=free", "--exp_name", "free", "--total_timesteps", "20"]
    assert train.main(arguments) == 0
    contents = load_checkpoint("runs/free/final_ckpt.pt")
    assert contents["policy"]["options"]["gripper"] is True
    rows = read_rows(tmp_path / "runs" / "free" / "metrics.jsonl", "train")
    assert 0.0 < rows[0]["charts/grip_closed"] < 1.0
    assert evaluate.main(["--checkpoint", "runs/free/final_ckpt.pt", "--num_episodes", "1"]) == 0
    refused = [*TINY, "grasp=free", "--exp_name", "other", "--policy_kwargs", "gripper=false"]
    assert train.main([*refused, "--total_timesteps", "20"]) == 1
    assert "gripper=false but the task opens and closes grippers" in capsys.readouterr().err


def test_materials_vary_and_observations_are_noisy_in_training(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ['material={"stretch": [0.5, 2], "friction": [0.5, 1.5]}', "--position_noise", "0.01"]
    arguments = [*TINY, *options, "--velocity_noise", "0.05", "--exp_name", "noisy"]
    assert train.main([*arguments, "--total_timesteps", "20"]) == 0
    config = load_checkpoint("runs/noisy/final_ckpt.pt")["train_config"]
    assert config["position_noise"] == 0.01


def test_curves_of_unknown_metrics_are_refused_with_what_there_is(run_dir, capsys):
    assert plot.main([str(run_dir), "--metrics", "speed"]) == 1
    assert "has not logged speed; it has" in capsys.readouterr().err
    assert plot.main([str(run_dir), "--metrics", "return", "success_at_end"]) == 0


def test_training_starts_from_given_weights(run_dir, monkeypatch):
    monkeypatch.chdir(run_dir.parents[1])
    arguments = [*TINY, "--exp_name", "tuned", "--total_timesteps", "20", "--learning_rate", "1e-12"]
    assert train.main([*arguments, "--checkpoint", str(run_dir / "final_ckpt.pt")]) == 0
    start, end = (load_checkpoint(d / "final_ckpt.pt")["weights"] for d in (run_dir, run_dir.parent / "tuned"))
    parameters = [key for key in start if "normalizer" not in key]
    for key in parameters:
        torch.testing.assert_close(start[key], end[key], rtol=0, atol=1e-6)


def test_evaluation_reports_every_episode(run_dir, tmp_path, capsys):
    arguments = ["--checkpoint", str(run_dir / "final_ckpt.pt"), "--num_episodes", "3", "--num_envs", "2"]
    assert evaluate.main([*arguments, "--json", str(tmp_path / "r.json")]) == 0
    table = capsys.readouterr().out
    for name in ("success_once", "success_at_end", "return", "mean_distance", "median"):
        assert name in table
    results = json.loads((tmp_path / "r.json").read_text())
    assert len(results["episodes"]["mean_distance"]) == 3
    assert results["mean"]["episode_len"] == 100
    assert results["env_kwargs"] == {"resolution": 20, "num_grippers": 2}


def test_evaluation_writes_a_card_that_says_where_the_policy_comes_from(run_dir, tmp_path, capsys):
    card = tmp_path / "cards" / "policy.md"
    arguments = ["--checkpoint", str(run_dir / "final_ckpt.pt"), "--num_episodes", "3"]
    assert evaluate.main([*arguments, "--card", str(card)]) == 0
    text = card.read_text()
    assert text.startswith("# final_ckpt.pt")
    assert f"maniskill-grpd evaluate {' '.join(arguments)}`" in text
    assert capsys.readouterr().out.splitlines()[-1] in text
    command = text.split("`maniskill-grpd train ")[1].split("`")[0]
    trained = load_checkpoint(run_dir / "final_ckpt.pt")["train_config"]
    words = shlex.split(command)
    words.remove("--no_recommended")  # or settings that the task recommends today would be mixed in
    rebuilt = tyro.cli(TrainConfig, args=words).to_dict()
    assert {name for name in rebuilt if rebuilt[name] != trained[name]} <= UNIMPORTANT


def test_evaluation_takes_another_resolution(run_dir, capsys):
    arguments = ["--checkpoint", str(run_dir / "final_ckpt.pt"), "--num_episodes", "1"]
    assert evaluate.main([*arguments, "--env_kwargs", "resolution=30"]) == 0
    assert "resolution=30" in capsys.readouterr().out


def test_evaluation_refuses_a_task_with_other_channels(run_dir, tmp_path, capsys):
    path = run_dir / "final_ckpt.pt"
    contents = torch.load(path, weights_only=True)
    scalars = contents["policy"]["schema"]["object"]["scalars"]
    scalars[0] = {**scalars[0], "name": "temperature"}
    torch.save(contents, tmp_path / "other.pt")
    assert evaluate.main(["--checkpoint", str(tmp_path / "other.pt"), "--num_episodes", "1"]) == 1
    error = capsys.readouterr().err
    assert "trained on other observations" in error
    assert "temperature" in error


def test_a_checkpoint_or_run_imports_the_module_that_it_names_only_when_allowed(run_dir, tmp_path, monkeypatch, capsys):
    (tmp_path / "planted.py").write_text("from pathlib import Path\nPath(__file__).with_suffix('.ran').touch()\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    contents = load_checkpoint(run_dir / "final_ckpt.pt")
    contents["train_config"]["env_id"] = "planted:RopeShaping-v1"
    save_checkpoint(tmp_path / "edited.pt", contents)
    (tmp_path / "config.json").write_text(json.dumps({"config": contents["train_config"]}))
    command = ["--checkpoint", str(tmp_path / "edited.pt"), "--num_episodes", "1"]
    for script, arguments in ((evaluate, command), (train, ["--resume", str(tmp_path)])):
        assert script.main(arguments) == 1
        assert "would import the Python module 'planted'" in capsys.readouterr().err
    assert not (tmp_path / "planted.ran").exists()
    assert evaluate.main([*command, "--allow_import"]) == 0
    assert (tmp_path / "planted.ran").exists()
    assert train.parse_train_options(["--resume", str(tmp_path), "--allow_import"]).env_id == "planted:RopeShaping-v1"


def test_evaluation_of_a_missing_file_is_one_line(capsys):
    assert evaluate.main(["--checkpoint", "none.pt"]) == 1
    assert "error: no checkpoint at none.pt" in capsys.readouterr().err


@pytest.mark.parametrize("script", [train, evaluate])
def test_help_explains_the_script(script, capsys):
    with pytest.raises(SystemExit) as exit_info:
        script.main(["--help"])
    assert exit_info.value.code == 0
    assert "maniskill-grpd " in capsys.readouterr().out


def test_frames_are_made_fit_for_codecs():
    frame = video.tile(torch.full((1, 5, 7, 4), 200))
    assert frame.shape == (4, 6, 3)
    assert frame.dtype == np.uint8


def test_episodes_are_shown_side_by_side():
    pictures = torch.arange(3, dtype=torch.uint8)[:, None, None, None].expand(3, 4, 6, 3)
    grid = video.tile(pictures)
    assert grid.shape == (8, 12, 3)
    assert [grid[row, column, 0] for row in (0, 7) for column in (0, 11)] == [0, 1, 2, 255]


def test_video_falls_back_to_gif_without_ffmpeg(tmp_path, monkeypatch):
    def fail():
        raise RuntimeError("no ffmpeg")

    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", fail)
    frames = [np.full((16, 16, 3), shade, np.uint8) for shade in (0, 120, 240)]
    path = video.write_frames(frames, tmp_path / "a.mp4", 20)
    assert path.name == "a.gif"
    assert len(imageio.mimread(path)) == 3


def test_demo_summary_compares_before_and_after():
    before = {
        "mean_distance": torch.tensor([0.4, 0.4]),
        "return": torch.tensor([1.0, 1.0]),
        "success_once": torch.tensor([False, False]),
        "success_at_end": torch.tensor([False, False]),
    }
    after = {**before, "mean_distance": torch.tensor([0.1, 0.1]), "success_once": torch.tensor([True, False])}
    summary = demo.summarize(before, after)
    assert summary["improvement"] == pytest.approx(4.0)
    assert summary["success_after"] == 0.5


def test_a_quick_demo_is_smaller_where_the_command_line_is_silent():
    assert demo.DemoConfig().with_sizes().total_timesteps == 64_000
    quick = demo.DemoConfig(quick=True, num_episodes=5).with_sizes()
    assert (quick.total_timesteps, quick.num_episodes, quick.num_videos) == (12_800, 5, 1)


@pytest.mark.slow
def test_demo_writes_everything(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    demo.demonstrate(demo.DemoConfig(total_timesteps=6400, num_episodes=8, num_videos=1))
    names = {path.name for path in (tmp_path / "runs" / "demo").iterdir()}
    assert names >= {"learning_curve.png", "metrics.json", "final_ckpt.pt"}
    assert names & {"policy.mp4", "policy.gif"}
