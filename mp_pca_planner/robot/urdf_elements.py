# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers and shapes in the elements of a URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RobotError

SHAPES = ("box", "sphere", "cylinder", "mesh")
# Numbers in attributes: how many.
NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": {"lower": 1, "upper": 1, "effort": 1, "velocity": 1},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
}


class StatedShape(NamedTuple):
    """A shape of a link as a URDF states it.

    Attributes
    ----------
    kind : str
        Its tag: box, sphere, cylinder, capsule or mesh.
    sizes : array, shape (n_sizes,)
        Edges of a box, radius of a sphere, radius and length of a cylinder or a capsule [m], scale
        of a mesh.
    file : str
        File of a mesh.
    origin : array, shape (6,)
        Its place on the link: x, y, z [m], roll, pitch, yaw [rad].
    """

    kind: str
    sizes: FloatArray
    file: str
    origin: FloatArray


def stated_shape(part: ET.Element) -> StatedShape:
    """Read a <visual> or <collision> element.

    Raises
    ------
    RobotError
        If it has no shape, an unknown one, or numbers that are missing or malformed.
    """
    shape = part.find("geometry/*")
    if shape is None:
        raise RobotError(f"a <{part.tag}> lacks its <geometry>")
    if shape.tag not in (*SHAPES, "capsule"):
        raise RobotError(f"no shape is called <{shape.tag}>")
    usual = "1 1 1" if shape.tag == "mesh" else ""
    counts = NUMBERS["cylinder" if shape.tag == "capsule" else shape.tag]
    sizes = [numbers_of(shape, name, count, usual) for name, count in counts.items()]
    file = shape.get("filename", "")
    return StatedShape(shape.tag, np.concatenate(sizes), file, stated_origin(part))


def stated_origin(part: ET.Element) -> FloatArray:
    """The x, y, z [m], roll, pitch and yaw [rad] of the <origin> in an element; 0 without one.

    Raises
    ------
    RobotError
        If the numbers are malformed.
    """
    origin = part.find("origin")
    if origin is None:
        return np.zeros(6)
    return np.concatenate([numbers_of(origin, name, 3, "0 0 0") for name in ("xyz", "rpy")])


def numbers_of(element: ET.Element, attribute: str, count: int, usual: str = "") -> FloatArray:
    """The numbers in an attribute, or the usual ones without it.

    Raises
    ------
    RobotError
        If there are not so many, or one is not finite.
    """
    text = element.get(attribute, usual)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if values.size != count or not np.isfinite(values).all():
        raise RobotError(f"'{attribute}' of <{element.tag}> is '{text}', expected {count} numbers")
    return values
