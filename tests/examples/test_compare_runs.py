"""Figures that compare two algorithms, checked by hand."""

import json

import compare_runs


def write_log(path, returns):
    rows = [
        {"kind": "train", "iteration": i, "global_step": i, "train/return": r, "losses/kl_raw_max": 0.1 * i}
        for i, r in enumerate(returns)
    ]
    path.write_text("\n".join(map(json.dumps, rows)) + "\n")
    return path


def test_figures_are_those_of_the_logs(tmp_path):
    steady = write_log(tmp_path / "a.jsonl", [1.0, 2.0, 3.0, 4.0, 5.0])
    broken = write_log(tmp_path / "b.jsonl", [1.0, 2.0, 1.5, 4.0, 7.0])  # 1.5 is below 0.8 * 2
    figures = compare_runs.describe([steady, broken])
    assert figures["seeds"] == "2"
    assert figures["final return (mean, 95 %)"].startswith("6.0 ")
    assert figures["iterations whose return collapses"] == "12.5%"  # one of eight
    # the mean of 0, 0, 1.125, 0 and 2 is 0.6
    assert figures["variance over seeds, mean over training"] == "1"
    assert figures["standard deviation of it over seeds"] == "1.4"
    assert figures["largest KL of an update at a state [nats]"] == "0.4"
