# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Reader of serialised joint states that deserialises few of them.

A goal waits while states are read. NumPy slices the numbers out of a serialised message several
times faster than rclpy makes a message object of it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState as JointStateMessage

from ..exceptions import GoalError
from ..files import reading
from ..motion.goal import JointState
from ..recordings.byte_layout import ENCAPSULATION, ByteLayout, find_layout
from .messages import to_state

# Encapsulations of version 1, big- and little-endian; others align numbers differently.
_PLAIN_CDR = (b"\x00\x00", b"\x00\x01")
# Larger messages are not read [bytes]: a state of a thousand joints has a quarter of that.
_MAX_BYTES = 2**18


@dataclass(frozen=True, eq=False)
class _KnownLayout:
    """A layout, and the bytes that are the same in all its messages."""

    layout: ByteLayout
    size: int
    fixed: list[tuple[slice, bytes]]

    def fits(self, message: bytes) -> bool:
        """Whether the message has this layout."""
        return len(message) == self.size and all(message[part] == b for part, b in self.fixed)

    def state(self, message: bytes, joint_names: tuple[str, ...]) -> JointState | None:
        """The state of these joints; None if one is missing or a number is not finite."""
        try:
            columns = [self.layout.joint_names.index(name) for name in joint_names]
        except ValueError:
            return None
        one = np.frombuffer(message, dtype=np.uint8)[None]
        q = self.layout.positions(one)[0, columns]
        v = self.layout.velocities(one)
        v = np.zeros_like(q) if v is None else v[0, columns]
        return JointState(joint_names, q, v) if np.isfinite(q + v).all() else None


class SerializedStateReader:
    """Reads the joint states of a few publishers, each of which sends the same joints every time.

    A robot publishes up to a thousand states a second; a goal needs few of them.
    """

    def __init__(self) -> None:
        # Layouts of the messages of a few publishers.
        self._layouts: deque[_KnownLayout] = deque(maxlen=16)

    def names_all(self, message: bytes, joint_names: Sequence[str]) -> bool:
        """Whether the message has all of these joints; a malformed one has none."""
        if not ENCAPSULATION <= len(message) <= _MAX_BYTES:
            return False
        known = self._known(message)
        if known is not None:
            return set(joint_names).issubset(known.layout.joint_names)
        try:
            with reading("a state", GoalError):
                names = deserialize_message(message, JointStateMessage).name
        except GoalError:
            return False
        return set(joint_names).issubset(names)

    def read(self, message: bytes, joint_names: Sequence[str]) -> JointState:
        """Read the state of these joints.

        Raises
        ------
        GoalError
            See :func:`.to_state`.
        """
        names, known = tuple(joint_names), self._known(message)
        state = None if known is None else known.state(message, names)
        if state is None:
            # The conversion of a message object reports the error.
            with reading("the present state", GoalError):
                state = to_state(deserialize_message(message, JointStateMessage), names)
        return state

    def stamp(self, message: bytes) -> float:
        """When the state was measured by the clock of the robot [s]; 0 if the message has none."""
        order: Literal["little", "big"] = "little" if message[1] & 1 else "big"
        seconds, nanoseconds = message[ENCAPSULATION:][:4], message[ENCAPSULATION + 4 :][:4]
        return (
            int.from_bytes(seconds, order, signed=True) + int.from_bytes(nanoseconds, order) * 1e-9
        )

    def _known(self, message: bytes) -> _KnownLayout | None:
        """The layout of a message; None if it is not well-formed."""
        for known in list(self._layouts):
            if known.fits(message):
                return known
        layout = find_layout(message, ros1=False) if message.startswith(_PLAIN_CDR) else None
        if layout is None:
            return None
        try:
            with reading("a state", GoalError):
                velocities = deserialize_message(message, JointStateMessage).velocity
        except GoalError:
            return None
        if len(velocities) not in (0, len(layout.joint_names)):
            return None
        fixed = [(part, message[part]) for part in layout.fixed]
        known = _KnownLayout(layout, len(message), fixed)
        self._layouts.append(known)
        return known
