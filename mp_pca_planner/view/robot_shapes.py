# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes of each link to draw: visual ones, else collision shapes, else a skeleton."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh

from ..arrays import FloatArray
from ..exceptions import PlannerError, RobotError
from ..robot.joints import joint_of
from ..robot.mesh_files import find_mesh, scaled
from ..robot.mesh_pieces import whole_piece
from ..robot.model import Robot
from ..robot.urdf import StatedShape, numbers_of, parse_xml, stated_shape
from ..robot.world import Box, Capsule, Cylinder, Mesh, Shape, Sphere

Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""

# Size of a ghost as a multiple of the robot's, whose surface would flicker with an equal one.
_GHOST_GROWTH = 1.02

_PLAIN: Colour = (0.76, 0.79, 0.83, 1.0)
_SHAPES: dict[str, Callable[..., Shape]] = {
    "sphere": Sphere,
    "cylinder": Cylinder,
    "capsule": Capsule,
}


@dataclass(frozen=True, eq=False)
class RobotShape:
    """A rigid body that a joint moves.

    Attributes
    ----------
    joint : int
        Index of the joint in Pinocchio's model; 0: the base.
    mesh : trimesh.Trimesh
        Its surface in the frame of the joint [m], with its own colours if `colour` is None.
    colour : tuple of float, or None
        Its colour.
    """

    joint: int
    mesh: Any
    colour: Colour | None

    @property
    def hull(self) -> Any:
        """The convex hull of the mesh, a little larger than that, as the surface of a ghost."""
        piece = whole_piece(np.asarray(self.mesh.vertices), np.asarray(self.mesh.faces))
        hull = trimesh.Trimesh(piece.corners, piece.faces, process=False)
        hull.vertices = hull.centroid + _GHOST_GROWTH * (hull.vertices - hull.centroid)
        return hull


