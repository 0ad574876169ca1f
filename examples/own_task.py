"""A task of one's own: bring both ends of a rope to a point on the table (docs/own_task.md explains it line by line).

python -m maniskill_grpd train --env_id examples.own_task:RopeClosing-v1
"""

import torch
from mani_skill.utils.registration import register_env

from maniskill_grpd.physics import rope
from maniskill_grpd.tasks import DeformableEnv, GoalMeasurement, Metric, channels


@register_env("RopeClosing-v1", max_episode_steps=50)
class RopeClosingEnv(DeformableEnv):
    """Two grippers hold the ends of a rope of 0.4 m. Success: both are within 2 cm of a random point."""

    GRIPPER_COUNTS, DEFAULT_NUM_GRIPPERS = (2,), 2
    PROGRESS = Metric("ends_distance", "m")
    OBJECT_CHANNELS = (*DeformableEnv.OBJECT_CHANNELS, channels.GOAL_OFFSET, channels.GOAL_DISTANCE)
    GRIPPER_CHANNELS = (*DeformableEnv.GRIPPER_CHANNELS, channels.GOAL_OFFSET, channels.GOAL_DISTANCE)

    def build_models(self):
        return [rope([[-0.2, 0.0], [0.2, 0.0]], num_nodes=21)]

    def candidate_gripper_nodes(self, model):
        return model.node_sets["ends"]

    def allocate_episode(self):
        self.goal = self.episode_tensor("goal", 3, kind="position")

    def start_episode(self, worlds):
        goal, start = (torch.nn.functional.pad(draws, (0, 1)) for draws in self.draw_uniform(worlds, 2, 2))
        lift = torch.tensor([0.0, 0.0, self.solver.model.radius], device=self.device)
        self.goal[worlds] = 0.2 * goal + lift
        straight = self.node_table([model.rest_positions for model in self.models])[self.variants[worlds]]
        ends = self.variant_table([self.candidate_gripper_nodes(model) for model in self.models])[self.variants[worlds]]
        return straight + (0.1 * start + lift)[:, None], ends

    def measure(self):
        offsets = self.goal[:, None] - self.solver.positions
        distances = offsets.norm(dim=-1)
        ends = self.at_start_nodes(distances)
        metrics = {"ends_distance": ends.mean(dim=1)}
        return GoalMeasurement(success=(ends < 0.02).all(dim=1), metrics=metrics, goal_offsets=offsets, goal_distances=distances)

    def reward(self, measurement):
        return 0.5 * torch.exp(-measurement.metrics["ends_distance"] / 0.1) + 0.5 * measurement.success

    def object_values(self, measurement):
        return {"goal_offset": measurement.goal_offsets, "goal_distance": measurement.goal_distances}

    def gripper_values(self, measurement):
        return {name: self.at_start_nodes(values) for name, values in self.object_values(measurement).items()}
