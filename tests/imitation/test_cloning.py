"""Behaviour cloning on a tiny rope task."""

import json

import gymnasium as gym
import pytest
import torch

pytest.importorskip("mani_skill")

from mani_skill.utils.wrappers.record import RecordEpisode

from maniskill_grpd.commands import clone, evaluate, train
from maniskill_grpd.experts import EXPERTS, make_expert
from maniskill_grpd.imitation import cloning
from maniskill_grpd.imitation.clone_config import CloneConfig
from maniskill_grpd.imitation.demonstrations import Demonstrations, load_demonstrations, record_demonstrations
from maniskill_grpd.imitation.regression import mean_squared_error, negative_log_likelihood, relative_error, train_policy
from maniskill_grpd.imitation.turned_scene import TurnedScene
from maniskill_grpd.learning import load_checkpoint
from maniskill_grpd.policies import ActionDistribution, make_policy

TASK = ("graph_nodes=5", "resolution=20")
SIZES = "--num_episodes 6 --num_steps 15 --epochs 2 --batch_size 40 --num_test_episodes 2"
TINY = [*SIZES.split(), "--env_kwargs", *TASK]


def make_env(num_envs=3, obs_mode="graph"):
    return gym.make(
        "RopeShaping-v1",
        num_envs=num_envs,
        obs_mode=obs_mode,
        sim_backend="cpu",
        render_backend="none",
        graph_nodes=5,
        resolution=20,
    )


@pytest.fixture(scope="module")
def demonstrations():
    env = make_env()
    recorded = record_demonstrations(
        env, "RopeShaping-v1", [1, 2, 3, 4], num_steps=12, action_noise=0.0, generator=torch.Generator().manual_seed(0)
    )
    yield recorded, env.unwrapped.graph_schema
    env.close()


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    folder = tmp_path_factory.mktemp("work")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        arguments = ["--exp_name", "tiny", "--policy", "grpd", "transformer", *TINY]
        assert clone.main([*arguments, "--markdown", "page.md"]) == 0
    return folder / "runs" / "tiny"


def test_demonstrations_are_what_the_expert_does(demonstrations):
    """Replay of the first world: same seed, same states, same actions."""
    recorded, _ = demonstrations
    assert recorded.actions.shape == (4 * 12, 4, 3)
    assert recorded.num_episodes == 4
    env = make_env(1)
    expert = make_expert("RopeShaping-v1", env)
    env.reset(seed=[1])
    graph, actions = recorded.select((recorded.episode == 0).nonzero()[:, 0])
    for step in range(12):
        positions = env.unwrapped.solver.gripper_positions[0]
        torch.testing.assert_close(graph["actuator"]["position"][step], positions)
        torch.testing.assert_close(actions[step].flatten(), expert.act()[0])
        env.step(expert.act())
    env.close()


def test_noise_disturbs_what_is_executed_and_not_what_is_recorded():
    """With noise, actions still are at most as long as the controller allows; states differ."""
    env = make_env()
    kept = {}
    for noise in (0.0, 0.5):
        generator = torch.Generator().manual_seed(0)
        kept[noise] = record_demonstrations(env, "RopeShaping-v1", [1, 2], num_steps=5, action_noise=noise, generator=generator)
        assert kept[noise].actions.norm(dim=-1).max() <= 1.0 + 1e-6
    states = [kept[noise].graph["actuator"]["position"] for noise in kept]
    torch.testing.assert_close(states[0][:2], states[1][:2])  # the first step of both worlds
    assert not torch.allclose(states[0][2:], states[1][2:])
    env.close()


def test_validation_episodes_are_not_trained_on(demonstrations):
    recorded, _ = demonstrations
    train_index, held_out = recorded.split(1, torch.Generator().manual_seed(0))
    assert len(train_index) + len(held_out) == len(recorded.episode)
    trained, tested = (set(recorded.episode[i].tolist()) for i in (train_index, held_out))
    assert not trained & tested
    assert len(tested) == 1


