"""Kinematic chains and links, read from URDF files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

REVOLUTE, PRISMATIC = "revolute", "prismatic"
MOVES = {"revolute": REVOLUTE, "continuous": REVOLUTE, "prismatic": PRISMATIC}
"""How joints move that are not fixed, by their type in the file."""


@dataclass(frozen=True)
class Joint:
    """A joint of a robot, with its frame at rest in that of its parent link."""

    name: str
    parent: str
    child: str
    motion: str | None
    """`REVOLUTE`, `PRISMATIC`, or None for a fixed joint."""
    origin: np.ndarray
    """(4, 4)."""
    axis: np.ndarray
    """Unit vector in the frame of the joint, (3,)."""
    lower: float
    """[rad], or [m] for a prismatic joint; so are the next."""
    upper: float
    speed: float
    """Largest speed [rad/s] or [m/s]."""


@dataclass(frozen=True)
class MeshOfLink:
    """A mesh that shows a link, in its frame."""

    file: Path
    origin: np.ndarray
    """(4, 4)."""
    scale: np.ndarray
    """(3,)."""


@dataclass(frozen=True)
class Robot:
    """What a URDF file says of the kinematics of a robot."""

    file: Path
    joints: dict[str, Joint]
    meshes: dict[str, tuple[MeshOfLink, ...]]
    """Visual meshes of every link, by its name."""

    @property
    def root(self) -> str:
        """Name of the link that has no parent."""
        children = {joint.child for joint in self.joints.values()}
        return next(link for link in self.meshes if link not in children)

    def chain(self, link: str) -> tuple[Joint, ...]:
        """Return all joints from the root to a link.

        Raises:
            ValueError: If there is no such link.
        """
        if link not in self.meshes:
            raise ValueError(f"{self.file} has no link {link!r}; it has {', '.join(self.meshes)}")
        by_child = {joint.child: joint for joint in self.joints.values()}
        joints = []
        while link in by_child:
            joints.append(by_child[link])
            link = joints[-1].parent
        return tuple(reversed(joints))


def read_urdf(file: Path) -> Robot:
    """Read the joints and the visual meshes of a URDF file.

    Raises:
        ValueError: If it is no URDF file, or a joint that moves lacks its limits.
    """
    try:
        root = ElementTree.parse(file).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"{file} is no XML file: {error}") from error
    if root.tag != "robot":
        raise ValueError(f"{file} is no URDF file: its root is <{root.tag}>, not <robot>")
    joints = {node.get("name"): _read_joint(file, node) for node in root.findall("joint")}
    meshes = {
        link.get("name"): tuple(
            _read_mesh(file, visual) for visual in link.findall("visual") if visual.find("geometry/mesh") is not None
        )
        for link in root.findall("link")
    }
    return Robot(file, joints, meshes)


def transform(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return the homogeneous matrix (4, 4) of a rotation (3, 3) and a position (3,)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return matrix


def _read_joint(file: Path, node: ElementTree.Element) -> Joint:
    name, motion = node.get("name"), MOVES.get(node.get("type"))
    limit = node.find("limit")
    if motion is not None and limit is None:
        raise ValueError(f"joint {name!r} of {file} has no <limit>")
    is_endless = node.get("type") == "continuous"
    lower, upper = (
        (-np.inf, np.inf) if is_endless or motion is None else (float(limit.get("lower", 0)), float(limit.get("upper", 0)))
    )
    axis = _numbers(node.find("axis"), "xyz", (1.0, 0.0, 0.0))
    return Joint(
        name=name,
        parent=node.find("parent").get("link"),
        child=node.find("child").get("link"),
        motion=motion,
        origin=_read_origin(node.find("origin")),
        axis=axis / np.linalg.norm(axis),
        lower=lower,
        upper=upper,
        speed=0.0 if motion is None else float(limit.get("velocity", 0)),
    )


def _read_mesh(file: Path, visual: ElementTree.Element) -> MeshOfLink:
    mesh = visual.find("geometry/mesh")
    return MeshOfLink(
        file=file.parent / mesh.get("filename"),
        origin=_read_origin(visual.find("origin")),
        scale=_numbers(mesh, "scale", (1.0, 1.0, 1.0)),
    )


def _read_origin(node: ElementTree.Element | None) -> np.ndarray:
    rotation = Rotation.from_euler("xyz", _numbers(node, "rpy", (0.0, 0.0, 0.0)))
    return transform(rotation.as_matrix(), _numbers(node, "xyz", (0.0, 0.0, 0.0)))


def _numbers(node: ElementTree.Element | None, key: str, default: tuple[float, ...]) -> np.ndarray:
    text = None if node is None else node.get(key)
    return np.array(default if text is None else [float(part) for part in text.split()])
