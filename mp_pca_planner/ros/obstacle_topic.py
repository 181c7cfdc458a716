# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The topic of obstacles: markers that are added to the world and removed from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from visualization_msgs.msg import MarkerArray

from ..arrays import FloatArray
from ..exceptions import PlannerError, WorldError
from ..execution.frames import Poses, foreign_poses, is_same, placed
from ..execution.motion_server import MotionServer
from ..execution.parameter_texts import fixed_frames
from ..motion.collision import package_folders
from ..robot.world import Obstacle, World
from .guarded_node import LOG_PERIOD, GuardedNode
from .messages import to_text
from .obstacle_markers import MarkerMessages
from .planning_setup import PlanningSetup
from .subscriptions import BURSTS, LATCHED_BURSTS, GroupExecutor, ThreadGroup
from .transforms import FrameTransforms


class ObstacleTopic:
    """Keeps the obstacles as the markers of ``~/obstacles`` say.

    Parameters
    ----------
    node : GuardedNode
        The node.
    setup : PlanningSetup
        Has the robot whose links markers may be attached to.
    server : MotionServer
        Keeps the obstacles.
    on_threat : callable
        Called if the running motion would hit a new obstacle.
    """

    def __init__(
        self,
        node: GuardedNode,
        setup: PlanningSetup,
        server: MotionServer,
        on_threat: Callable[[], None],
    ) -> None:
        self._node, self._setup, self._server = node, setup, server
        self._on_threat = on_threat
        self._messages, self._transforms = MarkerMessages(), FrameTransforms(node)
        # The obstacles as they are stated, and the poses that their frames had.
        self._stated: Sequence[Obstacle] = ()
        self._used: Poses = {}
        # Notes on the present obstacles, each of which is logged once.
        self._notes: frozenset[str] = frozenset()
        group = ThreadGroup()
        for callback, qos in ((self._on_live, BURSTS), (self._on_late, LATCHED_BURSTS)):
            node.create_subscription(
                MarkerArray, "~/obstacles", callback, qos, callback_group=group
            )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(0.2, self._follow_frames, callback_group=group, clock=steady)
        # A separate thread, so that a running motion is checked while a goal is planned.
        self._executor = GroupExecutor(node, group)

    @property
    def facts(self) -> dict[str, str | int]:
        """The number of obstacles, and why one is not avoided, for the diagnostics."""
        return {
            "obstacles": len(self._server.surroundings.world),
            "obstacle_rejected": self._server.surroundings.missing or "none",
        }

    def close(self) -> None:
        """End the thread, before the node is destroyed."""
        self._executor.shutdown()

    def _on_live(self, message: MarkerArray, facts: dict[str, Any]) -> None:
        self._apply(message, facts["source_timestamp"], is_late=False)

    def _on_late(self, message: MarkerArray, facts: dict[str, Any]) -> None:
        self._apply(message, facts["source_timestamp"], is_late=True)

    def _apply(self, message: MarkerArray, stamp: int, *, is_late: bool) -> None:
        """Apply the markers of a message; one that can't be used changes nothing."""
        applied = self._messages.apply(
            self._stated,
            message,
            stamp,
            is_late=is_late,
            folders=package_folders(self._setup.settings.package_folders),
        )
        if applied is None:
            return
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
        links, fixed = context.robot.frame_names, fixed_frames(context.settings.fixed_frames)

        def pose_of(frame: str) -> FloatArray | None:
            if frame in fixed:
                return np.array(fixed[frame])
            return self._transforms.pose(frame, links[0])

        return foreign_poses(obstacles, links, pose_of)

    def _place(self, stated: Sequence[Obstacle], poses: Poses, problems: list[str]) -> None:
        """Use obstacles with poses of their frames; log problems."""
        context, surroundings = self._setup.context, self._server.surroundings
        missing = list(self._messages.rejected.values())
        try:
            world = World(placed(stated, poses)[0])
            if surroundings.replace(world, context):
                self._on_threat()
            for note in world.notes:
                if note not in self._notes:
                    self._node.get_logger().warning(to_text(note))
            self._notes = frozenset(world.notes)
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
            text = to_text(f"obstacles: {problems[0]}{more}")
            self._node.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)
