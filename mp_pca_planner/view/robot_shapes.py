# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The robot and paths in the scene: visual shapes, else collision shapes, else a skeleton."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh
import viser

from ..arrays import FloatArray
from ..exceptions import PlannerError, RobotError
from ..plotting.motion import surface
from ..robot.bodies import primitive_of
from ..robot.meshes import find_mesh, scaled, solid_of
from ..robot.model import Robot
from ..robot.urdf import numbers_of, parse_xml, stated_shape

Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""

Rgb = tuple[int, int, int]

# Faces of a mesh above which its convex hull is drawn; browsers without a GPU need that.
_MAX_FACES = 40_000

# Size of a ghost as a multiple of the robot's, inside which it is where both have the same place.
_GHOST_SIZE = 0.97
_GHOST_OPACITY = 0.45

_PLAIN: Colour = (0.76, 0.79, 0.83, 1.0)


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
        """The convex hull of the mesh, a little smaller, as the surface of a ghost."""
        solid = solid_of(np.asarray(self.mesh.vertices), np.asarray(self.mesh.faces))
        hull = trimesh.Trimesh(solid.corners, solid.faces, process=False)
        hull.vertices = hull.centroid + _GHOST_SIZE * (hull.vertices - hull.centroid)
        return hull


class RobotShapes:
    """The shapes of a robot, and the places of its joints.

    Parameters
    ----------
    robot : Robot
        The robot.
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

    def __init__(self, robot: Robot, folders: Sequence[Path]) -> None:
        self._model, order = robot.pinocchio_model()
        self._data = self._model.createData()
        self._order = np.argsort(order)
        self.n_joints = int(self._model.njoints)
        root = parse_xml(robot.urdf, "the robot description")
        colours = dict(filter(None, map(_named_colour, root.findall("material"))))
        notes: dict[str, None] = {}

        def usable(link: ET.Element, tag: str) -> list[RobotShape]:
            """The shapes of a link under a tag; those that can't be used are noted."""
            found, name = [], link.get("name", "")
            for part in link.findall(tag):
                try:
                    found.append(_shape(self._model, name, part, colours, folders))
                except PlannerError as error:
                    notes[f"link '{name}': {error}"] = None
            return found

        links, shapes = root.findall("link"), list[RobotShape]()
        for link in links:
            visual = usable(link, "visual")
            is_missing = link.find("visual") is not None and not visual
            shapes += usable(link, "collision") if is_missing else visual
        if not shapes:
            shapes = [shape for link in links for shape in usable(link, "collision")]
        shapes += _skeleton(self._model, {shape.joint for shape in shapes})
        self.shapes, self.notes = tuple(shapes), tuple(notes)

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
        return found.parentJoint, position, turn

    def corners(self, q: FloatArray) -> FloatArray:
        """Corners of the boxes around all shapes, shape (n_corners, 3) [m]."""
        self.placements(q)
        return np.array(
            [
                self._data.oMi[shape.joint].act(np.asarray(corner))
                for shape in self.shapes
                for corner in product(*shape.mesh.bounds.T)
            ]
        )

    def gap(self, q: FloatArray, point: FloatArray) -> float:
        """Distance of a point, shape (3,), from the boxes around all shapes [m]; 0 inside."""
        self.placements(q)
        places = [self._data.oMi[shape.joint].actInv(point) for shape in self.shapes]
        away = [
            x - np.clip(x, *shape.mesh.bounds) for x, shape in zip(places, self.shapes, strict=True)
        ]
        return float(np.linalg.norm(away, axis=1).min())


def _pose(places: Sequence[Any]) -> tuple[FloatArray, FloatArray]:
    """Positions [m] and orientations (w, x, y, z) of places, shapes (n, 3) and (n, 4)."""
    found = np.array([pin.SE3ToXYZQUAT(place) for place in places])
    return found[:, :3], np.roll(found[:, 3:], 1, axis=1)


def _shape(
    model: Any,
    name: str,
    part: ET.Element,
    colours: Mapping[str, Colour],
    folders: Sequence[Path],
) -> RobotShape:
    """The <visual> or <collision> of a link; PlannerError if it can't be used."""
    stated = stated_shape(part)
    if stated.kind == "mesh":
        found = find_mesh(stated.file, folders)
        vertices = scaled(found.vertices, stated.sizes)
        # Merged vertices make smooth surfaces, and mix their colours.
        is_plain = found.colours is None
        mesh = trimesh.Trimesh(
            vertices, found.triangles, face_colors=found.colours, process=is_plain
        )
    else:
        mesh, is_plain = surface(primitive_of(stated)), True
    frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
    turn = pin.rpy.rpyToMatrix(*stated.origin[3:])
    mesh.apply_transform((frame.placement * pin.SE3(turn, stated.origin[:3])).homogeneous)
    material, colour = part.find("material"), None
    if material is not None:
        own = _named_colour(material)
        colour = own[1] if own else colours.get(material.get("name", ""))
    return RobotShape(frame.parentJoint, mesh, _PLAIN if colour is None and is_plain else colour)


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


