"""Why the reward of RopeShaping-v1 is what it is: detours that lay the free part of a W, and what two rewards pay for them.

python examples/rope_shaping_detours.py

Every gripper first goes to a point beyond its goal (`beyond` metres towards the middle vertex of the W, `lift` metres up),
then to its goal, so that the free middle trails on the right side. The table shows success, final distance and the
discounted return (gamma 0.99) under the task's reward and under one that pays for nearness alone.
"""

import gymnasium as gym
import torch

import maniskill_grpd  # noqa: F401  (registers the task)

NUM_WORLDS = 256
NUM_STEPS = 100
GAMMA = 0.99
MAX_STEP = 0.03
DETOURS = ((0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.3, 0.0), (0.0, 0.1), (0.1, 0.1), (0.2, 0.1))


def pay_for_nearness(distances: torch.Tensor, success: torch.Tensor) -> torch.Tensor:
    """Return a reward of node-goal distances (B, N) in which a rope that rests half done still earns most of the pay."""
    far = 1.0 - torch.tanh(distances.mean(dim=1) / 0.2)
    near = torch.exp(-((distances / 0.06) ** 2)).mean(dim=1)
    return 0.4 * far + 0.4 * near + 0.2 * success


def take_detour(env: gym.Env, beyond: float, lift: float) -> dict[str, float]:
    """Play one episode per world by the detour and return its means."""
    base = env.unwrapped
    env.reset(seed=list(range(NUM_WORLDS)))
    nodes = torch.tensor([(base.solver.holder[0] == gripper).nonzero().item() for gripper in range(4)])
    goals, curve = base.goal_positions[:, nodes], base.goal_positions
    quarter, middle = base.model.num_nodes // 4, base.model.num_nodes // 2
    up = curve[:, middle] - 0.5 * (curve[:, quarter] + curve[:, -1 - quarter])
    waypoints = goals + beyond * torch.nn.functional.normalize(up, dim=-1)[:, None]
    waypoints[..., 2] += lift
    is_laying = torch.zeros(NUM_WORLDS, dtype=torch.bool)
    returns = {"task": torch.zeros(NUM_WORLDS), "nearness": torch.zeros(NUM_WORLDS)}
    for step in range(NUM_STEPS):
        to_waypoint = waypoints - base.solver.gripper_positions
        is_laying |= to_waypoint.norm(dim=-1).amax(dim=1) < 0.02
        motion = torch.where(is_laying[:, None, None], goals - base.solver.gripper_positions, to_waypoint)
        _, reward, _, _, info = env.step((motion / MAX_STEP).flatten(1))
        distances = (base.solver.positions - curve).norm(dim=-1)
        returns["task"] += GAMMA**step * reward
        returns["nearness"] += GAMMA**step * pay_for_nearness(distances, info["success"])
    means = {name: value.mean().item() for name, value in returns.items()}
    return {"success": info["success"].float().mean().item(), "distance": info["mean_distance"].mean().item(), **means}


def main() -> None:
    """Print the table."""
    env = gym.make("RopeShaping-v1", num_envs=NUM_WORLDS, obs_mode="none")
    print("| beyond [m] | lift [m] | success | final distance [m] | return, task's reward | return, nearness only |")
    print("|--:|--:|--:|--:|--:|--:|")
    for beyond, lift in DETOURS:
        row = take_detour(env, beyond, lift)
        print(
            f"| {beyond:.1f} | {lift:.1f} | {row['success']:.2f} | {row['distance']:.4f} "
            f"| {row['task']:.1f} | {row['nearness']:.1f} |"
        )


if __name__ == "__main__":
    main()
