"""What `info` tells about contact of an object with itself."""

import gymnasium as gym
import pytest
import torch

import maniskill_grpd  # noqa: F401  (registers the tasks)


def make_env(env_id: str, **options) -> gym.Env:
    return gym.make(env_id, num_envs=2, sim_backend="cpu", render_backend="none", **options)


def test_crossings_are_counted_on_request_and_in_the_world_that_has_them():
    env = make_env("ClothFolding-v1", count_crossings=True, shapes=("square", "circle"))
    env.reset(seed=[0, 1])
    assert env.unwrapped.get_info()["self_crossings"].tolist() == [0, 0]
    solver = env.unwrapped.solver
    solver.positions[1] = torch.rand(solver.num_nodes, 3, generator=torch.Generator().manual_seed(0))
    env.unwrapped.forget_measurement()
    crossings = env.unwrapped.get_info()["self_crossings"]
    assert crossings[0] == 0
    assert crossings[1] > 0


def test_contacts_without_room_are_told_always():
    env = make_env("RopeShaping-v1")
    env.reset(seed=[0, 1])
    info = env.unwrapped.get_info()
    assert "self_crossings" not in info
    assert info["dropped_contacts"].tolist() == [0, 0]
    env.unwrapped.solver.dropped_contacts[1] = 3
    assert env.unwrapped.get_info()["dropped_contacts"].tolist() == [0, 3]
    assert info["dropped_contacts"].tolist() == [0, 0]  # a copy


def test_a_rope_has_no_crossings_to_count():
    with pytest.raises(ValueError, match="count_crossings"):
        make_env("RopeShaping-v1", count_crossings=True).reset(seed=[0, 1])


@pytest.mark.parametrize("self_collision", [True, False])
def test_collision_with_itself_is_an_option(self_collision):
    env = make_env("RopeWrapping-v1", self_collision=self_collision)
    assert env.unwrapped.solver._features.self_contact == self_collision
    assert torch.is_tensor(env.unwrapped.get_info()["dropped_contacts"])
