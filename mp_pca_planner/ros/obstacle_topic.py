# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The topic of obstacles: markers that are added to the world and removed from it.

Obstacles, and goals that are poses, may be stated in frames that are not links of the robot.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.time import Time

from ..arrays import FloatArray
from ..exceptions import GoalError, PlannerError, WorldError
from ..execution.parameters import fixed_frames
from ..execution.serving.assembly import Model
from ..execution.serving.surroundings import Poses, Surroundings, foreign_poses, is_same, placed
from ..execution.threads import IsCancelled
from ..motion.collision import package_folders
from ..robot.world import Obstacle, World
from .messages import to_text
from .nodes import LOG_PERIOD, GuardedNode
from .obstacle_markers import Applied, MarkerMessage, MarkerMessages, MarkerSubscription
from .planning_setup import PlanningSetup


class ForeignFrames:
    """Looks up frames in the parameter ``fixed_frames``, then in tf2.

    tf2_ros is part of ROS 2, but there is no package of it for pip. Without it, only fixed frames
    are known. Transforms are listened to from the first look on.

    Parameters
    ----------
    node : Node
        The node.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._buffer: Any = None
        self._lock = threading.Lock()
        self._is_installed = find_spec("tf2_ros") is not None

    def pose(self, frame: str, model: Model, wait: float = 0.0) -> FloatArray | None:
        """The newest pose of a frame in the base frame, shape (7,); None if it is unknown.

        Parameters
        ----------
        frame : str
            The frame.
        model : Model
            Has the parameters and the robot.
        wait : float
            Longest time to wait for its transform [s].
        """
        if (fixed := fixed_frames(model.settings.fixed_frames).get(frame)) is not None:
            return np.array(fixed)
        if not self._is_installed:
            return None
        tf2_ros = import_module("tf2_ros")
        with self._lock:
            if self._buffer is None:
                self._buffer = tf2_ros.Buffer(node=self._node)
                self._listener = tf2_ros.TransformListener(self._buffer, self._node)
        base, longest = model.robot.frame_names[0], Duration(seconds=wait)
        with suppress(tf2_ros.TransformException):
            found = self._buffer.lookup_transform(base, frame, Time(), longest).transform
            p, o = found.translation, found.rotation
            return np.array([p.x, p.y, p.z, o.x, o.y, o.z, o.w])
        return None


class ObstacleTopic:
    """Keeps the obstacles as the markers of ``~/obstacles`` say, and checks the running motion.

    Both take place in a thread of its own.

    Parameters
    ----------
    node : GuardedNode
        The node.
    setup : PlanningSetup
        Has the robot whose links markers may be attached to.
    surroundings : Surroundings
        Keeps the obstacles.
    frames : ForeignFrames
        Looks up the frames of obstacles that are not links.
    """

    period = 0.01
    """Time between two polls [s]."""

    frame_period = 0.2
    """Time between two looks at the frames of obstacles [s]."""

    look_period = 0.05
    """Time between two checks of the running motion while the obstacles stay the same [s]."""

    mesh_timeout = 5.0
    """Longest time that a goal waits for meshes [s]."""

    def __init__(
        self,
        node: GuardedNode,
        setup: PlanningSetup,
        surroundings: Surroundings,
        frames: ForeignFrames,
    ) -> None:
        self._node, self._setup, self._surroundings = node, setup, surroundings
        self._frames = frames
        self._markers = MarkerMessages()
        self._subscription = MarkerSubscription(node, "~/obstacles")
        # Notes on the present obstacles, each of which is logged once.
        # The problem that was logged last, and when; it is logged again if it comes anew.
        self._problem, self._logged = "", -LOG_PERIOD
        # The obstacles as they are stated, and the poses that their frames had.
        self._stated: Sequence[Obstacle] = ()
        self._used: Poses = {}
        self._looked = self._placed = 0.0
        # Polls that were begun and completed.
        self._cycled = threading.Condition()
        self._n_begun = self._n_completed = 0
        self._is_asked = threading.Event()
        self._is_ending = False
        self._thread = threading.Thread(target=self._run, name="obstacles", daemon=True)
        self._thread.start()

    @property
    def facts(self) -> dict[str, str | int]:
        """The number of obstacles, and why one is not avoided, for the diagnostics."""
        return {
            "obstacles": len(self._surroundings.world),
            "obstacle_rejected": self._surroundings.missing or "none",
        }

    def settle(self, is_cancelled: IsCancelled) -> None:
        """Wait until the markers that have arrived are obstacles; usually a millisecond.

        Raises
        ------
        GoalError
            If reading their meshes takes too long.
        CancelledError
            If the goal that waits is cancelled.
        """
        deadline = time.monotonic() + self.mesh_timeout

        def wait(is_done: Callable[[], bool]) -> None:
            with self._cycled:
                while not (is_done() or self._is_ending):
                    if is_cancelled():
                        raise CancelledError
                    if time.monotonic() > deadline:
                        raise GoalError(
                            "meshes of obstacles are still being read; send the goal again"
                        )
                    self._is_asked.set()
                    self._cycled.wait(self.period)

        due = self._n_begun + 1
        wait(lambda: self._n_completed >= due)
        n_asked, n_read = self._markers.meshes
        if n_read < n_asked:
            wait(lambda: self._markers.meshes[1] >= n_asked)
            after = self._n_begun + 1
            wait(lambda: self._n_completed >= after)

    def close(self) -> None:
        """End the thread, before the node is destroyed."""
        self._is_ending = True
        self._is_asked.set()
        self._thread.join()
        self._markers.close()

    def _run(self) -> None:
        cycle = self._node.guarded(self._cycle)
        while not self._is_ending:
            self._is_asked.wait(self.period)
            self._is_asked.clear()
            self._n_begun += 1
            cycle()
            with self._cycled:
                self._n_completed = self._n_begun
                self._cycled.notify_all()

    def _cycle(self) -> None:
        for message in self._subscription.poll():
            self._node.guarded(self._apply)(message)
        self._use(self._markers.refresh(self._stated, self._node.seconds()))
        if time.monotonic() - self._placed >= self.frame_period:
            self._placed = time.monotonic()
            self._follow_frames()
        context = self._setup.last_context
        if context is not None and time.monotonic() - self._looked >= self.look_period:
            self._looked = time.monotonic()
            try:
                self._surroundings.look_ahead(context)
            except PlannerError as error:
                self._log(str(error))

    def _apply(self, message: MarkerMessage) -> None:
        """Apply the markers of a message; one that can't be used changes nothing."""
        folders = package_folders(self._setup.settings.package_folders)
        now = self._node.seconds()
        self._use(self._markers.apply(self._stated, message, folders=folders, now=now))

    def _use(self, applied: Applied | None) -> None:
        """Replace the obstacles, unless nothing has changed."""
        if applied is not None:
            obstacles, problems = applied
            self._place(obstacles, self._poses(obstacles), problems)

    def _follow_frames(self) -> None:
        """Place the obstacles again where frames outside of the robot have moved."""
        poses = self._poses(self._stated)
        if not is_same(poses, self._used):
            self._place(self._stated, poses, [])

    def _poses(self, obstacles: Sequence[Obstacle]) -> Poses:
        """Poses of the frames of obstacles that are not links; none before there is a robot."""
        context = self._setup.context
        if context is None:
            return {}
        return foreign_poses(
            obstacles,
            context.robot.frame_names,
            lambda frame: self._frames.pose(frame, context),
        )

    def _place(self, stated: Sequence[Obstacle], poses: Poses, problems: list[str]) -> None:
        """Use obstacles with poses of their frames; log problems."""
        surroundings, missing = self._surroundings, list(self._markers.rejected.values())
        try:
            world = World(placed(stated, poses)[0])
            surroundings.replace(world, self._setup.context)
        except PlannerError as error:
            problems.append(str(error))
            missing.append(str(error))
            if isinstance(error, WorldError):  # the obstacles before are kept
                stated, poses = self._stated, self._used
        self._stated, self._used = stated, poses
        unplaced = placed(stated, poses)[1]
        problems += unplaced
        missing += unplaced
        surroundings.unplaced = to_text(unplaced[0]) if unplaced else ""
        surroundings.missing = to_text(missing[0]) if missing else ""
        if problems:
            more = f" (and {len(problems) - 1} more)" if problems[1:] else ""
            self._log(f"{problems[0]}{more}")
        elif stated:
            self._problem = ""

    def _log(self, text: str) -> None:
        """Log a problem once: the same obstacles are often sent, and looked at, again."""
        now = time.monotonic()
        if text != self._problem and now - self._logged >= LOG_PERIOD:
            self._problem, self._logged = text, now
            self._node.get_logger().error(to_text(f"obstacles: {text}"))
