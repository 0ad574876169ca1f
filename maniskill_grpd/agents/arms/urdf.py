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
KINDS = ("collision", "visual")
"""What shapes are for."""


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

    def displacement(self, position: float) -> np.ndarray:
        """Return what the joint does in its frame, (4, 4)."""
        if self.motion == REVOLUTE:
            return transform(Rotation.from_rotvec(position * self.axis).as_matrix(), np.zeros(3))
        return transform(np.eye(3), position * self.axis if self.motion == PRISMATIC else np.zeros(3))


@dataclass(frozen=True, eq=False)
class Shape:
    """A mesh or a box that stands for a part of a link, in its frame."""

    file: Path | None
    """File of the mesh, or None for a box."""
    origin: np.ndarray
    """(4, 4)."""
    size: np.ndarray
    """Factors on the mesh, or edges of the box [m], (3,)."""


@dataclass(frozen=True)
class Robot:
    """What a URDF file says of the kinematics of a robot."""

    file: Path
    joints: dict[str, Joint]
    shapes: dict[str, tuple[Shape, ...]]
    """Shapes of every link for collisions, by its name: meshes of some hundred triangles, and boxes."""
    visuals: dict[str, tuple[Shape, ...]]
    """What every link looks like, by its name: meshes of ten thousands of triangles."""

    @property
    def root(self) -> str:
        """Name of the link that has no parent."""
        children = {joint.child for joint in self.joints.values()}
        return next(link for link in self.shapes if link not in children)

    def chain(self, link: str) -> tuple[Joint, ...]:
        """Return all joints from the root to a link.

        Raises:
            ValueError: If there is no such link.
        """
        if link not in self.shapes:
            raise ValueError(f"{self.file} has no link {link!r}; it has {', '.join(self.shapes)}")
        by_child = {joint.child: joint for joint in self.joints.values()}
        joints = []
        while link in by_child:
            joints.append(by_child[link])
            link = joints[-1].parent
        return tuple(reversed(joints))

    def frames(self, base: np.ndarray, qpos: dict[str, float]) -> dict[str, np.ndarray]:
        """Return the frames (4, 4) of all links where the root is at `base` and joints at positions [rad] or [m], or at 0."""
        found, waiting = {self.root: base}, list(self.joints.values())
        while waiting:
            placed = [joint for joint in waiting if joint.parent in found]
            for joint in placed:
                found[joint.child] = found[joint.parent] @ joint.origin @ joint.displacement(qpos.get(joint.name, 0.0))
            waiting = [joint for joint in waiting if joint.child not in found]
            if not placed:
                raise ValueError(f"joints {[joint.name for joint in waiting]} of {self.file} hang on nothing")
        return found


def read_urdf(file: Path) -> Robot:
    """Read the joints and the shapes of a URDF file.

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
    shapes, visuals = ({link.get("name"): _read_shapes(file, link, kind) for link in root.findall("link")} for kind in KINDS)
    return Robot(file, joints, shapes, visuals)


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


def _read_shapes(file: Path, link: ElementTree.Element, kind: str) -> tuple[Shape, ...]:
    return tuple(
        _read_shape(file, node)
        for node in link.findall(kind)
        if node.find("geometry/mesh") is not None or node.find("geometry/box") is not None
    )


def _read_shape(file: Path, node: ElementTree.Element) -> Shape:
    mesh, origin = node.find("geometry/mesh"), _read_origin(node.find("origin"))
    if mesh is None:
        return Shape(None, origin, _numbers(node.find("geometry/box"), "size", (0.0, 0.0, 0.0)))
    return Shape(file.parent / mesh.get("filename"), origin, _numbers(mesh, "scale", (1.0, 1.0, 1.0)))


def _read_origin(node: ElementTree.Element | None) -> np.ndarray:
    rotation = Rotation.from_euler("xyz", _numbers(node, "rpy", (0.0, 0.0, 0.0)))
    return transform(rotation.as_matrix(), _numbers(node, "xyz", (0.0, 0.0, 0.0)))


def _numbers(node: ElementTree.Element | None, key: str, default: tuple[float, ...]) -> np.ndarray:
    text = None if node is None else node.get(key)
    return np.array(default if text is None else [float(part) for part in text.split()])
