# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The topics of goals, the thread of planning, and the report of each goal."""

from __future__ import annotations

import time
from functools import partial
from typing import Any, Literal

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from ..exceptions import GoalError
from ..execution.serving.assembly import Model, is_outdated
from ..execution.serving.execution import GoalOutcome, Served
from ..execution.serving.motion_server import (
    AnyPlan,
    GoalStatistics,
    MotionServer,
    UnexecutablePlanError,
)
from ..execution.threads import CancelledError, IsCancelled, PreemptiveWorker
from .goal_messages import GOAL_TOPICS, GoalTopic, ReceivedGoal, read_goal, read_stamp
from .last_motion import LastMotion
from .messages import to_goal_report, to_plan_report, to_text
from .nodes import EVERY, GOALS, LOG_PERIOD, GroupExecutor, GuardedNode, ThreadGroup
from .obstacle_topic import ForeignFrames
from .planning_setup import PlanningSetup

# Longest wait for a model of the present positions of other joints [s], and how many models a goal
# is planned with at most.
_LONGEST_WAIT, _MAX_MODELS = 1.0, 5
# Longest wait for the transform of a frame [s]; a further goal waits, too.
_TRANSFORM_WAIT = 0.5

Work = ReceivedGoal | Literal["react"]
"""A goal, or the request to replace a motion that would hit a new obstacle, or to go on after a
stop."""


