"""Why the reward of ClothHanging-v1 is what it is: what a cloth earns on its way onto the peg, and grippers that bunch.

python examples/cloth_hanging_valley.py

The flat cloth stands with its hole on the axis of the peg, `before` centimetres before the tip (negative: down the peg), or
30 cm before it at a `size` between its grippers. The return gained by going on is that of a cloth that comes nearer by 1 cm a
step, to 10 cm down the peg, minus that of one that waits, both discounted with 0.95 over 100 steps. The tables show them under
the task's reward and under one without pay for the last 8 cm and for a spread cloth, whose way ends where these begin.
"""

import gymnasium as gym
import torch
from mani_skill.utils.geometry.rotation_conversions import quaternion_to_matrix

import maniskill_grpd  # noqa: F401  (registers the task)
from maniskill_grpd.tasks.geometry.direction_draws import tilts_of_z
from maniskill_grpd.tasks.geometry.hanger import FUNNEL_RADIUS, WAITING_DISTANCE, Hanging

BEFORE = torch.arange(20, -11, -1) / 100.0
"""How far before the tip the hole is [m]."""
SIZES = torch.tensor([0.4, 0.6, 0.8, 0.9, 1.0])
"""Sizes of the cloth between its grippers, 1 for a flat one."""
GAMMA, NUM_STEPS = 0.95, 100


def pay_for_the_way(hanging: Hanging, axis: torch.Tensor) -> torch.Tensor:
    """Return a reward (B,) that is the same all along the last 8 cm before the tip, and for slack cloths."""
    height = -hanging.depth
    aside = (hanging.offset + height[:, None] * axis).norm(dim=-1)
    lowest = WAITING_DISTANCE * (aside / FUNNEL_RADIUS).clamp(max=1.0)
    missing = height - height.clamp(max=WAITING_DISTANCE).maximum(lowest)
    way = torch.where(hanging.is_on, 0.0, (aside.square() + missing.square()).sqrt())
    near = 1.0 - torch.tanh(way / 0.5)
    progress = torch.where(hanging.is_on, 2.0 * hanging.progress - 1.0, 0.0)
    return 0.2 * near + 0.1 * near * hanging.alignment + 0.2 * progress + 0.5 * hanging.is_hung


def rewards(before: torch.Tensor, sizes: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the task's rewards and the others of flat cloths, each (B,), before the tip by (B,) [m] and of sizes (B,)."""
    env = gym.make("ClothHanging-v1", num_envs=len(before), obs_mode="none", sim_backend="cpu", render_backend="none")
    env.reset(seed=0)
    base = env.unwrapped
    axis, flat = base.hanger_axis, base.rest_positions[base.variants]
    seat = flat.gather(1, base.seat_nodes[base.variants][..., None].expand(-1, -1, 3))[:, :-1].mean(dim=1, keepdim=True)
    turned = sizes[:, None, None] * (flat - seat) @ quaternion_to_matrix(tilts_of_z(axis)).mT
    base.solver.positions.copy_(turned + (base.hanger_point + before[:, None] * axis)[:, None])
    base.forget_measurement()
    measured = base.measurement
    both = base.reward(measured), pay_for_the_way(measured.hanging, axis)
    env.close()
    return both


def gain_of_going_on(reward: torch.Tensor) -> torch.Tensor:
    """Return by how much the return of going on step by step beats that of waiting, from every place on, (B,)."""
    count, discount = len(reward), GAMMA ** torch.arange(NUM_STEPS)
    gains = []
    for place in range(count):
        ahead = reward[torch.arange(place, place + NUM_STEPS).clamp(max=count - 1)]
        gains.append((discount * (ahead - reward[place])).sum())
    return torch.stack(gains)


def main() -> None:
    """Print both tables."""
    torch.set_num_threads(1)
    pays = rewards(BEFORE, torch.ones_like(BEFORE))
    first_step = [GAMMA * reward.diff(append=reward[-1:]) for reward in pays]
    columns = [BEFORE * 100.0, *(c for pair in zip(pays, first_step, map(gain_of_going_on, pays), strict=True) for c in pair)]
    names = ("reward", "gain of the next cm", "return gained by going on")
    print("| before [cm] | " + " | ".join(f"{name}, {kind}" for kind in ("task", "way alone") for name in names) + " |")
    print("|--:" * len(columns) + "|")
    for row in zip(*columns, strict=True):
        print("| " + " | ".join([f"{row[0]:.0f}", *(f"{value:.3f}" for value in row[1:])]) + " |")
    print("\n| size | reward, task | reward, way alone |\n|--:|--:|--:|")
    for row in zip(SIZES, *rewards(torch.full_like(SIZES, 0.3), SIZES), strict=True):
        print("| " + " | ".join(f"{value:.3f}" for value in row) + " |")


if __name__ == "__main__":
    main()