def test_recorded_trajectories_of_maniskill_are_read(tmp_path):
    env = RecordEpisode(make_env(2), tmp_path, trajectory_name="demo", save_video=False)
    expert = make_expert("RopeShaping-v1", env)
    env.reset(seed=[1, 2])
    taken = []
    for _ in range(4):
        taken.append(expert.act())
        env.step(taken[-1])
    env.reset()
    env.close()
    loaded = load_demonstrations(tmp_path / "demo.h5", env.unwrapped.graph_schema)
    assert loaded.num_episodes == 2
    assert loaded.graph["object"]["position"].shape == (8, 5, 3)
    first = loaded.actions[loaded.episode == 0].flatten(1)
    torch.testing.assert_close(first, torch.stack([action[0] for action in taken]))


def test_files_without_graphs_are_refused(tmp_path, capsys):
    env = RecordEpisode(make_env(2, "none"), tmp_path, trajectory_name="demo", save_video=False)
    env.reset(seed=[1, 2])
    env.step(torch.zeros(2, 12))
    env.reset()
    env.close()
    given = ["--demonstrations", str(tmp_path / "demo.h5"), *TINY]
    assert clone.main(given) == 1
    assert "no trajectories with graph observations" in capsys.readouterr().err
    assert clone.main(["--demonstrations", "none.h5", *TINY]) == 1
    assert "no trajectories at none.h5" in capsys.readouterr().err


@pytest.mark.parametrize("loss", ["mse", "nll"])
def test_training_reduces_the_error_on_what_is_shown(demonstrations, loss):
    recorded, schema = demonstrations
    torch.manual_seed(0)
    policy = make_policy("grpd", schema)
    config = CloneConfig(epochs=12, batch_size=12, loss=loss, validation_share=0.25)
    before = relative_error(policy, recorded, torch.arange(48))
    result = train_policy(policy, recorded, config)
    assert before > 0.8  # an untrained policy hardly moves
    assert result["train_error"] < 0.6 * before
    assert len(result["validation_history"]) == 12


def test_shuffled_actions_cannot_be_learned(demonstrations):
    """Negative control: the held-out error says whether something was understood."""
    recorded, schema = demonstrations
    order = torch.randperm(48, generator=torch.Generator().manual_seed(0))
    turned = recorded.actions[order] * torch.randn(48, 4, 1).sign()
    nonsense = Demonstrations(graph=recorded.graph, actions=turned, episode=recorded.episode)
    config = CloneConfig(epochs=12, batch_size=12, validation_share=0.25)
    result = train_policy(make_policy("grpd", schema), nonsense, config)
    assert result["validation_error"] > 0.9


def test_losses_by_hand():
    """Two actuators, one masked: |(1, 0, 0) - (0, 0, 2)|^2 = 5.

    With std 1 the negative log-likelihood is 5 / 2 + 3 / 2 log 2 pi.
    """
    dist = ActionDistribution(
        mean=torch.tensor([[[1.0, 0.0, 0.0], [9.0, 9.0, 9.0]]]), std=torch.ones(1, 2, 1), mask=torch.tensor([[True, False]])
    )
    actions = torch.tensor([[[0.0, 0.0, 2.0], [0.0, 0.0, 0.0]]])
    assert mean_squared_error(dist, actions).item() == pytest.approx(5.0)
    expected = 2.5 + 1.5 * 1.8378770664
    assert negative_log_likelihood(dist, actions).item() == pytest.approx(expected, rel=1e-6)


def test_squared_error_leaves_the_noise_for_exploration(demonstrations):
    recorded, schema = demonstrations
    policy = make_policy("grpd", schema, state_dependent_std=False)
    train_policy(policy, recorded, CloneConfig(epochs=2, batch_size=24, validation_share=0.25))
    std = policy.distribution(recorded.select(torch.arange(2))[0]).std
    torch.testing.assert_close(std, torch.full_like(std, 0.5))


def test_every_policy_leaves_its_results(run_dir):
    for name in ("grpd", "transformer"):
        files = {path.name for path in (run_dir / name).iterdir()}
        assert files == {"config.json", "results.json", "final_ckpt.pt"}
        result = json.loads((run_dir / name / "results.json").read_text())
        assert set(result["rollouts"]) == {"quarter", "quarter turned", "full"}
        assert 0.0 < result["validation_error"] < 2.0
    page = (run_dir.parents[1] / "page.md").read_text()
    for row in ("| grpd |", "| transformer |", "| (expert) |"):
        assert row in page
    assert "| success, full | mean_distance [m], full |" in page


