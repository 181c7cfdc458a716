# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Types of messages, their serialisation, and bags to write, by the library rosbags."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ...arrays import frozen_array, unique_names
from ...exceptions import RecordingError, unknown_name
from ...files import exists_already, put_in_place, workspace_beside
from ...input_limits import INPUT_LIMITS
from ...motion.trajectory import Trajectory
from ..joint_states import ENCAPSULATION, NS_PER_S
from .discovery import FORMAT_OF_SUFFIX, BagFormat, recordings_in

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"

Types = Any
"""The typestore of rosbags, whose class is not public."""


@cache
def known_types(bag_format: BagFormat) -> Types:
    """Types of ROS messages that rosbags supports."""
    if bag_format != "rosbag1":
        return get_typestore(Stores.ROS2_JAZZY)
    types = get_typestore(Stores.ROS1_NOETIC)
    # The types of /tf are the only common ones of ROS 1 that rosbags lacks.
    for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
        types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return types


def defined_types(definition: str, name: str) -> Types:
    """A type and those within it, as a bag defines them.

    Raises
    ------
    RecordingError
        If the definition is longer than is accepted.
    """
    limit = INPUT_LIMITS.definition_characters
    if len(definition) > limit:
        raise RecordingError(
            f"the definition of {name} has {len(definition):,} characters; accepted are {limit:,}"
        )
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(definition, name))
    return types


def field_of_states(types: Types, name: str) -> str:
    """Name of the first field that is a JointState, with dots where it is within others, or ''."""
    paths, waiting = {name: ""}, [name]
    for current in waiting:
        _, fields_of_type = types.fielddefs.get(current, ((), ()))
        for field, (_, inner) in fields_of_type:
            # A name denotes a type of messages. Each is searched once, as they may be recursive.
            if isinstance(inner, str) and inner not in paths:
                paths[inner] = f"{paths[current]}.{field}".lstrip(".")
                waiting.append(inner)
    return "" if name == JOINT_STATE else paths.get(JOINT_STATE, "")


def states_in_field(message: Any, field: str) -> Any:
    """The joint states in a field of a message, with dots where it is within other fields."""
    for name in field.split("."):
        valid = [item.name for item in fields(message)] if is_dataclass(message) else []
        if name not in valid:
            raise RecordingError(unknown_name(f"field of '{field}'", name, valid))
        message = getattr(message, name)
    kind = getattr(message, "__msgtype__", type(message).__name__)
    if kind != JOINT_STATE:
        raise RecordingError(f"the field '{field}' is a {kind}; expected a {JOINT_STATE}")
    return message


def decoder(types: Types, bag_format: BagFormat) -> Callable[[bytes, str], Any]:
    """A function from a serialised message and the name of its type to the message."""
    if bag_format == "rosbag1":
        decode: Callable[[bytes, str], Any] = types.deserialize_ros1
        return decode
    return lambda data, name: _decode_cdr(types, data, name)


def _decode_cdr(types: Types, data: bytes, name: str) -> Any:
    """Deserialise CDR; rosbags itself accepts no spare bytes but padding."""
    if data[:2] not in (b"\x00\x00", b"\x00\x01"):
        raise ValueError("it is no message in CDR")
    about = types.get_msgdef(name)
    decode = about.deserialize_cdr_le if data[1] else about.deserialize_cdr_be
    message, end = decode(data[ENCAPSULATION:], 0, about.cls, types)
    spare = len(data) - ENCAPSULATION - end
    # A message is padded to words of four bytes, and `rclpy.serialization` keeps room to align what
    # each empty sequence of numbers does not hold. Nearly all have few spare bytes.
    if spare < 0 or (spare > 3 and spare > 3 + 8 * _n_empty(message)):
        raise ValueError(f"size mismatch: {spare} bytes follow the message")
    return message


def _n_empty(value: Any) -> int:
    """Number of empty sequences of numbers in a message."""
    if isinstance(value, np.ndarray):
        return int(value.size == 0)
    if isinstance(value, list):
        return sum(map(_n_empty, value))
    return sum(map(_n_empty, vars(value).values())) if hasattr(value, "__msgtype__") else 0


def to_cdr(data: bytes) -> bytes:
    """A joint state of ROS 1 in the serialisation of ROS 2."""
    return bytes(known_types("mcap").ros1_to_cdr(data, JOINT_STATE))


def from_cdr(data: bytes) -> Any:
    """A joint state in the serialisation of ROS 2."""
    return _decode_cdr(known_types("mcap"), data, JOINT_STATE)


def _header(bag_format: BagFormat, stamp_ns: int) -> Any:
    types = known_types(bag_format).types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, NS_PER_S))
    sequence = {"seq": 0} if bag_format == "rosbag1" else {}
    return types["std_msgs/msg/Header"](**sequence, stamp=stamp, frame_id="")


