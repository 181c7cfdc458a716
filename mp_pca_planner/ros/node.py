# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node: callbacks that convert, call the core, and publish."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from ..exceptions import GoalError, quote_names, unknown_name
from ..execution.assembly import Model, assemble_model
from ..execution.execution_monitor import ExecutionReport
from ..execution.goal_planner import UnexecutablePlanError
from ..execution.goal_statistics import GoalStatistics
from ..execution.kept_motion import keep_motion
from ..execution.motion_server import MakeGoal, MotionServer
from ..execution.parameters import (
    DECLARATIONS,
    LIMITS_PREFIX,
    Declaration,
    ParameterError,
    Settings,
    check_limit_names,
    limit_declarations,
)
from ..execution.preemptive_worker import CancelledError, IsCancelled, PreemptiveWorker
from ..execution.served_goal import Served
from ..execution.start_state import StartStates
from ..motion.goal import Goal, JointGoal, PoseGoal, SequenceGoal
from ..motion.trajectory import Trajectory
from ..primitives.primitive import MovementPrimitive
from ..primitives.primitive_library import load_primitives
from ..robot.model import Robot
from .goal_intake import FetchedByHand, GoalIntake, Inlet, waiting_messages
from .guarded_node import GuardedNode
from .messages import (
    to_descriptor,
    to_execution_report,
    to_goal,
    to_overtaken_report,
    to_plan_report,
    to_pose_goal,
    to_refusal,
    to_sequence_goal,
    to_status,
    to_text,
    to_under_way_report,
)
from .preview import to_preview
from .reference_frame import stated_in
from .state_reader import SerializedStateReader
from .trajectory_bytes import serialize_trajectory

NODE_NAME = "mp_pca_planner"

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
# Only the newest goal counts, but those that come while another is planned get their reports, too.
_GOALS = QoSProfile(depth=20, reliability=ReliabilityPolicy.RELIABLE)
# A reliable subscription gets nothing from a best-effort publisher; this one hears both. Several
# broadcasters (arm, gripper) may publish at once, a thousand times a second, between two fetches.
_ANY_PUBLISHER = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
_WATCH_PERIOD = 0.05
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_EVERY = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)

_LOG_PERIOD = 1.0

# Declared by rclpy itself when it needs them.
_NAMES_OF_ROS = ("use_sim_time", "qos_overrides.", "start_type_description_service")


@dataclass(frozen=True, eq=False)
class _Asked:
    """What a message asks for.

    Attributes
    ----------
    make_goal : callable
        Makes the goal for a start state.
    check : callable
        Raises a `PlannerError` if it can be told without planning that it can't be served.
    """

    make_goal: MakeGoal
    check: Callable[[], None] = lambda: None


_ReadGoal = Callable[[Any, Model], _Asked]
"""Reads a message, for a model; or raises a `PlannerError` if it is wrong as it stands."""


@dataclass(frozen=True, eq=False)
class _Job:
    """A goal to be served: its kind, what is asked for, of which model, its stamp."""

    kind: type[Goal]
    asked: _Asked
    model: Model
    stamp: Time


def _check_description(settings: Settings) -> None:
    """Refuse the parameter, needed or not, that no robot can be made of."""
    if settings.robot_description:
        Robot(settings.robot_description, source="parameter 'robot_description'")


def _joint_names(primitives: Sequence[MovementPrimitive]) -> tuple[str, ...]:
    return primitives[0].joint_names if primitives else ()


