"""The training loop: it learns, it resumes exactly, it stops on NaN."""

import dataclasses
import sys

import pytest
import torch
from toy_env import ToyEnv, ToyPolicy
from toy_run import CONFIG, make_toy_trainer

from maniskill_grpd.extras import MissingExtraError
from maniskill_grpd.learning import CheckpointError, NonFiniteError, TrainConfig, Trainer, load_checkpoint
from maniskill_grpd.learning.episode_seeds import FIRST_TRAINING_SEED, episode_seeds
from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.learning.training_state import generator_seed
from maniskill_grpd.learning.update import FirstOrderAlgorithm


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


LEARNERS = {
    "projection": {},
    "lagrangian": {"trust_region": "lagrangian"},
    "fisher": {"trust_region": "fisher"},
    "ppo": {"algorithm": "ppo"},
}


@pytest.mark.parametrize("name", LEARNERS)
def test_all_algorithms_learn_the_toy_task(tmp_path, name):
    """Untrained: return 1.2, success 0. A perfect policy reaches about 6.7."""
    config = TrainConfig(
        **LEARNERS[name], num_envs=32, num_steps=10, num_minibatches=4, total_timesteps=12_800, learning_rate=3e-3, eval_freq=20
    )
    trainer = Trainer(config, ToyPolicy(), ToyEnv(32), ToyEnv(16), tmp_path)
    result = trainer.train()
    assert result["eval/return"] > 5.2
    assert result["eval/success_once"] > 0.7


@pytest.mark.parametrize("name", LEARNERS)
def test_grippers_learn_when_to_close(tmp_path, name):
    """Half of the reward is for closing exactly below the goal; chance earns 0.5 of it."""
    config = TrainConfig(
        **LEARNERS[name],
        num_envs=32,
        num_steps=10,
        num_minibatches=4,
        total_timesteps=12_800,
        learning_rate=1e-2,
        gripper_bound=0.1,  # of both actuators together
        eval_freq=40,
    )
    envs = (ToyEnv(num_envs, gripper=True) for num_envs in (32, 16))
    trainer = Trainer(config, ToyPolicy(gripper=True), *envs, tmp_path)
    trainer.train()
    graph = ToyEnv(64, gripper=True).reset(list(range(64)))[0]["graph"]
    action = trainer.policy.act(graph, deterministic=True).view(64, 2, 4)
    is_up = graph["actuator"]["vectors"][:, :, 0, 2] > 0.05
    is_down = graph["actuator"]["vectors"][:, :, 0, 2] < -0.05
    assert action[..., 3][is_up].mean() > 0.9
    assert action[..., 3][is_down].mean() < 0.1


def test_mixed_precision_without_a_gpu_is_refused(tmp_path):
    with pytest.raises(ValueError, match="--amp needs a CUDA device"):
        Trainer(dataclasses.replace(CONFIG, amp=True), ToyPolicy(), ToyEnv(8), None, tmp_path)


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """Run the toy training without interruption."""
    run_dir = tmp_path_factory.mktemp("unbroken")
    trainer = make_toy_trainer(run_dir)
    trainer.train()
    return run_dir


def assert_same_end(run_dir, other):
    first, second = (load_checkpoint(d / "final_ckpt.pt") for d in (run_dir, other))
    for key in ("weights", "optimizer", "value_scale", "generators"):
        torch.testing.assert_close(first[key], second[key], rtol=0, atol=0)
    for key in ("iteration", "global_step", "best_score"):
        assert first[key] == second[key]
    assert untimed_rows(run_dir) == untimed_rows(other)


def untimed_rows(run_dir):
    rows = read_rows(run_dir / "metrics.jsonl")
    return [{k: v for k, v in row.items() if not k.startswith(("time/", "charts/SPS"))} for row in rows]


def test_two_runs_with_one_seed_are_equal(tmp_path, unbroken):
    make_toy_trainer(tmp_path).train()
    assert_same_end(tmp_path, unbroken)


def test_another_seed_gives_another_run(tmp_path, unbroken):
    make_toy_trainer(tmp_path, dataclasses.replace(CONFIG, seed=2)).train()
    with pytest.raises(AssertionError):
        assert_same_end(tmp_path, unbroken)