def _write_messages(
    path: Path, bag_format: BagFormat, topic: str, kind: str, messages: Iterable[tuple[int, object]]
) -> Path:
    """Write messages with their times of reception [ns] as a new bag; return the written path."""
    types = known_types(bag_format)
    encode = types.serialize_ros1 if bag_format == "rosbag1" else types.serialize_cdr
    bare = bag_format != "rosbag1" and path.suffix in FORMAT_OF_SUFFIX
    target = path.with_suffix("") if bare else path
    writer: Writer1 | Writer2
    if bag_format == "rosbag1":
        writer = Writer1(target)
    else:
        plugin = StoragePlugin.MCAP if bag_format == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(target, version=Writer2.VERSION_LATEST, storage_plugin=plugin)
    try:
        with writer:
            connection = writer.add_connection(topic, kind, typestore=types)
            for stamp, message in messages:
                data = message if isinstance(message, bytes) else encode(message, kind)
                writer.write(connection, stamp, data)
    except sqlite3.Error as error:
        raise OSError(str(error)) from None
    return target / f"{target.name}{path.suffix}" if bare else target


def write_joint_states(
    path: str | Path,
    bag_format: BagFormat,
    joint_names: Sequence[str],
    stamps_ns: ArrayLike,
    positions: ArrayLike,
    *,
    overwrite: bool = False,
) -> None:
    """Write joint states as a bag on the topic /joint_states, atomically.

    Parameters
    ----------
    path :
        Where to write. For `bag_format` "rosbag1" a file. For the others a rosbag2 folder, or
        only its storage file if the path ends in .db3 or .mcap.
    bag_format :
        The format: "rosbag1", "sqlite3" or "mcap".
    joint_names :
        Names of the joints.
    stamps_ns : array of int, shape (n_steps,)
        Header stamps and times of reception [ns].
    positions : array, shape (n_steps, n_joints)
        Joint positions [rad or m]; velocities and efforts stay empty.
    overwrite :
        Whether an existing file or folder may be replaced.

    Raises
    ------
    RecordingError
        If the shapes disagree.
    PlannerError
        If there is something at the path already, or it can't be written.
    """
    names = unique_names(joint_names, "joints to write", RecordingError)
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    if stamps.ndim != 1:
        raise RecordingError("stamps to write must be one list of nanoseconds, one for each step")
    rows = frozen_array(positions, (stamps.size, len(names)), "positions", RecordingError)
    kind, empty = known_types(bag_format).types[JOINT_STATE], np.empty(0)
    messages = (
        (stamp, kind(_header(bag_format, stamp), list(names), row, empty, empty))
        for stamp, row in zip(stamps.tolist(), rows, strict=True)
    )
    _write(Path(path), bag_format, "/joint_states", JOINT_STATE, messages, overwrite)


def write_joint_trajectory(
    path: str | Path, trajectory: Trajectory, *, overwrite: bool = False
) -> None:
    """Write a trajectory as a bag that holds it as one JointTrajectory message at time 0.

    Parameters
    ----------
    path :
        Where to write: a ROS 1 bag if it ends in .bag, a bare storage file if it ends in .db3 or
        .mcap, else a rosbag2 folder (mcap).
    trajectory :
        The trajectory.
    overwrite :
        Whether an existing file or folder may be replaced.

    Raises
    ------
    PlannerError
        If there is something at the path already, or it can't be written.
    """
    target = Path(path)
    bag_format = FORMAT_OF_SUFFIX.get(target.suffix, "mcap")
    types = known_types(bag_format).types
    empty = np.empty(0)
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=trajectory.positions[step],
            velocities=trajectory.velocities[step],
            accelerations=trajectory.accelerations[step],
            effort=empty if trajectory.efforts is None else trajectory.efforts[step],
            time_from_start=types["builtin_interfaces/msg/Duration"](
                *divmod(round(float(time) * NS_PER_S), NS_PER_S)
            ),
        )
        for step, time in enumerate(trajectory.times)
    ]
    message = types[JOINT_TRAJECTORY](_header(bag_format, 0), list(trajectory.joint_names), points)
    _write(target, bag_format, "/joint_trajectory", JOINT_TRAJECTORY, [(0, message)], overwrite)


def write_stored_states(path: Path, topic: str, messages: Iterable[tuple[int, bytes]]) -> None:
    """Write serialised joint states (CDR) as an .mcap file, in place of an existing one.

    Parameters
    ----------
    path, topic :
        The file, and the topic of the joint states.
    messages :
        The messages with their times of reception [ns].

    Raises
    ------
    PlannerError
        If the file can't be written.
    """
    _write(path, "mcap", topic, JOINT_STATE, messages, overwrite=True)


def _write(
    target: Path,
    bag_format: BagFormat,
    topic: str,
    kind: str,
    messages: Iterable[tuple[int, object]],
    overwrite: bool,
) -> None:
    """Write a bag under a temporary name and rename it when it is complete."""
    if not target.name or target.name == "..":
        raise RecordingError(f"'{target}' can't be written: give the name of a file or folder")
    if target.exists() and not overwrite:
        raise exists_already(target)
    if target.is_dir() and any(target.iterdir()) and recordings_in(target) != [target]:
        raise RecordingError(f"'{target}' is a folder, but not a recording: it is not overwritten")
    if bag_format == "sqlite3" and set(str(target.absolute())) & set("?#%"):
        raise RecordingError(
            f"'{target}' can't be written as sqlite3: choose a path without '?', '#' and '%'"
        )
    try:
        with workspace_beside(target) as workspace:
            written = _write_messages(workspace / target.name, bag_format, topic, kind, messages)
            put_in_place(written, target)
    except OSError as error:
        raise RecordingError(f"'{target}' can't be written: {error.strerror or error}") from None
