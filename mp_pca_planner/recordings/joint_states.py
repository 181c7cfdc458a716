# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states as recorded, sliced from serialised messages into arrays.

Messages of one publisher differ in their stamp and their numbers only: all else (names, lengths,
frame) has the same bytes at the same places. A layout is taken from one message and applied to
those whose other bytes are equal. This is measured to be five times as fast as deserialising.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

Bytes = NDArray[np.uint8]

ENCAPSULATION = 4
"""Bytes before a message in CDR; alignment is relative to their end. ROS 1 has neither."""

NS_PER_S = 1_000_000_000
"""Nanoseconds in a second."""


@dataclass(frozen=True, eq=False)
class ByteLayout:
    """Places of the numbers in serialised joint states with the same joints.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints.
    template : array of uint8, shape (size,)
        The message that the layout was taken from.
    fixed : tuple of slice
        Which bytes are the same in every message of the layout; padding is excluded, because its
        content is arbitrary.
    stamp, position, velocity : int
        Where the header's stamp and the numbers of these fields start; `velocity` is None unless
        there is one for each joint.
    is_well_formed : bool
        Whether no name is listed twice, and there is one position for each.
    byte_order : str
        "<" or ">".
    """

    joint_names: tuple[str, ...]
    template: Bytes
    fixed: tuple[slice, ...]
    stamp: int
    position: int
    velocity: int | None
    is_well_formed: bool
    byte_order: str

    def fits(self, messages: Bytes) -> NDArray[np.bool_]:
        """Whether each message has this layout.

        Parameters
        ----------
        messages : array of uint8, shape (n_messages, size)
            Serialised messages.
        """
        fitting = np.ones(len(messages), dtype=bool)
        for part in self.fixed:
            fitting &= np.all(messages[:, part] == self.template[part], axis=1)
        return fitting

    def stamps(self, messages: Bytes) -> NDArray[np.int64]:
        """Header stamps [ns], shape (n_messages,)."""
        seconds = self._numbers(messages, self.stamp, "i4", 1)
        nanoseconds = self._numbers(messages, self.stamp + 4, "u4", 1)
        stamps: NDArray[np.int64] = seconds.astype(np.int64) * NS_PER_S + nanoseconds
        return stamps[:, 0]

    def positions(self, messages: Bytes) -> FloatArray:
        """Joint positions [rad or m], shape (n_messages, n_joints)."""
        return self._numbers(messages, self.position, "f8", len(self.joint_names))

    def velocities(self, messages: Bytes) -> FloatArray | None:
        """Joint velocities [/s], shape (n_messages, n_joints), if there are any."""
        if self.velocity is None:
            return None
        return self._numbers(messages, self.velocity, "f8", len(self.joint_names))

    def _numbers(self, messages: Bytes, start: int, kind: str, count: int) -> NDArray[Any]:
        dtype = np.dtype(self.byte_order + kind)
        part = np.ascontiguousarray(messages[:, start : start + count * dtype.itemsize])
        return part.view(dtype).astype(dtype.newbyteorder("="), copy=False)


def most_spare_bytes(n_empty: int) -> int:
    """Largest number of bytes behind a message in CDR.

    It is padded to words of four bytes, and `rclpy.serialization` keeps room to align what each of
    `n_empty` empty sequences of numbers does not hold.
    """
    return 3 + 8 * n_empty


def read_layout(message: bytes, *, ros1: bool) -> ByteLayout:
    """Read the layout of a serialised joint state.

    Parameters
    ----------
    message :
        CDR of ROS 2 with its encapsulation, or the serialisation of ROS 1.
    ros1 :
        Which of them.

    Raises
    ------
    ValueError
        If it is not a serialised joint state.
    """
    cursor = _Cursor(message, ros1)
    try:
        if ros1:
            cursor.position += 4
        stamp = cursor.position
        cursor.position += 8
        cursor.string()
        names = tuple(cursor.string() for _ in range(cursor.length()))
        position, n_positions = cursor.doubles()
        velocity, n_velocities = cursor.doubles()
        _, n_efforts = cursor.doubles()
    except struct.error as error:
        raise ValueError(f"a joint state is cut off: {error}") from None
    n_empty = (n_positions, n_velocities, n_efforts).count(0)
    spare = len(message) - cursor.position
    if not 0 <= spare <= (0 if ros1 else most_spare_bytes(n_empty)):
        raise ValueError(f"size mismatch: {spare} bytes follow a joint state")
    return ByteLayout(
        joint_names=names,
        template=np.frombuffer(message, dtype=np.uint8),
        fixed=tuple(slice(*span) for span in cursor.fixed),
        stamp=stamp,
        position=position,
        velocity=velocity if n_velocities == len(names) else None,
        is_well_formed=n_positions == len(names) == len(set(names)),
        byte_order=cursor.byte_order,
    )


