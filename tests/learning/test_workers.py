"""Several processes train one policy."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
import torch.multiprocessing as mp
from run_workers import WORKERS_CONFIG
from test_update import collect, make_learner
from toy_env import ToyEnv, ToyPolicy
from toy_run import CONFIG

from maniskill_grpd.learning import CheckpointError, Trainer, load_checkpoint
from maniskill_grpd.learning.algorithm import ALGORITHMS
from maniskill_grpd.learning.normalizer_update import update_normalizer
from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.learning.update import apply_gradients
from maniskill_grpd.learning.value_scale import ValueScale
from maniskill_grpd.learning.workers import Workers, join_workers, leave_workers

RUN_WORKERS = Path(__file__).with_name("run_workers.py")


def torchrun(*arguments, processes=2):
    """Run run_workers.py in several processes."""
    command = [sys.executable, "-m", "torch.distributed.run", f"--nproc_per_node={processes}"]
    command += ["--master_port=0", "--rdzv_backend=c10d", "--rdzv_endpoint=localhost:0"]
    return subprocess.run(
        [*command, str(RUN_WORKERS), *map(str, arguments)],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    """Train with two processes."""
    folder = tmp_path_factory.mktemp("workers")
    done = torchrun(folder, 9)
    assert done.returncode == 0, done.stderr
    return folder


def test_processes_end_with_the_same_weights_and_scales(run_dir):
    first, second = (torch.load(run_dir / f"weights_{rank}.pt") for rank in (0, 1))
    torch.testing.assert_close(first, second, rtol=0, atol=0)
    torch.testing.assert_close(load_checkpoint(run_dir / "final_ckpt.pt")["weights"], first)
    # The scales have seen the nodes of all environments: warm-up and nine iterations.
    assert first["normalizer.actuator_count"] == 10 * WORKERS_CONFIG.batch_size * 2


def test_one_log_tells_of_all_environments(run_dir):
    train, evaluation = (read_rows(run_dir / "metrics.jsonl", kind) for kind in ("train", "eval"))
    assert [row["iteration"] for row in train] == list(range(1, 10))
    assert train[-1]["global_step"] == 9 * WORKERS_CONFIG.batch_size
    assert len(evaluation) == 5


def test_a_resumed_run_of_two_processes_ends_bitwise_like_an_unbroken_one(run_dir, tmp_path):
    for arguments in ((6,), (9, "resume")):
        done = torchrun(tmp_path, *arguments)
        assert done.returncode == 0, done.stderr
    whole, resumed = (load_checkpoint(d / "final_ckpt.pt") for d in (run_dir, tmp_path))
    for key in ("weights", "optimizer", "value_scale", "generators"):
        torch.testing.assert_close(whole[key], resumed[key], rtol=0, atol=0)
    assert set(whole["generators"]) == {"action", "minibatch", "action.1", "minibatch.1"}


def test_another_number_of_processes_is_refused(run_dir):
    trainer = Trainer(WORKERS_CONFIG, ToyPolicy(), ToyEnv(8), None, run_dir)
    with pytest.raises(CheckpointError, match="2 process.*torchrun --nproc_per_node=2"):
        trainer.load(run_dir / "last.pt")


def test_sizes_that_cannot_be_shared_are_refused(tmp_path):
    with pytest.raises(ValueError, match="num_envs = 8 must be divisible by the 3 processes; 6 would"):
        Trainer(CONFIG, ToyPolicy(), ToyEnv(8), None, tmp_path, Workers(0, 3))
    config = dataclasses.replace(CONFIG, num_minibatches=8)
    with pytest.raises(ValueError, match=r"4 \* 7 transitions of each of 2 processes .* = 8"):
        Trainer(config, ToyPolicy(), ToyEnv(4), None, tmp_path, Workers(0, 2))


def half_update(rank, size, port, path):
    """Take one gradient step, fit scales and normaliser, with a share of one fixed rollout."""
    address = {"MASTER_ADDR": "localhost", "MASTER_PORT": str(port)}
    os.environ |= {"RANK": str(rank), "WORLD_SIZE": str(size), **address}
    torch.set_num_threads(1)
    workers = join_workers("cpu")
    torch.save(one_step(workers), path)
    leave_workers()


def one_step(workers):
    """Return gradients, metrics and scales after a step with this process's half of the batch."""
    policy = ToyPolicy()
    rollout, _ = collect(policy)
    with torch.no_grad():
        policy.mean.weight.add_(0.1)
    count = 56 // workers.size
    index = torch.arange(workers.rank * count, (workers.rank + 1) * count)
    learner = make_learner(policy)
    learner.workers = workers
    batch = learner.normalize_advantages(rollout.select(index))
    dist, outputs = learner.evaluate(batch)
    algorithm = ALGORITHMS[CONFIG.algorithm].from_config(CONFIG)
    loss, metrics = algorithm.policy_loss(dist, algorithm.project(dist, batch.old), batch)
    (loss + learner.value_loss(outputs, batch)).backward()
    apply_gradients(learner, list(policy.parameters()), metrics, "a test")
    scale = ValueScale()
    scale.update(batch.returns, workers)
    update_normalizer(policy.normalizer, batch.graph, workers)
    weights = {name: value.clone() for name, value in policy.state_dict().items()}
    return weights, workers.average_metrics(metrics), scale.state_dict()


def test_a_step_of_two_processes_is_that_of_one_with_the_whole_batch(tmp_path, monkeypatch):
    """Means over halves are means over the whole, also of advantages, returns and channel scales."""
    port = 29400 + os.getpid() % 2000
    paths = [tmp_path / f"{rank}.pt" for rank in (0, 1)]
    other = mp.get_context("spawn").Process(target=half_update, args=(1, 2, port, paths[1]))
    other.start()
    with monkeypatch.context() as patch:
        for name in ("RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT"):
            patch.setenv(name, "")  # what half_update sets is taken back
        half_update(0, 2, port, paths[0])
    other.join()
    halves = [torch.load(path) for path in paths]
    weights, metrics, scale = one_step(Workers())
    for found_weights, found_metrics, found_scale in halves:
        torch.testing.assert_close(found_weights, weights, rtol=1e-4, atol=1e-6)
        torch.testing.assert_close(found_metrics, metrics, rtol=1e-4, atol=1e-6)
        assert found_scale == pytest.approx(scale)
