# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions (URDF), read once and checked before Pinocchio parses them.

urdfdom, the parser behind Pinocchio, reports errors on stderr and skips the malformed part.
Therefore Pinocchio gets a copy that holds only joints and links with their inertials, all numbers
of which have been checked here. Collision shapes are made of their numbers, without Pinocchio.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, repeated_names
from ..exceptions import RobotError, quote_names, unknown_name
from ..input_limits import INPUT_LIMITS

_PART = 1 << 16  # characters of XML that are parsed at once
_SHAPES = ("box", "sphere", "cylinder", "mesh", "capsule")
# Numbers in attributes: how many, and which attributes may be left out.
_NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": {"lower": 1, "upper": 1, "effort": 1, "velocity": 1},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
}
_OPTIONAL = ("xyz", "rpy", "lower", "upper", "scale")
_ONE_DOF_TYPES = ("revolute", "continuous", "prismatic")
# Means "no limit" where a URDF needs a number. Continuous joints are revolute ones for Pinocchio:
# a configuration then has one angle per joint.
_UNBOUNDED = "1e30"
_PARTS_OF_JOINTS = ("origin", "parent", "child", "axis", "limit")


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
        found = quote_names(shape.tag for shape in shapes)
        raise RobotError(f"its geometry is {found}, expected one of {', '.join(_SHAPES)}")
    (shape,) = shapes
    is_mesh, file = shape.tag == "mesh", shape.get("filename", "")
    if is_mesh and not file:
        raise RobotError("its mesh lacks 'filename'")
    usual = "1 1 1" if is_mesh else None
    sizes = [numbers_of(shape, name, n, usual) for name, n in _NUMBERS[shape.tag].items()]
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


def numbers_of(
    element: ET.Element, attribute: str, count: int, usual: str | None = None
) -> FloatArray:
    """The numbers in an attribute, or the usual ones without it.

    Raises
    ------
    RobotError
        If they are missing, there are not so many, or one is not finite or huge.
    """
    text = element.get(attribute, usual)
    if text is None:
        raise RobotError(f"<{element.tag}> lacks '{attribute}'")
    # Limits may be huge; masses and lengths that are would overflow in the dynamics.
    most = math.inf if element.tag == "limit" else INPUT_LIMITS.description_value
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if values.size != count or not (np.isfinite(values) & (np.abs(values) <= most)).all():
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        expected += "" if most == math.inf else f" of at most {most:g}"
        raise RobotError(f"'{attribute}' of <{element.tag}> is '{text}', expected {expected}")
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
    xml : str
        The part for Pinocchio; continuous joints are revolute ones without bounds in it.
    types : mapping of str to str
        'revolute', 'continuous' or 'prismatic' for each movable joint.
    limits : mapping of str to mapping
        Their limits, damping and friction by the keys of limits files.
    mimics : mapping of str to Mimic
        Those of them that mimic others, and how.
    child_links : mapping of str to str
        The link that each of them moves.
    inertials : mapping of str to Element
        The usable <inertial> elements by link.
    lost_inertials : frozenset of str
        Links whose inertial can't be used.
    shapes : mapping of str to sequence of StatedShape
        The usable collision shapes by link.
    lost_shapes : mapping of str to str
        Defect of the collision shape of each link whose shape can't be used.
    solid_links : frozenset of str
        Links with a visual or collision shape: bodies, not just frames.
    """

    name: str
    xml: str
    types: Mapping[str, str]
    limits: Mapping[str, Mapping[str, float]]
    mimics: Mapping[str, Mimic]
    child_links: Mapping[str, str]
    inertials: Mapping[str, ET.Element]
    lost_inertials: frozenset[str]
    shapes: Mapping[str, Sequence[StatedShape]]
    lost_shapes: Mapping[str, str]
    solid_links: frozenset[str]


def read_description(urdf: str, source: str) -> Description:
    """Read and check a URDF.

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
    _check_tree(root, source)
    clean = ET.Element("robot", name=root.get("name") or "robot")
    inertials = _copy_links(root, clean)
    shapes, lost_shapes = _collision_shapes(root)
    mimics: dict[str, Mimic] = {}
    limits: dict[str, dict[str, float]] = {}
    for name, joint in every.items():
        try:
            _copy_joint(joint, clean)
            if name in joints:
                limits[name] = _limits_of(joint) | _drive_of(joint)
            mimic = joint.find("mimic")
            # Real descriptions also name joints that don't exist: these mimic nothing, as in
            # Pinocchio.
            if mimic is not None and name in joints and mimic.get("joint") in every:
                pairs = (("multiplier", "1"), ("offset", "0"))
                multiplier, offset = (
                    float(numbers_of(mimic, key, 1, usual)[0]) for key, usual in pairs
                )
                mimics[name] = mimic.get("joint", ""), multiplier, offset
        except RobotError as error:
            raise RobotError(f"{source}: joint '{name}': {error}") from None
    return Description(
        name=root.get("name", ""),
        xml=ET.tostring(clean, encoding="unicode"),
        types={name: joint.get("type", "") for name, joint in joints.items()},
        limits=limits,
        mimics=mimics,
        child_links={name: _end(joint, "child") for name, joint in joints.items()},
        inertials=inertials,
        lost_inertials=frozenset(
            link.get("name", "")
            for link in root.findall("link")
            if link.find("inertial") is not None and link.get("name") not in inertials
        ),
        shapes=shapes,
        lost_shapes=lost_shapes,
        solid_links=frozenset(
            link.get("name", "")
            for link in root.findall("link")
            if link.find("visual") is not None or link.find("collision") is not None
        ),
    )