class _Cursor:
    """Parses a message and records the offsets of its fields."""

    def __init__(self, message: bytes, ros1: bool) -> None:
        if not ros1 and message[:2] not in (b"\x00\x00", b"\x00\x01"):
            raise ValueError("a joint state is not in CDR")
        self._message = message
        self._ros1 = ros1
        self.byte_order = "<" if ros1 or message[1:2] == b"\x01" else ">"
        self.position = 0 if ros1 else ENCAPSULATION
        self.fixed = [] if ros1 else [(0, 2)]

    def length(self) -> int:
        self._align(4)
        (value,) = struct.unpack_from(self.byte_order + "I", self._message, self.position)
        self._keep(4)
        return int(value)

    def string(self) -> str:
        size = self.length()
        start = self.position
        if start + size > len(self._message):
            raise struct.error("the string ends behind the message")
        self._keep(size)
        if self._ros1:
            return self._message[start : start + size].decode()
        # In CDR a zero that counts ends the string.
        if size == 0 or self._message[start + size - 1]:
            raise ValueError("a text in a joint state does not end with a zero")
        return self._message[start : start + size - 1].decode()

    def doubles(self) -> tuple[int, int]:
        """Where a list of numbers starts, and how many there are."""
        count = self.length()
        if count:
            self._align(8)
        start = self.position
        self.position += 8 * count
        return start, count

    def _align(self, size: int) -> None:
        if not self._ros1:
            self.position += (ENCAPSULATION - self.position) % size

    def _keep(self, size: int) -> None:
        start, self.position = self.position, self.position + size
        # Spans that touch each other are joined: comparing a few long ones is faster.
        if self.fixed and self.fixed[-1][1] == start:
            start, _ = self.fixed.pop()
        self.fixed.append((start, self.position))


IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class JointLayout:
    """The messages that list the same joints in the same order.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints as in the messages.
    messages : array of int, shape (n_messages,)
        Which messages of the topic they are, increasing.
    positions : array, shape (n_messages, n_joints)
        Joint positions as recorded [rad or m]; may hold NaN.
    velocities : array of float32, shape (n_messages, n_joints), or None
        Joint velocities as recorded [/s], NaN in messages that have not one for each joint;
        None if no message has. They are compared with the positions, and not used otherwise.
    """

    joint_names: tuple[str, ...]
    messages: IntArray
    positions: FloatArray
    velocities: NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class RawJointStates:
    """Everything a topic of joint states holds, as recorded, in the order of reception.

    Attributes
    ----------
    topic : str
        Name of the topic.
    header_stamps, receive_stamps : array of int, shape (n_messages,)
        Time in the header (0: not set) and time of reception of each message [ns].
    layouts : tuple of JointLayout
        The messages, grouped by the joints they list, in the order of first appearance.
    n_malformed : int
        Messages that belong to no layout: as many positions as names are missing, or a name
        is listed twice.
    notes : tuple of str
        Notes on the reading, one sentence each.
    computed : bool
        Whether they were computed from other messages, which have no velocities to be checked.
    """

    topic: str
    header_stamps: IntArray
    receive_stamps: IntArray
    layouts: tuple[JointLayout, ...]
    n_malformed: int
    notes: tuple[str, ...] = ()
    computed: bool = False

    @property
    def n_messages(self) -> int:
        """Number of messages."""
        return int(self.header_stamps.size)

    @property
    def listed_joints(self) -> tuple[str, ...]:
        """All joints that messages list, in the order of first appearance."""
        return listed_names(layout.joint_names for layout in self.layouts)


def listed_names(names: Iterable[Sequence[str]]) -> tuple[str, ...]:
    """All names of several lists, in the order of first appearance."""
    return tuple(dict.fromkeys(name for own in names for name in own))


