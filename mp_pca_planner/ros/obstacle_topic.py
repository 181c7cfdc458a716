# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The topic of obstacles: markers that are added to the world and removed from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from visualization_msgs.msg import MarkerArray

from ..exceptions import PlannerError
from ..execution.motion_server import MotionServer
from ..motion.collision import package_folders
from ..robot.world import World
from .guarded_node import LOG_PERIOD, GuardedNode
from .messages import to_text
from .obstacle_markers import MarkerMessages
from .planning_setup import PlanningSetup
from .subscriptions import BURSTS, LATCHED_BURSTS, GroupExecutor, ThreadGroup


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
        self._messages = MarkerMessages()
        # Notes on the present obstacles, each of which is logged once.
        self._notes: frozenset[str] = frozenset()
        group = ThreadGroup()
        for callback, qos in ((self._on_live, BURSTS), (self._on_late, LATCHED_BURSTS)):
            node.create_subscription(
                MarkerArray, "~/obstacles", callback, qos, callback_group=group
            )
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
        context, surroundings = self._setup.context, self._server.surroundings
        applied = self._messages.apply(
            surroundings.world,
            message,
            stamp,
            is_late=is_late,
            links=context.robot.frame_names if context else None,
            folders=package_folders(self._setup.settings.package_folders),
        )
        if applied is None:
            return
        obstacles, problems = applied
        missing = list(self._messages.rejected.values())
        try:
            world = World(obstacles)
            if surroundings.replace(world, context):
                self._on_threat()
            for note in world.notes:
                if note not in self._notes:
                    self._node.get_logger().warning(to_text(note))
            self._notes = frozenset(world.notes)
        except PlannerError as error:
            problems.append(str(error))
            missing.append(str(error))
        surroundings.missing = to_text(missing[0]) if missing else ""
        if problems:
            more = f" (and {len(problems) - 1} more)" if problems[1:] else ""
            text = to_text(f"obstacles: {problems[0]}{more}")
            self._node.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)