def test_resuming_with_other_options_is_refused_by_name(tmp_path, unbroken):
    trainer = make_toy_trainer(tmp_path, dataclasses.replace(CONFIG, gamma=0.5))
    with pytest.raises(CheckpointError, match=r"gamma: the checkpoint has 0.99, here it is 0.5"):
        trainer.load(unbroken / "last.pt")


def test_a_finished_run_can_be_extended(tmp_path):
    short = dataclasses.replace(CONFIG, total_timesteps=8 * 7 * 3, anneal_lr=False)
    make_toy_trainer(tmp_path, short).train()
    longer = make_toy_trainer(tmp_path, dataclasses.replace(short, total_timesteps=8 * 7 * 5))
    longer.load(tmp_path / "last.pt")
    longer.train()
    assert load_checkpoint(tmp_path / "final_ckpt.pt")["iteration"] == 5
    iterations = [row["iteration"] for row in read_rows(tmp_path / "metrics.jsonl", "train")]
    assert iterations == [1, 2, 3, 4, 5]


def test_new_runs_start_from_given_weights(tmp_path, unbroken):
    trainer = make_toy_trainer(tmp_path)
    trainer.load_weights(unbroken / "final_ckpt.pt")
    expected = load_checkpoint(unbroken / "final_ckpt.pt")["weights"]
    torch.testing.assert_close(trainer.policy.state_dict(), expected, rtol=0, atol=0)
    assert trainer.state.iteration == 0


def test_metrics_carry_maniskill_names(unbroken):
    train, evaluation = (read_rows(unbroken / "metrics.jsonl", kind) for kind in ("train", "eval"))
    assert [row["iteration"] for row in train] == list(range(1, 10))
    assert [row["iteration"] for row in evaluation] == [2, 4, 6, 8, 9]
    tags = set().union(*train)  # no episode ends in the first rollout
    assert tags >= {
        "train/return",
        "train/success_once",
        "train/success_at_end",
        "train/episode_len",
        "losses/policy_loss",
        "losses/value_loss",
        "losses/entropy",
        "losses/kl_raw",
        "losses/kl_raw_max",
        "losses/kl_projected",
        "losses/kl_projected_max",
        "losses/mean_bound_active",
        "losses/cov_bound_active",
        "losses/std",
        "losses/explained_variance",
        "charts/action_norm",
        "charts/learning_rate",
        "charts/SPS",
        "time/rollout_time",
        "time/update_time",
    }
    assert set(evaluation[0]) >= {"eval/return", "eval/success_once", "eval/mean_distance", "time/eval_time"}
    assert list(unbroken.glob("events.out.tfevents.*"))


def test_the_learning_rate_anneals_to_zero(unbroken):
    rates = [row["charts/learning_rate"] for row in read_rows(unbroken / "metrics.jsonl", "train")]
    assert rates == pytest.approx([CONFIG.learning_rate * (1 - i / 9) for i in range(9)])


def test_checkpoints_are_written(unbroken):
    best = load_checkpoint(unbroken / "best_ckpt.pt")
    returns = [row["eval/return"] for row in read_rows(unbroken / "metrics.jsonl", "eval")]
    successes = [row["eval/success_at_end"] for row in read_rows(unbroken / "metrics.jsonl", "eval")]
    assert best["best_score"] == list(max(zip(successes, returns, strict=True)))
    assert load_checkpoint(unbroken / "last.pt")["iteration"] == 9


def test_the_best_checkpoint_follows_the_chosen_metric(tmp_path):
    config = dataclasses.replace(CONFIG, best_metric="return")
    make_toy_trainer(tmp_path, config).train()
    returns = [row["eval/return"] for row in read_rows(tmp_path / "metrics.jsonl", "eval")]
    assert load_checkpoint(tmp_path / "best_ckpt.pt")["best_score"] == [max(returns)] * 2


def test_a_task_without_the_chosen_metric_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("maniskill_grpd.learning.trainer.evaluate_policy", lambda *args: {"return": torch.zeros(2)})
    with pytest.raises(ValueError, match="does not report success_at_end.*--best_metric"):
        make_toy_trainer(tmp_path).train()