def _named_colour(material: ET.Element) -> tuple[str, Colour] | None:
    element = material.find("color")
    if element is None:
        return None
    try:
        red, green, blue, opacity = np.clip(numbers_of(element, "rgba", 4), 0.0, 1.0).tolist()
    except RobotError:  # a shape is drawn without its colour
        return None
    return material.get("name", ""), (red, green, blue, opacity)


def _skeleton(model: Any, drawn: Collection[int]) -> Iterator[RobotShape]:
    """Balls at the joints that move no shape, and rods from each to the next ones and its links."""
    ends = [(at, model.jointPlacements[i]) for i, at in enumerate(model.parents)][1:]
    ends += [(x.parentJoint, x.placement) for x in model.frames if x.type == pin.FrameType.BODY]
    lengths = [float(np.linalg.norm(place.translation)) for _, place in ends]
    radius = float(np.clip(0.02 * sum(lengths), 0.005, 0.05))
    for joint in set(range(model.njoints)) - set(drawn):
        yield RobotShape(joint, trimesh.creation.icosphere(radius=1.4 * radius), _PLAIN)
        for (at, place), length in zip(ends, lengths, strict=True):
            if at == joint and length > radius:
                rod = [np.zeros(3), place.translation]
                yield RobotShape(joint, trimesh.creation.cylinder(radius, segment=rod), _PLAIN)


class DrawnRobot:
    """A robot in the scene, in its own colours or, as a ghost, in one translucent colour.

    Parameters
    ----------
    scene : viser.SceneApi
        The scene.
    name : str
        Name of its node.
    shapes : RobotShapes
        Its shapes.
    ghost : tuple of int, optional
        Colour of a ghost, which consists of convex hulls of what moves.

    Attributes
    ----------
    configuration : array, shape (n_joints,)
        The configuration shown.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        shapes: RobotShapes,
        ghost: Rgb | None = None,
    ) -> None:
        self._shapes = shapes
        self.configuration: FloatArray = np.zeros(0)
        scene.add_frame(name, show_axes=False)
        self._joints = [
            scene.add_frame(f"{name}/{joint}", show_axes=False) for joint in range(shapes.n_joints)
        ]
        self._meshes: list[Any] = []
        for i, shape in enumerate(shapes.shapes):
            node = f"{name}/{shape.joint}/{i}"
            if ghost is None:
                _add_shape(scene, node, shape)
            elif shape.joint > 0:
                mesh = add_mesh(scene, node, shape.hull, ghost, opacity=_GHOST_OPACITY)
                mesh.cast_shadow = mesh.receive_shadow = False
                self._meshes.append(mesh)

    def show(self, q: FloatArray) -> None:
        """Put the robot into a configuration, shape (n_joints,)."""
        self.configuration = q
        positions, orientations = self._shapes.placements(q)
        for frame, position, orientation in zip(self._joints, positions, orientations, strict=True):
            frame.position, frame.wxyz = position, orientation

    def paint(self, colour: Rgb) -> None:
        """Give a ghost another colour."""
        for mesh in self._meshes:
            mesh.color = colour


def add_mesh(scene: viser.SceneApi, name: str, mesh: Any, colour: Rgb, **more: Any) -> Any:
    """Add a mesh of one colour to the scene."""
    return scene.add_mesh_simple(name, mesh.vertices, mesh.faces, color=colour, **more)


def _add_shape(scene: viser.SceneApi, name: str, shape: RobotShape) -> None:
    mesh = shape.mesh if len(shape.mesh.faces) <= _MAX_FACES else shape.hull
    if shape.colour is None and mesh is shape.mesh:
        scene.add_glb(name, glb(mesh))
        return
    red, green, blue, opacity = shape.colour or (0.8, 0.8, 0.8, 1.0)
    colour = round(255 * red), round(255 * green), round(255 * blue)
    add_mesh(scene, name, mesh, colour, opacity=None if opacity >= 1.0 else opacity)


class DrawnPath:
    """A path in the scene, hidden at first, with a width on the screen [pixels]."""

    def __init__(self, scene: viser.SceneApi, name: str, colour: Rgb, width: float = 3.0) -> None:
        self._line = scene.add_line_segments(
            name,
            np.zeros((1, 2, 3), np.float32),
            colour,
            thickness=width,
            thickness_units="screen",
            visible=False,
        )

    def show(self, points: FloatArray, colour: Rgb | None = None) -> None:
        """Show a path through points, shape (n_points, 3) [m]; one point hides it."""
        self._line.visible = len(points) > 1
        if len(points) > 1:
            self._line.points = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        if colour is not None:
            self._line.colors = np.asarray(colour, np.uint8)
