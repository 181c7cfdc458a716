# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals: a table of their topics, and what is read of each message.

A further topic is a row of `GOAL_TOPICS`: node and client are made from it.
"""

from __future__ import annotations

import math
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
from ..motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ..planning.resolve import in_order
from ..recordings.joint_states import ENCAPSULATION, NS_PER_S
from ..robot.model import Robot
from .messages import to_pose, to_seconds

PoseOf = Callable[[str], FloatArray | None]
"""Returns the pose of a frame in the base frame, shape (7,), or None if it is unknown."""


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
        Returns the request of a message for a model, given the poses of frames that are not links;
        raises a `PlannerError` if it is malformed.
    """

    name: str
    message_type: type[Any]
    read: Callable[[Any, NodeModel, PoseOf], GoalRequest]

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
        return self.read(message, model, pose_of)


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


def _read_configuration(message: JointStateMessage, model: NodeModel, _: PoseOf) -> GoalRequest:
    """A configuration, with the primitive in its frame_id, if it isn't empty; no efforts."""
    _check_count("names", len(message.name), "joints")
    stated = _state("the goal", message.name, message.position, message.velocity)
    (state,), ignored = _moved_joints([stated], message.name, model.robot)
    goal = JointGoal(state, model.settings.duration or None, message.header.frame_id or None)
    return GoalRequest(goal, message.header.stamp, None, ignored)


def _read_sequence(message: JointTrajectory, model: NodeModel, _: PoseOf) -> GoalRequest:
    """Configurations to pass and to end at, with the primitive in the frame_id.

    A time from start above 0 says when to be there, velocities of 0 that the motion stops there.
    """
    _check_count("names", len(message.joint_names), "joints")
    _check_count("has", len(message.points), "points")
    states = list[JointState]()
    for k, point in enumerate(message.points, start=1):
        what = f"point {k} of the goal"
        states.append(_state(what, message.joint_names, point.positions, point.velocities))
        for field in ("velocities", "accelerations", "effort"):
            if any(getattr(point, field)):
                raise GoalError(
                    f"{what} specifies {field}; accepted are positions, and velocities of 0 to "
                    "stop there"
                )
    targets, ignored = _moved_joints(states, message.joint_names, model.robot)
    times = tuple(to_seconds(point.time_from_start) or None for point in message.points)
    stops = tuple(bool(point.velocities) for point in message.points)
    goal = SequenceGoal(targets, times, message.header.frame_id or None, stops)
    return GoalRequest(goal, message.header.stamp, None, ignored)


def _state(
    what: str, names: Sequence[str], positions: Sequence[float], velocities: Sequence[float]
) -> JointState:
    """The state that a part of a goal specifies; velocities may be left out."""
    if len(positions) != len(names) or len(velocities) not in (0, len(names)):
        raise GoalError(
            f"{what} has {len(positions)} positions and {len(velocities)} velocities for "
            f"{len(names)} joints; one position for each is accepted, and none or one velocity"
        )
    for name, value in zip([*names, *names], [*positions, *velocities], strict=False):
        if not math.isfinite(value):
            raise GoalError(
                f"{what} has {value} for joint '{name}', but only finite numbers are accepted"
            )
    return JointState(names, positions, velocities or None)


def _moved_joints(
    states: Sequence[JointState], names: Sequence[str], robot: Robot
) -> tuple[tuple[JointState, ...], tuple[str, ...]]:
    """States without the robot's joints that the primitives don't move, and the names of these.

    Messages of a whole robot name the joints of its gripper, too.
    """
    still = set(robot.movable_joints) - set(robot.joint_names)
    kept = tuple(name for name in names if name not in still)
    if names and not kept:
        raise GoalError(
            f"the primitives do not move {quote_names(names)} of the goal; a goal names at least "
            f"one of {quote_names(robot.joint_names)}"
        )
    ignored = tuple(name for name in names if name in still)
    return tuple(in_order(state, kept) for state in states), ignored


def _read_pose(message: PoseStamped, model: NodeModel, pose_of: PoseOf) -> GoalRequest:
    """A pose of the end effector; a quaternion of zeros leaves the orientation free.

    For a pose in the frame of a moving link, the place of the link at the start of the motion
    counts: "10 cm forward" in the frame of a tool.
    """
    p, o = message.pose.position, message.pose.orientation
    turn = [o.x, o.y, o.z, o.w]
    pose = Pose(model.facts.end_effector, [p.x, p.y, p.z], turn if any(turn) else None)
    goal = PoseGoal(pose, model.settings.duration or None)
    stamp, frame, robot = message.header.stamp, message.header.frame_id, model.robot

    def make_goal(start: JointState) -> PoseGoal:
        q = in_order(start, robot.joint_names).positions
        (place,) = robot.attached_poses(q[None], [frame], np.zeros((1, 6)))[0]
        return _moved(goal, place)

    if not frame:
        return GoalRequest(goal, stamp)
    if frame in robot.frame_names:
        return GoalRequest(goal, stamp, make_goal)
    if (foreign := pose_of(frame)) is not None:
        return GoalRequest(_moved(goal, foreign), stamp)
    reason = unknown_name("link of the robot", frame, robot.frame_names)
    raise GoalError(
        f"the goal is stated in the frame '{frame}', but {reason}; an empty frame_id means the "
        "base. For other frames, set the parameter 'fixed_frames' (FRAME: X Y Z), or publish their "
        "transforms to tf2"
    )


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


GOAL_TOPICS = (
    GoalTopic("goal", JointStateMessage, _read_configuration),
    GoalTopic("goal_pose", PoseStamped, _read_pose),
    GoalTopic("goal_sequence", JointTrajectory, _read_sequence),
)
"""All topics of goals."""


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
    turn = np.zeros(4) if pose.orientation is None else pose.orientation
    message = PoseStamped(pose=to_pose([*pose.position, *turn]))
    message.header.frame_id = pose.frame
    return message
