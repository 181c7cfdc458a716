# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node: callbacks that convert, call the core, and publish."""

from __future__ import annotations

import time
from collections.abc import Mapping
from queue import SimpleQueue

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from ..exceptions import PlannerError, quote_names
from ..execution.serving.assembly import unknown_positions
from ..execution.serving.execution import ExecutionReport
from ..execution.serving.motion_monitor import MotionMonitor
from ..execution.serving.motion_server import GoalStatistics, MotionServer
from ..execution.tracking.following import MotionFollower
from ..execution.tracking.measured import MeasuredStates
from ..execution.tracking.published_motion import PublishedMotion
from ..robot.limits import limits_file_note
from ..robot.world import World
from .controller import ControllerAction
from .goal_messages import GoalTopics
from .last_motion import LastMotion
from .messages import to_execution_report, to_status, to_text
from .nodes import EVERY, LATCHED, LOG_PERIOD, GuardedNode
from .obstacle_topic import ForeignFrames, ObstacleTopic
from .planning_setup import NodeParameters, PlanningSetup
from .safety_thread import RobotStates, SafetyThread
from .serialised import serialize_trajectory

NODE_NAME = "mp_pca_planner"


class PlannerNode(GuardedNode):
    """Plans a motion for each goal and publishes it.

    Missing or unusable primitive files are no error: the node reports them and waits for
    ``~/reload_primitives``.

    Parameters
    ----------
    hold : str
        Reason for which the node loads no primitives and rejects goals; empty if it serves goals.

    Raises
    ------
    PlannerError
        If a parameter can't be used.
    """

    def __init__(self, hold: str = "") -> None:
        # Undeclared parameters are allowed, because the package's own check lists the valid names.
        try:
            super().__init__(NODE_NAME, allow_undeclared_parameters=True)
        except RuntimeError as error:  # where DDS security lacks files, or support, for example
            reason = str(error).splitlines()[0]
            raise PlannerError(f"ROS refuses the node: {reason}") from error
        self._statistics = GoalStatistics()
        self._clocks, self._failures = (True, False), SimpleQueue[str]()
        self._states = RobotStates(self)
        self._follower = MotionFollower(self._states.measured)
        self._monitor = MotionMonitor(
            self._follower, self._send, time.perf_counter, self._report_execution
        )
        self._server = MotionServer(self._monitor, self._statistics)
        self._declared = NodeParameters(self)
        topic = self.resolve_topic_name("robot_description")
        self._setup = PlanningSetup(self._declared, self.explain, self._monitor.expect, topic)
        self._setup.hold = hold
        for problem in self._declared.unknown():
            self.get_logger().warning(f"ignored: {to_text(problem)}")
        if not hold:
            self.load()
        # Registered after the declarations, because the initial values are checked together.
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._connect()
        self._action = ControllerAction(self, self._monitor.hear)
        self._use_controller()
        frames = ForeignFrames(self)
        self._obstacles = ObstacleTopic(self, self._setup, self._monitor.surroundings, frames)
        self._monitor.surroundings.settle = self._obstacles.settle
        self._goals = GoalTopics(
            self, self._setup, self._server, self._statistics, frames, self._last_motion
        )
        self._safety = SafetyThread(
            self, self._states, self._setup, self._monitor, self._goals, self._action
        )
        # A steady clock, because these are needed even if simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        self.create_timer(0.1, self._tidy, clock=steady)
        self.create_timer(0.05, self._lock_joints, clock=steady)
        if not self._setup.problem:
            self._log_readiness()

    def destroy_node(self) -> None:
        """End the threads, then the node."""
        self._safety.close()
        self._obstacles.close()
        self._goals.close()
        self._action.close()
        super().destroy_node()

    def load(self) -> bool:
        """Load the primitives, if any are given; returns False if they can't be read."""
        is_loaded = not self._setup.settings.primitive_paths or self._setup.load()
        if not is_loaded:
            problem = self._setup.problem
            self.get_logger().error(f"{problem}; fix it, then call ~/reload_primitives")
        return is_loaded

    def accept_goals(self) -> None:
        """Serve goals from now on."""
        self._setup.hold = ""
        self._log_readiness()

    def reject_goals(self, hold: str) -> None:
        """Cancel goals, reject further ones, with this reason, and stop a running motion."""
        self._setup.hold = hold
        self._goals.cancel()
        try:
            if self._setup.last_context is not None:
                self._monitor.release(self._setup.last_context, hold)
        except Exception as error:  # the transition must not fail
            self.get_logger().error(f"the robot was not stopped: {self.explain(error)}")

    def _connect(self) -> None:
        self._trajectories = self.create_publisher(JointTrajectory, "~/joint_trajectory", EVERY)
        self._executions = self.create_publisher(DiagnosticStatus, "~/execution_report", EVERY)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", EVERY)
        previews = self.create_publisher(MarkerArray, "~/preview", LATCHED)
        self._last_motion = LastMotion(previews.publish)
        self.create_subscription(String, "robot_description", self._on_description, LATCHED)
        self.create_service(Trigger, "~/reload_primitives", self._on_reload)
        self.create_service(Trigger, "~/save_motion", self._on_save)

    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        file = self._last_motion.keep(self._setup.settings.save_folder, NODE_NAME)
        response.success = True
        response.message = to_text(f"saved as '{file}'; call ~/reload_primitives to use it")
        return response

    def _on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.success = self._setup.load()
        except Exception as error:
            self._setup.problem = self.explain(error)
        library, problem = self._setup.library, self._setup.problem
        response.message = (
            f"loaded: {library}" if response.success else f"{problem}; {library} kept"
        )
        return response

    def _on_description(self, message: String) -> None:
        if self._setup.use_description(message.data):
            self._log_readiness()

    def _on_set_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        if self._declared.is_declaring:
            return SetParametersResult(successful=True)
        try:
            self._setup.change(changes)
            self._use_controller()
        except Exception as error:
            return SetParametersResult(successful=False, reason=self.explain(error))
        return SetParametersResult(successful=True)

    def _use_controller(self) -> None:
        """Use the topic and the action of the controller that the parameters name."""
        settings, parent = self._setup.settings, self._trajectories.topic_name.rpartition("/")[0]
        topic = settings.controller_state_topic or f"{parent}/controller_state"
        self._states.use_controller(topic, self._follower.controller)
        self._action.use(settings)

    def _lock_joints(self) -> None:
        """Lock the joints that the primitives do not move where they are measured."""
        self._setup.lock(self._follower.measured.others, self._monitor.surroundings.world)

    def _log_clocks(self) -> None:
        """Log when the judgement of the robot's clock changes."""
        clock = self._follower.measured.clock
        state = clock.is_usable, clock.offset != 0.0
        if state == self._clocks or not clock.is_certain:
            return
        self._clocks, logger = state, self.get_logger()
        if not clock.is_usable:
            logger.warning(
                "the stamps of joint_states follow no clock with a constant difference from that "
                f"of this node: they are {clock.estimate:.3g} s behind. Trajectories are "
                "sent without stamps, so goals for a moving robot may cause jumps; synchronise the "
                "clocks"
            )
        elif clock.offset:
            logger.info(
                f"the clock of the robot is {clock.offset:.3g} s behind that of this node; "
                "trajectories are stamped with the time of the robot"
            )
        else:
            logger.info("the clocks of the robot and of this node agree")

    def _send(self, motion: PublishedMotion) -> None:
        # Stops have no efforts.
        with_efforts = self._setup.settings.publish_effort and motion.sent.efforts is not None
        content = serialize_trajectory(
            motion.sent,
            with_efforts=with_efforts,
            stamp=motion.stamp,
            last_point_only=motion.last_point_only,
        )
        is_goal = self._action.send(motion.sent, content)
        # A controller that listens to both would execute the motion twice.
        topic = self._trajectories.topic_name
        if not (is_goal and self._action.is_served_by_subscriber(topic)):
            self._trajectories.publish(content)

    def _report_execution(self, report: ExecutionReport) -> None:
        self._executions.publish(to_execution_report(report))
        self._last_motion.end(report.outcome)
        if not report.outcome.is_good:
            self._failures.put(to_text(report.message))

    def _tidy(self) -> None:
        """Do what the thread that stops the robot leaves to others: the output may block."""
        self._last_motion.tidy()
        self._log_clocks()
        if (state := self._action.state) not in ("none", "ready"):
            text = f"parameter 'controller_action': {state}"
            self.get_logger().warning(text, throttle_duration_sec=LOG_PERIOD)
        while not self._failures.empty():
            self.get_logger().error(self._failures.get())

    def _publish_diagnostics(self) -> None:
        name = f"{self.get_fully_qualified_name()}: planner"
        values = {
            "internal_errors": self.n_internal_errors,
            "safety_longest_gap_s": round(self._safety.longest_gap(), 4),
            "locked_joints": self._setup.locked_joints,
            "controller_action": self._action.state,
            "controller_state": "received" if self._follower.controller.is_fresh else "none",
            **self._obstacles.facts,
        }
        measured, world = self._follower.measured, self._monitor.surroundings.world
        status = _status(name, self._setup, measured, self._statistics, world, values)
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _log_readiness(self) -> None:
        self.get_logger().info(self._setup.missing or "ready for goals")
        context = self._setup.context
        if context is not None and (unlimited := context.limits.unlimited):
            self.get_logger().info(
                f"some joints have no limit of {', '.join(unlimited)}: set them with 'limits_file' "
                "before a real robot moves"
            )
        if context is not None and (note := limits_file_note(context.settings.limits_file)):
            self.get_logger().info(to_text(note))
        if context is not None and not context.settings.collision:
            self.get_logger().info(
                "self-collision is not checked: set 'collision' to true to avoid it"
            )


