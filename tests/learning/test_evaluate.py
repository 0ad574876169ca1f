"""Evaluation on given seeds."""

import pytest
import torch
from toy_env import ToyEnv, ToyPolicy

from maniskill_grpd.learning import evaluate_policy

SEEDS = [7, 3, 11, 5, 2]


def test_every_float_and_success_is_reported_per_episode():
    episodes = evaluate_policy(ToyPolicy(), ToyEnv(2), SEEDS)
    assert set(episodes) == {"return", "episode_len", "success_once", "success_at_end", "mean_distance"}
    assert all(values.shape == (5,) for values in episodes.values())
    assert episodes["success_once"].dtype == torch.bool


@pytest.mark.parametrize("num_envs", [1, 2, 5, 8])
def test_results_belong_to_seeds_not_to_chunks(num_envs):
    expected = evaluate_policy(ToyPolicy(), ToyEnv(5), SEEDS)
    found = evaluate_policy(ToyPolicy(), ToyEnv(num_envs), SEEDS)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6)


def test_plain_and_self_resetting_environments_agree():
    """The last info of a self-resetting environment is the one it put aside, not that of the reset."""
    plain = evaluate_policy(ToyPolicy(), ToyEnv(5, auto_reset=False), SEEDS)
    vector = evaluate_policy(ToyPolicy(), ToyEnv(5), SEEDS)
    torch.testing.assert_close(plain, vector, rtol=0, atol=0)


def test_environments_that_end_early_are_not_counted_further():
    staggered = evaluate_policy(ToyPolicy(), ToyEnv(5, stagger=True), SEEDS)
    assert staggered["episode_len"].tolist() == [10, 9, 8, 7, 6]
    whole = evaluate_policy(ToyPolicy(), ToyEnv(5), SEEDS)
    assert (staggered["return"][1:] < whole["return"][1:]).all()


def test_returns_are_sums_of_rewards():
    class Counting(ToyEnv):
        def step(self, action):
            obs, reward, *rest = super().step(action)
            return obs, torch.ones_like(reward), *rest

    assert evaluate_policy(ToyPolicy(), Counting(3), SEEDS)["return"].tolist() == [10.0] * 5


def test_sampled_evaluation_follows_its_generator():
    def play(seed):
        generator = torch.Generator().manual_seed(seed)
        return evaluate_policy(ToyPolicy(), ToyEnv(5), SEEDS, False, generator=generator)["return"]

    assert torch.equal(play(0), play(0))
    assert not torch.equal(play(0), play(1))


def test_on_step_sees_every_state():
    calls = []
    evaluate_policy(ToyPolicy(), ToyEnv(5), SEEDS, on_step=lambda: calls.append(1))
    assert len(calls) == 11


def test_no_seeds_is_an_error():
    with pytest.raises(ValueError, match="seeds"):
        evaluate_policy(ToyPolicy(), ToyEnv(2), [])
