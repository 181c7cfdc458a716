# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals: a table of their topics, and what is read of each message.

A further topic is a row of `GOAL_TOPICS`: node and client are made from it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState as JointStateMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..arrays import FloatArray
from ..exceptions import GoalError, quote_names, unknown_name
from ..execution.server import GoalRequest, NodeModel
from ..files import reading
from ..input_limits import INPUT_LIMITS
from ..motion.goal import Goal, JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ..planning.resolve import in_order
from ..recordings.joint_states import ENCAPSULATION, NS_PER_S
from ..robot.model import Robot
from .messages import check_finite, to_seconds

MakeGoal = Callable[[JointState], Goal]
"""Returns a goal for a motion from a start state."""

PoseOf = Callable[[str], FloatArray | None]
"""Returns the pose of a frame in the base frame, shape (7,), or None if it is unknown."""

Stated = tuple[Goal, MakeGoal | None, tuple[str, ...]]
"""A goal, how it depends on the start if it does, and the joints that the primitives don't move."""


@dataclass(frozen=True)
class GoalTopic:
    """A topic of goals.

    Attributes
    ----------
    name : str
        Its name, below that of the node.
    message_type : type
        Type of its messages.
    read : callable
        Returns the goal of a message for a model, given the poses of frames that are not links;
        raises a `PlannerError` if it is malformed.
    """

    name: str
    message_type: type[Any]
    read: Callable[[Any, NodeModel, PoseOf], Stated]

    def request(self, content: bytes, model: NodeModel, pose_of: PoseOf) -> GoalRequest:
        """Read the goal of a serialised message.

        Raises
        ------
        GoalError
            If it is far too large, or malformed.
        """
        if len(content) > INPUT_LIMITS.goal_bytes:
            raise GoalError(
                f"the message of the goal has {len(content)} bytes, at most "
                f"{INPUT_LIMITS.goal_bytes} are accepted"
            )
        with reading("the message of the goal", GoalError):
            message = deserialize_message(content, self.message_type)
        goal, make_goal, ignored = self.read(message, model, pose_of)
        return GoalRequest(goal, message.header.stamp, make_goal, ignored)


def read_stamp(content: bytes) -> Time:
    """The stamp at the begin of a serialised message; zero if the message is too short."""
    if len(content) < ENCAPSULATION + 8:
        return Time()
    order = ">" if content[1] == 0 else "<"
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", content, ENCAPSULATION)
    return Time(sec=seconds, nanosec=nanoseconds)


def _check_count(verb: str, n: int, things: str) -> None:
    most = INPUT_LIMITS.goal_items
    if n > most:
        raise GoalError(f"the goal {verb} {n} {things}, at most {most} are accepted")


def _read_configuration(message: JointStateMessage, model: NodeModel, _: PoseOf) -> Stated:
    goal, ignored = _without_unmoved(to_goal(message, model.settings.duration), model.robot)
    return goal, None, ignored


def _read_pose(message: PoseStamped, model: NodeModel, pose_of: PoseOf) -> Stated:
    goal = to_pose_goal(message, model.facts.end_effector, model.settings.duration)
    return goal, stated_in(goal, message.header.frame_id, model.robot, pose_of), ()


def _read_sequence(message: JointTrajectory, model: NodeModel, _: PoseOf) -> Stated:
    goal, ignored = _without_unmoved(to_sequence_goal(message), model.robot)
    return goal, None, ignored


GOAL_TOPICS = (
    GoalTopic("goal", JointStateMessage, _read_configuration),
    GoalTopic("goal_pose", PoseStamped, _read_pose),
    GoalTopic("goal_sequence", JointTrajectory, _read_sequence),
)
"""All topics of goals."""


