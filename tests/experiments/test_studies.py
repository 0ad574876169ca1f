"""The declared studies are sound: names are unique, claims speak of what is there, runs can be configured."""

import dataclasses
import itertools

import pytest
from random_graphs import SCHEMA

from maniskill_grpd.experiments import STUDIES, Arm, Condition, Run, Task, find_study
from maniskill_grpd.experiments.metrics import METRICS
from maniskill_grpd.experiments.plots import PLOTS
from maniskill_grpd.experiments.studies import register_task
from maniskill_grpd.experiments.studies.tuning import SIZES
from maniskill_grpd.experiments.study import PILOT_SEED, combine, to_pairs, with_noise, with_option
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.policies import POLICIES, make_policy

ALL = pytest.mark.parametrize("study", STUDIES.values(), ids=STUDIES)


def test_every_claim_of_the_design_has_a_study():
    ablations = {"equivariance", "unseen_poses", "heterogeneity", "features", "decoder", "architecture"}
    training = {"main", "bpp_vs_ppo", "unseen_shapes", "pose_range", "bar", "hepi", *ablations}
    tested = {"noise", "resolution", "grippers", "cost"}
    assert set(STUDIES) == training | tested | {"occlusion", "critic"} | {f"tuning_{name}" for name in POLICIES}


def test_a_registered_task_joins_the_studies_of_all_tasks_once(monkeypatch):
    for name, study in STUDIES.items():
        monkeypatch.setitem(STUDIES, name, study)  # all are put back
    before = dict(STUDIES)
    for _ in range(2):
        register_task("own:Knots-v1", {"resolution": 21})
        register_task("RopeShaping-v1", {"resolution": 100})
    joined = {name for name, study in STUDIES.items() if study != before[name]}
    assert joined == {"main"}
    for name in joined:
        assert find_study(name).tasks == (*before[name].tasks, Task(env_id="own:Knots-v1", options={"resolution": 21}))


@ALL
def test_names_are_unique(study):
    assert len({task.name for task in study.tasks}) == len(study.tasks)
    assert len({arm.name for arm in study.arms}) == len(study.arms)
    for task in study.tasks:
        assert len({condition.name for condition in task.conditions}) == len(task.conditions)


@ALL
def test_claims_speak_of_arms_tasks_conditions_and_metrics_that_are_there(study):
    for claim, side in itertools.product(study.claims, ("ours", "theirs")):
        place = getattr(claim, side)
        assert place.arm in {arm.name for arm in study.arms}
        tasks = [task for task in study.tasks if place.task in (None, task.name)]
        assert tasks
        for task in tasks:
            assert set(place.conditions) <= {condition.name for condition in task.conditions}
        assert claim.metric in METRICS


@ALL
def test_metrics_and_plots_are_known(study):
    assert set(study.metrics) <= set(METRICS)
    assert set(study.plots) <= set(PLOTS)
    assert (study.factor is not None) == ("lines" in study.plots)


@ALL
def test_every_run_has_its_own_folder_and_a_valid_configuration(study):
    runs = list(study.runs(1_000_000, (1, 2)))
    assert len({run.name for run in runs}) == len(runs) == 2 * len(study.tasks) * len(study.arms)
    for run in runs:
        config = run.train_config()
        assert config.num_iterations >= 1
        assert "/" not in run.name
        assert len(run.name) < 200
        make_policy(run.arm.policy, SCHEMA, **config.policy_options)


@ALL
def test_arms_differ_in_nothing_but_what_they_name(study):
    for task in study.tasks:
        configs = [run.train_config() for run in study.runs(1_000_000, (1,)) if run.task == task]
        for config, arm in zip(configs, study.arms, strict=True):
            same = {"exp_name": None, "policy": "grpd", "policy_kwargs": (), "algorithm": "bpp"}
            same |= {name: getattr(TrainConfig(), name) for name in arm.train_options}
            assert dataclasses.replace(config, **same) == dataclasses.replace(configs[0], **same)


@ALL
def test_checkpoints_that_are_tested_are_those_of_a_study_that_trains(study):
    if study.trained_by is None:
        return
    trained = {run.name for run in find_study(study.trained_by).runs(1000, (1,))}
    assert {run.name for run in study.runs(1000, (1,))} <= trained


def test_studies_share_runs():
    def names(study):
        return {run.name for run in STUDIES[study].runs(1000, (1,))}

    for study in ("heterogeneity", "equivariance", "pose_range", "decoder", "architecture", "hepi"):
        assert names(study) & names("main")
    assert names("unseen_poses") & names("pose_range")


def changed_options(arm, partner):
    """Return the names of all options in which the trainings of two arms differ."""
    task = Task(env_id="RopeShaping-v1")
    configs = [Run(task=task, arm=side, seed=1, budget=1_000_000).train_config().to_dict() for side in (arm, partner)]
    configs = [{**config, "policy_kwargs": None, "exp_name": None} for config in configs]
    found = {name for name in configs[0] if configs[0][name] != configs[1][name]}
    options = [side.policy_options for side in (arm, partner)]
    return found | {name for name in {*options[0], *options[1]} if options[0].get(name) != options[1].get(name)}


