# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The visual shapes of a robot as markers, in some of the poses of a motion."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from ..arrays import FloatArray
from ..robot.model import Robot


@dataclass(frozen=True, eq=False)
class VisualShape:
    """A visual shape of a link.

    Attributes
    ----------
    link : str
        The link.
    origin : tuple of float
        Its place on the link: x, y, z [m], roll, pitch, yaw [rad].
    kind : int
        Type of its marker.
    scale : tuple of float
        Scale of its marker [m], or that of its mesh.
    mesh : str
        URI of its mesh; empty for other shapes.
    """

    link: str
    origin: tuple[float, ...]
    kind: int
    scale: tuple[float, ...]
    mesh: str = ""


def visual_shapes(urdf: str) -> list[VisualShape]:
    """The visual shapes in a robot description; those that are malformed are left out."""
    shapes: list[VisualShape] = []
    for link in ET.fromstring(urdf).findall("link"):
        for visual in link.findall("visual"):
            try:
                shapes += _shapes_of(link.get("name", ""), visual)
            except ValueError:
                continue
    return shapes


def ghost_markers(
    robot: Robot, shapes: list[VisualShape], q: FloatArray, colours: list[ColorRGBA]
) -> list[Marker]:
    """Markers of the shapes in configurations, without a frame.

    Parameters
    ----------
    robot : Robot
        The robot.
    shapes : list of VisualShape
        Shapes of its links; those of other links are left out.
    q : array, shape (n_poses, n_joints)
        The configurations [rad or m].
    colours : list of ColorRGBA
        A colour for each of them.
    """
    known = set(robot.frame_names)
    drawn = [shape for shape in shapes if shape.link in known]
    origins = np.reshape([shape.origin for shape in drawn], (-1, 6))
    poses = robot.attached_poses(q, [shape.link for shape in drawn], origins).tolist()
    markers: list[Marker] = []
    for row, colour in zip(poses, colours, strict=True):
        for shape, (x, y, z, *turn) in zip(drawn, row, strict=True):
            marker = Marker(ns="ghost_shapes", id=len(markers), type=shape.kind, color=colour)
            marker.scale = Vector3(x=shape.scale[0], y=shape.scale[1], z=shape.scale[2])
            marker.mesh_resource = shape.mesh
            orientation = Quaternion(x=turn[0], y=turn[1], z=turn[2], w=turn[3])
            marker.pose = Pose(position=Point(x=x, y=y, z=z), orientation=orientation)
            markers.append(marker)
    return markers


def _shapes_of(link: str, visual: ET.Element) -> Iterator[VisualShape]:
    """The shape of a visual element, if its kind is known; `ValueError` if it is malformed."""
    origin, geometry = visual.find("origin"), visual.find("geometry")
    place = (*_numbers(origin, "xyz", "0 0 0"), *_numbers(origin, "rpy", "0 0 0"))
    for shape in [] if geometry is None else geometry:
        if shape.tag == "box":
            yield VisualShape(link, place, Marker.CUBE, _numbers(shape, "size"))
        elif shape.tag == "sphere":
            yield VisualShape(link, place, Marker.SPHERE, (_diameter(shape),) * 3)
        elif shape.tag == "cylinder":
            size = (_diameter(shape), _diameter(shape), _number(shape, "length"))
            yield VisualShape(link, place, Marker.CYLINDER, size)
        elif shape.tag == "mesh" and shape.get("filename"):
            name, scale = shape.get("filename", ""), _numbers(shape, "scale", "1 1 1")
            address = f"file://{name}" if name.startswith("/") else name
            yield VisualShape(link, place, Marker.MESH_RESOURCE, scale, address)


def _diameter(shape: ET.Element) -> float:
    return 2.0 * _number(shape, "radius")


def _number(element: ET.Element, name: str) -> float:
    value = float(element.get(name, ""))
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value}")
    return value


def _numbers(element: ET.Element | None, name: str, default: str = "") -> tuple[float, ...]:
    text = default if element is None else element.get(name, default)
    values = tuple(map(float, text.split()))
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError(f"{name} is '{text}'")
    return values
