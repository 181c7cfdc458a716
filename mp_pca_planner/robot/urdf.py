# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions (URDF), read by Pinocchio, with what it leaves out.

Pinocchio gets joints, links and their usable inertials alone: visual shapes and materials may be
wrong. Collision shapes are made of their numbers, without Pinocchio. An inertial that Pinocchio
would skip is known here, and so is what it does not read: mimicking joints and drives.
"""

from __future__ import annotations

import os
import re
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..exceptions import RobotError, printable, quote_names
from ..files import reading
from ..input_limits import INPUT_LIMITS
from ..lazy import LazyModule

pin = LazyModule("pinocchio")

# Numbers of shapes in attributes: how many.
_SHAPES = {
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
    "capsule": {"radius": 1, "length": 1},
}
_ONE_DOF_TYPES = ("revolute", "continuous", "prismatic")
# Means "no limit" where a URDF needs a number. Continuous joints are revolute ones for Pinocchio: a
# configuration then has one angle per joint.
_UNBOUNDED = "1e30"
_PARTS_OF_JOINTS = ("origin", "parent", "child", "axis")
# Standard error is that of the whole process.
_STANDARD_ERROR = Lock()


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
    shapes = list(next(part.iter("geometry"), ()))
    if len(shapes) != 1 or shapes[0].tag not in _SHAPES:
        kinds = quote_names(shape.tag for shape in shapes)
        raise RobotError(f"its geometry is {kinds}, expected one of {', '.join(_SHAPES)}")
    (shape,) = shapes
    is_mesh, file = shape.tag == "mesh", shape.get("filename", "")
    if is_mesh and not file:
        raise RobotError("its mesh lacks 'filename'")
    usual = "1 1 1" if is_mesh else None
    sizes = [numbers_of(shape, name, n, usual) for name, n in _SHAPES[shape.tag].items()]
    return StatedShape(shape.tag, np.concatenate(sizes), file, _origin_of(part))


def _origin_of(part: ET.Element) -> FloatArray:
    """The x, y, z [m], roll, pitch and yaw [rad] of the <origin> in an element; 0 without one."""
    origin = part.find("origin")
    if origin is None:
        return np.zeros(6)
    return np.concatenate([numbers_of(origin, name, 3, "0 0 0") for name in ("xyz", "rpy")])


def numbers_of(
    element: ET.Element, attribute: str, count: int, usual: str | None = None
) -> FloatArray:
    """The numbers in an attribute, or the usual ones without it.

    Raises
    ------
    RobotError
        If they are missing, there are not so many, or one is not finite or absurd.
    """
    text = element.get(attribute, usual)
    if text is None:
        raise RobotError(f"<{element.tag}> lacks '{attribute}'")
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    most = INPUT_LIMITS.description_value
    if values.size != count or not (np.abs(values) <= most).all():
        expected = "a number" if count == 1 else f"{count} numbers"
        raise RobotError(
            f"'{attribute}' of <{element.tag}> is '{text}', expected {expected} of at most {most:g}"
        )
    return values


Mimic = tuple[str, float, float]
"""How a joint follows another one: its position is the multiple of that one's, plus the offset.

