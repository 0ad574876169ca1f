"""Options: defaults, derived numbers, and messages that say what is allowed."""

import dataclasses
import math
import sys
import types
from pathlib import Path
from typing import ClassVar, get_args, get_type_hints

import pytest
import tyro

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning import config as config_module
from maniskill_grpd.learning.algorithm import ALGORITHMS
from maniskill_grpd.learning.config import RESUMABLE_FIELDS
from maniskill_grpd.learning.options import OptionGroup
from maniskill_grpd.learning.ppo import PPO


def test_derived_numbers():
    config = TrainConfig(num_envs=8, num_steps=50, num_minibatches=4, total_timesteps=1000)
    assert (config.batch_size, config.minibatch_size, config.num_iterations) == (400, 100, 2)


def test_round_trip_through_plain_types():
    config = TrainConfig(env_kwargs=("num_grippers=2",), target_kl=0.1)
    assert TrainConfig.from_dict(config.to_dict()) == config


def test_unknown_fields_are_refused():
    with pytest.raises(ValueError, match="nonsense"):
        TrainConfig.from_dict({"nonsense": 1})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"algorithm": "trpo"}, "one of bpp, ppo, got 'trpo'"),
        ({"num_envs": 10, "num_steps": 10, "num_minibatches": 16}, "20 would fit"),
        ({"total_timesteps": 10}, "less than one iteration"),
        ({"num_envs": 4, "num_steps": 4, "num_minibatches": 16}, "at least 2 transitions"),
        ({"learning_rate": 0.0}, r"learning_rate must lie in \(0, inf\), got 0.0"),
        ({"learning_rate": float("nan")}, r"learning_rate must lie in \(0, inf\), got nan"),
        ({"mean_bound": -1.0}, r"mean_bound must lie in \(0, inf\), got -1.0"),
        ({"gamma": 1.5}, r"gamma must lie in \[0, 1\]"),
        ({"ent_coef": -0.1}, r"ent_coef must lie in \[0, inf\), got -0.1"),
        ({"trust_region": "ball"}, "one of projection, lagrangian, fisher, got 'ball'"),
        ({"lr_schedule": "step"}, "lr_schedule must be one of constant, linear, cosine"),
        ({"ent_schedule": "step"}, "ent_schedule must be one of constant, linear, cosine"),
        ({"best_metric": "speed"}, "one of success_at_end, success_once, return, got 'speed'"),
        ({"resume": "runs/a", "checkpoint": "b.pt"}, "give one of them"),
        ({"algorithm": "ppo", "trust_region": "fisher"}, "belongs to --algorithm bpp"),
        ({"anneal_lr": True, "lr_schedule": "cosine"}, "give one of them"),
        ({"ent_schedule": "linear"}, "set it too"),
        ({"algorithm": "ppo", "entropy_floor": 0.0}, "projection only"),
        ({"entropy_floor_final": 0.0}, "needs --entropy_floor"),
        ({"trust_region": "fisher", "target_kl": 0.1}, "has a line search"),
        ({"trust_region": "fisher", "compile": True}, "no second derivatives"),
        ({"max_multiplier": 1.0}, r"max_multiplier must lie in \(1, inf\), got 1.0"),
        ({"position_noise": -0.1}, r"position_noise must lie in \[0, inf\), got -0.1"),
        ({"target_kl": float("nan")}, r"target_kl must lie in \(0, inf\), got nan"),
        ({"normalizer_freeze_steps": -5}, r"normalizer_freeze_steps must lie in \[0, inf\), got -5"),
        ({"entropy_floor": float("inf")}, r"entropy_floor must lie in \(-inf, inf\), got inf"),
        ({"torch_threads": 100_000}, r"torch_threads must lie in \[1, 1024\], got 100000"),
        ({"env_kwargs": ("num_grippers",)}, "key=value"),
        ({"env_kwargs": ("a=1", "a=2")}, "'a' twice"),
    ],
)
def test_bad_options_are_refused_with_a_way_out(options, message):
    with pytest.raises(ValueError, match=message):
        TrainConfig(**options)


