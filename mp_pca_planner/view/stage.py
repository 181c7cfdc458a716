# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What all panels share: the scene, the player, parts of HTML, and caught errors."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

import jinja2  # noqa: F401  # missing, it is reported before the page is made
import numpy as np
import viser

from ..arrays import FloatArray
from ..exceptions import PlannerError, printable
from ..plotting.style import environment
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .robot_shapes import DrawnRobot, RobotShapes

GOOD, WARNING, BAD = "#009E73", "#E69F00", "#D9352B"
"""Colours of verdicts, legible on light and on dark."""

LOG = logging.getLogger("mp_pca_planner.view")
"""Log of the page."""

# From what it sees to the camera, whose vertical field of view is narrow [rad]; the robot fills at
# most this share of the scene, which is about as wide as high: the rest is for handles on a phone.
_DIRECTION, _FIELD, _FILLED = np.array([0.75, -0.65, 0.35]), 0.6, 0.65

HANDLE_LENGTH = 90.0
"""Length of the arrows of handles on the screen [pixels]."""

_PERIOD = 1.0 / 30.0  # between two configurations [s]
_SLIDER_STEP = 5  # in which the slider follows [%]
REST = 0.6
"""Rest at the end of a motion before it starts again [s]."""


def part(macro: str, *content: Any) -> str:
    """HTML of a part of the page, by a macro of the template."""
    return str(getattr(_macros(), macro)(*content))


@cache
def _macros() -> Any:
    return environment().get_template("view.html").module


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

    Attributes
    ----------
    frame : str
        The link whose path is drawn and that the handle moves.
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
    ) -> None:
        self.server, self.robot, self.limits = server, robot, limits
        self.shapes, self.frame = shapes, robot.end_effector
        self.lock = threading.RLock()
        self.drawn = DrawnRobot(server.scene, "/robot", shapes)

    def arrange(self, configurations: FloatArray) -> None:
        """Put the robot into the first configuration, and the camera where it sees all of them."""
        self.drawn.show(configurations[0])
        corners = np.concatenate(
            [self.path(configurations), *(self.shapes.corners(q) for q in configurations)]
        )
        low, high = corners.min(axis=0), corners.max(axis=0)
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
            width=2.0 * size,
            height=2.0 * size,
            cell_size=cell,
            section_size=2.0 * cell,
            # Thin, and between the backgrounds of the light and of the dark page.
            cell_color=(160, 165, 170),
            section_color=(160, 165, 170),
            cell_thickness=0.4,
            section_thickness=0.7,
            position=(0.0, 0.0, min(float(low[2]), 0.0)),
        )
        aim = 0.5 * (low + high)
        back = _DIRECTION / np.linalg.norm(_DIRECTION)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        x, y, z = np.array([right, np.cross(back, right), back]) @ (corners - aim).T
        away = z + np.maximum(np.abs(x), np.abs(y)) / (_FILLED * np.tan(0.5 * _FIELD))
        camera = self.server.initial_camera
        camera.position, camera.look_at, camera.fov = aim + away.max() * back, aim, _FIELD

    def add_handle(self, name: str, **more: Any) -> viser.TransformControlsHandle:
        """Add a handle to drag, of the same size at any distance.

        What takes a finger is 4.5 times as wide as the lines.
        """
        return self.server.scene.add_transform_controls(
            name, HANDLE_LENGTH, line_width=6.0, fixed=True, depth_test=False, **more
        )

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
        except Exception as error:
            is_internal = not isinstance(error, PlannerError)
            text = f"internal error, {type(error).__name__}: {error}" if is_internal else str(error)
            LOG.error("the page continues: %s", printable(text), exc_info=is_internal)
            for client in self.server.get_clients().values():
                client.add_notification("Not done", printable(text), auto_close_seconds=10.0)

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


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """A motion to show.

    Attributes
    ----------
    times : array, shape (n_steps,)
        Increasing times [s], the first 0.
    positions : array, shape (n_steps, n_joints)
        Joint positions [rad or m].
    """

    times: FloatArray
    positions: FloatArray

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.times[-1])

    def at(self, time: float) -> FloatArray:
        """The configuration at a time [s], shape (n_joints,); held before and after the motion."""
        return np.array([np.interp(time, self.times, column) for column in self.positions.T])


class Player:
    """Plays one motion at a time, again and again with a rest between.

    Parameters
    ----------
    stage : Stage
        The scene.
    motion : ShownMotion
        The first motion.

    Attributes
    ----------
    motion : ShownMotion
        The motion.
    """

    def __init__(self, stage: Stage, motion: ShownMotion) -> None:
        self._stage, self.motion = stage, motion
        self._time, self._is_playing = 0.0, True
        gui = stage.server.gui
        self._button = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        self._slider: Any = gui.add_slider("Time [%]", 0, 100, 1, 0)
        stage.on_click(self._button, lambda: self.play(not self._is_playing))
        stage.on_change(self._slider, lambda: self.seek(0.01 * self._slider.value))
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="player", daemon=True)
        self._thread.start()

    @property
    def share(self) -> float:
        """Share of the motion that has passed, 0 to 1."""
        duration = self.motion.duration
        return min(self._time / duration, 1.0) if duration > 0.0 else 0.0

    def show(self, motion: ShownMotion) -> None:
        """Show another motion, at the same share of its duration."""
        share, self.motion = self.share, motion
        self._time = share * motion.duration
        self._draw()

    def play(self, is_playing: bool) -> None:
        """Play or pause."""
        self._is_playing = is_playing
        self._button.label = "Pause" if is_playing else "Play"
        self._button.icon = viser.Icon.PLAYER_PAUSE if is_playing else viser.Icon.PLAYER_PLAY

    def seek(self, share: float) -> None:
        """Pause at a share of the motion, 0 to 1."""
        self.play(False)
        self._time = share * self.motion.duration
        self._slider.value = round(100 * share)
        self._draw()

    def advance(self, elapsed: float) -> None:
        """Let time pass [s]."""
        self._time = (self._time + elapsed) % (self.motion.duration + REST)
        self._slider.value = _SLIDER_STEP * round(100 * self.share / _SLIDER_STEP)
        self._draw()

    def close(self) -> None:
        """End the thread."""
        self._closed.set()
        self._thread.join()

    def _draw(self) -> None:
        with self._stage.server.atomic():
            self._stage.drawn.show(self.motion.at(self._time))

    def _run(self) -> None:
        last = time.monotonic()
        while not self._closed.wait(_PERIOD):
            now = time.monotonic()
            with self._stage.lock:
                if self._is_playing:
                    self.advance(now - last)
            last = now
