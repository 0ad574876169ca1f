"""Moving whole scenes rigidly."""

import torch


def move_everything(base, rotation: torch.Tensor, translation: torch.Tensor) -> None:
    """Rotate and translate rope, grippers, goals, table and gravity of all worlds."""
    solver = base.solver
    for points in (solver.positions, solver.gripper_positions, solver.gripper_targets, base.goal_positions):
        points.copy_(points @ rotation.T + translation)
    for vectors in (solver.velocities, solver.hold_offsets, solver.gravity):
        vectors.copy_(vectors @ rotation.T)
    normal = solver.plane[:, :3] @ rotation.T
    solver.plane.copy_(torch.cat([normal, solver.plane[:, 3:] + normal @ translation[:, None]], dim=1))
    velocities = base.agent.robot.qvel.unflatten(1, (-1, 3))
    base.agent.robot.qvel.copy_((velocities @ rotation.T).flatten(1))
