"""Shapes of cloth that tasks offer by name or take as polygons, and their resolutions."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from maniskill_grpd.physics import (
    circle_outline,
    hexagon_outline,
    l_shape_outline,
    rectangle_outline,
    square_outline,
    triangle_outline,
)
from maniskill_grpd.physics.mesh.outlines import centroid, check_polygon, signed_area
from maniskill_grpd.tasks.geometry.mesh_outlines import GivenMesh, is_mesh, outline_of_mesh
from maniskill_grpd.tasks.geometry.shape_registry import GivenShape, Shape, ShapeRegistry, shape_label

RESOLUTIONS = (49, 1225)
"""Smallest and largest number of nodes of a cloth."""
REACHES = (0.05, 0.36)
"""Smallest and largest distance of the farthest point of an outline from its centroid [m]: below, the nodes are as near to each
other as the cloth is thick; above, it may lie over a hanger when an episode starts."""

CLOTH_SHAPES = ShapeRegistry("shapes of cloth", "polygons (P >= 3, 2) [m]", check_polygon)
"""Outlines of 1 m^2 by the names of all shapes."""
for _name, _outline in {
    "square": square_outline(1.0),
    "rectangle": rectangle_outline(np.sqrt(1.5), np.sqrt(2.0 / 3.0)),
    "triangle": triangle_outline(2.0 / 3.0**0.25),
    "hexagon": hexagon_outline(np.sqrt(2.0) / 27.0**0.25),
    "circle": circle_outline(1.0 / np.sqrt(np.pi)),
    "l_shape": l_shape_outline(2.0 / np.sqrt(3.0)),
}.items():
    CLOTH_SHAPES.register(_name, _outline)


def register_cloth_shape(name: str, outline: GivenShape | Callable[[], GivenShape]) -> None:
    """Offer a shape of cloth by a name, as in `gym.make("ClothFolding-v1", shapes=["star"])`.

    Tasks scale it to the area of their cloth, as they do with all shapes that have names, and put its centroid at the origin.

    Args:
        name: A new name.
        outline: Polygon, (P >= 3, 2) of any size, in either direction; or a function without arguments that returns one.

    Raises:
        ValueError: If the name is taken, or the outline is not finite, has no area, or touches or crosses itself.
    """

    def of_unit_area() -> np.ndarray:
        polygon = check_polygon(outline() if callable(outline) else outline, f"the shape {name!r}")
        return (polygon - centroid(polygon)) / np.sqrt(signed_area(polygon))

    CLOTH_SHAPES.register(name, of_unit_area)


def cloth_outline(shape: Shape, area: float) -> np.ndarray:
    """Return the outline of a cloth.

    All named shapes of one area have the same mass. A rectangle is 3 : 2, the arms of an L are half as wide as long, a triangle
    and a hexagon are regular. A polygon keeps its own size; its centroid comes to lie at the origin.

    Args:
        shape: One of `CLOTH_SHAPES`, or a polygon (P, 2) [m].
        area: Area enclosed by a shape with a name [m^2].

    Returns:
        Closed polygon about the origin, counter-clockwise, (P, 2) float64 [m].

    Raises:
        ValueError: If there is no shape of that name, or the polygon is none.
    """
    points = CLOTH_SHAPES.points(shape)
    return np.sqrt(area) * points if isinstance(shape, str) else points - centroid(points)


def in_cloth_frame(shape: Shape, points: np.ndarray) -> np.ndarray:
    """Return points (Q, 2) [m] that are given in the coordinates of a shape in those of `cloth_outline`, (Q, 2) [m]."""
    return points if isinstance(shape, str) else points - centroid(np.array(shape))


def check_cloth_shapes(shapes: GivenShape | GivenMesh | Iterable[GivenShape | GivenMesh], area: float) -> tuple[Shape, ...]:
    """Return the shapes that the option `shapes` of a task gives as a tuple.

    Args:
        shapes: A name, a polygon (P, 2) [m], a flat mesh without holes, or several of them. Of a mesh the rim is taken: tasks
            mesh it anew at their resolution.
        area: Area enclosed by shapes with names [m^2].

    Raises:
        ValueError: If there is none, a name is not in `CLOTH_SHAPES`, a mesh is not flat or has holes, or a polygon is none or of
            a wrong size; says why.
    """
    parsed = CLOTH_SHAPES.parse(_with_rims_of_meshes(shapes), "shapes")
    smallest, largest = REACHES
    for shape in parsed:
        outline = cloth_outline(shape, area)
        reach = np.linalg.norm(outline - centroid(outline), axis=1).max()
        if not smallest <= reach <= largest:
            raise ValueError(
                f"the farthest point of a cloth must be {smallest} to {largest} m from its centroid, got {reach:.3g} m for the "
                f"{shape_label(shape)}; coordinates are in metres"
            )
    return parsed


def _with_rims_of_meshes(shapes: GivenShape | GivenMesh | Iterable[GivenShape | GivenMesh]) -> GivenShape | Iterable[GivenShape]:
    """Return shapes with the rims of meshes in their place."""
    if is_mesh(shapes):
        return outline_of_mesh(shapes, "shapes")
    if isinstance(shapes, (list, tuple)):
        return [outline_of_mesh(shape, f"shapes[{index}]") if is_mesh(shape) else shape for index, shape in enumerate(shapes)]
    return shapes