@pytest.mark.parametrize("env_id", sorted(EXPERTS))
def test_the_expert_of_every_task_is_cloned(env_id, tmp_path, monkeypatch, capsys):
    """Where a task measures no mean distance, cloning died between training and saving."""
    monkeypatch.chdir(tmp_path)
    sizes = "--num_episodes 2 --num_steps 3 --epochs 1 --batch_size 3 --validation_share 0.5 --num_test_episodes 1"
    options = ["--env_id", env_id, "--env_kwargs", "graph_nodes=6", "resolution=49", "max_episode_steps=4", "--exp_name", "tiny"]
    assert clone.main([*options, *sizes.split()]) == 0
    record = json.loads((tmp_path / "runs/tiny/grpd/config.json").read_text())
    assert f"({record['progress']['name']} " in capsys.readouterr().out
    assert load_checkpoint(tmp_path / "runs/tiny/grpd/final_ckpt.pt")["train_config"]["env_id"] == env_id


def test_what_was_trained_is_saved_before_it_is_played(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cloning, "play", lambda *_: pytest.fail("playing broke off"))
    with pytest.raises(pytest.fail.Exception, match="playing broke off"):
        clone.main(["--exp_name", "tiny", *TINY])
    assert load_checkpoint(tmp_path / "runs/tiny/grpd/final_ckpt.pt")["global_step"] == 6 * 15


def test_expert_row_is_the_ceiling(run_dir):
    page = (run_dir.parents[1] / "page.md").read_text()
    row = next(line for line in page.splitlines() if line.startswith("| (expert)"))
    assert row.count("100%") == 3


def test_checkpoint_is_evaluated_and_training_goes_on_from_it(run_dir, monkeypatch, capsys):
    monkeypatch.chdir(run_dir.parents[1])
    checkpoint = str(run_dir / "grpd" / "final_ckpt.pt")
    assert evaluate.main(["--checkpoint", checkpoint, "--num_episodes", "1"]) == 0
    assert "success_at_end" in capsys.readouterr().out
    sizes = "--num_envs 4 --num_steps 5 --num_minibatches 2 --update_epochs 1 --eval_freq 0"
    arguments = [*sizes.split(), "--total_timesteps", "20", "--learning_rate", "1e-12"]
    arguments += ["--no-capture_video", "--exp_name", "warm", "--checkpoint", checkpoint]
    assert train.main([*arguments, "--env_kwargs", *TASK]) == 0
    start, end = (load_checkpoint(path)["weights"] for path in (checkpoint, "runs/warm/final_ckpt.pt"))
    for key in (key for key in start if "normalizer" not in key):
        torch.testing.assert_close(start[key], end[key], rtol=0, atol=1e-6)


def test_turned_scenes_are_the_same_scenes_turned():
    """Turning back gives the original; every world is turned by at least 90 degrees."""
    env = make_env(8)
    env.reset(seed=list(range(8)))
    base = env.unwrapped
    rope, goal = base.solver.positions.clone(), base.goal_positions.clone()
    turned = TurnedScene(env)
    obs, info = turned.reset(seed=list(range(8)))
    rotation = turned.rotation
    assert (rotation[:, 0, 0] <= 1e-6).all()  # the cosine of the angle
    torch.testing.assert_close(base.solver.positions @ rotation, rope)
    torch.testing.assert_close(base.goal_positions @ rotation, goal)
    held = base.solver.positions[:, base.start_nodes[0]]
    torch.testing.assert_close(base.solver.gripper_positions, held)
    torch.testing.assert_close(base.solver.gripper_targets, held)
    torch.testing.assert_close(obs["graph"]["actuator"]["position"], held)
    torch.testing.assert_close(info["mean_distance"], (rope - goal).norm(dim=-1).mean(dim=1))
    env.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--epochs", "0"], "epochs must be positive"),
        (["--validation_share", "1.0"], "validation_share must be in"),
        (["--env_kwargs", "pose_range=half"], "--train_pose_range"),
        (["--loss", "l1"], "mse"),
    ],
)
def test_bad_options_are_explained(arguments, message, capsys):
    assert clone.main(arguments) == 2
    assert message in capsys.readouterr().err


def test_an_unknown_policy_is_one_line_before_anything_is_recorded(capsys):
    assert clone.main(["--policy", "grdp"]) == 1
    assert "error: unknown policy 'grdp'" in capsys.readouterr().err
