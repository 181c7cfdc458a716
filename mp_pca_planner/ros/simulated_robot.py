# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node of a simulated robot: joint states, description, controller and faults."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial

from rcl_interfaces.msg import SetParametersResult
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..exceptions import PlannerError
from ..recordings.joint_states import NS_PER_S
from ..simulation.controller import (
    CANCELED,
    RESULT_CODES,
    SUCCEEDED,
    TrajectoryMessage,
    TrajectoryPoint,
)
from ..simulation.robot import CYCLE_NS, SimulatedRobot
from .controller import HAS_CONTROL_MSGS, FollowJointTrajectory, JointTrajectoryControllerState
from .nodes import LATCHED

NODE_NAME = "simulated_robot"

# Longest time that the robot makes up for [ns]; before that, it is held.
_LONGEST_BACKLOG_NS = NS_PER_S


def to_controller_message(message: JointTrajectory) -> TrajectoryMessage:
    """Read a message as a controller receives it, well-formed or not."""

    def nanoseconds(time: object) -> int:
        return int(time.sec * NS_PER_S + time.nanosec)  # type: ignore[attr-defined]

    points = tuple(
        TrajectoryPoint(
            nanoseconds(point.time_from_start),
            tuple(point.positions),
            tuple(point.velocities),
            tuple(point.accelerations),
            tuple(point.effort),
        )
        for point in message.points
    )
    return TrajectoryMessage(tuple(message.joint_names), points, nanoseconds(message.header.stamp))


def to_state_message(
    robot: SimulatedRobot, measured: Sequence[float]
) -> JointTrajectoryControllerState:
    """What the controller of a robot at measured positions publishes of itself."""
    reference, since_ns = robot.controller.stated()
    message = JointTrajectoryControllerState(
        joint_names=robot.joint_names, speed_scaling_factor=robot.controller.speed_scaling
    )
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(robot.time_ns, NS_PER_S)
    positions, velocities, accelerations = reference.tolist()
    message.reference = JointTrajectoryPoint(
        positions=positions, velocities=velocities, accelerations=accelerations
    )
    since = message.reference.time_from_start
    since.sec, since.nanosec = divmod(since_ns, NS_PER_S)
    message.feedback.positions = list(measured)
    pairs = zip(positions, measured, strict=True)
    message.error.positions = [wanted - found for wanted, found in pairs]
    return message


def _send_result(
    outcome: str, message: str, handle: ServerGoalHandle
) -> FollowJointTrajectory.Result:
    end = {SUCCEEDED: handle.succeed, CANCELED: handle.canceled}.get(outcome, handle.abort)
    end()
    return FollowJointTrajectory.Result(error_code=RESULT_CODES[outcome], error_string=message)


