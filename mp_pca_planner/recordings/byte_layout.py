# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Places of the numbers in serialised joint states, for slicing many messages with NumPy.

Messages of one publisher differ in their stamp and their numbers only: all else (names, lengths,
frame) has the same bytes at the same places. A layout is taken from one message and applied to
those whose other bytes are equal. This is measured to be five times as fast as deserialising.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
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
