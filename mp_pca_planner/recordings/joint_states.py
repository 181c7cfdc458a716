# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states as recorded: the messages of a topic as arrays."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

ENCAPSULATION = 4
"""Bytes before a message in CDR; alignment is relative to their end."""

NS_PER_S = 1_000_000_000
"""Nanoseconds in a second."""

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


def collect_joint_states(topic: str, messages: Iterable[tuple[int, Any]]) -> RawJointStates:
    """Collect the numbers of joint states.

    Parameters
    ----------
    topic :
        Name of their topic.
    messages :
        Time of reception [ns] of each, and the ``sensor_msgs/JointState``.
    """
    headers, received = array("q"), array("q")
    # Of the messages with the same names: their indices, positions and velocities.
    found: dict[tuple[str, ...], tuple[array[int], array[float], array[float]]] = {}
    n_malformed = 0
    for stamp, message in messages:
        names, since = tuple(message.name), message.header.stamp
        headers.append(since.sec * NS_PER_S + since.nanosec)
        received.append(stamp)
        if len(message.position) != len(names) or len(set(names)) != len(names):
            n_malformed += 1
            continue
        own = found.setdefault(names, (array("q"), array("d"), array("d")))
        own[0].append(len(received) - 1)
        has_velocities = len(message.velocity) == len(names)
        own[1].extend(message.position)
        own[2].extend(message.velocity if has_velocities else [np.nan] * len(names))
    return RawJointStates(
        topic=topic,
        header_stamps=np.array(headers, dtype=np.int64),
        receive_stamps=np.array(received, dtype=np.int64),
        layouts=tuple(_layout(names, *own) for names, own in found.items()),
        n_malformed=n_malformed,
    )


def _layout(
    names: tuple[str, ...], rows: array[int], positions: array[float], velocities: array[float]
) -> JointLayout:
    shape = len(rows), len(names)
    # Values beyond the range of float32 become infinite; they are no valid velocities in any case.
    with np.errstate(over="ignore", invalid="ignore"):
        checked = np.array(velocities).astype(np.float32).reshape(shape)
    return JointLayout(
        names,
        np.array(rows, dtype=np.int64),
        np.array(positions, dtype=np.float64).reshape(shape),
        None if np.isnan(checked).all() else checked,
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


def _joined(names: tuple[str, ...], parts: Sequence[JointLayout]) -> JointLayout:
    """All messages of a layout; no velocities where no part has any."""
    velocities = None
    if any(part.velocities is not None for part in parts):
        unknown = [np.full(part.positions.shape, np.nan, np.float32) for part in parts]
        known = [part.velocities for part in parts]
        velocities = np.concatenate(
            [x if y is None else y for x, y in zip(unknown, known, strict=True)]
        )
    return JointLayout(
        names,
        np.concatenate([part.messages for part in parts]),
        np.concatenate([part.positions for part in parts]),
        velocities,
    )
