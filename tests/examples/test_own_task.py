"""The example of a task of one's own, as its author runs it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_task.py"


def test_train_runs_a_task_that_it_has_to_import(tmp_path):
    shutil.copy(EXAMPLE, tmp_path)
    options = "--env_id own_task:RopeClosing-v1 --num_envs 8 --num_steps 50 --total_timesteps 800 --exp_name own"
    options += " --num_eval_envs 8 --eval_freq 0 --no-capture_video"
    command = [sys.executable, "-m", "maniskill_grpd", "train", *options.split()]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    lines = [json.loads(line) for line in (tmp_path / "runs/own/metrics.jsonl").read_text().splitlines()]
    distances = [line["train/ends_distance"] for line in lines if "train/ends_distance" in line]
    assert len(distances) == 2
    assert all(0.0 < distance < 0.6 for distance in distances)
    assert (tmp_path / "runs/own/final_ckpt.pt").is_file()