def parse_xml(text: str, source: str) -> ET.Element:
    """Parse XML of bounded size and depth; the parsers behind Pinocchio recurse without a bound.

    Raises
    ------
    RobotError
        If the text is no XML, too long or nested too deeply.
    """
    if len(text) > INPUT_LIMITS.text_bytes:
        raise RobotError(f"{source} has more than {INPUT_LIMITS.text_bytes:,} characters")
    parser = ET.XMLParser()
    try:
        # In parts, because each keeps the lock of the interpreter, and the robot may have to stop.
        for begin in range(0, len(text), _PART):
            parser.feed(text[begin : begin + _PART])
        root = parser.close()
    except ET.ParseError as error:
        raise RobotError(f"{source} is not XML: {error}") from None
    except ValueError as error:  # for example an encoding declaration that text can't have
        raise RobotError(f"{source} can't be parsed: {error}") from None
    level, depth = [root], 0
    while level:
        level, depth = [child for element in level for child in element], depth + 1
        if depth > (most := INPUT_LIMITS.description_depth):
            raise RobotError(f"{source} has elements within more than {most} others")
    return root


def _parse(urdf: str, source: str) -> ET.Element:
    root = parse_xml(urdf, source)
    if root.tag != "robot":
        raise RobotError(f"{source} is not a URDF: its root element is <{root.tag}>, not <robot>")
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
        or any("${" in value for value in element.attrib.values())
        for element in root.iter()
    )


def _limits_of(joint: ET.Element) -> dict[str, float]:
    """Limits that the URDF states for a joint, by the keys of limits files."""
    limit = joint.find("limit")
    if limit is None:
        return {}
    keys = {"velocity": "max_velocity", "effort": "max_effort"}
    if joint.get("type") != "continuous":
        keys |= {"lower": "min_position", "upper": "max_position"}
    found = {key: limit.get(attribute, "0") for attribute, key in keys.items()}
    return {key: float(text) for key, text in found.items()}


def _drive_of(joint: ET.Element) -> dict[str, float]:
    """Damping and friction that the URDF states for a joint, by the keys of limits files."""
    dynamics = joint.find("dynamics")
    if dynamics is None:
        return {}
    found = {key: float(numbers_of(dynamics, key, 1, "0")[0]) for key in ("damping", "friction")}
    for key, value in found.items():
        if value < 0.0:
            raise RobotError(f"'{key}' of <dynamics> is {value:g}, expected at least 0")
    return found


