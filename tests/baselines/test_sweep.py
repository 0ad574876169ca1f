"""Sweeps of independent runs through submitit's local executor."""

import sys

import pytest

pytest.importorskip("mani_skill")
pytest.importorskip("submitit")

import sweep

from maniskill_grpd.learning import load_checkpoint

SIZES = "--num_envs 4 --num_steps 5 --num_minibatches 2 --update_epochs 1 --eval_freq 0"
RHYTHM = "--checkpoint_freq 1 --no-capture_video --total_timesteps 40"
TINY = f"{SIZES} {RHYTHM} --env_kwargs resolution=20 num_grippers=2".split()


def run_sweep(*grid, common=TINY):
    return sweep.main(["--name", "s", "--grid", *grid, "--jobs", "2", "--interval", "0.5", "--", *common])


def test_every_combination_is_trained_once_and_broken_runs_are_resumed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run_sweep("algorithm=bpp,ppo") == 0
    folders = [tmp_path / "runs" / "s" / f"algorithm={name}" for name in ("bpp", "ppo")]
    table = capsys.readouterr().out
    assert "algorithm=bpp" in table
    assert "40 / 40" in table
    final = [load_checkpoint(folder / "final_ckpt.pt") for folder in folders]
    assert [contents["train_config"]["algorithm"] for contents in final] == ["bpp", "ppo"]
    before = (folders[0] / "final_ckpt.pt").stat().st_mtime_ns
    (folders[1] / "final_ckpt.pt").unlink()  # as if the job had died after its last checkpoint
    assert run_sweep("algorithm=bpp,ppo") == 0
    assert (folders[0] / "final_ckpt.pt").stat().st_mtime_ns == before
    assert load_checkpoint(folders[1] / "final_ckpt.pt")["iteration"] == 2


def test_a_failed_run_is_named_with_its_reason(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run_sweep("seed=1", common=[*TINY, "--checkpoint", "none.pt"]) == 1
    output = capsys.readouterr()
    assert "failed" in output.out
    assert "no checkpoint at none.pt" in output.err


def test_combinations_are_checked_before_the_first_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        run_sweep("trust_region=projection,ball")
    assert "trust_region must be one of" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_run_without_a_checkpoint_starts_and_one_with_it_resumes(tmp_path):
    run = sweep.Run(tmp_path, ("--seed", "1"), num_processes=2)
    assert run.command()[-2:] == ["--seed", "1"]
    assert "--nproc_per_node=2" in run.command()
    (tmp_path / "last.pt").touch()
    assert run.command()[-2:] == ["--resume", str(tmp_path)]


def test_without_submitit_the_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(RuntimeError, match="pip install submitit"):
        sweep.make_executor("local", tmp_path, {})


def test_unknown_options_of_slurm_are_refused(tmp_path):
    with pytest.raises(ValueError, match="--slurm: .*colour"):
        sweep.make_executor("local", tmp_path, {"slurm_colour": "red"})
