# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node: what connects what. One thread; whatever takes long is for its workers."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from ..exceptions import GoalError, PlannerError, quote_names
from ..execution.link import (
    ModelFacts,
    Planned,
    Positions,
    Rejected,
    SetUp,
    SetUpDone,
    Verdict,
    WatchedRobot,
    WorkerDied,
    WorldFacts,
)
from ..execution.motions import PublishedMotion
from ..execution.outcomes import ExecutionReport, GoalOutcome, MotionOutcome
from ..execution.parameters import Settings
from ..execution.server import MotionServer, NodeModel
from ..execution.states import MeasuredStates
from ..execution.tracking import Tracker
from ..robot.model import Robot
from .controller import (
    HAS_CONTROL_MSGS,
    ControllerAction,
    JointTrajectoryControllerState,
    to_command,
)
from .goals import GOAL_TOPICS, GoalTopic, read_stamp
from .markers import Frames
from .messages import (
    to_execution_report,
    to_goal_report,
    to_plan_report,
    to_seconds,
    to_status,
    to_text,
)
from .nodes import (
    EVERY,
    GOALS,
    LATCHED,
    LOG_PERIOD,
    NODE_NAME,
    READY,
    STATES,
    WAITING,
    PolledSubscription,
    message_age,
    thinned,
)
from .obstacles import ForeignFrames, MarkerSubscription
from .parameters import NodeParameters
from .serialised import serialize_trajectory
from .worker import PLANNER, InternalError, KeepMotion, Preview, ShowMotion, trace_of
from .workers import Workers

_TICK, _TIDY = 0.05, 0.1  # periods [s]
# Messages of markers that may wait for a worker: others wait in the middleware.
_MOST_MARKERS = 5
# Time after its start at which a node says that it hears no controller [s].
_CONTROLLER_TIME = 5.0
_NEWEST_STATE = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_PENDING = "the planner has not accepted this yet"
_RESTARTING = "the planner is being started again; send the goal again"


