"""Channels of the observation graph that tasks have in common."""

from __future__ import annotations

from maniskill_grpd.graphs import Channel

VELOCITY = Channel("velocity", "vector", "m/s", "v_v, eq. 42, 43")
GOAL_OFFSET = Channel("goal_offset", "vector", "m", "goal position minus position, design", starts_at="node")
GOAL_DISTANCE = Channel("goal_distance", "scalar", "m", "d_v, eq. 42", distance_of="goal_offset")
ARC = Channel("arc", "scalar", "", "|2 s - 1| for arc fraction s: 0 in the middle, 1 at the ends, design")
CORNER = Channel("corner", "scalar", "", "1 at the corners of a cloth, falling to 0 at the node farthest from them, design")
HELD = Channel("held", "scalar", "", "1 where a gripper holds the node, design")
CONTACT = Channel("contact", "scalar", "", "1 where the node touches the table, design")
AGE = Channel("age", "scalar", "s", "time since the node was last seen, design")
GRIPPER_STATUS = Channel("gripper_status", "scalar", "", "1 closed, eq. 43")
