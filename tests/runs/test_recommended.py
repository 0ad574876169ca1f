"""What tasks recommend for their trainings, and what is left of it beside a command line."""

import pytest
from mani_skill.utils.registration import REGISTERED_ENVS

from maniskill_grpd.commands.train import parse_train_options
from maniskill_grpd.experiments.training import Training
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.environments import check_task
from maniskill_grpd.runs.recommended import describe_settings, recommended_settings
from maniskill_grpd.tasks import ClothFoldingEnv, DeformableEnv

TASKS = [name for name, spec in REGISTERED_ENVS.items() if issubclass(spec.cls, DeformableEnv)]
FOLDING = ["--env_id", "ClothFolding-v1"]


@pytest.mark.parametrize("env_id", TASKS)
def test_recommendations_are_options_that_training_and_task_take(env_id):
    config = parse_train_options(["--env_id", env_id])
    for name, value in recommended_settings(env_id).items():
        assert getattr(config, name) == value
    check_task(env_id, config.env_options)
    assert describe_settings(config).endswith("taken as they are") == bool(recommended_settings(env_id))


def test_flags_replace_single_recommendations():
    """Options of the task one by one, too; the line at the start says what is otherwise."""
    config = parse_train_options([*FOLDING, "--gamma", "0.9", "--env_kwargs", "resolution=64", "num_grippers=1"])
    assert (config.gamma, config.num_envs) == (0.9, 16)
    assert config.env_options == {"graph_nodes": 25, "resolution": 64, "num_grippers": 1}
    assert describe_settings(config).endswith(": here env_kwargs=graph_nodes=25 resolution=64 num_grippers=1; here gamma=0.9")


def test_a_recommendation_makes_sizes_fit_that_would_not_by_default():
    """20 transitions in 4 minibatches; by default there are 16."""
    sizes = ["--num_envs", "4", "--num_steps", "5", "--total_timesteps", "20"]
    assert parse_train_options([*FOLDING, *sizes]).num_minibatches == 4


def test_studies_and_cards_mean_what_they_say(tmp_path):
    """The command that a study writes is read back as the same training, whatever the task recommends."""
    config = TrainConfig(env_id="ClothFolding-v1", exp_name="s/run", env_kwargs=("resolution=100",))
    assert config.num_envs != recommended_settings("ClothFolding-v1")["num_envs"]
    assert parse_train_options(Training(config).words[1:]) == config
    assert parse_train_options([*FOLDING, "--no_recommended"]) == TrainConfig(env_id="ClothFolding-v1")


def test_recommending_what_there_is_not_is_refused(monkeypatch):
    monkeypatch.setattr(ClothFoldingEnv, "TRAINING", {"gama": 0.9})
    with pytest.raises(ValueError, match="ClothFoldingEnv.TRAINING names gama, which `train` does not take"):
        parse_train_options(FOLDING)
    with pytest.raises(ValueError, match="no_such_module"):
        parse_train_options(["--env_id", "no_such_module:Task-v1"])
