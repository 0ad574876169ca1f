"""Every logged tag is defined in the pages, and every defined tag is logged."""

import re
from pathlib import Path

import pytest
from toy_env import ToyEnv, ToyPolicy

from maniskill_grpd.learning import TrainConfig, Trainer
from maniskill_grpd.learning.run_log import read_rows

DOCS = Path(__file__).parents[2] / "docs"
VARIANTS = {
    "ppo": {"algorithm": "ppo"},
    "projection": {"entropy_floor": 0.0},
    "lagrangian": {"trust_region": "lagrangian"},
    "fisher": {"trust_region": "fisher"},
}


def documented(page):
    """Return the tags that the tables of a page define."""
    rows = [line for line in (DOCS / page).read_text().splitlines() if line.startswith("| `")]
    first_cells = [row.split("|")[1] for row in rows]
    return set(re.findall(r"`((?:train|eval|losses|charts|time)/[^`]+)`", " ".join(first_cells)))


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """Return the tags of a short run of each variant."""
    tags = {}
    for name, options in VARIANTS.items():
        sizes = {"num_envs": 4, "num_steps": 10, "num_minibatches": 2, "total_timesteps": 80}
        config = TrainConfig(**sizes, num_eval_envs=2, eval_freq=1, **options)
        run_dir = tmp_path_factory.mktemp(name)
        envs = (ToyEnv(count, gripper=True) for count in (4, 2))
        Trainer(config, ToyPolicy(gripper=True), *envs, run_dir).train()
        rows = read_rows(run_dir / "metrics.jsonl")
        found = set().union(*rows) - {"kind", "iteration", "global_step"}
        tags[name] = {re.sub(r"/mean_distance$", "/{info}", tag) for tag in found}
    return tags


def test_every_tag_of_ppo_is_defined_in_its_page(logged):
    assert logged["ppo"] <= documented("ppo.md")


@pytest.mark.parametrize("name", ["projection", "lagrangian", "fisher"])
def test_every_tag_of_bpp_is_defined_in_a_page(logged, name):
    assert logged[name] <= documented("ppo.md") | documented("bpp.md")


def test_no_page_defines_what_no_run_logs(logged):
    assert documented("ppo.md") | documented("bpp.md") <= set().union(*logged.values())