def slice_joint_states(
    topic: str,
    messages: Iterable[tuple[object, int, bytes]],
    *,
    ros1: bool,
    part_messages: int = 4096,
    part_bytes: int = 4 << 20,
) -> RawJointStates:
    """Slice the numbers out of serialised joint states.

    Parameters
    ----------
    topic :
        Name of their topic.
    messages :
        Anything, times of reception [ns], and CDR of ROS 2 with its encapsulation or the
        serialisation of ROS 1.
    ros1 :
        Which of them.
    part_messages, part_bytes :
        Messages are kept in memory until there are this many of them or of their bytes.

    Raises
    ------
    ValueError
        If a message is not a joint state.
    """
    headers, received = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    found: dict[tuple[str, ...], list[JointLayout]] = {}
    n_done = n_malformed = 0
    for stamps, part in _parts(messages, part_messages, part_bytes):
        received.append(np.array(stamps, dtype=np.int64))
        headers.append(np.zeros(len(part), dtype=np.int64))
        for layout, rows, alike in _alike(part, ros1):
            headers[-1][rows] = layout.stamps(alike)
            if layout.is_well_formed:
                own = _sliced(layout, n_done + rows, alike)
                found.setdefault(layout.joint_names, []).append(own)
            else:
                n_malformed += rows.size
        n_done += len(part)
    layouts = [_joined(names, own) for names, own in found.items()]
    return RawJointStates(
        topic=topic,
        header_stamps=np.concatenate(headers),
        receive_stamps=np.concatenate(received),
        layouts=tuple(sorted(layouts, key=lambda layout: int(layout.messages[0]))),
        n_malformed=n_malformed,
    )


def joined(first: RawJointStates, second: RawJointStates) -> RawJointStates:
    """Joint states of a topic, followed by later ones of the same topic."""
    found: dict[tuple[str, ...], list[JointLayout]] = {}
    for part, n_before in ((first, 0), (second, first.n_messages)):
        for layout in part.layouts:
            shifted = replace(layout, messages=n_before + layout.messages)
            found.setdefault(layout.joint_names, []).append(shifted)
    return replace(
        second,
        header_stamps=np.concatenate([first.header_stamps, second.header_stamps]),
        receive_stamps=np.concatenate([first.receive_stamps, second.receive_stamps]),
        layouts=tuple(_joined(names, own) for names, own in found.items()),
        n_malformed=first.n_malformed + second.n_malformed,
    )


def _parts(
    messages: Iterable[tuple[object, int, bytes]], part_messages: int, part_bytes: int
) -> Iterator[tuple[list[int], list[bytes]]]:
    stamps: list[int] = []
    waiting: list[bytes] = []
    n_bytes = 0
    for _, stamp, message in messages:
        stamps.append(stamp)
        waiting.append(message)
        n_bytes += len(message)
        if len(waiting) >= part_messages or n_bytes >= part_bytes:
            yield stamps, waiting
            stamps, waiting, n_bytes = [], [], 0
    if waiting:
        yield stamps, waiting


def _alike(
    messages: Sequence[bytes], ros1: bool, max_layouts: int = 8
) -> Iterator[tuple[ByteLayout, IntArray, Bytes]]:
    """Layouts, the rows of the messages that have them, and the bytes of these messages.

    Where messages of one size have more than `max_layouts`, slicing many at once gains nothing.
    """
    sizes = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    for size in np.unique(sizes):
        rows = np.flatnonzero(sizes == size)
        block = np.frombuffer(b"".join([messages[row] for row in rows.tolist()]), dtype=np.uint8)
        block = block.reshape(rows.size, -1)
        n_layouts = 0
        while rows.size:
            layout = read_layout(messages[int(rows[0])], ros1=ros1)
            n_layouts += 1
            if n_layouts > max_layouts:
                yield layout, rows[:1], block[:1]
                rows, block = rows[1:], block[1:]
                continue
            fitting = layout.fits(block)
            if fitting.all():
                yield layout, rows, block
                break
            yield layout, rows[fitting], block[fitting]
            rows, block = rows[~fitting], block[~fitting]


def _sliced(layout: ByteLayout, rows: IntArray, messages: Bytes) -> JointLayout:
    velocities = layout.velocities(messages)
    # Values beyond the range of float32 become infinite; they are no valid velocities in any case.
    with np.errstate(over="ignore", invalid="ignore"):
        checked = None if velocities is None else velocities.astype(np.float32)
    return JointLayout(layout.joint_names, rows, layout.positions(messages), checked)


def _joined(names: tuple[str, ...], parts: Sequence[JointLayout]) -> JointLayout:
    """All messages of a layout as received; no velocities where none is a number."""
    messages = np.concatenate([part.messages for part in parts])
    positions = np.concatenate([part.positions for part in parts])
    velocities = None
    if any(part.velocities is not None for part in parts):
        shapes = [part.positions.shape for part in parts]
        velocities = np.full((len(messages), shapes[0][1]), np.nan, dtype=np.float32)
        for part, end in zip(parts, np.cumsum([n for n, _ in shapes]), strict=True):
            if part.velocities is not None:
                velocities[end - len(part.velocities) : end] = part.velocities
        if np.isnan(velocities).all():
            velocities = None
    # Copies are avoided, since the arrays may be large.
    if np.any(np.diff(messages) < 0):
        order = np.argsort(messages)
        messages, positions = messages[order], positions[order]
        velocities = None if velocities is None else velocities[order]
    return JointLayout(names, messages, positions, velocities)