DIFFERENCES = {
    "empn": {"policy"},
    "hetero_gnn": {"policy"},
    "transformer": {"policy"},
    "hepi": {"policy"},
    "grpd_raw": {"coordinates"},
    "grpd_shared": {"weights"},
    "grpd_blind": {"object_messages"},
    "grpd_raw_turned": {"rotation_augmentation"},
    "hetero_gnn_turned": {"rotation_augmentation"},
    "bpp_lagrangian": {"trust_region"},
    "bpp_fisher": {"trust_region"},
    "ppo": {"algorithm"},
    "ppo_matched": {"clip_kl"},
    "naive": {"decoder"},
    "independent": {"decoders"},
    "unbounded": {"magnitude"},
    "small_steps": {"mean_bound", "cov_bound"},
    "large_steps": {"mean_bound", "cov_bound"},
    "full_critic": {"critic_observations"},
}
"""The one thing in which an arm differs from its partner."""


@ALL
def test_each_arm_differs_from_its_partner_in_one_thing(study):
    arms = {arm.name: arm for arm in study.arms}
    references = [arm for arm in study.arms if arm.partner is None]
    assert references == [study.arms[0]]
    for arm in study.arms[1:]:
        partner = arms[arm.partner] if arm.partner in arms else augmented_or_plain(arm.partner)
        changed = changed_options(arm, partner)
        assert arm.difference
        if study.name == "architecture":
            assert changed == {arm.name.partition("=")[0]}
        elif study.name.startswith("tuning") and arm.name in ("wide", "deep"):
            assert changed == set(arm.policy_options)
            assert (changed == {"num_layers"}) == (arm.name == "deep")
        else:
            assert changed == DIFFERENCES.get(arm.name, {"learning_rate"})


def augmented_or_plain(name):
    """Return an arm that a study does not have itself."""
    return next(arm for study in STUDIES.values() for arm in study.arms if arm.name == name)


def test_networks_that_are_tuned_are_larger_than_the_defaults():
    for policy, sizes in SIZES.items():
        counts = {
            name: sum(p.numel() for p in make_policy(policy, SCHEMA, **options).parameters())
            for name, options in {"default": {}, **sizes}.items()
        }
        assert 1.5 < counts["wide"] / counts["default"] < 4.5, policy
        assert 1.0 < counts["deep"] / counts["default"] < 2.0, policy


def test_seeds_of_pilots_are_no_results():
    pilot, main = STUDIES["tuning_grpd"], STUDIES["main"]
    assert list(pilot.seeds(2)) == [PILOT_SEED, PILOT_SEED + 1]
    assert list(main.seeds(2)) == [1, 2]
    assert [study.shows(seed) for study in (pilot, main) for seed in (1, PILOT_SEED)] == [False, True, True, False]


def test_a_run_is_named_by_all_that_determines_it():
    run = Run(task=Task(env_id="T-v1", options={"shapes": ["a", "b"], "n": 3}), arm=Arm(name="x"), seed=2, budget=500)
    assert run.name == "T-v1,n=3,shapes=a+b__grpd__bpp__500__s2"
    seen = dataclasses.replace(run, task=Task(env_id="T-v1", options={"sensor_configs": {"fov": 0.4, "width": 64}}))
    assert seen.name == "T-v1,sensor_configs=fov-0.4+width-64__grpd__bpp__500__s2"
    for change in ({"seed": 3}, {"budget": 600}, {"train_options": {"gamma": 0.9}}, {"arm": Arm(name="x", algorithm="ppo")}):
        assert dataclasses.replace(run, **change).name != run.name
    assert dataclasses.replace(run, arm=Arm(name="y")).name == run.name


def test_a_training_is_evaluated_twenty_times():
    run = next(STUDIES["main"].runs(1_000_000, (1,)))
    config = run.train_config()
    assert config.num_iterations // config.eval_freq in range(20, 24)
    assert next(STUDIES["main"].runs(20_000, (1,))).train_config().eval_freq == 1


def test_conditions_combine():
    both = combine(with_option("resolution", 81, graph_nodes=None), with_noise(0.05))
    assert both.name == "resolution=81, sigma=0.05"
    assert both.env_options == {"resolution": 81, "graph_nodes": None}
    assert both.sigma == 0.05
    assert Condition().name == with_noise(0.0).name == "as trained"


def test_factors_of_a_task_are_those_of_the_condition_or_of_the_training():
    task = Task(env_id="T-v1", options={"resolution": 41})
    assert task.factor("resolution") == 41
    assert task.factor("resolution", with_option("resolution", 81)) == 81
    assert task.factor("sigma") == 0.0
    assert task.factor("pose_range") == "full"


def test_options_become_pairs_that_the_command_line_reads():
    assert to_pairs({"n": 3, "shapes": ["a"], "nodes": None, "name": "x"}) == ("n=3", 'shapes=["a"]', "nodes=null", 'name="x"')
    config = TrainConfig(env_kwargs=to_pairs({"shapes": ["a"], "nodes": None}))
    assert config.env_options == {"shapes": ["a"], "nodes": None}


def test_what_does_not_exist_is_refused_with_what_does():
    with pytest.raises(ValueError, match="unknown study 'nose'; there are main, .*noise"):
        find_study("nose")
    with pytest.raises(ValueError, match="has no task Foo; it has ClothFolding-v1, "):
        STUDIES["main"].restricted(["Foo"], [])
    with pytest.raises(ValueError, match="has no arm bar; it has empn, grpd"):
        STUDIES["main"].restricted([], ["bar"])


def test_a_study_can_be_restricted():
    part = STUDIES["main"].restricted(["RopeShaping-v1"], ["grpd", "empn"])
    assert [run.name.split("__")[:2] for run in part.runs(1000, (1,))] == [
        ["RopeShaping-v1,graph_nodes=21,resolution=41", "grpd"],
        ["RopeShaping-v1,graph_nodes=21,resolution=41", "empn"],
    ]
