"""The player: who acts, what can be changed while it plays, and what happens to what cannot be done."""

from pathlib import Path

import gymnasium as gym
import pytest
import torch

from maniskill_grpd.learning import CheckpointError
from maniskill_grpd.playing.agents import Teleoperator
from maniskill_grpd.playing.play_config import PlayConfig
from maniskill_grpd.playing.player import Player

CHECKPOINTS = Path(__file__).parents[2] / "checkpoints"
ROPE, WRAPPING = CHECKPOINTS / "rope_shaping_w.pt", CHECKPOINTS / "rope_wrapping.pt"


class Witness:
    """Remembers what a player tells."""

    def __init__(self, player: Player) -> None:
        self.events: list[str] = []
        self.messages: list[str] = []
        player.watchers.append(self)

    def on_environment(self):
        """There is a new environment."""
        self.events.append("environment")

    def on_reset(self):
        """New episodes have started."""
        self.events.append("reset")

    def on_step(self):
        """A step was taken."""
        self.events.append("step")

    def on_idle(self):
        """Nothing happens."""
        self.events.append("idle")

    def on_message(self, message):
        """Somebody is told something."""
        self.messages.append(message)


@pytest.fixture
def make():
    players = []

    def build(**options) -> Player:
        player = Player(PlayConfig(sim_backend="cpu", **options))
        players.append(player)
        return player

    yield build
    for player in players:
        player.close()


def positions(player: Player) -> torch.Tensor:
    return player.base.solver.positions.clone()


def test_a_checkpoint_brings_its_task_and_acts_as_in_an_evaluation(make):
    player = make(checkpoint=ROPE, num_envs=2, seed=7)
    assert player.base.spec.id == "RopeShaping-v1"
    graph = player.moment.graph
    player.step()
    assert torch.equal(player.moment.action, player.agent.policy.act(graph, deterministic=True))


@pytest.mark.parametrize("agent", ["expert", "planner", "random", "zero"])
def test_agents_act(make, agent):
    player = make(env_id="RopeShaping-v1", agent=agent, num_envs=2)
    player.reset()
    before = player.base.solver.gripper_positions.clone()
    for _ in range(3):
        player.step()
    moved = (player.base.solver.gripper_positions - before).norm(dim=-1)
    assert bool((moved == 0.0).all()) == (agent == "zero")


def test_grippers_that_nobody_leads_stay_closed(make):
    player = make(env_id="RopeWrapping-v1", agent="zero", env_kwargs=('grasp="free"',))
    player.step()
    assert player.base.solver.closed.all()


def test_a_hand_leads_one_world_and_opens_grippers_there(make):
    player = make(env_id="RopeWrapping-v1", agent="teleop", env_kwargs=('grasp="free"',), num_envs=2)
    agent, solver = player.agent, player.base.solver
    assert isinstance(agent, Teleoperator)
    agent.take_over(1)
    before = solver.gripper_positions.clone()
    agent.targets[0] += torch.tensor([0.0, 0.0, 0.08])
    agent.closed[1] = False
    for _ in range(4):
        player.step()
    torch.testing.assert_close(solver.gripper_positions[1, 0], before[1, 0] + torch.tensor([0.0, 0.0, 0.08]), atol=1e-5, rtol=0.0)
    assert torch.equal(solver.gripper_positions[0], before[0])
    assert solver.closed.tolist() == [[True, True], [True, False]]


def test_arms_are_led_by_hand_too(make):
    player = make(env_id="RopeWrapping-v1", agent="teleop", env_kwargs=('robot_uids=["panda", "panda"]',))
    player.agent.targets[:, 2] += 0.05
    before = player.base.solver.gripper_positions[0].clone()
    for _ in range(3):
        player.step()
    moved = player.base.solver.gripper_positions[0] - before
    assert (moved - torch.tensor([0.0, 0.0, 0.05])).norm(dim=-1).max() < 5e-3


def test_a_reset_repeats_its_seed_and_the_next_episodes_have_the_next_seeds(make):
    player = make(env_id="RopeShaping-v1", num_envs=2, seed=40, env_kwargs=("max_episode_steps=3",))
    first = positions(player)
    for _ in range(3):
        player.step()
    player.step()  # the episodes are over: new ones
    assert (player.seed, player.moment.step) == (42, 0)
    assert not torch.equal(positions(player), first)
    player.reset(40)
    assert torch.equal(positions(player), first)


def test_material_and_gravity_change_at_once_and_stay_changed(make):
    player = make(env_id="ClothHanging-v1", agent="zero", env_kwargs=("resolution=64",))
    solver = player.base.solver
    friction, stretch = solver.friction.clone(), solver.stretch_scale.clone()
    player.set_material("friction", 2.0)
    player.set_material("stretch", 0.5)
    player.set_gravity(0.0)
    player.reset()
    torch.testing.assert_close(solver.friction, 2.0 * friction)
    torch.testing.assert_close(solver.stretch_scale, 0.5 * stretch)
    before = positions(player)
    player.step()
    assert (positions(player) - before).abs().max() < 1e-4  # nothing falls
    player.set_gravity(9.81)
    player.step()
    assert (positions(player) - before).abs().max() > 1e-3