class PlannerNode(Node):
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
        self.n_internal_errors = 0
        self._hold, self._began = hold, time.monotonic()
        self._declared = NodeParameters(self)
        self._settings = self._declared.settings()
        for problem in self._declared.unknown():
            self.get_logger().warning(f"ignored: {to_text(problem)}")
        self._description, self._problem, self._model_problem = "", "", ""
        self._done = SetUpDone(0)
        self._others: dict[str, float] = {}
        self._notes: tuple[str, ...] = ()
        woken = self.create_guard_condition(lambda: self._workers.receive())
        longest = self._settings.max_solve_time
        self._workers = Workers(woken.trigger, longest, self._on_worker)
        self._planner, self._watcher = self._workers.planner, self._workers.watcher
        self._world = WorldFacts(0)
        # The motion of the last goal, whether it has ended, and whether its preview is to be drawn.
        self._planned: Planned | None = None
        self._is_over, self._is_due = True, False
        measured = MeasuredStates(time.monotonic, self.seconds)
        self._tracker = Tracker(measured, self.seconds)
        self._server = MotionServer(self._tracker, self._planner, self)
        self._server.hold = hold
        self._connect()
        # Registered after the declarations, because the initial values are checked together.
        self.add_on_set_parameters_callback(self._on_set_parameters)
        if not hold:
            self.load()

    # Start, end, and what a managed node needs.

    def load(self) -> bool:
        """Load the primitives, and wait for that; returns False if they can't be read."""
        done = self._wait(self._set_up(self._settings, rereads=True))
        if done.is_unreadable:
            self._problem = done.problem
            hint = "fix it, then call ~/reload_primitives"
            self.get_logger().error(f"{to_text(done.problem)}; {hint}")
            return False
        if done.problem:
            raise PlannerError(done.problem)
        self._adopt(done, self._settings)
        return True

    def destroy_node(self) -> None:
        """End the workers, then the node."""
        self._workers.close()
        super().destroy_node()

    def seconds(self) -> float:
        """The time by the clock of the node [s]."""
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def explain(self, error: BaseException) -> str:
        """Describe an error in one sentence; log the traceback of an internal one."""
        if isinstance(error, PlannerError):
            return to_text(error)
        is_of_rclpy = type(error).__module__.startswith("rclpy")
        if is_of_rclpy or (isinstance(error, RuntimeError) and "deserialize" in str(error)):
            return to_text(f"rclpy rejects the received message: {error}")
        self._log_internal(trace_of(error))
        return to_text(f"internal error, please report it: {error!r}")

    def failed(self, error: Exception) -> None:
        """Log an exception of a callback."""
        self.get_logger().error(self.explain(error), throttle_duration_sec=LOG_PERIOD)

    def answering(self, callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return a callback of a service that answers whatever happens."""

        async def answer(request: Any, response: Any) -> Any:
            try:
                found = callback(request, response)
                return await found if hasattr(found, "__await__") else found
            except Exception as error:
                text = self.explain(error)
                if hasattr(response, "message"):
                    response.message = text
                return response

        return answer

    def _connect(self) -> None:
        self._trajectories = self.create_publisher(JointTrajectory, "~/joint_trajectory", EVERY)
        self._reports = self.create_publisher(DiagnosticStatus, "~/plan_report", EVERY)
        self._executions = self.create_publisher(DiagnosticStatus, "~/execution_report", EVERY)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", EVERY)
        self._preview = self.create_publisher(MarkerArray, "~/preview", LATCHED)
        self._states = PolledSubscription(self, JointState, "joint_states", STATES)
        self._polled = time.monotonic()
        self._controller: tuple[str, PolledSubscription] | None = None
        self._action = ControllerAction(self, self._server.hear)
        self._frames = ForeignFrames(self)
        self._markers = MarkerSubscription(self, "~/obstacles")
        describe: Any = self._on_description  # a coroutine, which rclpy's types do not know
        # Callbacks that wait for the planner must not keep others from running.
        apart = ReentrantCallbackGroup()
        self.create_subscription(
            String, "robot_description", describe, LATCHED, callback_group=apart
        )
        for topic in GOAL_TOPICS:
            receive = partial(self._on_goal, topic)
            name = f"~/{topic.name}"
            self.create_subscription(topic.message_type, name, receive, GOALS, raw=True)
        for name, callback in (
            ("stop", self._on_stop),
            ("reload_primitives", self._on_reload),
            ("save_motion", self._on_save),
        ):
            answer = self.answering(callback)
            self.create_service(Trigger, f"~/{name}", answer, callback_group=apart)
        # Setting a parameter may have to wait for the planner, which these of rclpy can't.
        for service in self.services:
            if service.srv_type is SetParameters:
                service.callback = self.answering(self._on_parameters)
                service.callback_group = apart
            elif service.srv_type is SetParametersAtomically:
                service.callback = self.answering(self._on_parameters_at_once)
                service.callback_group = apart
        # A steady clock, because these are needed even if simulated time stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        self.create_timer(_TIDY, self._tidy, clock=steady)
        self.create_timer(_TICK, self._tick, clock=steady)
        self._use_controller()

    # What comes in.

    def _on_goal(self, topic: GoalTopic, content: bytes) -> None:
        self._poll()
        self._poll_obstacles()
        stamp, model = read_stamp(content), self._server.model
        if model is None or self._server.hold:
            self._server.refuse(stamp, self._server.hold or self._missing)
            return
        try:
            pose_of = partial(self._frames.pose, model=model)
            request = topic.request(content, model, pose_of)
        except Exception as error:
            self._server.refuse(stamp, self.explain(error))
            return
        self._server.goal(request)

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._poll()
        is_doubtful = self._action.has_unanswered_motion
        try:
            response.message = self._server.stop()
        except PlannerError as error:
            response.message = f"nothing was published: {self.explain(error)}"
            return response
        response.success = True
        if is_doubtful:
            response.message = (
                "a stop was sent; the controller has not answered a motion that was sent before, "
                "which is cancelled as soon as it is accepted"
            )
        return response

    def _poll(self) -> None:
        """Read the states of robot and controller that wait, and look at the planner's answers.

        Their age counts from when the middleware got them; at most from the last look, because the
        wall clock may have been set.
        """
        last, self._polled = self._polled, time.monotonic()
        longest = self._polled - last
        measured = self._tracker.measured
        if self._controller is not None:
            for content, facts in self._controller[1].poll():
                stamp, age = to_seconds(read_stamp(content)), message_age(facts, longest)
                then = measured.time_of(stamp, age)
                with suppress(GoalError):  # it does not count
                    self._tracker.receive(to_command(content, measured.joint_names, then))
        for content, facts in thinned(self._states.poll()):
            try:
                message = deserialize_message(content, JointState)
            except RuntimeError:  # what is no message
                measured.n_unusable += 1
                continue
            stamp, age = to_seconds(message.header.stamp), message_age(facts, longest)
            measured.receive(message.name, message.position, message.velocity, stamp, age)

    def _tick(self) -> None:
        """Look at the robot."""
        self._poll()
        self._watch_robot()
        self._poll_obstacles()
        self._action.watch()
        self._server.tick()
        self._workers.check()
        others = self._tracker.measured.others
        if others != self._others and self._server.is_idle and self._server.model is not None:
            self._others = dict(others)
            self._planner.send(Positions(self._others))

    def _poll_obstacles(self) -> None:
        """Hand the markers that have arrived to the workers."""
        if self._workers.backlog > _MOST_MARKERS:
            return
        for message in self._markers.poll():
            self._workers.send_obstacles(message)
            if not self._workers.is_watching:
                self._server.release("the watcher of obstacles is being started")
            elif self._server.watcher is None:
                self._server.use_watcher(self._watcher)

    def _follow_frames(self) -> None:
        """Look up the frames of obstacles that are neither links nor fixed."""
        model = self._server.model
        if model is None or not self._world.frames:
            return
        poses = {frame: self._frames.pose(frame, model) for frame in self._world.frames}
        self._workers.send_obstacles(Frames(poses))

    # Workers.

    def _watch_robot(self) -> None:
        """Tell the watcher which robot it watches, if that is another one."""
        model = self._server.model
        if model is not None:
            urdf = self._settings.robot_description or self._description
            names, locked = model.robot.joint_names, dict(model.facts.locked)
            self._workers.watch(WatchedRobot(urdf, names, locked, self._settings))

    def _on_worker(self, role: str, message: object) -> None:
        """Handle what a worker says."""
        match message:
            case Planned() | Rejected() | Verdict():
                self._poll()
                self._server.answer(message)
                if isinstance(message, Verdict):
                    self._server.tick()  # now, because an obstacle may be near
            case ModelFacts():
                self._server.learn(message)
            case WorldFacts():
                if message.missing and message.missing != self._world.missing:
                    text = f"obstacles: {message.missing}"
                    self.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)
                self._world = message
                self._follow_frames()
            case Preview():
                if not self._is_over:
                    self._preview.publish(message.content)
            case SetUpDone() if role == PLANNER:  # it was started again
                self._server.hold = self._hold
                # It had ended during the set-up with another robot description.
                if self._model_problem and message.model is not None:
                    self._adopt(message, self._settings)
            case SetUpDone():
                if self._workers.has_obstacles:
                    self._server.use_watcher(self._watcher)
            case InternalError():
                self._log_internal(message.text)
            case WorkerDied() if role == PLANNER:
                self.get_logger().error(f"the planner has ended: {message.reason}")
                self._server.hold = self._hold or _RESTARTING
                self._server.answer(message)
                self._planner.send(self._set_up_of(0, self._settings))
            case WorkerDied():
                self.get_logger().error(f"the watcher of obstacles has ended: {message.reason}")
                self._server.use_watcher(None)
                if self._workers.has_obstacles:
                    reason = f"the watcher of obstacles has ended ({message.reason})"
                    self._server.release(reason)

    def _log_internal(self, text: str) -> None:
        self.n_internal_errors += 1
        self.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)

    # Set-up.

    def _set_up_of(self, number: int, settings: Settings, *, rereads: bool = False) -> SetUp:
        urdf = settings.robot_description or self._description
        return SetUp(number, urdf, settings, dict(self._tracker.measured.others), rereads)

    def _set_up(self, settings: Settings, *, rereads: bool = False) -> Future:
        """Have the planner use other parameters, files or robots."""
        question = partial(self._set_up_of, settings=settings, rereads=rereads)
        return self._workers.ask(question)

    def _wait(self, future: Future) -> SetUpDone:
        """The answer of the planner; nothing else is done meanwhile, at the start of a node."""
        while not future.done():
            time.sleep(0.002)
            self._workers.check()
            self._workers.receive()
        return future.result()

    def _adopt(self, done: SetUpDone, settings: Settings) -> None:
        """Use what the planner has accepted."""
        self._poll()  # states of the joints before, which wait, must not be taken for new ones
        self._declared.use_joints(done.joint_names)
        self._settings, self._done = settings, done
        self._problem, self._model_problem = self._problem * (not done.primitives), ""
        self._planner.longest_solve = settings.max_solve_time
        model = None
        if done.model is not None:
            urdf = settings.robot_description or self._description
            robot = Robot(urdf, done.joint_names, locked=done.model.locked)
            robot = robot.with_drives(done.model.drives)
            model = NodeModel(robot, done.model, settings)
        self._server.use(model, done.joint_names)
        self._use_controller()
        self._log_readiness()

    def _on_set_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        """Accept what the planner has accepted, see `_changed`."""
        if self._declared.is_declaring:
            return SetParametersResult(successful=True)
        try:
            self._declared.check_names([p.name for p in changes], self._done.joint_names)
            settings = self._declared.settings(changes)
        except PlannerError as error:
            return SetParametersResult(successful=False, reason=self.explain(error))
        is_known = settings == self._settings
        return SetParametersResult(successful=is_known, reason="" if is_known else _PENDING)

    async def _on_parameters(self, request: Any, response: Any) -> Any:
        for message in request.parameters:
            response.results.append(await self._changed([Parameter.from_parameter_msg(message)]))
        return response

    async def _on_parameters_at_once(self, request: Any, response: Any) -> Any:
        changes = [Parameter.from_parameter_msg(message) for message in request.parameters]
        response.result = await self._changed(changes)
        return response

    async def _changed(self, changes: list[Parameter]) -> SetParametersResult:
        """Set parameters, if they are well-formed and the planner accepts them."""
        while (result := self.set_parameters_atomically(changes)).reason == _PENDING:
            settings = self._declared.settings(changes)
            done = await self._set_up(settings)
            # Without a usable model anyway, a fix may need several changes.
            is_partial = self._model_problem and done.primitives
            if done.problem and not is_partial:
                return SetParametersResult(successful=False, reason=to_text(done.problem))
            if self._declared.settings(changes) == settings:
                self._adopt(done, settings)
                self._model_problem = done.problem
        return result

    async def _on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        done = await self._set_up(self._settings, rereads=True)
        if not done.problem:
            self._adopt(done, self._settings)
        self._problem = done.problem
        response.success, library = not done.problem, self._library
        text = f"loaded: {library}" if response.success else f"{done.problem}; {library} kept"
        response.message = to_text(text)
        return response

    async def _on_description(self, message: String) -> None:
        is_new, self._description = message.data != self._description, message.data
        if self._settings.robot_description or not is_new:
            return
        done = await self._set_up(self._settings)
        if not done.problem:
            self._adopt(done, self._settings)
            return
        # The robot has changed, so the old model is invalid.
        self._server.use(None, self._done.joint_names)
        self._model_problem = done.problem
        self.get_logger().error(to_text(done.problem))

    async def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        planned, folder = self._planned, self._settings.save_folder
        if not folder:
            raise GoalError("motions can't be saved: set the parameter 'save_folder' to a folder")
        if planned is None:
            raise GoalError("there is no motion to save: none was published")
        question = partial(KeepMotion, key=planned.key, folder=folder)
        kept = await self._workers.ask(question)
        response.success = not kept.problem
        response.message = to_text(
            kept.problem or f"saved as '{kept.file}'; call ~/reload_primitives to use it"
        )
        return response

    def _use_controller(self) -> None:
        """Use the topic and the action of the controller that the parameters name."""
        settings, old = self._settings, self._controller
        parent = self._trajectories.topic_name.rpartition("/")[0]
        topic = settings.controller_state_topic or f"{parent}/controller_state"
        if HAS_CONTROL_MSGS and (old is None or old[0] != topic):
            kind = JointTrajectoryControllerState
            self._controller = topic, PolledSubscription(self, kind, topic, _NEWEST_STATE)
            if old is not None:
                old[1].destroy()
        self._action.use(settings)

    @property
    def _library(self) -> str:
        """The names of the primitives, for messages."""
        return quote_names(self._done.primitives)

    @property
    def _missing(self) -> str:
        """The reason why goals are rejected; empty if they are accepted."""
        if self._server.hold or self._server.model is not None:
            return self._server.hold
        if not self._done.primitives:
            return self._problem or (
                "no primitives are loaded: set the parameter 'primitives' to primitive files or "
                "folders of them"
            )
        topic = self.resolve_topic_name("robot_description")
        return self._model_problem or (
            f"{WAITING}a robot description: nothing has arrived on '{topic}' yet, and the "
            "parameter 'robot_description' is empty"
        )

    # What goes out (see `Outputs`).

    def send(self, motion: PublishedMotion, planned: Planned | None) -> None:
        """Send a motion to the controller."""
        content = serialize_trajectory(
            motion.sent,
            # Stops have no efforts.
            with_efforts=self._settings.publish_effort and motion.sent.efforts is not None,
            stamp=motion.stamp,
            last_point_only=not motion.is_path_known,
        )
        is_goal = self._action.send(motion.sent, content, is_stop=planned is None)
        # A controller that listens to both would execute the motion twice.
        topic = self._trajectories.topic_name
        if not (is_goal and self._action.is_served_by_subscriber(topic)):
            self._trajectories.publish(content)

    def report_goal(
        self,
        outcome: GoalOutcome,
        name: Any,
        reason: str = "",
        planned: Planned | Rejected | None = None,
        ignored_joints: Sequence[str] = (),
    ) -> None:
        """Report what became of a goal, which is named by its stamp."""
        if outcome is GoalOutcome.SERVED and isinstance(planned, Planned):
            self._planned, self._is_over, self._is_due = planned, False, True
            missing = self._world.missing
            self._reports.publish(to_plan_report(planned, name, ignored_joints, missing))
            seconds = planned.trajectory.duration
            times = f"{seconds:.4g} s long, planned in {1e3 * planned.solve_time:.3g} ms"
            self.get_logger().info(to_text(f"goal served: {planned.message} ({times})"))
            return
        values = planned.values if planned is not None else {}
        self._reports.publish(to_goal_report(outcome, reason, name, values))
        if outcome is GoalOutcome.REFUSED:
            text = f"goal rejected: {to_text(reason)}"
            self.get_logger().warning(text, throttle_duration_sec=LOG_PERIOD)
            if self._is_over:
                self._erase_preview()

    def report_motion(self, report: ExecutionReport) -> None:
        """Report what became of a motion."""
        self._executions.publish(to_execution_report(report))
        if report.outcome is not MotionOutcome.REPLACED:
            self._is_over = True
            if report.outcome is not MotionOutcome.NEVER_STARTED:
                self._erase_preview()
        if not report.outcome.is_good:
            self.get_logger().error(to_text(report.message))

    def _erase_preview(self) -> None:
        self._is_due = False
        self._preview.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))

    def log(self, text: str) -> None:
        """Tell a user what was done without a goal."""
        self.get_logger().warning(to_text(text), throttle_duration_sec=LOG_PERIOD)

    def _tidy(self) -> None:
        """Do what can wait."""
        self._follow_frames()
        if self._is_due and self._planned is not None and self._server.is_idle:
            self._is_due = False
            self._planner.send(ShowMotion(self._planned.trajectory))
        if (state := self._action.state) not in ("none", "ready"):
            text = f"parameter 'controller_action': {state}"
            self.get_logger().warning(text, throttle_duration_sec=LOG_PERIOD)
        measured, logger = self._tracker.measured, self.get_logger()
        if measured.stamps.is_certain and not measured.stamps.is_usable:
            logger.warning(
                "the stamps of joint_states are no times of this node's clock: they are "
                f"{measured.stamps.difference:.3g} s behind. Trajectories are sent without stamps, "
                "so goals for a moving robot may cause jumps; synchronise the clocks",
                once=True,
            )
        is_due = time.monotonic() - self._began > _CONTROLLER_TIME and measured.age is not None
        if is_due and not self._tracker.hears_controller and self._server.model is not None:
            install = "install control_msgs, or make it by scripts/control_messages.py, to hear"
            why = "no usable message has come on" if HAS_CONTROL_MSGS else install
            topic = self._controller[0] if self._controller else "controller_state"
            logger.warning(
                f"without the controller's state ({why} '{topic}'), the command of a moving robot "
                "is taken from the published motion: goals for a slowed or held robot are "
                "rejected, and one that is not noticed may jump",
                once=True,
            )

    def _publish_diagnostics(self) -> None:
        measured, model = self._tracker.measured, self._server.model
        statistics = self._server.statistics
        age, problem = measured.age, self._missing or self._problem
        timeout = self._settings.state_timeout
        if not problem and age is None:
            problem = f"{WAITING}joint_states"
        elif not problem and age is not None and 0.0 < timeout < age:
            problem = f"joint_states stopped {age:.1f} s ago"
        elif not problem and self._world.missing:
            problem = f"an obstacle is not avoided: {self._world.missing}"
        elif not problem and model is not None:
            problem = model.facts.unknown
        locked = model.robot.locked_positions if model else {}
        values = {
            "model": quote_names(model.robot.joint_names) if model else "none",
            "joints": ", ".join(model.robot.described_joints) if model else "none",
            "library": self._library,
            **{f"goals_{outcome}": n for outcome, n in statistics.counts.items()},
            "internal_errors": self.n_internal_errors,
            "worker_restarts": self._workers.n_restarts,
            "locked_joints": ", ".join(f"{k}={x:.4g}" for k, x in locked.items()) or "none",
            "controller_action": self._action.state,
            "controller_state": "received" if self._tracker.hears_controller else "none",
            "obstacles": self._world.n_obstacles,
            "obstacle_rejected": self._world.missing or "none",
            **statistics.solve_time_percentiles(),
            "joint_states_age_s": "none" if age is None else round(age, 3),
            "joint_states_incomplete": measured.n_incomplete,
            "joint_states_unusable": measured.n_unusable,
        }
        level = DiagnosticStatus.WARN if problem else DiagnosticStatus.OK
        name = f"{self.get_fully_qualified_name()}: planner"
        status = to_status(name, level, problem or READY, values)
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _log_readiness(self) -> None:
        self.get_logger().info(to_text(self._missing or READY))
        model = self._server.model
        notes = model.facts.notes if model is not None else self._notes
        for note in notes:
            if note not in self._notes:
                self.get_logger().warning(to_text(note))
        self._notes = notes


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
        self._hold = self._server.hold = ""
        self._log_readiness()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Cancel goals, reject further ones, and stop a running motion."""
        self._reject_goals()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop the primitives."""
        self._server.use(None, ())
        self._done = SetUpDone(0)
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reject goals permanently."""
        self._reject_goals()
        return super().on_shutdown(state)

    def _reject_goals(self) -> None:
        self._hold = self._server.hold = _INACTIVE
        self._poll()
        self._server.cancel(_INACTIVE)
        self._server.release(_INACTIVE)
