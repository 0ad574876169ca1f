"""Why the reward of RopeShaping-v1 is what it is: detours that lay the free part of a W, and what three rewards pay for them.

python examples/rope_shaping_detours.py

Every gripper first goes to a point beyond its goal (`beyond` metres towards the middle vertex of the W, `lift` metres up),
then to its goal, so that the free middle trails on the right side. The table shows success, final distance and the
discounted return (gamma 0.99) under the task's reward and, for ropes that come from below, under two others: one that pays
half for success and for precision only within 3 cm, and one that pays for nearness alone. From below means from the side
away from the middle vertex, more than 120 degrees from it: those ropes have to be dragged past their goal and back. The last
row is the scripted expert. The poses are those of the 200 seeds on which `baselines/evaluate.py` plays by default.
"""

from collections.abc import Callable

import gymnasium as gym
import torch

import maniskill_grpd  # noqa: F401  (registers the task)
from maniskill_grpd.experts import make_expert

NUM_WORLDS = 200
FIRST_SEED = 1_000_000
NUM_STEPS = 100
GAMMA = 0.99
MAX_STEP = 0.03
DETOURS = tuple((beyond, lift) for lift in (0.0, 0.1) for beyond in (0.0, 0.05, 0.1, 0.15, 0.2, 0.25))
COLUMNS = (
    "beyond [m]",
    "lift [m]",
    "success",
    "from below",
    "distance [m]",
    "return",
    "from below",
    "pay for success",
    "pay for nearness",
)


def pay_for_success(distances: torch.Tensor, success: torch.Tensor) -> torch.Tensor:
    """Return a reward of node-goal distances (B, N) that tells nothing between a rope laid half and one laid well."""
    mean = distances.mean(dim=1)
    return 0.2 * (1.0 - torch.tanh(mean / 0.2)) + 0.3 * torch.exp(-((mean / 0.03) ** 2)) + 0.5 * success


def pay_for_nearness(distances: torch.Tensor, success: torch.Tensor) -> torch.Tensor:
    """Return a reward of node-goal distances (B, N) in which a rope that rests half done still earns most of the pay."""
    far = 1.0 - torch.tanh(distances.mean(dim=1) / 0.2)
    near = torch.exp(-((distances / 0.06) ** 2)).mean(dim=1)
    return 0.4 * far + 0.4 * near + 0.2 * success


def plan_detour(env: gym.Env, beyond: float, lift: float) -> Callable[[], torch.Tensor]:
    """Return what gives the actions (B, A * 3) of a detour, for the episodes that have just begun."""
    solver, curve = env.unwrapped.solver, env.unwrapped.goal_positions
    nodes = torch.tensor([(solver.holder[0] == gripper).nonzero().item() for gripper in range(4)])
    quarter, middle = curve.shape[1] // 4, curve.shape[1] // 2
    up = curve[:, middle] - 0.5 * (curve[:, quarter] + curve[:, -1 - quarter])
    goals = curve[:, nodes].clone()
    waypoints = goals + beyond * torch.nn.functional.normalize(up, dim=-1)[:, None]
    waypoints[..., 2] += lift
    is_laying = torch.zeros(NUM_WORLDS, dtype=torch.bool)

    def act() -> torch.Tensor:
        to_waypoint = waypoints - solver.gripper_positions
        is_laying.logical_or_(to_waypoint.norm(dim=-1).amax(dim=1) < 0.02)
        motion = torch.where(is_laying[:, None, None], goals - solver.gripper_positions, to_waypoint)
        return (motion / MAX_STEP).flatten(1)

    return act


def play(env: gym.Env, plan: Callable[[], Callable[[], torch.Tensor]]) -> str:
    """Play one episode per world and return the figures of a row of the table."""
    base = env.unwrapped
    env.reset(seed=list(range(FIRST_SEED, FIRST_SEED + NUM_WORLDS)))
    is_below = comes_from_below(base.solver.positions, base.goal_positions)
    act = plan()
    task, for_success, for_nearness = torch.zeros(3, NUM_WORLDS)
    for step in range(NUM_STEPS):
        _, reward, _, _, info = env.step(act())
        distances = (base.solver.positions - base.goal_positions).norm(dim=-1)
        discount = GAMMA**step
        task += discount * reward
        for_success += discount * pay_for_success(distances, info["success"])
        for_nearness += discount * pay_for_nearness(distances, info["success"])
    success = info["success"].float()
    shares = f"{success.mean():.2f} | {success[is_below].mean():.2f} | {info['mean_distance'].mean():.4f}"
    returns = (task, task[is_below], for_success[is_below], for_nearness[is_below])
    return f"{shares} | {' | '.join(f'{entry.mean():.1f}' for entry in returns)} |"


def comes_from_below(positions: torch.Tensor, goals: torch.Tensor) -> torch.Tensor:
    """Return which ropes (B, N, 3) lie more than 120 degrees from the direction of the middle vertex of their goals, (B,)."""
    quarter, middle = goals.shape[1] // 4, goals.shape[1] // 2
    up = torch.nn.functional.normalize(goals[:, middle] - 0.5 * (goals[:, quarter] + goals[:, -1 - quarter]), dim=-1)
    way = torch.nn.functional.normalize(positions.mean(dim=1) - goals.mean(dim=1), dim=-1)
    return (way * up).sum(dim=-1) < -0.5


def main() -> None:
    """Print the table."""
    env = gym.make("RopeShaping-v1", num_envs=NUM_WORLDS, obs_mode="none", sim_backend="cpu")
    print("|", " | ".join(COLUMNS), "|")
    print("|--:" * len(COLUMNS) + "|")
    for beyond, lift in DETOURS:
        print(f"| {beyond:.2f} | {lift:.1f} |", play(env, lambda b=beyond, u=lift: plan_detour(env, b, u)))
    print("| expert | |", play(env, lambda: make_expert("RopeShaping-v1", env).act))


if __name__ == "__main__":
    main()
