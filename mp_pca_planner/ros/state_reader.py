# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Reads serialised joint states, hardly ever by deserialising them.

A robot waits while its state is read, and rclpy takes longer to make a message object than NumPy to
slice the numbers out of messages that are alike but for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState as JointStateMessage

from ..exceptions import GoalError
from ..files import reading
from ..motion.goal import JointState
from ..recordings.byte_layout import ByteLayout, find_layout
from .messages import to_state

# Bytes of the encapsulation and the stamp; all before the first name is the same in the next
# message of the same publisher.
_STAMP, _STAMP_END = 4, 12
# Encapsulations of version 1, big- and little-endian: in others numbers are aligned otherwise.
_PLAIN_CDR = (bytes([0, 0]), bytes([0, 1]))
# Larger messages are not read [bytes]: a state of a thousand joints has a quarter of that.
_MAX_BYTES = 2**18
# Publishers whose names are remembered.
_MOST_BLOCKS = 16


class _Alike(NamedTuple):
    """Messages that differ from an accepted one in their numbers only.

    Attributes
    ----------
    joint_names : tuple of str
        The joints to read.
    columns : list of int
        Where they are among those of the message.
    layout : ByteLayout
        Where the numbers are.
    same : list of (slice, bytes)
        What is the same in all messages.
    """

    joint_names: tuple[str, ...]
    columns: list[int]
    layout: ByteLayout
    same: list[tuple[slice, bytes]]

    def state(self, message: bytes, joint_names: tuple[str, ...]) -> JointState | None:
        """The state, if the message is one of these and its numbers are finite."""
        if (
            self.joint_names != joint_names
            or len(message) != self.layout.template.size
            or any(message[part] != same for part, same in self.same)
        ):
            return None
        one = np.frombuffer(message, dtype=np.uint8)[None]
        q = self.layout.positions(one)[0, self.columns]
        v = self.layout.velocities(one)
        v = np.zeros_like(q) if v is None else v[0, self.columns]
        # What is wrong is said of messages that are deserialised.
        return JointState(joint_names, q, v) if np.isfinite(q + v).all() else None


def _find_alike(message: bytes, joint_names: tuple[str, ...]) -> _Alike | None:
    layout = find_layout(message, ros1=False)
    if layout is None or not message.startswith(_PLAIN_CDR):
        return None
    columns = [layout.joint_names.index(name) for name in joint_names]
    same = [(part, message[part]) for part in layout.fixed]
    return _Alike(joint_names, columns, layout, same)


class SerializedStateReader:
    """Reads the joint states of a few publishers that each send the same joints again and again.

    A robot sends a thousand states a second, of which a goal needs one.
    """

    def __init__(self) -> None:
        self._joint_names: tuple[str, ...] = ()
        self._blocks: list[tuple[bytes, bool]] = []
        self._alike: _Alike | None = None

    def names_all(self, message: bytes, joint_names: Sequence[str]) -> bool:
        """Whether the message has all of these joints; a malformed one has none."""
        if self._joint_names != tuple(joint_names):
            self._joint_names, self._blocks = tuple(joint_names), []
        for block, verdict in self._blocks:
            if message.startswith(block, _STAMP_END):
                return verdict
        if not _STAMP_END <= len(message) <= _MAX_BYTES:
            return False
        try:
            with reading("a state", GoalError):
                return self._learn(message)
        except GoalError:
            return False

    def read(self, message: bytes, joint_names: Sequence[str]) -> JointState:
        """Read the state of these joints.

        Raises
        ------
        GoalError
            See :func:`.to_state`.
        """
        names = tuple(joint_names)
        state = None if self._alike is None else self._alike.state(message, names)
        if state is None:
            with reading("the present state", GoalError):
                state = to_state(deserialize_message(message, JointStateMessage), names)
                self._alike = _find_alike(message, names)
        return state

    def stamp(self, message: bytes) -> float:
        """When the state was measured by the clock of the robot [s]; 0 if it isn't said."""
        order: Literal["little", "big"] = "little" if message[1] & 1 else "big"
        seconds = int.from_bytes(message[_STAMP : _STAMP + 4], order, signed=True)
        return seconds + int.from_bytes(message[_STAMP + 4 : _STAMP_END], order) * 1e-9

    def _learn(self, message: bytes) -> bool:
        names = deserialize_message(message, JointStateMessage).name
        verdict = set(self._joint_names).issubset(names)
        if message.startswith(_PLAIN_CDR):
            block = message[_STAMP_END : _end_of_names(message)]
            self._blocks = [*self._blocks[1 - _MOST_BLOCKS :], (block, verdict)]
        return verdict


def _end_of_names(message: bytes) -> int:
    """Where the names end in a well-formed message."""
    order: Literal["little", "big"] = "little" if message[1] & 1 else "big"

    def behind_text(start: int) -> int:
        start += -start % 4
        return start + 4 + int.from_bytes(message[start : start + 4], order)

    # The encapsulation is four bytes long, so alignment counts from the start as well.
    place = behind_text(_STAMP_END)
    place += -place % 4
    n_names = int.from_bytes(message[place : place + 4], order)
    place += 4
    for _ in range(n_names):
        place = behind_text(place)
    return place