def to_goal(message: JointStateMessage, duration: float) -> JointGoal:
    """Read a goal.

    Parameters
    ----------
    message :
        Positions by joint name; velocities at the end, if there are any; in its frame_id the
        name of the primitive, if it isn't empty. Efforts are not used.
    duration : float
        Duration of the motion [s]; 0 leaves it to the planner.

    Raises
    ------
    GoalError
        If names repeat or are too many, lengths disagree or a number is not finite.
    """
    names = list(message.name)
    _check_count("names", len(names), "joints")
    for field, fields, values, lengths, accepted in (
        ("position", "positions", message.position, (len(names),), "one"),
        ("velocity", "velocities", message.velocity, (0, len(names)), "none or one"),
    ):
        if len(values) not in lengths:
            raise GoalError(
                f"the goal names {len(names)} joints and has {len(values)} {fields}, "
                f"{accepted} for each joint is accepted"
            )
        found = zip(names, values, strict=False)
        check_finite(f"the goal {field} of joint '{{}}' is {{}}", found)
    state = JointState(names, message.position, message.velocity or None)
    return JointGoal(state, duration or None, message.header.frame_id or None)


def to_pose_goal(message: PoseStamped, frame: str, duration: float) -> PoseGoal:
    """Read a pose goal, relative to the frame in which it is stated.

    Parameters
    ----------
    message :
        The pose; its frame_id is not used. A quaternion of zeros leaves the orientation free.
    frame : str
        The link of the robot that the pose is for.
    duration : float
        Duration of the motion [s]; 0 leaves it to the planner.

    Raises
    ------
    GoalError
        If a number is not finite or the quaternion not of length 1.
    """
    p, o = message.pose.position, message.pose.orientation
    turned = [o.x, o.y, o.z, o.w]
    return PoseGoal(Pose(frame, [p.x, p.y, p.z], turned if any(turned) else None), duration or None)


def to_sequence_goal(message: JointTrajectory) -> SequenceGoal:
    """Read configurations to pass and to end at.

    Parameters
    ----------
    message :
        One configuration per point; a time from start above 0 says when to be there, velocities
        of 0 that the motion stops there. In its frame_id the name of the primitive, if it isn't
        empty.

    Raises
    ------
    GoalError
        If names repeat, names or points are too many, lengths disagree, a number is not finite,
        times don't increase, or velocities, accelerations or efforts are specified.
    """
    _check_count("names", len(message.joint_names), "joints")
    _check_count("has", len(message.points), "points")
    targets = []
    for k, point in enumerate(message.points, start=1):
        _check_point(k, point, message.joint_names)
        targets.append(JointState(message.joint_names, point.positions))
    times = tuple(to_seconds(point.time_from_start) or None for point in message.points)
    stops = tuple(bool(point.velocities) for point in message.points)
    return SequenceGoal(tuple(targets), times, message.header.frame_id or None, stops)


def _check_point(k: int, point: JointTrajectoryPoint, joint_names: Sequence[str]) -> None:
    """Raise a `GoalError` if the k-th point of a sequence is not accepted."""
    n = len(joint_names)
    if len(point.positions) != n:
        raise GoalError(
            f"the goal names {n} joints and point {k} has {len(point.positions)} positions, "
            "one for each joint is accepted"
        )
    values = zip(joint_names, point.positions, strict=True)
    check_finite(f"point {k} of the goal puts joint '{{}}' at {{}}", values)
    if len(point.velocities) not in (0, n):
        raise GoalError(
            f"the goal names {n} joints and point {k} has {len(point.velocities)} velocities: "
            "none, or one of 0 for each joint to stop there, is accepted"
        )
    for field in ("velocities", "accelerations", "effort"):
        if any(getattr(point, field)):
            raise GoalError(
                f"point {k} of the goal specifies {field}; accepted are positions, and "
                "velocities of 0 to stop there"
            )


