"""Sweeps from the command line: every combination once, resumed, and nothing touched that is not theirs."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import main
from maniskill_grpd.learning import load_checkpoint

SIZES = "--num_envs 4 --num_steps 5 --num_minibatches 2 --update_epochs 1 --eval_freq 0"
RHYTHM = "--checkpoint_freq 1 --no_capture_video --total_timesteps 40"
TINY = f"{SIZES} {RHYTHM} --env_kwargs resolution=20 num_grippers=2".split()


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_sweep(*grid, name="s", common=TINY):
    return main(["sweep", "--name", name, "--grid", *grid, "--jobs", "2", "--", *common])


def test_every_combination_is_trained_once_and_interrupted_runs_are_resumed(capsys):
    assert run_sweep("algorithm=bpp,ppo") == 0
    folders = [Path("runs") / "s" / f"algorithm={name}" for name in ("bpp", "ppo")]
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "algorithm=bpp" in line)
    assert line.split()[1:5] == ["finished", "40", "of", "40"]
    final = [load_checkpoint(folder / "final_ckpt.pt") for folder in folders]
    assert [contents["train_config"]["algorithm"] for contents in final] == ["bpp", "ppo"]
    before = (folders[0] / "final_ckpt.pt").stat().st_mtime_ns
    (folders[1] / "final_ckpt.pt").unlink()  # as if the job had died after its last checkpoint
    assert run_sweep("algorithm=bpp,ppo") == 0
    assert (folders[0] / "final_ckpt.pt").stat().st_mtime_ns == before
    assert "train --resume runs/s/algorithm=ppo" in (folders[1] / "job.log").read_text()
    assert load_checkpoint(folders[1] / "final_ckpt.pt")["iteration"] == 2


def test_a_failed_run_is_named_with_its_reason(capsys):
    assert run_sweep("seed=1", common=[*TINY, "--checkpoint", "none.pt"]) == 1
    output = capsys.readouterr()
    assert "failed" in output.out
    assert "no checkpoint at none.pt" in output.err


def test_a_sweep_that_is_asked_to_stop_passes_it_on_and_its_runs_leave_checkpoints(folder):
    """Its runs were killed, and lost what they had trained since their last checkpoint."""
    run_dir = folder / "runs/s/seed=1"

    def hang_up():
        end = time.monotonic() + 300.0
        while not any(path.stat().st_size for path in run_dir.glob("metrics.jsonl")) and time.monotonic() < end:
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGHUP)

    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # tests that run under nohup ignore it
    threading.Thread(target=hang_up).start()
    common = [*TINY, "--total_timesteps", "2_000_000", "--checkpoint_freq", "100_000"]
    assert run_sweep("seed=1", common=common) == 130
    signal.signal(signal.SIGHUP, before)
    assert load_checkpoint(run_dir / "last.pt")["iteration"] >= 1
    assert not (run_dir / "failed.json").exists()
    assert "go on: maniskill-grpd train --resume runs/s/seed=1" in (run_dir / "job.log").read_text()


@pytest.mark.parametrize("name", ["../precious", "s/../../precious"])
def test_a_sweep_that_leads_out_of_its_folder_is_refused_and_deletes_nothing(name, capsys, folder):
    """It deleted precious/seed=1, and ended well."""
    precious = folder / "precious" / "seed=1" / "thesis.tex"
    precious.parent.mkdir(parents=True)
    precious.write_text("years of work")
    assert run_sweep("seed=1", name=name) == 1
    assert "runs go to folders below runs/" in capsys.readouterr().err
    assert precious.read_text() == "years of work"
    assert not Path("runs").exists()


def test_a_folder_of_a_sweep_that_holds_something_else_is_refused_and_kept(capsys):
    mine = Path("runs/s/seed=2/thesis.tex")
    mine.parent.mkdir(parents=True)
    mine.write_text("years of work")
    assert run_sweep("seed=1,2") == 1
    assert "runs/s/seed=2 is not the folder of a run but holds thesis.tex" in capsys.readouterr().err
    assert mine.read_text() == "years of work"
    assert not Path("runs/s/seed=1").exists()


def test_a_sweep_without_checkpoints_is_not_trained_twice(capsys):
    common = [*TINY, "--no_save_model"]
    assert run_sweep("seed=1", common=common) == 0
    log = Path("runs/s/seed=1/metrics.jsonl")
    before = log.stat().st_mtime_ns
    assert run_sweep("seed=1", common=common) == 0
    assert log.stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ("trust_region=projection,ball", "invalid choice 'ball'"),
        ("no_such_option=1", "no_such_option"),
        ("seed=1,2,1", "grid names a value of seed twice: 1,2,1"),
        ("seed", "grid takes key=value pairs"),
    ],
)
def test_combinations_are_checked_before_the_first_run(grid, message, capsys):
    assert run_sweep(grid) != 0
    assert message in capsys.readouterr().err
    assert not Path("runs").exists()


def test_a_dry_run_lists_the_runs_and_starts_none(capsys):
    assert main(["sweep", "--name", "s", "--grid", "seed=1,2", "--dry_run", "--", *TINY]) == 0
    output = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in output[:2]] == [["seed=1", "waiting"], ["seed=2", "waiting"]]
    assert output[2].startswith("2 runs and 0 experts with 0 tests")
    assert not Path("runs").exists()