def test_policies_see_through_noise(make):
    player = make(checkpoint=ROPE)
    graph = player.moment.graph
    clear = player.agent.act(graph)
    player.set_noise(0.02)
    assert not torch.equal(player.agent.act(graph), clear)
    player.set_noise(0.0)
    assert torch.equal(player.agent.act(graph), clear)


def test_what_cannot_be_done_is_told_and_changes_nothing(make, tmp_path):
    player = make(checkpoint=ROPE)
    witness, agent, env = Witness(player), player.agent, player.env
    (tmp_path / "rubbish.pt").write_bytes(b"rubbish")
    wrong = {
        "another task": lambda: player.choose_agent("policy", WRAPPING),
        "no checkpoint": lambda: player.choose_agent("policy", tmp_path / "rubbish.pt"),
        "no file": lambda: player.choose_agent("policy", tmp_path / "missing.pt"),
        "no agent": lambda: player.choose_agent("nobody"),
        "no option": lambda: player.change_options(("nonsense=1",)),
        "no pair": lambda: player.change_options(("nonsense",)),
        "bad value": lambda: player.change_options(("num_grippers=99",)),
        "no material": lambda: player.set_material("colour", 1.0),
        "bad factor": lambda: player.set_material("mass", -1.0),
        "rubbish": lambda: player.set_material("mass", "heavy"),
        "nothing": lambda: player.set_material("mass", None),
        "gravity": lambda: player.set_gravity(float("nan")),
        "noise": lambda: player.set_noise(-1.0),
        "seed": lambda: player.reset(-5),
        "not recording": player.keep_episode,
    }
    for count, what in enumerate(wrong.values(), 1):
        player.ask(what)
        player.obey()
        assert len(witness.messages) == count, list(wrong)[count - 1]
    assert all(message.startswith("not done: ") for message in witness.messages)
    assert (player.agent, player.env) == (agent, env)
    player.step()
    assert witness.events[-1] == "step"


def test_options_make_the_task_anew(make):
    player = make(env_id="RopeShaping-v1", num_envs=2)
    witness = Witness(player)
    player.change_options(("num_grippers=3",))
    assert player.base.num_grippers == 3
    assert witness.events == ["environment"]
    player.step()


def test_a_checkpoint_is_exchanged_while_the_episode_goes_on(make):
    player = make(env_id="RopeShaping-v1", env_kwargs=("graph_features=rich",), agent="zero")
    player.step()
    player.choose_agent("policy", ROPE)
    player.step()
    assert (player.moment.step, player.agent_name, player.checkpoint) == (2, "policy", ROPE)


def test_run_does_what_is_asked_for_and_stops(make):
    player = make(env_id="RopeShaping-v1", agent="zero")
    witness, player.speed = Witness(player), 0.0
    done = []
    player.ask(lambda: done.append(1))
    player.stop()
    player.run()
    assert done == [1]
    assert witness.events.count("step") <= 1


def test_a_paused_player_stands_still(make):
    player = make(env_id="RopeShaping-v1", agent="random")
    witness, player.is_playing = Witness(player), False
    before = positions(player)
    witness.on_idle = player.stop
    player.run()
    assert torch.equal(positions(player), before)


@pytest.mark.parametrize(
    ("options", "error"),
    [({"agent": "policy"}, "needs a --checkpoint"), ({"num_envs": 0}, "num_envs"), ({"env_kwargs": ("novalue",)}, "novalue")],
)
def test_options_that_contradict_each_other_are_refused(options, error):
    with pytest.raises(ValueError, match=error):
        PlayConfig(**options)


def test_a_checkpoint_of_another_task_is_refused_before_anything_is_shown():
    with pytest.raises(CheckpointError, match="other observations"):
        Player(PlayConfig(checkpoint=WRAPPING, env_id="RopeShaping-v1", sim_backend="cpu"))


def test_an_environment_can_be_lent(make):
    env = gym.make("RopeShaping-v1", num_envs=2, obs_mode="graph", sim_backend="cpu")
    player = Player(PlayConfig(num_envs=2), env)
    player.step()
    with pytest.raises(ValueError, match="was given to the viewer"):
        player.change_options(())
    player.close()
    env.reset(seed=[1, 2])  # is still open
    env.close()
    blind = gym.make("RopeShaping-v1", obs_mode="state", sim_backend="cpu")
    with pytest.raises(ValueError, match="graph observations"):
        Player(PlayConfig(), blind)
    blind.close()
