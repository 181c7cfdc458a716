# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The topic of obstacles: markers that are added to the world and removed from it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from visualization_msgs.msg import Marker, MarkerArray

from ..exceptions import PlannerError, WorldError, unknown_name
from ..execution.avoidance import ObstacleAvoidance
from ..motion.collision import package_folders
from ..robot.world import Obstacle, World
from .guarded_node import LOG_PERIOD, GuardedNode
from .messages import to_text
from .obstacle_markers import marker_name, to_obstacle
from .planning_setup import PlanningSetup
from .subscriptions import GroupExecutor, ThreadGroup

# Receives from all publishers; bursts of messages wait.
_LIVE = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
# Receives what latching publishers sent before.
_LATE = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
# Messages that are remembered, because latched ones arrive on both subscriptions.
_N_SEEN = 400


class ObstacleTopic:
    """Keeps the obstacles as the markers of ``~/obstacles`` say.

    Parameters
    ----------
    node : GuardedNode
        The node.
    setup : PlanningSetup
        Has the robot whose links markers may be attached to.
    avoidance : ObstacleAvoidance
        Keeps the obstacles.
    on_threat : callable
        Called if the running motion would hit a new obstacle.

    Attributes
    ----------
    problem : str
        Why a marker of the last message was rejected; empty if none was.
    """

    def __init__(
        self,
        node: GuardedNode,
        setup: PlanningSetup,
        avoidance: ObstacleAvoidance,
        on_threat: Callable[[], None],
    ) -> None:
        self._node, self._setup, self._avoidance = node, setup, avoidance
        self._on_threat, self.problem = on_threat, ""
        self._seen: deque[int] = deque(maxlen=_N_SEEN)
        # Source time of the last change of each obstacle, and of all of them [ns].
        self._changed: dict[str, int] = {}
        self._cleared = 0
        group = ThreadGroup()
        for callback, qos in ((self._on_live, _LIVE), (self._on_late, _LATE)):
            node.create_subscription(
                MarkerArray, "~/obstacles", callback, qos, callback_group=group
            )
        # A separate thread, so that a running motion is checked while a goal is planned.
        self._executor = GroupExecutor(node, group)

    @property
    def facts(self) -> dict[str, str | int]:
        """The number of obstacles, and the last problem, for the diagnostics."""
        return {
            "obstacles": len(self._avoidance.world),
            "obstacle_rejected": self.problem or "none",
        }

    def close(self) -> None:
        """End the thread, before the node is destroyed."""
        self._executor.shutdown()

    def _on_live(self, message: MarkerArray, facts: dict[str, Any]) -> None:
        if self._is_new(facts["source_timestamp"]):
            self._apply(message, facts["source_timestamp"], is_late=False)

    def _on_late(self, message: MarkerArray, facts: dict[str, Any]) -> None:
        if self._is_new(facts["source_timestamp"]):
            self._apply(message, facts["source_timestamp"], is_late=True)

    def _is_new(self, stamp: int) -> bool:
        if stamp and stamp in self._seen:
            return False
        self._seen.append(stamp)
        return True

    def _apply(self, message: MarkerArray, stamp: int, *, is_late: bool) -> None:
        """Apply the markers of a message; one that can't be used changes nothing."""
        obstacles = {one.name: one for one in self._avoidance.world}
        problems: list[str] = []
        for marker in message.markers:
            name = marker_name(marker)
            # A latched message may come after a newer one.
            if is_late and stamp < max(self._changed.get(name, 0), self._cleared):
                continue
            try:
                self._apply_marker(marker, obstacles)
            except WorldError as error:
                problems.append(str(error))
                continue
            self._changed[name] = stamp
            if marker.action == Marker.DELETEALL and not marker.ns:
                self._cleared = stamp
        try:
            world = World(obstacles.values())
            if self._avoidance.replace_world(world, self._setup.context):
                self._on_threat()
        except PlannerError as error:
            problems.append(str(error))
        self.problem = to_text(problems[0]) if problems else ""
        if problems:
            more = f" (and {len(problems) - 1} more)" if problems[1:] else ""
            text = to_text(f"obstacles: {problems[0]}{more}")
            self._node.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)

    def _apply_marker(self, marker: Marker, obstacles: dict[str, Obstacle]) -> None:
        name = marker_name(marker)
        if marker.action == Marker.DELETEALL:
            prefix = f"{marker.ns}/" if marker.ns else ""
            for other in [one for one in obstacles if one.startswith(prefix)]:
                del obstacles[other]
        elif marker.action == Marker.DELETE:
            obstacles.pop(name, None)
        elif marker.action == Marker.ADD:
            context = self._setup.context
            frame, links = marker.header.frame_id, context.robot.frame_names if context else ()
            if frame and context and frame not in links:
                raise WorldError(f"marker '{name}': {unknown_name('link', frame, links)}")
            folders = package_folders(self._setup.settings.package_folders)
            obstacles[name] = to_obstacle(marker, folders)
        else:
            raise WorldError(
                f"marker '{name}' has the action {marker.action}; accepted are 0 (add or modify), "
                "2 (delete) and 3 (delete all)"
            )
