# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What all panels share: the scene with robots and paths, parts of HTML, and caught errors."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from itertools import product
from typing import Any

import jinja2  # noqa: F401  # missing, it is reported before the page is made
import numpy as np
import viser

from ..arrays import FloatArray
from ..exceptions import PlannerError, printable
from ..plotting.page import environment
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .robot_shapes import RobotShape, RobotShapes, glb

Rgb = tuple[int, int, int]

GOOD, WARNING, BAD, GREY = "#009E73", "#E69F00", "#D9352B", "#8C8C8C"
"""Colours of verdicts, legible on light and on dark."""

LOG = logging.getLogger("mp_pca_planner.view")
"""Log of the page."""

# Faces of a mesh above which its convex hull is drawn; browsers without a GPU need that.
_MAX_FACES = 40_000

# From what it sees to a camera, in diagonals of that.
_DIRECTION = np.array([0.75, -0.65, 0.35])

# Where a phone shows the robot, in halves of its width and height from the middle, right and down.
_PHONE_SIDE, _PHONE_HEIGHTS = 0.9, (-0.85, -0.2)

_COMPLAINT_TIME = 10.0  # for which an error is shown, and not repeated [s]


def part(macro: str, *content: Any) -> str:
    """HTML of a part of the page, by a macro of the template."""
    return str(getattr(_macros(), macro)(*content))


@cache
def _macros() -> Any:
    colours = {"GOOD": GOOD, "WARNING": WARNING, "BAD": BAD, "GREY": GREY}
    return environment().get_template("view.html", globals=colours).module


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
    opacity : float
        Opacity of a ghost.

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
        opacity: float = 0.35,
    ) -> None:
        self._shapes = shapes
        self.configuration: FloatArray = np.zeros(0)
        self._root = scene.add_frame(name, show_axes=False)
        self._joints = [
            scene.add_frame(f"{name}/{joint}", show_axes=False) for joint in range(shapes.n_joints)
        ]
        self._meshes: list[Any] = []
        for i, shape in enumerate(shapes.shapes):
            node = f"{name}/{shape.joint}/{i}"
            if ghost is None:
                _add_shape(scene, node, shape)
            elif shape.joint > 0:
                mesh = add_mesh(scene, node, shape.hull, ghost, opacity=opacity)
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

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return bool(self._root.visible)

    @visible.setter
    def visible(self, is_visible: bool) -> None:
        self._root.visible = is_visible


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