class RobotShapes:
    """The shapes of a robot, and the places of its joints.

    Parameters
    ----------
    robot : Robot
        The robot.
    urdf : str
        Its description, XML text.
    folders : sequence of Path
        Folders with the packages that ``package://`` paths of meshes name, and folders of relative
        paths.

    Attributes
    ----------
    shapes : tuple of RobotShape
        At least one.
    notes : tuple of str
        What is drawn in place of the visual shapes, and why; empty if all of these are drawn.
    n_joints : int
        Number of joints of Pinocchio's model, the base included.
    """

    def __init__(self, robot: Robot, urdf: str, folders: Sequence[Path]) -> None:
        self._model, order = robot.pinocchio_model()
        self._data = self._model.createData()
        self._order = np.argsort(order)
        self.n_joints = int(self._model.njoints)
        root = parse_xml(urdf, "the robot description")
        reader = _ShapeReader(self._model, root, folders)
        links = root.findall("link")
        shapes = [shape for link in links for shape in reader.visual_shapes(link)]
        if not shapes:
            shapes = [shape for link in links for shape in reader.shapes(link, "collision")]
        shapes += _skeleton(self._model, {shape.joint for shape in shapes})
        self.shapes: tuple[RobotShape, ...] = tuple(shapes)
        self.notes = tuple(dict.fromkeys(reader.notes))

    def placements(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places of all joints, the base first.

        Parameters
        ----------
        q : array, shape (n_joints,)
            Positions of the robot's joints in its order [rad or m].

        Returns
        -------
        positions : array, shape (n_joints + 1, 3)
            Origins in the base frame [m].
        orientations : array, shape (n_joints + 1, 4)
            Unit quaternions (w, x, y, z).
        """
        pin.forwardKinematics(self._model, self._data, np.ascontiguousarray(q[self._order]))
        return _pose([self._data.oMi[joint] for joint in range(self.n_joints)])

    def frame_pose(self, q: FloatArray, frame: str) -> tuple[FloatArray, FloatArray]:
        """Position [m], shape (3,), and orientation (w, x, y, z), shape (4,), of a link."""
        pin.forwardKinematics(self._model, self._data, np.ascontiguousarray(q[self._order]))
        index = self._model.getFrameId(frame, pin.FrameType.BODY)
        (position,), (turn,) = _pose([pin.updateFramePlacement(self._model, self._data, index)])
        return position, turn

    def link_place(self, frame: str) -> tuple[int, FloatArray, FloatArray]:
        """The joint that moves a link, and the place of the link in the frame of the joint.

        Returns
        -------
        joint : int
            Its index.
        position : array, shape (3,)
            [m].
        orientation : array, shape (4,)
            Unit quaternion (w, x, y, z).
        """
        found = self._model.frames[self._model.getFrameId(frame, pin.FrameType.BODY)]
        (position,), (turn,) = _pose([found.placement])
        return joint_of(found), position, turn

    def corners(self, q: FloatArray) -> FloatArray:
        """Lowest and highest coordinates of all shapes, shape (2, 3) [m]."""
        self.placements(q)
        points = [
            np.array(self._data.oMi[s.joint].act(np.asarray(corner)))
            for s in self.shapes
            for corner in product(*s.mesh.bounds.T)
        ]
        return np.array([np.min(points, axis=0), np.max(points, axis=0)])


def _pose(places: Sequence[Any]) -> tuple[FloatArray, FloatArray]:
    """Positions [m] and orientations (w, x, y, z) of places, shapes (n, 3) and (n, 4)."""
    found = np.array([pin.SE3ToXYZQUAT(place) for place in places])
    return found[:, :3], np.roll(found[:, 3:], 1, axis=1)


class _ShapeReader:
    """Reads the visual or collision shapes of a URDF; unusable ones are left out with a note."""

    def __init__(self, model: Any, root: ET.Element, folders: Sequence[Path]) -> None:
        self._model, self._root, self._folders = model, root, folders
        self._colours = dict(filter(None, map(_named_colour, root.findall("material"))))
        self.notes: list[str] = []

    def visual_shapes(self, link: ET.Element) -> list[RobotShape]:
        """The visual shapes of a link; its collision shapes if none of these can be used."""
        found = self.shapes(link, "visual")
        is_missing = link.find("visual") is not None and not found
        return self.shapes(link, "collision") if is_missing else found

    def shapes(self, link: ET.Element, tag: str) -> list[RobotShape]:
        """The usable shapes of a link under a tag."""
        found = (self._shape(link, part) for part in link.findall(tag))
        return [shape for shape in found if shape is not None]

    def _shape(self, link: ET.Element, part: ET.Element) -> RobotShape | None:
        name = link.get("name", "")
        frame = self._model.frames[self._model.getFrameId(name, pin.FrameType.BODY)]
        try:
            shape = stated_shape(part)
            mesh, has_colours = self._mesh(shape)
        except PlannerError as error:
            self.notes.append(f"link '{name}': {error}")
            return None
        turn = pin.rpy.rpyToMatrix(*shape.origin[3:])
        place = frame.placement * pin.SE3(turn, shape.origin[:3])
        mesh.apply_transform(place.homogeneous)
        colour = self._colour(part)
        if colour is None and not has_colours:
            colour = _PLAIN
        return RobotShape(joint_of(frame), mesh, colour)

    def _colour(self, part: ET.Element) -> Colour | None:
        material = part.find("material")
        if material is None:
            return None
        own = _named_colour(material)
        return own[1] if own else self._colours.get(material.get("name", ""))

    def _mesh(self, shape: StatedShape) -> tuple[Any, bool]:
        """The surface of a shape in its own frame, and whether it has colours of its own."""
        if shape.kind == "mesh":
            return self._loaded(shape)
        if shape.kind == "box":
            return surface(Box(shape.sizes)), False
        return surface(_SHAPES[shape.kind](*shape.sizes)), False

    def _loaded(self, shape: StatedShape) -> tuple[Any, bool]:
        found = find_mesh(shape.file, self._folders)
        vertices = scaled(found.vertices, shape.sizes)
        # Merged vertices make smooth surfaces, and mix their colours.
        is_plain = found.colours is None
        mesh = trimesh.Trimesh(
            vertices, found.triangles, face_colors=found.colours, process=is_plain
        )
        return mesh, not is_plain


def glb(mesh: Any) -> bytes:
    """A mesh with its own colours, as a binary glTF file.

    Without a material, browsers would draw it as metal: black, except where a lamp is mirrored.
    """
    return bytes(mesh.export(file_type="glb", tree_postprocessor=_make_matte))


def _make_matte(tree: dict[str, Any]) -> None:
    tree["materials"] = [{"pbrMetallicRoughness": {"metallicFactor": 0.0}}]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0


def surface(shape: Shape) -> Any:
    """The surface of a shape in its own frame, a trimesh.Trimesh."""
    make = trimesh.creation
    if isinstance(shape, Box):
        return make.box(shape.size)
    if isinstance(shape, Sphere):
        return make.icosphere(radius=shape.radius, subdivisions=3)
    if isinstance(shape, Capsule):
        return make.capsule(shape.height, shape.radius)
    if isinstance(shape, Cylinder):
        return make.cylinder(shape.radius, shape.height, sections=32)
    if isinstance(shape, Mesh):
        return trimesh.Trimesh(shape.vertices, shape.triangles, process=False)
    raise TypeError(f"no drawing of a {type(shape).__name__}")


def _named_colour(material: ET.Element) -> tuple[str, Colour] | None:
    element = material.find("color")
    if element is None:
        return None
    try:
        red, green, blue, opacity = np.clip(numbers_of(element, "rgba", 4), 0.0, 1.0).tolist()
    except RobotError:
        return None
    return material.get("name", ""), (red, green, blue, opacity)


def _skeleton(model: Any, drawn: Collection[int]) -> Iterator[RobotShape]:
    """Balls at the joints that move no shape, and rods from each to the next ones and its links.

    Several joints in one place have one ball, that of the last.
    """
    ends: list[tuple[int, FloatArray]] = [
        (int(model.parents[joint]), np.array(model.jointPlacements[joint].translation))
        for joint in range(1, model.njoints)
    ]
    ends += [
        (joint_of(frame), np.array(frame.placement.translation))
        for frame in model.frames
        if frame.type == pin.FrameType.BODY
    ]
    reach = sum(float(np.linalg.norm(end)) for _, end in ends) or 1.0
    radius = float(np.clip(0.02 * reach, 0.005, 0.05))
    parents = set(model.parents[1:])
    for joint in set(range(model.njoints)) - set(drawn):
        rods = [end for at, end in ends if at == joint and np.linalg.norm(end) > radius]
        if rods or joint not in parents:
            yield RobotShape(joint, trimesh.creation.icosphere(radius=1.4 * radius), _PLAIN)
        for end in rods:
            rod = trimesh.creation.cylinder(radius, segment=[np.zeros(3), end], sections=24)
            yield RobotShape(joint, rod, _PLAIN)