def _status(
    name: str,
    setup: PlanningSetup,
    measured: MeasuredStates,
    statistics: GoalStatistics,
    world: World,
    more: Mapping[str, str | float | int],
) -> DiagnosticStatus:
    """Diagnostics on the node's inputs and on the goals that it served."""
    age, context, problem = measured.age, setup.context, setup.missing or setup.problem
    if not problem and age is None:
        problem = "waiting for joint_states"
    elif not problem and age is not None and 0.0 < setup.settings.state_timeout < age:
        problem = f"joint_states stopped {age:.1f} s ago"
    elif not problem and more["obstacle_rejected"] != "none":
        problem = f"an obstacle is not avoided: {more['obstacle_rejected']}"
    elif not problem and context is not None:
        problem = unknown_positions(context, world)
    values = {
        "model": quote_names(context.robot.joint_names) if context else "none",
        "joints": ", ".join(context.robot.described_joints) if context else "none",
        "library": setup.library,
        **{f"goals_{outcome}": n for outcome, n in statistics.counts.items()},
        **more,
        **statistics.solve_time_percentiles(),
        "joint_states_age_s": "none" if age is None else round(age, 3),
        "joint_states_incomplete": measured.n_incomplete,
        "joint_states_unusable": measured.n_unusable,
    }
    level = DiagnosticStatus.WARN if problem else DiagnosticStatus.OK
    return to_status(name, level, problem or "ready for goals", values)


_INACTIVE = "the node is not active: configure and activate it with ~/change_state"


class LifecyclePlannerNode(LifecycleNodeMixin, PlannerNode):
    """A `PlannerNode` that loads primitives when configured and publishes motions when active.

    Its topics exist in every state: goals that arrive while it is not active are rejected in
    ``~/plan_report``. It stops the robot at any time.
    """

    def __init__(self) -> None:
        PlannerNode.__init__(self, hold=_INACTIVE)
        own = set(self.services)
        LifecycleNodeMixin.__init__(self)
        # rclpy raises where a transition is not possible, and creates these services by itself.
        for service in set(self.services) - own:
            service.callback = self.answering(service.callback)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the primitives; it fails if they can't be used."""
        return super().on_configure(state) if self.load() else TransitionCallbackReturn.FAILURE

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Serve goals from now on."""
        self.accept_goals()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Cancel goals, reject further ones, and stop a running motion."""
        self.reject_goals(_INACTIVE)
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the primitives."""
        self._setup.unload()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reject goals permanently."""
        self.reject_goals(_INACTIVE)
        return super().on_shutdown(state)