class PlannerNode(GuardedNode):
    """Plans a motion for each goal and publishes it.

    Raises
    ------
    PlannerError
        If a parameter can't be used. Missing or refused primitive files are no such error: the
        node says so in its reports and waits for ``~/reload_primitives``.
    """

    def __init__(self) -> None:
        # Unknown names must reach our own check, whose answer lists the valid ones.
        try:
            super().__init__(NODE_NAME, allow_undeclared_parameters=True)
        except RuntimeError as error:  # where DDS security lacks files, or support, for example
            reason = str(error).splitlines()[0]
            raise ParameterError(f"ROS refuses the node: {reason}") from error
        self._statistics = GoalStatistics()
        self._states = StartStates(
            SerializedStateReader(), time.monotonic, self._seconds, self._fetch_states
        )
        self._server = MotionServer(
            self._states, self._statistics, self._send, time.perf_counter, self._report_execution
        )
        self._clocks_are_known = False
        self._fetching = threading.Lock()
        self._fetched = time.monotonic()
        self._last_served: Served | None = None
        self._previewed: Served | None = None
        self._last_cost: float | None = None
        self._primitives: tuple[MovementPrimitive, ...] = ()
        self._primitives_problem = ""
        self._description = ""
        self._model_problem = ""
        self._model: Model | None = None
        self._is_declaring = False
        self._declare(DECLARATIONS)
        self._settings = self._read_settings()
        self._start()
        # Registered only now: the first values are judged together.
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._connect()
        self._goals = PreemptiveWorker(self._serve, self._on_overtaken, self.guarded(self._preview))
        self._intake = GoalIntake(
            self.context,
            [
                self._inlet(JointStateMessage, "~/goal", JointGoal, self._read_goal),
                self._inlet(PoseStamped, "~/goal_pose", PoseGoal, self._read_goal_pose),
                self._inlet(
                    JointTrajectory, "~/goal_sequence", SequenceGoal, self._read_goal_sequence
                ),
            ],
        )
        if not self._primitives_problem:
            self._log_readiness()

    def destroy_node(self) -> None:
        """End the threads, then the node."""
        self._intake.close()
        self._goals.close()
        super().destroy_node()

    def _start(self) -> None:
        """Check what the parameters say, and load what they name."""
        self._warn_of_unknown_parameters()
        _check_description(self._settings)
        self._load()

    def _load(self) -> None:
        """Load the primitives, or keep why they can't be used."""
        if not self._settings.primitive_paths:
            return
        try:
            primitives = load_primitives(self._settings.primitive_paths)
        except Exception as error:
            self._primitives_problem = problem = self.explain(error)
            self.get_logger().error(f"{problem}; fix it, then call ~/reload_primitives")
        else:
            self._adopt(primitives)

    def _connect(self) -> None:
        self._trajectories = self.create_publisher(JointTrajectory, "~/joint_trajectory", _EVERY)
        self._reports = self.create_publisher(DiagnosticStatus, "~/plan_report", _EVERY)
        self._execution_reports = self.create_publisher(
            DiagnosticStatus, "~/execution_report", _EVERY
        )
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", _EVERY)
        self._previews = self.create_publisher(MarkerArray, "~/preview", _LATCHED)
        self._state_subscription = self.create_subscription(
            JointStateMessage,
            "joint_states",
            lambda _: None,
            _ANY_PUBLISHER,
            callback_group=FetchedByHand(),
            raw=True,
        )
        self.create_subscription(Float64, "~/trial_cost", self._on_trial_cost, _NEWEST)
        self._descriptions = self.create_subscription(
            String, "robot_description", self._on_description, _LATCHED
        )
        self.create_service(Trigger, "~/reload_primitives", self._on_reload)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_service(Trigger, "~/save_motion", self._on_save)
        # Simulated time may stand still, and then the diagnostics are wanted most.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._on_timer, clock=steady)
        self.create_timer(_WATCH_PERIOD, self._watch, clock=steady)

    # Callbacks

    def _on_trial_cost(self, message: Float64) -> None:
        if self._last_served is None or not math.isfinite(message.data):
            self.get_logger().warning(
                f"the cost {message.data} of a trial is ignored: it must be a finite number that "
                "follows a motion",
                throttle_duration_sec=_LOG_PERIOD,
            )
            return
        if self._last_served.trial is not None:
            try:
                self._last_served.trial.tell(message.data)
            except Exception as error:
                problem = self.explain(error)
                self.get_logger().error(f"nothing was learned from a trial: {problem}")
                return
        self._last_cost = message.data

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._goals.cancel()
        try:
            response.message = self._server.stop(self._ready_model())
        except Exception as error:
            response.message = f"nothing was published: {self.explain(error)}"
        else:
            response.success = True
        return response

    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        saved = f"saved as '{self._save()}'; ~/reload_primitives takes it into use"
        response.success, response.message = True, to_text(saved)
        return response

    def _on_description(self, message: String) -> None:
        is_new = message.data != self._description
        self._description = message.data
        if self._settings.robot_description or not is_new:
            return
        try:
            self._adopt(self._primitives)
        except Exception as error:
            # The robot is another one than before, so the old model is of no use.
            self._model, self._model_problem = None, self.explain(error)
            self.get_logger().error(self._model_problem)
        else:
            self._log_readiness()

    def _on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._adopt(load_primitives(self._settings.primitive_paths))
        except Exception as error:
            self._primitives_problem = self.explain(error)
            response.message = f"{self._primitives_problem}; {self._library()} kept"
        else:
            response.success = True
            response.message = f"loaded: {self._library()}"
        return response

    def _on_set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        if self._is_declaring:
            return SetParametersResult(successful=True)
        try:
            self._check_names(parameters)
            settings = self._read_settings(parameters)
            if settings.robot_description != self._settings.robot_description:
                _check_description(settings)
            primitives = self._primitives
            if settings.primitives != self._settings.primitives:
                paths = settings.primitive_paths
                primitives = load_primitives(paths) if paths else ()
            if settings != self._settings:
                self._adopt(primitives, parameters)
        except Exception as error:
            return SetParametersResult(successful=False, reason=self.explain(error))
        return SetParametersResult(successful=True)

    def _on_timer(self) -> None:
        array = DiagnosticArray(status=[self._status()])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    # Goals

    def _inlet(self, message_type: Any, topic: str, kind: type[Goal], read: _ReadGoal) -> Inlet:
        """Where goals of a kind come in."""

        def receive(messages: list[Any]) -> None:
            # One that can't be served must not take another one's place; otherwise planning sees.
            check = len(messages) > 1 or not self._goals.is_idle
            found = [self._job(message, kind, read, check) for message in messages]
            jobs = [job for job in found if job is not None]
            if jobs:
                self._goals.submit(jobs[-1])
            for job in jobs[:-1]:
                self._on_overtaken(job)

        subscription = self.create_subscription(
            message_type, topic, lambda _: None, _GOALS, callback_group=FetchedByHand()
        )
        return Inlet(subscription, self.guarded(receive))

    def _job(self, message: Any, kind: type[Goal], read: _ReadGoal, check: bool) -> _Job | None:
        """What there is to do; nothing for a goal that is refused."""
        stamp = message.header.stamp
        try:
            model = self._ready_model()
            asked = read(message, model)
            if check:
                asked.check()
        except Exception as error:
            self._refuse(to_refusal(self.explain(error), stamp))
        else:
            return _Job(kind, asked, model, stamp)
        return None

    def _read_goal(self, message: JointStateMessage, model: Model) -> _Asked:
        goal = to_goal(message, self._settings.duration)
        return _Asked(lambda _: goal, partial(model.planner.check, goal))

    def _read_goal_pose(self, message: PoseStamped, model: Model) -> _Asked:
        goal = to_pose_goal(message, model.end_effector, self._settings.duration)
        return _Asked(stated_in(goal, message.header.frame_id, model.planning_robot))

    def _read_goal_sequence(self, message: JointTrajectory, _: Model) -> _Asked:
        goal = to_sequence_goal(message)
        return _Asked(lambda _: goal)

    def _serve(self, job: _Job, is_cancelled: IsCancelled) -> None:
        """Plan, publish and report: in the planning thread."""
        try:
            served = self._server.serve(
                job.kind, job.asked.make_goal, job.model, is_cancelled, job.stamp
            )
            self._report_served(served, job.stamp)
        except UnexecutablePlanError as error:
            self._refuse(to_refusal(str(error), job.stamp, error.plan))
        except CancelledError:
            raise
        except Exception as error:
            self._refuse(to_refusal(self.explain(error), job.stamp))

    def _report_served(self, served: Served, stamp: Time) -> None:
        plan = served.plan
        if served.under_way:
            self._statistics.under_way()
            self._reports.publish(to_under_way_report(plan, served.under_way, stamp))
            return
        # A cost may follow the report at once.
        self._last_served, self._last_cost = served, None
        trial = served.trial.facts if served.trial else None
        primitives = served.model.planner.primitives
        self._reports.publish(to_plan_report(plan, stamp, trial, primitives))
        times = f"{served.motion.duration:.3g} s long, planned in {1e3 * plan.solve_time:.3g} ms"
        self.get_logger().info(to_text(f"goal served: {plan.message} ({times})"))

    def _refuse(self, report: DiagnosticStatus) -> None:
        self._statistics.refused()
        self.get_logger().warning(
            f"goal refused: {report.message}", throttle_duration_sec=_LOG_PERIOD
        )
        self._reports.publish(report)

    def _on_overtaken(self, job: _Job) -> None:
        try:
            job.asked.check()
        except Exception as error:
            self._refuse(to_refusal(self.explain(error), job.stamp))
        else:
            self._statistics.overtaken()
            self._reports.publish(to_overtaken_report(job.stamp))

    def _send(self, trajectory: Trajectory, *, stamp: float | None, last_point_only: bool) -> None:
        # Stops have no efforts.
        with_efforts = self._settings.publish_effort and trajectory.efforts is not None
        self._trajectories.publish(
            serialize_trajectory(
                trajectory, with_efforts=with_efforts, stamp=stamp, last_point_only=last_point_only
            )
        )

    def _report_execution(self, report: ExecutionReport) -> None:
        self._execution_reports.publish(to_execution_report(report))
        if not report.is_good:
            self.get_logger().error(to_text(report.message))

    def _watch(self) -> None:
        """Take the states that wait, and check how the robot follows its motion."""
        self._fetch_states()
        if self._model is not None:
            self._server.watch(self._model)
        if not (self._clocks_are_known or self._states.measured.clocks_agree):
            self._clocks_are_known = True
            difference = self._states.measured.clock_difference
            self.get_logger().warning(
                "the clocks of the robot and of this node differ: the stamps of joint_states are "
                f"{difference:.3g} s behind. Trajectories are sent without stamps, so goals for a "
                "moving robot may cause jumps; synchronise the clocks"
            )

    def _preview(self) -> None:
        served = self._last_served
        if served is None or served is self._previewed:
            return
        self._previewed = served
        model = served.model
        robot, frame = model.planning_robot, model.end_effector
        self._previews.publish(to_preview(served.plan.trajectory, robot, frame, model.urdf))

    def _save(self) -> Path:
        """Keep the last motion; returns the file."""
        folder, served = self._settings.save_folder, self._last_served
        if not folder:
            raise ParameterError(
                "motions can't be saved: set the parameter 'save_folder' to a folder"
            )
        if served is None:
            raise GoalError("there is no motion to save: none was published")
        cost = {} if self._last_cost is None else {"trial_cost": self._last_cost}
        return keep_motion(served, Path(folder), {"kept_by": NODE_NAME, **cost})

    def _fetch_states(self) -> None:
        """Take the states that wait; their age counts from when the middleware got them."""
        with self._fetching, self._state_subscription.handle:
            now, wall_clock = time.monotonic(), time.time_ns()
            longest, self._fetched = now - self._fetched, now
            for message, facts in waiting_messages(self._state_subscription):
                age = (wall_clock - facts["received_timestamp"]) * 1e-9
                # Not older than the last time that none was left: the wall clock may be set.
                self._states.measured.receive(message, min(max(age, 0.0), longest))

    def _ready_model(self) -> Model:
        if self._model is None:
            raise GoalError(self._what_is_missing())
        return self._model

    def _log_readiness(self) -> None:
        self.get_logger().info(self._what_is_missing() or "ready for goals")

    def _what_is_missing(self) -> str:
        """Why there is no model; empty if there is one."""
        if self._model is not None:
            return ""
        if not self._primitives:
            return self._primitives_problem or (
                "no primitives are loaded: set the parameter 'primitives' to primitive files or "
                "folders of them"
            )
        return self._model_problem or (
            f"there is no robot model: the parameter 'robot_description' is empty, and nothing has "
            f"arrived on '{self._descriptions.topic_name}'"
        )

    # Model and primitives

    def _adopt(
        self, primitives: tuple[MovementPrimitive, ...], changed: Sequence[Parameter] = ()
    ) -> None:
        """Use these primitives and changed parameters from now on.

        Raises
        ------
        PlannerError
            If they don't fit together; then all stays as it was. Where nothing works anyway, the
            changes are accepted and the problem is kept: it may take several to mend it.
        """
        joint_names = _joint_names(primitives)
        if primitives:
            check_limit_names(self._parameter_overrides, joint_names)
        limits = limit_declarations(joint_names)
        self._declare([d for d in limits if not self.has_parameter(d.name)])
        settings = self._read_settings(changed)
        try:
            model, problem = self._assemble(settings, primitives), ""
        except Exception as error:
            if not self._model_problem:
                self._forget_limits_except(_joint_names(self._primitives))
                raise
            model, problem = None, self.explain(error)
        if primitives is not self._primitives:
            self._primitives_problem = ""
        self._settings, self._primitives = settings, primitives
        self._model, self._model_problem = model, problem
        self._states.expect(joint_names)
        self._forget_limits_except(joint_names)

    def _assemble(
        self, settings: Settings, primitives: tuple[MovementPrimitive, ...]
    ) -> Model | None:
        """Set up a model if all that it needs has arrived."""
        urdf = settings.robot_description or self._description
        return assemble_model(urdf, primitives, settings) if urdf and primitives else None

    # Parameters

    def _declare(self, declarations: Sequence[Declaration]) -> None:
        self._is_declaring = True
        try:
            for declaration in declarations:
                self._declare_one(declaration)
        finally:
            self._is_declaring = False

    def _declare_one(self, declaration: Declaration) -> None:
        default = declaration.default
        value = list(default) if isinstance(default, tuple) else default
        try:
            self.declare_parameter(declaration.name, value, to_descriptor(declaration))
        except (InvalidParameterTypeException, InvalidParameterValueException):
            # rclpy has no public way to ask for a value that was given but not declared.
            given = self._parameter_overrides[declaration.name].value
            raise ParameterError(
                f"parameter '{declaration.name}' is {given!r:.80}, "
                f"but it must be {declaration.accepted}"
            ) from None

    def _forget_limits_except(self, joint_names: Sequence[str]) -> None:
        names = {declaration.name for declaration in limit_declarations(joint_names)}
        for name in self.get_parameters_by_prefix(""):
            if name.startswith(LIMITS_PREFIX) and name not in names:
                self.undeclare_parameter(name)

    def _read_settings(self, changed: Sequence[Parameter] = ()) -> Settings:
        """Collect the values of all parameters, some of which are about to change."""
        present: dict[str, Any] = dict(self.get_parameters_by_prefix(""))
        values = {name: parameter.value for name, parameter in present.items()}
        values |= {parameter.name: parameter.value for parameter in changed}
        # An empty list in a parameter file leaves its parameter without a value.
        return Settings.from_values({k: v for k, v in values.items() if v is not None})

    def _check_names(self, parameters: Sequence[Parameter]) -> None:
        names = [parameter.name for parameter in parameters]
        if self._primitives:
            check_limit_names(names, self._primitives[0].joint_names)
        for name in names:
            if not self.has_parameter(name) and not name.startswith(_NAMES_OF_ROS):
                valid = self.get_parameters_by_prefix("")
                raise ParameterError(unknown_name("parameter", name, valid))

    def _warn_of_unknown_parameters(self) -> None:
        # Only a warning: a parameter file may serve several nodes.
        valid = [declaration.name for declaration in DECLARATIONS]
        known = (*_NAMES_OF_ROS, LIMITS_PREFIX)
        for name in self._parameter_overrides:
            if name not in valid and not name.startswith(known):
                problem = to_text(unknown_name("parameter", name, valid))
                self.get_logger().warning(f"ignored: {problem}")

    # Diagnostics

    def _status(self) -> DiagnosticStatus:
        age = self._states.measured.age
        problem = self._what_is_missing() or self._primitives_problem
        if not problem and age is None:
            problem = "waiting for joint_states"
        elif not problem and age is not None and 0.0 < self._settings.state_timeout < age:
            problem = f"joint_states stopped {age:.1f} s ago"
        return to_status(
            f"{self.get_fully_qualified_name()}: planner",
            DiagnosticStatus.WARN if problem else DiagnosticStatus.OK,
            problem or "ready for goals",
            {
                "model": quote_names(self._model.robot.joint_names) if self._model else "none",
                "library": self._library(),
                "goals_served": self._statistics.n_served,
                "goals_refused": self._statistics.n_refused,
                "goals_under_way": self._statistics.n_under_way,
                "goals_overtaken": self._statistics.n_overtaken,
                "trial_cost": "none" if self._last_cost is None else self._last_cost,
                **self._statistics.solve_time_percentiles(),
                "joint_states_age_s": "none" if age is None else round(age, 3),
                "joint_states_incomplete": self._states.measured.n_incomplete,
                "joint_states_unusable": self._states.measured.n_unusable,
            },
        )

    def _library(self) -> str:
        return quote_names(primitive.name for primitive in self._primitives)

    def _seconds(self) -> float:
        return float(self.get_clock().now().nanoseconds) * 1e-9
