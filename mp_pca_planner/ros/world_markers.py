# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A world as markers for the node's ``~/obstacles``."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ..robot.world import Box, Capsule, Cylinder, Mesh, Shape, Sphere, World
from .messages import to_pose

_COLOUR = ColorRGBA(r=0.9, g=0.5, b=0.1, a=0.8)


def to_obstacle_markers(world: World, *, clear: bool = False) -> MarkerArray:
    """The markers of the obstacles of a world, one for each shape.

    The namespace of a marker is the name of its obstacle, its id the number of the shape. A capsule
    becomes a cylinder and two spheres. Markers know no contacts that are allowed, but that of an
    obstacle with the link that it moves with.

    Parameters
    ----------
    world : World
        The obstacles.
    clear : bool
        Whether all other obstacles are removed before.
    """
    markers = [Marker(action=Marker.DELETEALL)] if clear else []
    for obstacle in world:
        shapes = [part for shape in obstacle.shapes for part in _parts(shape)]
        for number, shape in enumerate(shapes):
            marker = _marker(shape)
            marker.ns, marker.id = obstacle.name, number
            marker.header.frame_id, marker.color = obstacle.frame, _COLOUR
            markers.append(marker)
    return MarkerArray(markers=markers)


def _parts(shape: Shape) -> list[Shape]:
    """A shape as shapes that markers have."""
    if not isinstance(shape, Capsule):
        return [shape]
    ends = (Sphere(shape.radius, [0.0, 0.0, sign * 0.5 * shape.height]) for sign in (-1.0, 1.0))
    cylinder = Cylinder(shape.radius, shape.height, shape.position, shape.orientation)
    return [cylinder, *(end.moved(shape.pose) for end in ends)]


def _marker(shape: Shape) -> Marker:
    marker = Marker(action=Marker.ADD)
    marker.pose = to_pose(shape.pose)
    if isinstance(shape, Mesh):
        marker.type, scale = Marker.TRIANGLE_LIST, [1.0, 1.0, 1.0]
        corners = shape.vertices[np.ravel(shape.triangles)]
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in corners.tolist()]
    elif isinstance(shape, Box):
        marker.type, scale = Marker.CUBE, shape.size.tolist()
    elif isinstance(shape, Cylinder):
        diameter = 2.0 * shape.radius
        marker.type, scale = Marker.CYLINDER, [diameter, diameter, shape.height]
    else:
        assert isinstance(shape, Sphere)
        marker.type, scale = Marker.SPHERE, [2.0 * shape.radius] * 3
    marker.scale = Vector3(x=scale[0], y=scale[1], z=scale[2])
    return marker
