# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states as recorded, gathered from a stream of messages into flat arrays."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from .byte_layout import NS_PER_S, ByteLayout, Bytes, find_layout

IntArray = NDArray[np.int64]

BLOCK_MESSAGES = 8192
BLOCK_BYTES = 4 << 20
"""Messages are sliced together in blocks of as many messages or bytes, whatever comes first."""

MAX_LAYOUTS = 8
"""Layouts of messages of one size that are remembered; there is a message of another kind in
every block where that many don't suffice, and slicing would not be faster."""


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
        none if no message has. Nobody should trust them: they are kept to be checked.
    """

    joint_names: tuple[str, ...]
    messages: IntArray
    positions: FloatArray
    velocities: NDArray[np.float32] | None = None

    def rows(self, rows: slice, first_message: int) -> JointLayout:
        """Some of its messages, counted from the first one of a part."""
        return JointLayout(
            self.joint_names,
            self.messages[rows] - first_message,
            self.positions[rows],
            None if self.velocities is None else self.velocities[rows],
        )


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
        What is worth knowing about how they were read, one sentence each.
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

    def divided(self, place: int) -> tuple[RawJointStates, RawJointStates]:
        """The messages before and from a place; nobody knows where the malformed ones were."""
        before, behind = [], []
        for layout in self.layouts:
            n = int(np.searchsorted(layout.messages, place))
            before.append(layout.rows(slice(None, n), 0))
            behind.append(layout.rows(slice(n, None), place))
        return (
            replace(
                self,
                header_stamps=self.header_stamps[:place],
                receive_stamps=self.receive_stamps[:place],
                layouts=tuple(layout for layout in before if layout.messages.size),
            ),
            replace(
                self,
                header_stamps=self.header_stamps[place:],
                receive_stamps=self.receive_stamps[place:],
                layouts=tuple(layout for layout in behind if layout.messages.size),
                n_malformed=0,
            ),
        )


def listed_names(names: Iterable[Sequence[str]]) -> tuple[str, ...]:
    """All names of several lists, in the order of first appearance."""
    return tuple(dict.fromkeys(name for own in names for name in own))


def joined(parts: Iterable[RawJointStates]) -> RawJointStates:
    """Put parts of a recording together, in their order."""
    given = list(parts)
    if len(given) == 1:
        return given[0]
    firsts = np.cumsum([0, *(part.n_messages for part in given)])
    found: dict[tuple[str, ...], list[tuple[int, JointLayout]]] = {}
    for first, part in zip(firsts, given, strict=False):
        for layout in part.layouts:
            found.setdefault(layout.joint_names, []).append((int(first), layout))
    return RawJointStates(
        topic=given[0].topic,
        header_stamps=np.concatenate([part.header_stamps for part in given]),
        receive_stamps=np.concatenate([part.receive_stamps for part in given]),
        layouts=tuple(_joined_layouts(names, own) for names, own in found.items()),
        n_malformed=sum(part.n_malformed for part in given),
        notes=given[-1].notes,
        computed=given[-1].computed,
    )


def _joined_layouts(
    names: tuple[str, ...], layouts: Sequence[tuple[int, JointLayout]]
) -> JointLayout:
    velocities = None
    if any(layout.velocities is not None for _, layout in layouts):
        velocities = np.concatenate(
            [
                np.full(layout.positions.shape, np.nan, dtype=np.float32)
                if layout.velocities is None
                else layout.velocities
                for _, layout in layouts
            ]
        )
    return JointLayout(
        names,
        np.concatenate([first + layout.messages for first, layout in layouts]),
        np.concatenate([layout.positions for _, layout in layouts]),
        velocities,
    )


class JointStateCollector:
    """Gathers serialised joint states in flat buffers, sliced in blocks where they are alike.

    A message that is not like another one goes through the deserialiser, with the same result.

    Parameters
    ----------
    deserialise :
        From a serialised message to one with the fields of JointState.
    ros1 :
        Whether the messages are serialised as in ROS 1.
    """

    def __init__(self, deserialise: Callable[[bytes], Any], *, ros1: bool) -> None:
        self._deserialise = deserialise
        self._ros1 = ros1
        self._known: dict[int, list[ByteLayout]] = {}
        self._waiting: list[bytes] = []
        self._waiting_bytes = 0
        self._start()

    def _start(self) -> None:
        self._header_stamps = array("q")
        self._receive_stamps = array("q")
        self._buffers: dict[tuple[str, ...], _Buffer] = {}
        self._n_malformed = 0

    def add(self, receive_stamp: int, message: bytes) -> None:
        """Take a serialised message, received at that time [ns]."""
        self._receive_stamps.append(receive_stamp)
        self._waiting.append(message)
        self._waiting_bytes += len(message)
        if len(self._waiting) >= BLOCK_MESSAGES or self._waiting_bytes >= BLOCK_BYTES:
            self._slice_waiting()

    def taken(self, topic: str) -> RawJointStates:
        """Everything since the last call; what is known of the layouts is kept for the next."""
        self._slice_waiting()
        part = RawJointStates(
            topic=topic,
            header_stamps=np.frombuffer(self._header_stamps, dtype=np.int64),
            receive_stamps=np.frombuffer(self._receive_stamps, dtype=np.int64),
            layouts=tuple(buffer.layout(names) for names, buffer in self._buffers.items()),
            n_malformed=self._n_malformed,
        )
        self._start()
        return part

    def _slice_waiting(self) -> None:
        if not self._waiting:
            return
        block = _Block(first=len(self._header_stamps), stamps=np.zeros(len(self._waiting), "q"))
        sizes = np.fromiter(map(len, self._waiting), dtype=np.int64, count=len(self._waiting))
        for size in np.unique(sizes):
            self._slice_alike(np.flatnonzero(sizes == size), int(size), block)
        self._header_stamps.frombytes(block.stamps.tobytes())
        for names, parts in block.in_order():
            self._buffers.setdefault(names, _Buffer()).append(*parts)
        self._waiting, self._waiting_bytes = [], 0

    def _slice_alike(self, rows: IntArray, size: int, block: _Block) -> None:
        """Slice messages of one size by the layouts known, and by those of the ones left over."""
        joined = b"".join([self._waiting[row] for row in rows])
        messages = np.frombuffer(joined, dtype=np.uint8).reshape(rows.size, size)
        layouts = self._known.setdefault(size, [])
        for layout in layouts:
            rows, messages = block.take(layout, rows, messages)
        while rows.size:
            layout_found = self._deserialise_one(int(rows[0]), block)
            rows, messages = rows[1:], messages[1:]
            if layout_found is not None and len(layouts) < MAX_LAYOUTS:
                layouts.append(layout_found)
                rows, messages = block.take(layout_found, rows, messages)

    def _deserialise_one(self, row: int, block: _Block) -> ByteLayout | None:
        """Deserialise a message; return its layout if this one finds the same numbers."""
        data = self._waiting[row]
        message = self._deserialise(data)
        stamp = message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec
        names = tuple(message.name)
        position = np.asarray(message.position, dtype=np.float64)
        velocity = np.asarray(message.velocity, dtype=np.float64)
        block.stamps[row] = stamp
        if position.size != len(names) or len(set(names)) != len(names):
            self._n_malformed += 1
            return None
        block.add(
            names,
            np.array([row]),
            position[np.newaxis],
            velocity[np.newaxis] if velocity.size == len(names) else None,
        )
        layout = find_layout(data, ros1=self._ros1)
        if layout is None:
            return None
        found = layout.template[np.newaxis]
        own_velocity = layout.velocities(found)
        same = (
            layout.joint_names == names
            and layout.stamps(found)[0] == stamp
            and layout.positions(found).tobytes() == position.tobytes()
            and layout.has_velocity == (velocity.size == len(names))
            and (own_velocity is None or own_velocity.tobytes() == velocity.tobytes())
        )
        return layout if same else None


_Parts = tuple[IntArray, FloatArray, NDArray[np.float32]]
"""Which messages, their positions and velocities (NaN where there are none)."""


class _Block:
    """What was found in a block, before it is put in order."""

    def __init__(self, first: int, stamps: IntArray) -> None:
        self.first = first
        self.stamps = stamps
        self._parts: dict[tuple[str, ...], list[_Parts]] = {}

    def add(
        self,
        names: tuple[str, ...],
        rows: IntArray,
        positions: FloatArray,
        velocities: FloatArray | None,
    ) -> None:
        # What is too large for a small float becomes infinite: it is no velocity either way.
        with np.errstate(over="ignore", invalid="ignore"):
            checked = (
                np.full(positions.shape, np.nan, dtype=np.float32)
                if velocities is None
                else velocities.astype(np.float32)
            )
        self._parts.setdefault(names, []).append((rows, positions, checked))

    def take(self, layout: ByteLayout, rows: IntArray, messages: Bytes) -> tuple[IntArray, Bytes]:
        """Take the messages that have this layout; return those that are left."""
        fitting = layout.fits(messages)
        if not fitting.any():
            return rows, messages
        whole = bool(fitting.all())
        own, own_rows = (messages, rows) if whole else (messages[fitting], rows[fitting])
        self.stamps[own_rows] = layout.stamps(own)
        self.add(layout.joint_names, own_rows, layout.positions(own), layout.velocities(own))
        return rows[~fitting], messages[~fitting]

    def in_order(self) -> list[tuple[tuple[str, ...], _Parts]]:
        """By joints in the order of first appearance; the messages of each as received."""
        merged = []
        for names, parts in self._parts.items():
            rows = np.concatenate([part[0] for part in parts])
            order = np.argsort(rows)
            positions, velocities = (
                np.concatenate([part[1] for part in parts])[order],
                np.concatenate([part[2] for part in parts])[order],
            )
            merged.append((names, (rows[order] + self.first, positions, velocities)))
        return sorted(merged, key=lambda item: int(item[1][0][0]))


class _Buffer:
    """Grows in place: a long recording takes little more than its numbers."""

    def __init__(self) -> None:
        self._messages = array("q")
        self._positions = array("d")
        self._velocities = array("f")
        self._any_velocity = False

    def append(
        self, messages: IntArray, positions: FloatArray, velocities: NDArray[np.float32]
    ) -> None:
        self._messages.frombytes(messages.astype(np.int64).tobytes())
        self._positions.frombytes(positions.tobytes())
        self._velocities.frombytes(velocities.tobytes())
        self._any_velocity |= not bool(np.isnan(velocities).all())

    def layout(self, names: tuple[str, ...]) -> JointLayout:
        shape = (len(self._messages), len(names))
        return JointLayout(
            names,
            np.frombuffer(self._messages, dtype=np.int64),
            np.frombuffer(self._positions, dtype=np.float64).reshape(shape),
            np.frombuffer(self._velocities, dtype=np.float32).reshape(shape)
            if self._any_velocity
            else None,
        )
