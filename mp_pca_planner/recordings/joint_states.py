# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states as recorded, sliced from serialised messages into arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .byte_layout import ByteLayout, Bytes, read_layout

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
    progress: Callable[[int], None] = lambda n_done: None,
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
    progress :
        Called with the number of messages done.
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
        progress(n_done)
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
