# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states as recorded, sliced from serialised messages into arrays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .byte_layout import ByteLayout, Bytes, read_layout

IntArray = NDArray[np.int64]

PART_MESSAGES = 4096
PART_BYTES = 4 << 20
"""Serialised joint states are kept until there are this many messages or bytes."""

MAX_LAYOUTS = 8
"""Layouts of messages of one size that are searched for others like them; where messages have more
layouts, slicing many at once gains nothing."""


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


def joined(parts: Iterable[RawJointStates]) -> RawJointStates:
    """Put parts of a recording together, in their order."""
    given = list(parts)
    if len(given) == 1:
        return given[0]
    firsts = np.cumsum([0, *(part.n_messages for part in given)])
    found: dict[tuple[str, ...], list[JointLayout]] = {}
    for first, part in zip(firsts, given, strict=False):
        for layout in part.layouts:
            shifted = replace(layout, messages=first + layout.messages)
            found.setdefault(layout.joint_names, []).append(shifted)
    return replace(
        given[-1],
        header_stamps=np.concatenate([part.header_stamps for part in given]),
        receive_stamps=np.concatenate([part.receive_stamps for part in given]),
        layouts=tuple(_concatenated(names, own) for names, own in found.items()),
        n_malformed=sum(part.n_malformed for part in given),
    )


def _concatenated(names: tuple[str, ...], parts: Sequence[JointLayout]) -> JointLayout:
    velocities = None
    if any(part.velocities is not None for part in parts):
        velocities = np.concatenate(
            [
                np.full(part.positions.shape, np.nan, dtype=np.float32)
                if part.velocities is None
                else part.velocities
                for part in parts
            ]
        )
    return JointLayout(
        names,
        np.concatenate([part.messages for part in parts]),
        np.concatenate([part.positions for part in parts]),
        velocities,
    )


def slice_in_parts(
    topic: str, messages: Iterable[tuple[object, int, bytes]], *, ros1: bool
) -> Iterator[RawJointStates]:
    """Slice joint states part by part, so that not all of them are in memory as messages.

    Parameters
    ----------
    topic, ros1 :
        See :func:`slice_joint_states`.
    messages :
        Iterable of times of reception [ns] and serialised messages.

    Yields
    ------
    :
        The parts, at least one.
    """
    stamps: list[int] = []
    waiting: list[bytes] = []
    n_bytes = n_parts = 0
    for _, stamp, message in messages:
        stamps.append(stamp)
        waiting.append(message)
        n_bytes += len(message)
        if len(waiting) >= PART_MESSAGES or n_bytes >= PART_BYTES:
            yield slice_joint_states(topic, stamps, waiting, ros1=ros1)
            stamps, waiting, n_bytes = [], [], 0
            n_parts += 1
    if waiting or not n_parts:
        yield slice_joint_states(topic, stamps, waiting, ros1=ros1)


def slice_joint_states(
    topic: str, receive_stamps: Sequence[int], messages: Sequence[bytes], *, ros1: bool
) -> RawJointStates:
    """Slice the numbers out of serialised joint states.

    Parameters
    ----------
    topic :
        Name of their topic.
    receive_stamps :
        Times of reception [ns].
    messages :
        CDR of ROS 2 with its encapsulation, or the serialisation of ROS 1.
    ros1 :
        Which of them.

    Raises
    ------
    ValueError
        If a message is not a joint state.
    """
    stamps = np.zeros(len(messages), dtype=np.int64)
    n_malformed = 0
    found: dict[tuple[str, ...], list[JointLayout]] = {}
    for layout, rows, alike in _alike(messages, ros1):
        stamps[rows] = layout.stamps(alike)
        if layout.is_well_formed:
            found.setdefault(layout.joint_names, []).append(_sliced(layout, rows, alike))
        else:
            n_malformed += rows.size
    layouts = [_in_order(_concatenated(names, own)) for names, own in found.items()]
    return RawJointStates(
        topic=topic,
        header_stamps=stamps,
        receive_stamps=np.array(receive_stamps, dtype=np.int64),
        layouts=tuple(sorted(layouts, key=lambda layout: int(layout.messages[0]))),
        n_malformed=n_malformed,
    )


def _alike(messages: Sequence[bytes], ros1: bool) -> Iterator[tuple[ByteLayout, IntArray, Bytes]]:
    """Layouts, the rows of the messages that have them, and the bytes of these messages."""
    sizes = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    for size in np.unique(sizes):
        rows = np.flatnonzero(sizes == size)
        block = np.frombuffer(b"".join([messages[row] for row in rows.tolist()]), dtype=np.uint8)
        block = block.reshape(rows.size, -1)
        n_layouts = 0
        while rows.size:
            layout = read_layout(messages[int(rows[0])], ros1=ros1)
            n_layouts += 1
            if n_layouts > MAX_LAYOUTS:
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


def _in_order(layout: JointLayout) -> JointLayout:
    """The messages of a layout as received; no velocities where none is a number."""
    order = np.argsort(layout.messages)
    velocities = layout.velocities
    if velocities is not None:
        velocities = None if np.isnan(velocities).all() else velocities[order]
    return JointLayout(
        layout.joint_names, layout.messages[order], layout.positions[order], velocities
    )