def _end(joint: ET.Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


def _check_tree(root: ET.Element, source: str) -> None:
    """Reject joints between missing links, and links that form no tree."""
    joints = root.findall("joint")
    links = [link.get("name", "") for link in root.findall("link")]
    for kind, names in (("link", links), ("joint", [joint.get("name", "") for joint in joints])):
        if "" in names or repeated_names(names):
            raise RobotError(
                f"{source}: every {kind} needs a name of its own, but one has none, or several "
                f"have the same: {quote_names(repeated_names(names))}"
            )
    for joint in joints:
        for which in ("parent", "child"):
            if _end(joint, which) not in links:
                unknown = unknown_name("link", _end(joint, which), links)
                raise RobotError(f"{source}: {which} of joint '{joint.get('name')}': {unknown}")
    children = [_end(joint, "child") for joint in joints]
    roots = [name for name in links if name not in children]
    if len(roots) != 1 or repeated_names(children):
        raise RobotError(
            f"{source}: the links must form one tree, each but one the child of one joint; "
            f"{quote_names(roots)} are children of none, "
            f"{quote_names(repeated_names(children))} of several"
        )


def _copy_links(root: ET.Element, clean: ET.Element) -> dict[str, ET.Element]:
    """Copy the links; return the usable inertials by link."""
    found: dict[str, ET.Element] = {}
    for link in root.findall("link"):
        name = link.get("name", "")
        copy, inertial = ET.SubElement(clean, "link", name=name), link.find("inertial")
        if inertial is not None and _is_usable(inertial):
            copy.append(inertial)
            found[name] = inertial
    return found


def _is_usable(inertial: ET.Element) -> bool:
    mass = inertial.find("mass")
    if mass is None or inertial.find("inertia") is None:
        return False
    try:
        _check_numbers(inertial)
    except RobotError:
        return False
    return float(mass.attrib["value"]) >= 0.0


def _collision_shapes(root: ET.Element) -> tuple[dict[str, list[StatedShape]], dict[str, str]]:
    """The collision shapes, and what is wrong with those left out, by link."""
    shapes: dict[str, list[StatedShape]] = {}
    lost: dict[str, str] = {}
    for link in root.findall("link"):
        name = link.get("name", "")
        for part in link.findall("collision"):
            try:
                shapes.setdefault(name, []).append(stated_shape(part))
            except RobotError as error:
                lost[name] = str(error)
    return shapes, lost


def _copy_joint(joint: ET.Element, clean: ET.Element) -> None:
    """Add a joint to a description, a continuous one as revolute without bounds."""
    kind = joint.get("type", "")
    copy = ET.SubElement(clean, "joint", name=joint.get("name", ""), type=kind)
    copy.extend(part for part in joint if part.tag in _PARTS_OF_JOINTS)
    limit = copy.find("limit")
    if kind == "continuous":
        if limit is None:
            limit = ET.SubElement(copy, "limit", velocity=_UNBOUNDED, effort=_UNBOUNDED)
        limit.attrib.update(lower="-" + _UNBOUNDED, upper=_UNBOUNDED)
        copy.set("type", "revolute")
    _check_numbers(copy)
    if kind not in _ONE_DOF_TYPES:
        return
    axis = copy.find("axis")
    if axis is not None and not any(map(float, axis.get("xyz", "1").split())):
        raise RobotError("its <axis> has no direction, expected three numbers that are not all 0")
    if limit is None:
        raise RobotError("it has no <limit>, which must state 'effort' and 'velocity'")
    # `Description` has these limits; Pinocchio would reject a negative one, of any joint.
    negative = {x: _UNBOUNDED for x in ("velocity", "effort") if float(limit.attrib[x]) < 0.0}
    if negative:
        copy.remove(limit)
        ET.SubElement(copy, "limit", limit.attrib | negative)


def _check_numbers(element: ET.Element) -> None:
    """Reject wrong numbers in an element; valid ones are rewritten for urdfdom."""
    for part in element.iter():
        for attribute, count in _NUMBERS.get(part.tag, {}).items():
            if attribute in part.attrib or attribute not in _OPTIONAL:
                numbers = numbers_of(part, attribute, count)
                part.set(attribute, " ".join(map(repr, numbers.tolist())))