def stated_in(
    goal: PoseGoal, reference: str, robot: Robot, pose_of: PoseOf
) -> Callable[[JointState], PoseGoal]:
    """Return the conversion of a goal from a reference frame to the frame of the base.

    Parameters
    ----------
    goal : PoseGoal
        Its pose is relative to the reference frame.
    reference : str
        A link of the robot, or another frame; empty: the base. For a moving link, its pose at the
        start of the motion counts: "10 cm forward" in the frame of a tool.
    robot : Robot
        The robot with the links.
    pose_of : callable
        Returns the poses of other frames.

    Raises
    ------
    GoalError
        If the pose of the frame is not known.

    Returns
    -------
    :
        Takes the start state of the motion and returns the goal in the frame of the base.
    """
    if not reference:
        return lambda _: goal
    if reference not in robot.frame_names:
        foreign = pose_of(reference)
        if foreign is None:
            reason = unknown_name("link of the robot", reference, robot.frame_names)
            raise GoalError(
                f"the goal is stated in the frame '{reference}', but {reason}; an empty frame_id "
                "means the base. For other frames, set the parameter 'fixed_frames' (FRAME: X Y "
                "Z), or publish their transforms to tf2"
            )
        moved = _moved(goal, foreign)
        return lambda _: moved

    def make_goal(start: JointState) -> PoseGoal:
        q = in_order(start, robot.joint_names).positions
        (place,) = robot.attached_poses(q[None], [reference], np.zeros((1, 6)))[0]
        return _moved(goal, place)

    return make_goal


def _moved(goal: PoseGoal, place: FloatArray) -> PoseGoal:
    """A goal that is stated in a frame at a place (x, y, z and a quaternion)."""
    # Imported late for a fast start of the node.
    from scipy.spatial.transform import Rotation

    turned, pose = Rotation.from_quat(place[3:]), goal.pose
    orientation = pose.orientation
    if orientation is not None:
        orientation = (turned * Rotation.from_quat(orientation)).as_quat()
    position = place[:3] + turned.as_matrix() @ pose.position
    return replace(goal, pose=Pose(pose.frame, position, orientation))


def _without_unmoved(
    goal: JointGoal | SequenceGoal, robot: Robot
) -> tuple[JointGoal | SequenceGoal, tuple[str, ...]]:
    """The goal without the robot's joints that don't move here, and the names of these.

    Messages of a whole robot name the joints of its gripper, too.

    Raises
    ------
    GoalError
        If it names no other joints.
    """
    states = goal.targets if isinstance(goal, SequenceGoal) else (goal.state,)
    names = next(state.joint_names for state in states if isinstance(state, JointState))
    still = set(robot.movable_joints) - set(robot.joint_names)
    kept = tuple(name for name in names if name not in still)
    if names and not kept:
        raise GoalError(
            f"the primitives do not move {quote_names(names)} of the goal; a goal names at least "
            f"one of {quote_names(robot.joint_names)}"
        )
    if len(kept) == len(names):
        return goal, ()
    reduced = tuple(in_order(state, kept) for state in states if isinstance(state, JointState))
    ignored = tuple(name for name in names if name in still)
    if isinstance(goal, SequenceGoal):
        return replace(goal, targets=reduced), ignored
    return replace(goal, state=reduced[0]), ignored


def to_sequence_message(goal: SequenceGoal) -> JointTrajectory:
    """Write a sequence of configurations of the same joints.

    Raises
    ------
    GoalError
        If there is a pose among them, they differ in joints, or a time is too long for a message.
    """
    message = JointTrajectory(joint_names=list(getattr(goal.targets[0], "joint_names", ())))
    message.header.frame_id = goal.primitive or ""
    for target, when, stops in zip(goal.targets, goal.times, goal.stops, strict=True):
        if not isinstance(target, JointState) or [*target.joint_names] != message.joint_names:
            raise GoalError("all targets of a sequence must be configurations of the same joints")
        point = JointTrajectoryPoint(positions=target.positions.tolist())
        point.velocities = [0.0] * (len(target.joint_names) if stops else 0)
        if when is not None and when >= 2**31:
            raise GoalError(f"the time {when:g} s of a target is longer than a message can hold")
        since = point.time_from_start
        since.sec, since.nanosec = divmod(round((when or 0.0) * NS_PER_S), NS_PER_S)
        message.points.append(point)
    return message


def to_pose_message(pose: Pose) -> PoseStamped:
    """Write a pose that is stated in the frame that it names; a free orientation becomes zeros."""
    message = PoseStamped()
    message.header.frame_id = pose.frame
    to, turned = message.pose.position, message.pose.orientation
    to.x, to.y, to.z = pose.position.tolist()
    free = [0.0] * 4 if pose.orientation is None else pose.orientation.tolist()
    turned.x, turned.y, turned.z, turned.w = free
    return message
