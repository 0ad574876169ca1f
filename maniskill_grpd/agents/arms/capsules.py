"""Links of arms as capsules, fitted about their meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from maniskill_grpd.agents.arms.arm_description import ArmDescription
from maniskill_grpd.agents.arms.meshes import shape_mesh
from maniskill_grpd.physics import Link

WRISTS = 2
"""Links before the hand that are capsules."""


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a segment."""

    ends: np.ndarray
    """Of the segment, (2, 3) [m]."""
    radius: float
    """[m]."""


@dataclass(frozen=True)
class LinkCapsule:
    """A capsule about links that move with a joint."""

    joint: int
    """Which of the arm's joints; the capsule is in the frame behind it."""
    capsule: Capsule
    is_fingers: bool
    """Whether these are the fingers, closed; how near they come to the table the TCP decides."""


@cache
def link_capsules(description: ArmDescription) -> tuple[LinkCapsule, ...]:
    """Return capsules about the last two links of an arm, its hand and its fingers, as far as it has them."""
    last = len(description.arm_joints) - 1
    groups = [(joint, [description.arm_joints[joint].child], False) for joint in range(last + 1 - WRISTS, last + 1)]
    fingers = _links_behind(description, [joint.child for joint in description.fingers])
    hand = _links_behind(description, [description.arm_joints[last].child])
    groups.append((last, [link for link in hand[1:] if link not in fingers], False))
    groups.append((last, fingers, True))
    found = []
    for joint, links, is_fingers in groups:
        points = _points(description, links, description.arm_joints[joint].child)
        if len(points):
            found.append(LinkCapsule(joint, fit_capsule(points), is_fingers))
    return tuple(found)


@cache
def column_capsule(description: ArmDescription) -> Capsule:
    """Return an upright capsule about the base of an arm and the link on it, in the frame of the base."""
    root = description.robot.root
    fixed = [link for link in description.robot.shapes if not _moving_joints(description, link)]
    points = _points(description, [*fixed, description.arm_joints[0].child], root)
    return _about_axis(points, np.array([0.0, 0.0, 1.0]))


def arm_links(descriptions: Sequence[ArmDescription]) -> tuple[Link, ...]:
    """Return the links that the object meets, arm after arm."""
    return tuple(Link(arm, link.capsule.radius) for arm, entry in enumerate(descriptions) for link in link_capsules(entry))


def fit_capsule(points: np.ndarray) -> Capsule:
    """Return a small capsule about points (n, 3): the smallest of those along their principal axes."""
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    return min((_about_axis(points, axis) for axis in axes), key=_volume)


def _about_axis(points: np.ndarray, axis: np.ndarray) -> Capsule:
    """Return the capsule along an axis about points; its middle is that of their bounds across."""
    across = np.linalg.svd(axis[None])[2][1:]
    flat, along = points @ across.T, points @ axis
    middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    distances = np.linalg.norm(flat - middle, axis=1)
    radius = distances.max()
    caps = np.sqrt(np.maximum(radius**2 - distances**2, 0.0))
    low, high = (along + caps).min(), (along - caps).max()
    low, high = (low, high) if low < high else (0.5 * (low + high),) * 2
    return Capsule(np.stack([middle @ across + end * axis for end in (low, high)]), float(radius))


def _volume(capsule: Capsule) -> float:
    length = np.linalg.norm(capsule.ends[1] - capsule.ends[0])
    return float(np.pi * capsule.radius**2 * (length + 4.0 / 3.0 * capsule.radius))


def _points(description: ArmDescription, links: Sequence[str], frame: str) -> np.ndarray:
    """Return the vertices of links in the frame of another, all joints at 0, (n, 3) [m]."""
    frames = description.robot.frames(np.eye(4), {})
    found = [np.zeros((0, 3))]
    for link in links:
        place = np.linalg.inv(frames[frame]) @ frames[link]
        meshes = [shape_mesh(shape)[0] for shape in description.robot.shapes[link]]
        found += [vertices @ place[:3, :3].T + place[:3, 3] for vertices in meshes]
    return np.concatenate(found)


def _links_behind(description: ArmDescription, roots: Sequence[str]) -> list[str]:
    """Return links and all that hang on them."""
    found = list(roots)
    for link in found:
        found += [joint.child for joint in description.robot.joints.values() if joint.parent == link]
    return found


def _moving_joints(description: ArmDescription, link: str) -> list[str]:
    return [joint.name for joint in description.robot.chain(link) if joint.motion is not None]