def from_hex(colour: str) -> Rgb:
    """A colour written as ``#RRGGBB``."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


class DrawnPaths:
    """Paths of one colour in the scene.

    Parameters
    ----------
    scene : viser.SceneApi
        The scene.
    name : str
        Name of its node.
    colour : tuple of int
        Its colour.
    width : float
        Its width on the screen [pixels].
    """

    def __init__(self, scene: viser.SceneApi, name: str, colour: Rgb, width: float = 3.0) -> None:
        self._lines = scene.add_line_segments(
            name,
            np.zeros((1, 2, 3), np.float32),
            colour,
            thickness=width,
            thickness_units="screen",
            visible=False,
        )

    def show(self, *paths: FloatArray, colour: Rgb | None = None) -> None:
        """Draw paths through points, each of shape (n_points, 3) [m]; without any, hide them."""
        segments = [np.stack([path[:-1], path[1:]], axis=1) for path in paths]
        drawn = np.concatenate([np.zeros((0, 2, 3)), *segments]).astype(np.float32)
        if len(drawn):
            self._lines.points = drawn
        if colour is not None:
            self._lines.colors = np.asarray(colour, np.uint8)
        self._lines.visible = bool(len(drawn))


class Stage:
    """The scene of the page and what all panels share.

    Parameters
    ----------
    server : viser.ViserServer
        The server of the page.
    robot : Robot
        The robot, for this page alone.
    limits : JointLimits
        Limits of its joints.
    shapes : RobotShapes
        Its shapes.
    frame : str
        The link whose path is drawn and that the handle moves.

    Attributes
    ----------
    lock : threading.RLock
        Held by every callback and thread while it changes the page.
    drawn : DrawnRobot
        The robot on the page.
    size : float
        Length of the diagonal of what the robot fills at first [m].
    """

    def __init__(
        self,
        server: viser.ViserServer,
        robot: Robot,
        limits: JointLimits,
        shapes: RobotShapes,
        frame: str,
    ) -> None:
        self.server, self.robot, self.limits = server, robot, limits
        self.shapes, self.frame = shapes, frame
        self.lock = threading.RLock()
        self._complaint = "", 0.0
        self.drawn = DrawnRobot(server.scene, "/robot", shapes)

    def arrange(self, configurations: FloatArray) -> None:
        """Put the robot into the first configuration, and the camera where it sees all of them."""
        self.drawn.show(configurations[0])
        corners = np.array([self.shapes.corners(q) for q in configurations])
        low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
        self.size = size = float(np.linalg.norm(high - low))
        scene = self.server.scene
        scene.set_up_direction("+z")
        # Without a GPU, each of these makes the page several times slower.
        scene.configure_environment_map(None)
        scene.configure_default_lights(cast_shadow=False)
        scene.add_light_hemisphere("/sky", ground_color=(190, 190, 200), intensity=1.5)
        cell = 10.0 ** np.floor(np.log10(size)) / 2.0
        scene.add_grid(
            "/ground",
            width=4.0 * size,
            height=4.0 * size,
            cell_size=cell,
            section_size=2.0 * cell,
            # Between the backgrounds of the light and of the dark page.
            cell_color=(165, 168, 172),
            section_color=(140, 143, 148),
            position=(0.0, 0.0, min(float(low[2]), 0.0)),
        )
        aim = 0.5 * (low + high) - np.array([0.0, 0.0, 0.12 * size])
        first = aim + size * _DIRECTION
        points = np.array([corner for box in corners for corner in product(*box.T)])
        camera = self.server.initial_camera
        camera.position, camera.look_at = first, aim

        def show_on_phone(camera: viser.CameraHandle) -> None:
            # The panel covers the lower half of a phone. A page that loads may drop the message.
            with self.caught():
                if camera.aspect < 1.0 and np.allclose(camera.position, first, atol=1e-3):
                    view = view_above_sheet(points, camera.aspect, camera.fov)
                    camera.position, camera.look_at = view

        @self.server.on_client_connect
        def _(client: viser.ClientHandle) -> None:
            client.camera.on_update(show_on_phone)
            show_on_phone(client.camera)

    def path(self, positions: FloatArray) -> FloatArray:
        """Positions of the end effector along configurations, shape (n_steps, 3) [m]."""
        with self.lock:
            return np.asarray(self.robot.frame_positions(positions, [self.frame])[:, 0])

    def joint_range(self, name: str) -> tuple[float, float, str]:
        """Lowest and highest position of a joint and their unit; a turn each way without limits."""
        i = self.robot.joint_names.index(name)
        is_prismatic = name in self.robot.prismatic_joints
        wide = 1.0 if is_prismatic else 2.0 * np.pi
        ends = np.array([self.limits.lower[i], self.limits.upper[i]])
        low, high = np.nan_to_num(ends, posinf=wide, neginf=-wide).tolist()
        return low, high, "m" if is_prismatic else "rad"

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Log an error and show it to everybody: threads and widgets of the page outlive it."""
        try:
            yield
        except BaseException as error:  # such as SystemExit, which ends a thread silently
            is_internal = not isinstance(error, PlannerError)
            text = f"internal error, {type(error).__name__}: {error}" if is_internal else str(error)
            self._complain(printable(text), error if is_internal else None)

    def _complain(self, text: str, error: BaseException | None) -> None:
        """Show an error and log it with its traceback, once if it comes again and again."""
        now = time.monotonic()
        if text == self._complaint[0] and now < self._complaint[1] + _COMPLAINT_TIME:
            return
        self._complaint = text, now
        LOG.error("the page continues: %s", text, exc_info=error)
        for client in self.server.get_clients().values():
            client.add_notification("Not done", text, auto_close_seconds=_COMPLAINT_TIME)

    def on_change(self, handle: Any, react: Callable[[], None]) -> None:
        """Call a function when a person changes a widget; the page's own changes don't count."""

        def call(event: Any) -> None:
            if event.client_id is not None:
                with self.caught(), self.lock:
                    react()

        handle.on_update(call)

    def on_click(self, handle: Any, react: Callable[[], None]) -> None:
        """Call a function when a person clicks a button."""

        def call(_: Any) -> None:
            with self.caught(), self.lock:
                react()

        handle.on_click(call)

    def on_drag(self, handle: Any, react: Callable[[bool], None]) -> None:
        """Call a function when a person drags a handle, with whether he has released it."""

        # Viser keeps the order of the events for coroutines only; the release must be the last.
        async def call(event: viser.TransformControlsEvent) -> None:
            with self.caught(), self.lock:
                react(event.phase == "end")

        handle.on_update(call)


def view_above_sheet(
    points: FloatArray, aspect: float, fov: float
) -> tuple[FloatArray, FloatArray]:
    """The nearest camera with all points above the sheet of a phone, and what it looks at.

    Parameters
    ----------
    points : array, shape (n_points, 3)
        The points [m].
    aspect : float
        Width of the screen, relative to its height.
    fov : float
        Vertical angle that the camera sees [rad].

    Returns
    -------
    position, look_at : array, shape (3,)
        In [m].
    """
    forward = -_DIRECTION / np.linalg.norm(_DIRECTION)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(forward, right), forward])
    x, y, depth = axes @ points.T
    # A camera at (u, v, z) along the axes sees a point at ((x - u), (y - v)) / (depth - z). Each
    # bound of that is one of u or v, linear in z. The largest z where they meet is the nearest.
    half = np.tan(0.5 * fov)
    side, (top, bottom) = half * _PHONE_SIDE * aspect, half * np.array(_PHONE_HEIGHTS)
    left_end, right_end = np.max(x - side * depth), np.min(x + side * depth)
    low_end, high_end = np.max(y - bottom * depth), np.min(y - top * depth)
    z = min((right_end - left_end) / (2.0 * side), (high_end - low_end) / (bottom - top))
    middle = [0.5 * (left_end + right_end), 0.5 * (low_end + high_end + (bottom + top) * z), z]
    position = np.array(middle) @ axes
    return position, position + (np.mean(depth) - z) * forward