The other joint, the multiplier and the offset [rad or m].
"""


@dataclass(frozen=True)
class Description:
    """Content of a URDF.

    Attributes
    ----------
    name : str
        Name of the robot; empty if it has none.
    model : pinocchio.Model
        All of its joints; continuous joints are revolute ones without bounds in it, so that a
        configuration has one angle per joint.
    types : mapping of str to str
        'revolute', 'continuous' or 'prismatic' for each movable joint.
    limits : mapping of str to mapping
        Their limits and drives by the keys of limits files.
    mimics : mapping of str to Mimic
        Those of them that mimic others, and how.
    inertias : mapping of str to pinocchio.Inertia
        Inertias by link, in the frame of the link.
    links, joints : mapping of str to Element
        The elements of all links and of the movable joints.
    """

    name: str
    model: Any
    types: Mapping[str, str]
    limits: Mapping[str, Mapping[str, float]]
    mimics: Mapping[str, Mimic]
    inertias: Mapping[str, Any]
    links: Mapping[str, ET.Element]
    joints: Mapping[str, ET.Element]

    def states(self, link: str, *tags: str) -> bool:
        """Whether a link has an element of any of these tags."""
        return any(self.links[link].find(tag) is not None for tag in tags)


def read_description(urdf: str, source: str) -> Description:
    """Read a URDF.

    Parameters
    ----------
    urdf : str
        XML text.
    source : str
        Name of the description in messages.

    Raises
    ------
    RobotError
        If it is no URDF, or a part that matters has wrong numbers or names.
    """
    root = _parse(urdf, source)
    every = {joint.get("name", ""): joint for joint in root.findall("joint")}
    joints = {name: j for name, j in every.items() if j.get("type") in _ONE_DOF_TYPES}
    if not joints:
        raise RobotError(f"{source} has no revolute, continuous or prismatic joint")
    links = {link.get("name", ""): link for link in root.findall("link")}
    inertias = {
        name: inertia
        for name, link in links.items()
        for inertial in link.findall("inertial")[:1]
        if (inertia := _inertia_of(inertial)) is not None
    }
    with reading(source, RobotError):  # of elements in elements without end
        text = _part_for_pinocchio(root, inertias)
    model = _model_of(text, source)
    mimics: dict[str, Mimic] = {}
    limits: dict[str, dict[str, float]] = {}
    for name, joint in joints.items():
        try:
            limits[name] = _limits_of(joint) | _drive_of(joint)
            mimic = joint.find("mimic")
            # Real descriptions also name joints that don't exist: these mimic nothing.
            if mimic is not None and mimic.get("joint") in every:
                (factor,), (offset,) = (
                    numbers_of(mimic, key, 1, usual).tolist()
                    for key, usual in (("multiplier", "1"), ("offset", "0"))
                )
                mimics[name] = mimic.get("joint", ""), factor, offset
            axis = joint.find("axis")
            if axis is not None and not numbers_of(axis, "xyz", 3, "1 0 0").any():
                raise RobotError("its <axis> has no direction, expected numbers that are not all 0")
        except RobotError as error:
            raise RobotError(f"{source}: joint '{name}': {error}") from None
    types = {name: joint.get("type", "") for name, joint in joints.items()}
    return Description(root.get("name", ""), model, types, limits, mimics, inertias, links, joints)


def parse_xml(text: str, source: str) -> ET.Element:
    """Parse XML.

    Raises
    ------
    RobotError
        If the text is no XML.
    """
    try:
        return ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:  # an encoding declaration that text can't have
        raise RobotError(f"{source} is not XML: {error}") from None


def _parse(urdf: str, source: str) -> ET.Element:
    """The root element of a URDF that Pinocchio can hold."""
    root = parse_xml(urdf, source)
    if root.tag != "robot":
        mjcf = " (MuJoCo's MJCF): give the URDF of the same robot" if root.tag == "mujoco" else ""
        raise RobotError(
            f"{source} is not a URDF: its root element is <{root.tag}>, not <robot>{mjcf}"
        )
    if _is_xacro(root):
        raise RobotError(
            f"{source} is a xacro file: expand it to a URDF first (`xacro file.xacro`)"
        )
    n_links = len(root.findall("link"))
    n_movable = sum(joint.get("type") in _ONE_DOF_TYPES for joint in root.findall("joint"))
    if n_links > INPUT_LIMITS.links or n_movable > INPUT_LIMITS.movable_joints:
        raise RobotError(
            f"{source} has {n_links} links and {n_movable} movable joints, but at most "
            f"{INPUT_LIMITS.links} and {INPUT_LIMITS.movable_joints} are accepted"
        )
    return root


def _is_xacro(root: ET.Element) -> bool:
    """Whether this is a xacro file that was not expanded."""
    return any(
        re.match(r"\{[^}]*xacro\}", element.tag)
        or any("${" in value or "$(" in value for value in element.attrib.values())
        for element in root.iter()
    )


def _part_for_pinocchio(root: ET.Element, with_inertias: Collection[str]) -> str:
    """The joints, and the links with their usable inertials; continuous joints are revolute."""
    part = ET.Element("robot", name=root.get("name") or "robot")
    for link in root.findall("link"):
        copy = ET.SubElement(part, "link", link.attrib)
        if link.get("name", "") in with_inertias:
            copy.extend(link.findall("inertial")[:1])
    for joint in root.findall("joint"):
        copy = ET.SubElement(part, "joint", joint.attrib)
        copy.extend(child for child in joint if child.tag in _PARTS_OF_JOINTS)
        limit = joint.find("limit")
        bounds = {} if limit is None else dict(limit.attrib)
        if joint.get("type") == "continuous":
            copy.set("type", "revolute")
            bounds = bounds or dict.fromkeys(("velocity", "effort"), _UNBOUNDED)
            bounds |= {"lower": "-" + _UNBOUNDED, "upper": _UNBOUNDED}
        # Pinocchio would reject the robot for a negative limit of any joint; `limits` has it.
        negative = (x for x in ("velocity", "effort") if bounds.get(x, "").strip()[:1] == "-")
        if bounds := bounds | dict.fromkeys(negative, _UNBOUNDED):
            ET.SubElement(copy, "limit", bounds)
    return ET.tostring(part, encoding="unicode")


def _model_of(urdf: str, source: str) -> Any:
    """Pinocchio's model of a URDF; urdfdom, its parser, writes to stderr why it rejects one."""
    with _STANDARD_ERROR, tempfile.TemporaryFile() as said:
        kept = os.dup(2)
        os.dup2(said.fileno(), 2)
        try:
            return pin.buildModelFromXML(urdf)
        except (ValueError, RuntimeError) as error:
            problem = str(error)
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        said.seek(0)
        reasons = re.findall(r"^Error: *(.*)", said.read().decode(errors="replace"), re.MULTILINE)
    words = [re.sub(r"\[(.*?)\]", r"'\1'", x) for x in reasons if not x.startswith("joint xml")]
    reason = printable("; ".join(words).partition(". ")[0] or problem).removesuffix(".")
    raise RobotError(f"{source} is no valid URDF: {reason:.400}")


