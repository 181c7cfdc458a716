# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Serialised messages: checked before rclpy reads them, or read and written by NumPy.

rclpy reads a message in one call that stops all threads of the process. It makes room for as many
items as the message states: a damaged length took 4 s and 3 GB. It makes an object of each point:
reading 100,000 points takes 0.2 s. Writing takes 25 times as long as here: for 100 points of 7
joints 0.75 instead of 0.03 ms, for 300 points up to 10 ms.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import (
    AbstractSequence,
    AbstractString,
    Array,
    BasicType,
    NamespacedType,
)
from trajectory_msgs.msg import JointTrajectory

from ..arrays import FloatArray
from ..exceptions import TrajectoryError, WorldError
from ..motion.trajectory import Trajectory
from ..recordings.joint_states import ENCAPSULATION, NS_PER_S


def read_message(content: bytes, message_type: Any) -> Any:
    """Deserialise a message whose lengths fit into it.

    Raises
    ------
    ValueError
        If they don't.
    """
    CdrReader(content).skip(_layout(message_type))
    return deserialize_message(content, message_type)


# Numbers of a size [bytes] in a message; or the length of a sequence, with the parts of its items.
_Part = tuple[int, tuple["_Part", ...]]


_ORDERS = {b"\0\0": ">", b"\0\1": "<"}  # of bytes, by the start of a message in CDR
_BYTES = {kind: struct.calcsize(f"={kind}") for kind in "?iI"}
_LENGTH = 4  # bytes of the length of a sequence
_SIZES = {"int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "float": 4}
_SIZES |= {"int64": 8, "uint64": 8, "double": 8}


@lru_cache
def _layout(message_type: Any) -> tuple[_Part, ...]:
    """The parts of a message; one without fields has a byte."""
    return tuple(part for kind in message_type.SLOT_TYPES for part in _parts(kind)) or ((1, ()),)


def _parts(kind: Any) -> tuple[_Part, ...]:
    if isinstance(kind, BasicType):
        return ((_SIZES.get(kind.typename, 1), ()),)
    if isinstance(kind, Array):
        return kind.size * _parts(kind.value_type)
    if isinstance(kind, AbstractString):
        return ((_LENGTH, ((1, ()),)),)
    if isinstance(kind, AbstractSequence):
        return ((_LENGTH, _parts(kind.value_type)),)
    if isinstance(kind, NamespacedType):
        return _layout(getattr(import_module(".".join(kind.namespaces)), kind.name))
    raise TypeError(f"messages with {kind!r} are not received")


class CdrReader:
    """Reads one value after the other from a message in CDR.

    Whatever is malformed raises a `ValueError`.

    Parameters
    ----------
    content : bytes
        The message.
    """

    def __init__(self, content: bytes) -> None:
        if len(content) < ENCAPSULATION:
            raise ValueError(f"it has {len(content)} bytes, at least {ENCAPSULATION} are needed")
        if content[:2] not in _ORDERS:
            raise ValueError("it is not in plain CDR")
        self._content, self._order = content, _ORDERS[content[:2]]
        self._place = ENCAPSULATION

    def skip(self, parts: tuple[_Part, ...]) -> None:
        """Pass the parts of a message, or of an item."""
        for size, items in parts:
            if not items:
                self._pass(size, 1)
                continue
            n = self.count(sum(least for least, _ in items))
            (first, inner), *others = items
            if not (inner or others):
                self._pass(first, n)
                continue
            for _ in range(n):
                self.skip(items)

    def count(self, least_bytes: int) -> int:
        """The length of a sequence, whose items have this many bytes at least."""
        (n,) = self.numbers("I")
        if n * least_bytes > len(self._content) - self._place + least_bytes:
            raise ValueError(f"it is too short for {n} items")
        return int(n)

    def numbers(self, kinds: str) -> tuple[Any, ...]:
        """Numbers of the same size, by their characters in `struct`."""
        size = _BYTES[kinds[0]]
        self._align(size)
        try:
            found = struct.unpack_from(self._order + kinds, self._content, self._place)
        except struct.error:
            raise ValueError(f"it ends within its {len(self._content)} bytes") from None
        self._place += size * len(kinds)
        return found

    def text(self) -> str:
        """A string."""
        n = self.count(1)
        begin, self._place = self._place, self._place + n
        return self._content[begin : self._place].rstrip(b"\0").decode()

    def array(self, kind: str, n: int) -> FloatArray:
        """Numbers of a type of NumPy."""
        if not n:
            return np.zeros(0)
        size = int(kind[1])
        self._align(size)
        numbers = np.frombuffer(self._content, self._order + kind, n, self._place)
        self._place += size * n
        return numbers.astype(float) if kind == "f8" else numbers

    def _pass(self, size: int, n: int) -> None:
        if n:
            self._align(size)
            self._place += n * size
            if self._place > len(self._content):
                raise ValueError(f"it ends within its {len(self._content)} bytes")

    def _align(self, size: int) -> None:
        self._place += (ENCAPSULATION - self._place) % size


@dataclass(frozen=True, eq=False)
class MarkerData:
    """The fields of a visualization_msgs/Marker that describe an obstacle.

    Attributes
    ----------
    frame_id, ns, id, type, action, mesh_resource
        As in the message.
    pose : array, shape (7,)
        Position [m] and quaternion (x, y, z, w).
    scale : array, shape (3,)
        Sizes [m], or factors.
    lifetime : float
        Time after which the marker is deleted [s]; 0: never.
    points : array, shape (n_points, 3)
        Points in the frame of the pose [m].
    """

    frame_id: str
    ns: str
    id: int
    type: int
    action: int
    pose: FloatArray
    scale: FloatArray
    lifetime: float
    points: FloatArray
    mesh_resource: str

    @property
    def name(self) -> str:
        """The name of its obstacle: its namespace and number."""
        return f"{self.ns}/{self.id}" if self.ns else f"marker {self.id}"


def read_markers(content: bytes) -> list[MarkerData]:
    """The markers of a serialised visualization_msgs/MarkerArray.

    Raises
    ------
    WorldError
        If the message is malformed.
    """
    try:
        reader = CdrReader(content)
        return [_marker(reader) for _ in range(reader.count(_LEAST_BYTES))]
    except ValueError as error:
        raise WorldError(f"the message of markers is malformed: {error}") from None


# Of a marker without names, points and images.
_LEAST_BYTES = 200


def _marker(reader: CdrReader) -> MarkerData:
    reader.numbers("iI")  # stamp
    frame, namespace = reader.text(), reader.text()
    number, kind, action = reader.numbers("iii")
    pose, scale = reader.array("f8", 7), reader.array("f8", 3)
    reader.array("f4", 4)  # colour
    seconds, nanoseconds = reader.numbers("iI")
    reader.numbers("?")  # frame_locked
    points = reader.array("f8", 3 * reader.count(24)).reshape(-1, 3)
    reader.array("f4", 4 * reader.count(16))  # colours
    reader.text()  # texture
    reader.numbers("iI")
    reader.text()
    reader.text()
    reader.array("u1", reader.count(1))
    reader.array("f4", 2 * reader.count(8))  # its coordinates
    reader.text()
    mesh = reader.text()
    reader.text()  # embedded mesh
    reader.array("u1", reader.count(1))
    reader.numbers("?")
    lifetime = seconds + 1e-9 * nanoseconds
    return MarkerData(frame, namespace, number, kind, action, pose, scale, lifetime, points, mesh)


def serialize_trajectory(
    trajectory: Trajectory,
    *,
    with_efforts: bool,
    stamp: float | None = None,
    last_point_only: bool = False,
) -> bytes:
    """Serialise a trajectory.

    Parameters
    ----------
    trajectory : Trajectory
        The trajectory.
    with_efforts : bool
        Whether points carry efforts.
    stamp : float or None
        When its first point is commanded [s]; None: when the controller receives it.
    last_point_only : bool
        Writes only the last point, to which the controller moves from its present command.

    Returns
    -------
    :
        A serialised ``trajectory_msgs/JointTrajectory`` (XCDR version 1).

    Raises
    ------
    TrajectoryError
        If efforts are requested and the trajectory has none, or points are less than 1 ns apart.
    """
    efforts = trajectory.efforts if with_efforts else None
    if with_efforts and efforts is None:
        raise TrajectoryError("the trajectory has no efforts to publish")
    stamps = np.rint(trajectory.times * NS_PER_S).astype(np.int64)
    if np.any(np.diff(stamps) <= 0):
        raise TrajectoryError("points of a trajectory must be at least 1 ns apart")
    names = ("positions", "velocities", "accelerations")
    columns = dict(zip(names, trajectory.states, strict=True))
    if efforts is not None:
        columns["effort"] = efforts
    first = trajectory.n_steps - 1 if last_point_only else 0
    stamped = JointTrajectory(joint_names=list(trajectory.joint_names))
    since = stamped.header.stamp
    since.sec, since.nanosec = divmod(round((stamp or 0.0) * NS_PER_S), NS_PER_S)
    # Without points, a message ends with their number. It begins with the encapsulation (plain CDR,
    # little-endian), and alignment is relative to the end of that.
    head = serialize_message(stamped)
    encapsulation, message = head[:4], head[4:-4]
    message += (trajectory.n_steps - first).to_bytes(4, "little")
    # The start of a point determines the alignment of its fields; all but the first are equal.
    for part in (slice(first, first + 1), slice(first + 1, None)):
        kind = _point_type(len(message) % 8, trajectory.n_joints, with_efforts)
        points = np.zeros(len(stamps[part]), kind)
        for name, values in columns.items():
            points[f"n_{name}"] = trajectory.n_joints
            points[name] = values[part]
        points["sec"], points["nanosec"] = np.divmod(stamps[part], NS_PER_S)
        message += points.tobytes()
    return encapsulation + message


@lru_cache(maxsize=16)
def _point_type(start: int, n_joints: int, with_efforts: bool) -> np.dtype[np.void]:
    """Layout of a ``JointTrajectoryPoint`` that starts `start` bytes after the encapsulation."""
    count, numbers = np.dtype("<u4"), np.dtype(("<f8", (n_joints,)))
    fields: list[tuple[str, np.dtype[Any], int]] = []  # name, type, alignment
    for name in ("positions", "velocities", "accelerations", "effort"):
        fields.append((f"n_{name}", count, 4))
        if name != "effort" or with_efforts:
            fields.append((name, numbers, 8))
    fields += [("sec", np.dtype("<i4"), 4), ("nanosec", count, 4)]
    offsets, end = [], start
    for _, kind, alignment in fields:
        end += -end % alignment
        offsets.append(end - start)
        end += kind.itemsize
    names, formats, _ = zip(*fields, strict=True)
    return np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": end - start}
    )