class GoalTopics:
    """Receives goals, has the newest one served, and publishes a report for each.

    Parameters
    ----------
    node : GuardedNode
        The node.
    setup : PlanningSetup
        Makes the planning context.
    server : MotionServer
        Plans and publishes motions.
    statistics : GoalStatistics
        Counts goals.
    frames : ForeignFrames
        Looks up the frames of poses that are not links.
    last_motion : LastMotion
        Records each published motion before its report, and previews it when no goals have come for
        a moment; a rejected goal erases the preview.
    """

    def __init__(
        self,
        node: GuardedNode,
        setup: PlanningSetup,
        server: MotionServer,
        statistics: GoalStatistics,
        frames: ForeignFrames,
        last_motion: LastMotion,
    ) -> None:
        self._node, self._setup, self._server = node, setup, server
        self._statistics, self._frames, self._last_motion = statistics, frames, last_motion
        self._reports = node.create_publisher(DiagnosticStatus, "~/plan_report", EVERY)
        self._worker: PreemptiveWorker[Work] = PreemptiveWorker(
            self._serve, self._on_preempted, last_motion.show_preview, self._on_failure
        )
        group = ThreadGroup()
        for topic in GOAL_TOPICS:
            node.create_subscription(
                topic.message_type,
                f"~/{topic.name}",
                partial(self._receive, topic),
                GOALS,
                callback_group=group,
                raw=True,
            )
        # A separate thread, so that no goal waits for new parameters or primitives.
        self._executor = GroupExecutor(node, group)

    def react(self) -> None:
        """Replace the running motion, stop the robot, or go on; after the goal being served."""
        self._worker.submit_if_idle("react")

    def cancel(self) -> None:
        """Cancel all goals that wait or are being planned."""
        self._worker.cancel()

    def close(self) -> None:
        """End the threads, before the node is destroyed."""
        self._executor.shutdown()
        self._worker.close()

    def stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Callback of the service that stops the robot, which cancels all goals."""
        self._worker.cancel()
        try:
            # Whatever prevents goals, the robot that was given one can be stopped.
            context = self._setup.last_context or self._setup.ready()
            response.message = self._server.monitor.stop(context)
        except Exception as error:
            response.message = f"nothing was published: {self._node.explain(error)}"
        else:
            response.success = True
        return response

    def _receive(self, topic: GoalTopic, content: bytes) -> None:
        try:
            context = self._setup.ready()
            request = self._goal(topic, read_goal(content, topic.message_type), context)
            # An invalid goal must not preempt a running one. If none is running, planning reports
            # the error.
            if not self._worker.is_idle:
                request.check()
        except Exception as error:
            self._reject(self._node.explain(error), read_stamp(content))
        else:
            self._worker.submit(request)

    def _serve(self, request: Work, is_cancelled: IsCancelled) -> None:
        """Serve a goal, then react to an obstacle that the running motion would hit."""
        if isinstance(request, ReceivedGoal):
            self._serve_goal(request, is_cancelled)
        has_threat = self._server.monitor.surroundings.threat is not None
        if not has_threat and isinstance(request, ReceivedGoal):
            return
        react = self._server.avoid_obstacle if has_threat else self._server.go_on
        logger = self._node.get_logger()
        try:
            text, served = react(self._setup.ready(), is_cancelled)
        except CancelledError:
            raise
        except Exception as error:
            text = f"no reaction to an obstacle: {self._node.explain(error)}"
            logger.error(text, throttle_duration_sec=LOG_PERIOD)
        else:
            if served is not None:
                self._last_motion.replace(served)
            if text:
                logger.warning(to_text(text))

    def _serve_goal(self, request: ReceivedGoal, is_cancelled: IsCancelled) -> None:
        """Plan, publish and report, in the thread of the worker."""
        stamp: Time = request.name

        def is_over() -> bool:
            is_held = bool(self._setup.hold) or self._setup.context is not request.model
            return is_cancelled() or is_held

        try:
            for _ in range(_MAX_MODELS):
                request = self._with_present_model(request, is_cancelled)
                try:
                    served = self._server.serve(request, is_over)
                    break
                except CancelledError:
                    if is_cancelled() or not self._is_relocked(request.model):
                        raise
            else:
                raise GoalError(
                    "joints that the primitives do not move were moving during planning; send the "
                    "goal again when they are at rest"
                )
        except UnexecutablePlanError as error:
            self._reject(str(error), stamp, error.plan)
        except CancelledError:
            if is_cancelled():
                raise
            changed = "the parameters, the primitives or the robot description changed during "
            reason = self._setup.hold or f"{changed}planning; send the goal again"
            self._reject(reason, stamp)
        except Exception as error:
            self._reject(self._node.explain(error), stamp)
        else:
            # The motion is published: an error in its report is logged, and rejects nothing.
            self._node.guarded(self._report)(served, request)

    def _with_present_model(self, request: ReceivedGoal, is_cancelled: IsCancelled) -> ReceivedGoal:
        """The request with the model of the present positions of all joints.

        The thread of parameters makes that model; while joints keep moving, the newest one counts.
        """
        monitor = self._server.monitor
        measured, world = monitor.follower.measured, monitor.surroundings.world
        deadline = time.monotonic() + _LONGEST_WAIT
        while time.monotonic() < deadline and not is_cancelled():
            if not is_outdated(self._setup.ready(), measured.others, world):
                break
            time.sleep(0.01)
        context = self._setup.ready()
        if context is request.model:
            return request
        return self._goal(request.topic, request.message, context)

    def _goal(self, topic: GoalTopic, message: Any, model: Model) -> ReceivedGoal:
        pose_of = partial(self._frames.pose, model=model, wait=_TRANSFORM_WAIT)
        return topic.goal(message, model, pose_of)

    def _is_relocked(self, model: Model) -> bool:
        """Whether the present model differs in positions of locked joints alone."""
        context = self._setup.context
        return context is not None and not self._setup.hold and context.settings is model.settings

    def _report(self, served: Served, request: ReceivedGoal) -> None:
        plan, stamp = served.plan, request.name
        if served.under_way:
            self._finish(GoalOutcome.UNDER_WAY, served.under_way, stamp, plan)
            return
        # A cost may follow the report at once.
        self._last_motion.replace(served)
        missing = self._server.monitor.surroundings.missing
        report = to_plan_report(plan, stamp, served.primitives, request.ignored_joints, missing)
        self._reports.publish(report)
        seconds = plan.trajectory.duration  # as in the report, without a hold before the motion
        times = f"{seconds:.4g} s long, planned in {1e3 * plan.solve_time:.3g} ms"
        self._node.get_logger().info(to_text(f"goal served: {plan.message} ({times})"))

    def _reject(self, reason: str, stamp: Time, plan: AnyPlan | None = None) -> None:
        self._node.get_logger().warning(
            f"goal rejected: {to_text(reason)}", throttle_duration_sec=LOG_PERIOD
        )
        self._finish(GoalOutcome.REFUSED, reason, stamp, plan)
        self._node.guarded(self._last_motion.erase_preview)()

    def _finish(
        self, outcome: GoalOutcome, text: str, stamp: Time, plan: AnyPlan | None = None
    ) -> None:
        """Count a goal without a motion of its own, and report it."""
        self._statistics.count(outcome)
        self._reports.publish(to_goal_report(outcome, text, stamp, plan))

    def _on_failure(self, request: Work | None, error: BaseException) -> None:
        """Log what nothing else caught; a goal is rejected."""
        text = self._node.explain(error)
        self._node.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)
        if isinstance(request, ReceivedGoal):
            self._reject(text, request.name)

    def _on_preempted(self, request: Work) -> None:
        if not isinstance(request, ReceivedGoal):
            return
        try:
            request.check()
        except Exception as error:
            self._reject(self._node.explain(error), request.name)
        else:
            text = "preempted: a newer goal or a stop came before its motion was planned"
            self._finish(GoalOutcome.OVERTAKEN, text, request.name)