def _limits_of(joint: ET.Element) -> dict[str, float]:
    """Limits that the URDF states for a joint, by the keys of limits files."""
    limit = joint.find("limit")
    if limit is None:
        return {}
    keys = {"velocity": "max_velocity", "effort": "max_effort"}
    if joint.get("type") != "continuous":
        keys |= {"lower": "min_position", "upper": "max_position"}
    # Of URDF 1.2.
    rates = ("acceleration", "deceleration", "jerk")
    keys |= {rate: f"max_{rate}" for rate in rates if rate in limit.attrib}
    return {key: float(limit.get(attribute, "0")) for attribute, key in keys.items()}


def _drive_of(joint: ET.Element) -> dict[str, float]:
    """Damping and friction that the URDF states for a joint, by the same keys."""
    dynamics = joint.find("dynamics")
    if dynamics is None:
        return {}
    drive = {key: float(numbers_of(dynamics, key, 1, "0")[0]) for key in ("damping", "friction")}
    for key, value in drive.items():
        if value < 0.0:
            raise RobotError(f"'{key}' of <dynamics> is {value:g}, expected at least 0")
    return drive


def _inertia_of(inertial: ET.Element) -> Any | None:
    """The inertia of an <inertial> element; None if its numbers are missing, wrong or absurd."""
    mass, moments = inertial.find("mass"), inertial.find("inertia")
    if mass is None or moments is None:
        return None
    try:
        (m,) = numbers_of(mass, "value", 1)
        keys = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
        xx, xy, yy, xz, yz, zz = (float(numbers_of(moments, key, 1)[0]) for key in keys)
        place = _origin_of(inertial)
    except RobotError:
        return None
    turn = pin.rpy.rpyToMatrix(place[3:])
    tensor = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    inertia = pin.Inertia.Zero()  # whose constructor refuses what `inertia_flaws` has to name
    inertia.mass, inertia.lever, inertia.inertia = m, place[:3], tensor
    return inertia if m >= 0.0 else None