def test_without_save_model_nothing_is_saved_and_the_run_is_the_same(tmp_path, unbroken):
    make_toy_trainer(tmp_path, dataclasses.replace(CONFIG, save_model=False)).train()
    assert not list(tmp_path.glob("*.pt"))
    assert untimed_rows(tmp_path) == untimed_rows(unbroken)


@pytest.mark.parametrize("broken", ["reward", "obs"])
def test_non_finite_numbers_stop_training_with_name_and_place(tmp_path, broken):
    # warm-up of 7 steps, iterations of 7: step 31 is step 2 (reward) of iteration 3
    env = ToyEnv(8, stagger=True, break_at=(31, broken))
    trainer = Trainer(CONFIG, ToyPolicy(), env, None, tmp_path)
    name, step = ("the reward", 2) if broken == "reward" else ("observation object.vectors", 3)
    with pytest.raises(NonFiniteError, match=rf"{name} .*iteration 3, step {step}, in environment\(s\) 0 \(1 of 8\)"):
        trainer.train()
    assert load_checkpoint(tmp_path / "last.pt")["iteration"] == 3


@pytest.mark.parametrize("freeze", [None, 8 * 7 * 2])
def test_old_and_new_policy_see_the_same_scales(tmp_path, freeze):
    """In the first minibatch of every iteration the probability ratio is one."""
    config = dataclasses.replace(CONFIG, normalizer_freeze_steps=freeze, eval_freq=0)
    trainer = make_toy_trainer(tmp_path, config)
    probe = FirstRatios(trainer, config)
    trainer.state.algorithm = probe
    trainer.train()
    assert len(probe.errors) == 9
    assert max(probe.errors) < 1e-5
    counts = probe.counts
    assert all(a < b for a, b in zip(counts[:3], counts[1:3], strict=False))
    assert (counts[-1] == counts[3]) == (freeze is not None)


class FirstRatios(FirstOrderAlgorithm):
    """Passes losses through and notes how far the first ratio of each iteration is from one."""

    def __init__(self, trainer, config):
        super().__init__(ent_coef=0.0)
        self.inner, self.trainer = trainer.state.algorithm, trainer
        self.period = config.update_epochs * config.num_minibatches
        self.calls, self.errors, self.counts = 0, [], []

    @classmethod
    def from_config(cls, config):
        """Not built from a config."""
        raise NotImplementedError

    def project(self, dist, old):
        """Project as the algorithm does."""
        return self.inner.project(dist, old)

    def policy_loss(self, dist, projected, batch):
        """Note the ratios."""
        if self.calls % self.period == 0:
            ratio = (dist.log_prob(batch.actions) - batch.log_probs).exp()
            self.errors.append((ratio - 1.0).abs().max().item())
            self.counts.append(self.trainer.policy.normalizer.object_count.item())
        self.calls += 1
        return self.inner.policy_loss(dist, projected, batch)

    def diagnose(self, dist, projected, batch):
        """Pass metrics through."""
        return self.inner.diagnose(dist, projected, batch)


def test_training_seeds_are_apart_from_evaluation_seeds_and_from_each_other():
    config = TrainConfig()
    seeds = [seed for iteration in range(100) for seed in episode_seeds(config, iteration)]
    assert all(FIRST_TRAINING_SEED <= seed < 2**31 for seed in seeds)
    assert len(set(seeds)) == len(seeds)
    assert episode_seeds(config, 3) == episode_seeds(config, 3)


def test_runs_with_different_seeds_share_no_episode_and_no_noise():
    """All seeds of an iteration follow from the run's own, the generators of other processes too."""
    first, second = (set(episode_seeds(TrainConfig(seed=seed), 3)) for seed in (1, 2))
    assert not first & second
    assert len({generator_seed(seed, rank) for seed in range(20) for rank in range(4)}) == 80


def test_a_wrong_number_of_environments_is_refused(tmp_path):
    with pytest.raises(ValueError, match="num_envs is 8 but envs has 3"):
        Trainer(CONFIG, ToyPolicy(), ToyEnv(3), None, tmp_path)


def test_tracking_without_wandb_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    trainer = make_toy_trainer(tmp_path, dataclasses.replace(CONFIG, track=True))
    with pytest.raises(MissingExtraError, match=r"--track needs wandb: pip install 'maniskill-grpd\[track\]'"):
        trainer.train()
