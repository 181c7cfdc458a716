# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The scene of the page: the ground, the robot, and what all panels share."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from ..arrays import FloatArray
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .drawing import DrawnRobot
from .robot_shapes import RobotShapes


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
            cell_color=(200, 200, 200),
            section_color=(165, 165, 165),
            position=(0.0, 0.0, min(float(low[2]), 0.0)),
        )
        centre = 0.5 * (low + high)
        camera = self.server.initial_camera
        # The robot appears above the middle: on phones, the panel covers the lower part.
        aim = centre - np.array([0.0, 0.0, 0.12 * size])
        camera.look_at = tuple(aim)
        camera.position = tuple(aim + size * np.array([0.75, -0.65, 0.35]))

    def path(self, positions: FloatArray) -> FloatArray:
        """Positions of the end effector along configurations, shape (n_steps, 3) [m]."""
        with self.lock:
            return np.asarray(self.robot.frame_positions(positions, [self.frame])[:, 0])

    def on_change(self, handle: Any, react: Callable[[], None]) -> None:
        """Call a function when a person changes a widget; the page's own changes don't count."""

        def call(event: Any) -> None:
            if event.client_id is not None:
                with self.lock:
                    react()

        handle.on_update(call)

    def on_click(self, handle: Any, react: Callable[[], None]) -> None:
        """Call a function when a person clicks a button."""

        def call(_: Any) -> None:
            with self.lock:
                react()

        handle.on_click(call)
