"""Why the reward of RopeShaping-v1 is what it is: detours that lay the free part of a W, and what two rewards pay for them.

python examples/rope_shaping_detours.py

Every gripper first goes to a point beyond its goal (`beyond` metres towards the middle vertex of the W, `lift` metres up),
then to its goal, so that the free middle trails on the right side. The table shows success, final distance and the
discounted return (gamma 0.99) under the task's reward and under one that pays for nearness alone; the last row is the scripted
expert. The poses are those of the 200 seeds on which `baselines/evaluate.py` plays by default.
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
DETOURS = ((0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.3, 0.0), (0.0, 0.1), (0.1, 0.1), (0.2, 0.1))


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
    act = plan()
    task, nearness = torch.zeros(NUM_WORLDS), torch.zeros(NUM_WORLDS)
    for step in range(NUM_STEPS):
        _, reward, _, _, info = env.step(act())
        distances = (base.solver.positions - base.goal_positions).norm(dim=-1)
        task += GAMMA**step * reward
        nearness += GAMMA**step * pay_for_nearness(distances, info["success"])
    success, distance = info["success"].float().mean(), info["mean_distance"].mean()
    return f"{success:.2f} | {distance:.4f} | {task.mean():.1f} | {nearness.mean():.1f} |"


def main() -> None:
    """Print the table."""
    env = gym.make("RopeShaping-v1", num_envs=NUM_WORLDS, obs_mode="none", sim_backend="cpu")
    print("| beyond [m] | lift [m] | success | final distance [m] | return, task's reward | return, nearness only |")
    print("|--:|--:|--:|--:|--:|--:|")
    for beyond, lift in DETOURS:
        print(f"| {beyond:.1f} | {lift:.1f} |", play(env, lambda b=beyond, u=lift: plan_detour(env, b, u)))
    print("| expert | |", play(env, lambda: make_expert("RopeShaping-v1", env).act))


if __name__ == "__main__":
    main()