class SimulatedRobotNode(Node):
    """Publishes a simulated robot's state, receives trajectories, has parameters for faults.

    Where control_msgs is installed, it publishes the state of its controller beside the topic of
    trajectories, and serves the controller's action there.

    Parameters
    ----------
    robot : SimulatedRobot
        The robot; its clock is that of the node.
    urdf : str
        Its description, XML text.
    controller_topic : str
        Name of the topic of trajectories.
    others : mapping of str to float
        Positions of the joints that the controller does not move, such as a gripper's [rad or m].
    keep_record : bool
        Whether the robot's record is kept from the start.

    Attributes
    ----------
    delays : list of float
        Time that each trajectory was on its way [s].
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        urdf: str,
        controller_topic: str,
        *,
        others: Mapping[str, float],
        keep_record: bool,
    ) -> None:
        super().__init__(NODE_NAME)
        self._robot, self._others, self._keep_record = robot, others, keep_record
        self.delays: list[float] = []
        self._published, self._n_rejections = robot.state_time_ns, 0
        self._states = self.create_publisher(JointState, "joint_states", 10)
        self._descriptions = self.create_publisher(String, "robot_description", LATCHED)
        self._descriptions.publish(String(data=urdf))
        # The types of rclpy don't know of callbacks that take facts of the message, too.
        callback: Callable[..., None] = self._on_trajectory
        self.create_subscription(JointTrajectory, controller_topic, callback, 10)
        self._goals: dict[Hashable, ServerGoalHandle] = {}
        self._n_results = 0
        if HAS_CONTROL_MSGS:
            self._serve_controller(controller_topic.rpartition("/")[0])
        # Before the declarations: values of the command line count, too.
        self.add_on_set_parameters_callback(self._on_parameters)
        for name, value in asdict(robot.faults).items():
            self.declare_parameter(name, value)

    def advance(self) -> float:
        """Bring the robot up to the present time; returns the time until its next state [s]."""
        robot, now = self._robot, self.get_clock().now().nanoseconds
        # On a computer that is too busy, making up for all cycles would take ever longer.
        if not -_LONGEST_BACKLOG_NS <= now - robot.time_ns <= _LONGEST_BACKLOG_NS:
            robot.set_time(min(now, max(robot.time_ns, now - _LONGEST_BACKLOG_NS)))
        while robot.time_ns + CYCLE_NS <= now:
            robot.step()
            if robot.state_time_ns != self._published:
                self._publish()
            self._end_goals()
        for _, reason in robot.rejections[self._n_rejections :]:
            self.get_logger().warning(f"Trajectory rejected: {reason}")
        self._n_rejections = len(robot.rejections)
        if not self._keep_record and len(robot.record) > 10_000:
            robot.record.clear()
        # Messages are handled on receipt; the cycles until then are made up for afterwards.
        return (robot.time_ns + max(robot.state_period_ns, CYCLE_NS) - now) / NS_PER_S

    def _serve_controller(self, name: str) -> None:
        """Publish the controller's state and serve its action, as a controller of a name does."""
        prefix = f"{name}/" if name else ""
        state_topic = f"{prefix}controller_state"
        self._controller = self.create_publisher(JointTrajectoryControllerState, state_topic, 10)
        self._action = ActionServer(
            self,
            FollowJointTrajectory,
            f"{prefix}follow_joint_trajectory",
            lambda _: FollowJointTrajectory.Result(),
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
        )

    def _on_goal(self, goal: FollowJointTrajectory.Goal) -> GoalResponse:
        self.advance()
        message = to_controller_message(goal.trajectory)
        reason = self._robot.controller.rejection(message, self._robot.time_ns)
        if reason is not None:
            self.get_logger().warning(f"Goal rejected: {reason}")
        return GoalResponse.REJECT if reason else GoalResponse.ACCEPT

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        goal = bytes(handle.goal_id.uuid)
        self._goals[goal] = handle
        self._robot.send_message(to_controller_message(handle.request.trajectory), goal)

    def _on_cancel(self, handle: ServerGoalHandle) -> CancelResponse:
        self.advance()
        self._robot.cancel(bytes(handle.goal_id.uuid))
        return CancelResponse.ACCEPT

    def _end_goals(self) -> None:
        """Send the results of the goals that have ended."""
        results = self._robot.controller.results[self._n_results :]
        self._n_results += len(results)
        for goal, outcome, message in results:
            # Goals of rclpy run in a task of their own; here, it only sends what is known.
            self._goals.pop(goal).execute(partial(_send_result, outcome, message))

    def _publish(self) -> None:
        robot = self._robot
        self._published = robot.state_time_ns
        _, q, v = robot.newest_state()
        rest = [0.0] * len(self._others)
        message = JointState(
            name=[*robot.joint_names, *self._others],
            position=[*q.tolist(), *self._others.values()],
            velocity=v.tolist() + rest,
            effort=robot.plant.acting.tolist() + rest,
        )
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(self._published, NS_PER_S)
        self._states.publish(message)
        if HAS_CONTROL_MSGS and robot.controller.is_active:
            self._controller.publish(to_state_message(robot, q.tolist()))

    def _on_trajectory(self, message: JointTrajectory, facts: dict[str, int]) -> None:
        self.advance()
        self.delays.append(1e-9 * (self._robot.time_ns - facts["source_timestamp"]))
        self._robot.send_message(to_controller_message(message))

    def _on_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        self.advance()
        known = asdict(self._robot.faults)
        changes = {p.name: p.value for p in parameters if p.name in known}
        try:
            self._robot.faults = replace(self._robot.faults, **changes)
        except PlannerError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)
