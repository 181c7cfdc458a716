# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Reads serialised joint states: which joints a message has is seen without deserialising it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState as JointStateMessage

from ..goal import JointState
from .messages import to_state

# Bytes of the encapsulation and the stamp; all before the first name is the same in the next
# message of the same publisher.
_STAMP_END = 12
# Publishers whose names are remembered.
_MOST_BLOCKS = 16


class SerializedStateReader:
    """Reads the joint states of a few publishers that each send the same joints again and again.

    A robot sends a thousand states a second, of which a goal needs one.
    """

    def __init__(self) -> None:
        self._joint_names: tuple[str, ...] = ()
        self._blocks: list[tuple[bytes, bool]] = []

    def names_all(self, message: bytes, joint_names: Sequence[str]) -> bool:
        """Whether the message has all of these joints."""
        if self._joint_names != tuple(joint_names):
            self._joint_names, self._blocks = tuple(joint_names), []
        for block, verdict in self._blocks:
            if message.startswith(block, _STAMP_END):
                return verdict
        return self._learn(message)

    def read(self, message: bytes, joint_names: Sequence[str]) -> JointState:
        """Read the state of these joints.

        Raises
        ------
        GoalError
            See :func:`.to_state`.
        """
        return to_state(deserialize_message(message, JointStateMessage), joint_names)

    def _learn(self, message: bytes) -> bool:
        names = deserialize_message(message, JointStateMessage).name
        verdict = set(self._joint_names).issubset(names)
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