def numeric_fields():
    """Return the names of all options that are numbers, or numbers or None."""
    hints = get_type_hints(TrainConfig)
    kinds = {name: set(get_args(hint) or [hint]) - {type(None)} for name, hint in hints.items()}
    return sorted(field.name for field in dataclasses.fields(TrainConfig) if kinds[field.name] in ({int}, {float}))


@pytest.mark.parametrize("name", numeric_fields())
def test_no_number_is_taken_without_a_range(name):
    """Neither NaN nor an infinity is a value of any option, and the message names the range."""
    beside = {"algorithm": "ppo"} if name == "clip_kl" else {"entropy_floor": 0.0}
    for value in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match=rf"^{name} must lie in [\[(].*[\])], got {value}"):
            TrainConfig(**{**beside, name: value})


def test_a_third_algorithm_brings_its_own_options(monkeypatch):
    """A class with options and one entry of the table: config, checks and command line know them."""

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Options(OptionGroup):
        RANGES: ClassVar = {"new_coef": "(0, 1)"}
        new_coef: float = 0.5
        """new: a coefficient"""

    class New(PPO):
        pass

    New.Options = Options
    monkeypatch.setitem(ALGORITHMS, "new", New)
    source = Path(config_module.__file__).read_text()
    module = types.ModuleType("config_with_three")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(source, "config_with_three.py", "exec"), module.__dict__)
    config = tyro.cli(module.TrainConfig, args=["--algorithm", "new", "--new_coef", "0.25"])
    assert ALGORITHMS[config.algorithm] is New
    assert config.new_coef == 0.25
    with pytest.raises(ValueError, match=r"new_coef must lie in \(0, 1\), got 2.0"):
        module.TrainConfig(new_coef=2.0)


def test_schedules_start_at_the_first_value_and_go_to_the_last():
    sizes = {"num_envs": 8, "num_steps": 10, "num_minibatches": 2, "total_timesteps": 800}
    config = TrainConfig(
        **sizes,
        learning_rate=1e-3,
        lr_schedule="cosine",
        ent_coef=0.1,
        ent_schedule="linear",
        entropy_floor=2.0,
        entropy_floor_final=-2.0,
    )
    start, middle, end = (config.coefficients(iteration) for iteration in (0, 5, 10))
    assert (start.learning_rate, start.ent_coef, start.entropy_floor) == (1e-3, 0.1, 2.0)
    assert middle.learning_rate == pytest.approx(5e-4)
    assert (middle.ent_coef, middle.entropy_floor) == pytest.approx((0.05, 0.0))
    assert end.learning_rate == pytest.approx(0.0, abs=1e-12)
    constant = TrainConfig(**sizes)
    assert constant.coefficients(0) == constant.coefficients(9)


def test_pairs_are_parsed_as_json_or_strings():
    config = TrainConfig(env_kwargs=("num_grippers=2", 'shapes=["U", "W"]', "pose_range=half", "flag=true"))
    assert config.env_options == {"num_grippers": 2, "shapes": ["U", "W"], "pose_range": "half", "flag": True}


def test_command_line_takes_underscores_and_pairs():
    arguments = "--num_envs 8 --total_timesteps 1_000_000 --env_kwargs num_grippers=2 goal=V --anneal_lr"
    config = tyro.cli(TrainConfig, args=arguments.split())
    assert config.num_envs == 8
    assert config.total_timesteps == 1_000_000
    assert config.env_options == {"num_grippers": 2, "goal": "V"}
    assert config.anneal_lr


def test_every_field_is_documented_on_the_command_line(capsys):
    with pytest.raises(SystemExit):
        tyro.cli(TrainConfig, args=["--help"])
    text = capsys.readouterr().out
    assert "largest covariance part of the KL" in " ".join(text.replace("│", "").split())


def test_resumable_fields_exist():
    assert {field.name for field in dataclasses.fields(TrainConfig)} >= RESUMABLE_FIELDS
