"""The training benchmark: its peer learns, its rows add up."""

import importlib.util
from pathlib import Path

import pytest
import torch

pytest.importorskip("mani_skill")

from tools.docs.benchmark_pages import train_page

# By path: baselines has a train.py, too.
SPEC = importlib.util.spec_from_file_location("train_benchmark", Path(__file__).parents[2] / "benchmarks" / "train.py")
benchmark = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(benchmark)


def test_the_peer_collects_and_learns_and_counts_the_time_of_the_environment():
    peer = benchmark.Peer(num_steps=5)
    before = [parameter.detach().clone() for parameter in peer.agent.parameters()]
    peer.run_iteration()
    assert set(peer.times) == {"rollout", "env", "update"}
    assert 0.0 < peer.times["env"] < peer.times["rollout"]
    assert any(not torch.equal(old, new) for old, new in zip(before, peer.agent.parameters(), strict=True))
    peer.envs.close()


def test_shares_of_the_phases_add_up_to_one():
    times = [{"rollout": 2.0, "env": 0.5, "update": 6.0}, {"rollout": 2.0, "env": 1.5, "update": 2.0}]
    row = benchmark.summarize("ours", times, steps=1000)
    assert row["env_steps_per_s"] == pytest.approx((1000 / 8 + 1000 / 4) / 2)
    shares = [row[f"share_{phase}"] for phase in ("simulation", "policy", "update")]
    assert shares == pytest.approx([2 / 12, 2 / 12, 8 / 12])
    assert "| ours | 188 | 125 - 250 | 17% | 17% | 67% |  |  | 0.50 |" in train_page([{**row, "ratio": 0.5, "machine": {}}])


def test_operations_are_counted_in_products_and_their_gradients():
    """A product of (n, k) and (k, m) has 2 n k m operations, its gradients twice as many."""

    class Learner:
        def run_iteration(self):
            weight = torch.rand(30, 40, requires_grad=True)
            inputs = torch.rand(20, 30, requires_grad=True)
            (inputs @ weight).sum().backward()

    assert benchmark.count_flops(Learner()) == 3 * 2 * 20 * 30 * 40


def test_an_update_of_a_tenth_of_the_peak_is_one():
    use = benchmark.use_of_core(5e9, [{"rollout": 0.5, "update": 0.5}], steps=1000, peak=50.0)
    assert use == pytest.approx({"mflop_per_step": 5.0, "share_of_peak": 0.1})


def test_rates_of_two_trainings_are_compared_by_their_medians():
    rates = {"old": iter([1.0, 3.0, 2.0]), "new": iter([6.0, 4.0, 5.0])}
    old, new = benchmark.take_turns({name: lambda found=found: next(found) for name, found in rates.items()}, repeats=3)
    assert (old["env_steps_per_s"], old["min"], old["max"]) == (2.0, 1.0, 3.0)
    assert (new["peer"], new["ratio"]) == ("old", 2.5)
