# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states as recorded: the messages of a topic as arrays."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, unique_names
from ..exceptions import RecordingError
from ..renaming import Rename, new_name

ENCAPSULATION = 4
"""Bytes before a message in CDR; alignment is relative to their end."""

NS_PER_S = 1_000_000_000
"""Nanoseconds in a second."""

IntArray = NDArray[np.int64]

Names = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class JointStates:
    """The well-formed messages of a topic, as recorded, in the order of reception.

    Attributes
    ----------
    topic : str
        Name of the topic.
    joint_names : tuple of str
        All joints that messages list, in the order of first appearance.
    header_stamps, receive_stamps : array of int, shape (n_messages,)
        Time in the header (0: not set) and time of reception of each message [ns].
    positions : array, shape (n_messages, n_joints)
        Joint positions as recorded [rad or m], NaN of joints that a message does not list.
    velocities : array of float32, shape (n_messages, n_joints), or None
        Joint velocities as recorded [/s], NaN where a message has none; None if all have none.
        They are compared with the positions, and not used otherwise.
    layouts : tuple of tuple of str
        Different lists of joints in messages, in the order of first appearance.
    layout_of : array of int, shape (n_messages,)
        Which of them each message has.
    n_malformed : int
        Further messages: as many positions as names are missing, or a name is listed twice.
    notes : tuple of str
        Notes on the reading, one sentence each.
    computed : bool
        Whether they were computed from other data, which have no velocities to be checked.
    """

    topic: str
    joint_names: Names
    header_stamps: IntArray
    receive_stamps: IntArray
    positions: FloatArray
    layouts: tuple[Names, ...]
    layout_of: IntArray
    velocities: NDArray[np.float32] | None = field(default=None, kw_only=True)
    n_malformed: int = field(default=0, kw_only=True)
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    computed: bool = field(default=False, kw_only=True)

    @classmethod
    def of_arrays(
        cls,
        topic: str,
        joint_names: Names,
        header_stamps: IntArray,
        receive_stamps: IntArray,
        positions: FloatArray,
        notes: tuple[str, ...] = (),
    ) -> JointStates:
        """Joint states that list all joints each, computed from other data."""
        same = np.zeros(len(positions), dtype=np.int64)
        return cls(
            topic,
            joint_names,
            header_stamps,
            receive_stamps,
            positions,
            (joint_names,),
            same,
            notes=notes,
            computed=True,
        )

    @property
    def n_messages(self) -> int:
        """Number of messages, malformed ones included."""
        return self.header_stamps.size + self.n_malformed

    def listing(self, names: Collection[str]) -> NDArray[np.bool_]:
        """Which messages list all of some joints, shape (n_messages,)."""
        lists = [set(names) <= set(layout) for layout in self.layouts]
        return np.array(lists, dtype=bool)[self.layout_of]

    def columns(self, names: Iterable[str]) -> list[int]:
        """Columns of some joints."""
        return [self.joint_names.index(name) for name in names]

    def without(self, joints: Collection[str]) -> JointStates:
        """The states without some joints."""
        kept = tuple(name for name in self.joint_names if name not in joints)
        columns = self.columns(kept)
        return replace(
            self,
            joint_names=kept,
            positions=self.positions[:, columns],
            velocities=None if self.velocities is None else self.velocities[:, columns],
            layouts=tuple(tuple(x for x in own if x in kept) for own in self.layouts),
        )

    def renamed(self, rename: Rename) -> JointStates:
        """The states by the new names of their joints.

        Raises
        ------
        RecordingError
            If two joints of a message get the same name.
        """
        if not rename:
            return self
        new = {name: new_name(name, rename, self.topic) for name in self.joint_names}
        layouts = tuple(tuple(new[name] for name in names) for names in self.layouts)
        for names in layouts:
            unique_names(names, "renamed joints", RecordingError)
        names = tuple(dict.fromkeys(new.values()))
        return replace(self, layouts=layouts).in_columns(names, new.values())

    def scaled(self, factors: Mapping[str, float]) -> JointStates:
        """The states with some joints multiplied by factors."""
        own = np.array([factors.get(name, 1.0) for name in self.joint_names])
        velocities = None if self.velocities is None else self.velocities * own.astype(np.float32)
        return replace(self, positions=self.positions * own, velocities=velocities)

    def in_columns(self, names: Names, of_joints: Iterable[str] | None = None) -> JointStates:
        """The states in a table of other columns.

        Parameters
        ----------
        names : tuple of str
            Names of the columns. Joints may be missing, and others may be among them.
        of_joints : iterable of str, optional
            Name of the column into which each joint goes; by default its own.
        """
        columns = [names.index(name) for name in of_joints or self.joint_names]

        def spread(values: NDArray[Any]) -> NDArray[Any]:
            table = np.full((len(values), len(names)), np.nan, values.dtype)
            for column, own in zip(columns, values.T, strict=True):
                known = ~np.isnan(own)
                table[known, column] = own[known]
            return table

        velocities = None if self.velocities is None else spread(self.velocities)
        return replace(
            self, joint_names=names, positions=spread(self.positions), velocities=velocities
        )


def collect_joint_states(topic: str, messages: Iterable[tuple[int, Any]]) -> JointStates:
    """Collect the numbers of joint states.

    Parameters
    ----------
    topic :
        Name of their topic.
    messages :
        Time of reception [ns] of each, and the ``sensor_msgs/JointState``.
    """
    headers, received, layout_of = array("q"), array("q"), array("q")
    places: dict[Names, int] = {}
    # Positions and velocities of the messages with the same names.
    values: list[tuple[array[float], array[float]]] = []
    n_malformed = 0
    for stamp, message in messages:
        names, since = tuple(message.name), message.header.stamp
        if len(message.position) != len(names) or len(set(names)) != len(names):
            n_malformed += 1
            continue
        headers.append(since.sec * NS_PER_S + since.nanosec)
        received.append(stamp)
        if names not in places:
            places[names] = len(values)
            values.append((array("d"), array("d")))
        layout_of.append(places[names])
        positions, velocities = values[places[names]]
        positions.extend(message.position)
        has_velocities = len(message.velocity) == len(names)
        velocities.extend(message.velocity if has_velocities else [np.nan] * len(names))
    joints = tuple(dict.fromkeys(name for names in places for name in names))
    table = np.full((2, len(received), len(joints)), np.nan)
    which = np.array(layout_of, dtype=np.int64)
    for names, place in places.items():
        rows = np.flatnonzero(which == place)[:, None]
        columns = [joints.index(name) for name in names]
        for of_all, own in zip(table, values[place], strict=True):
            of_all[rows, columns] = np.array(own).reshape(rows.size, len(names))
    # Values beyond the range of float32 become infinite; they are no valid velocities in any case.
    with np.errstate(over="ignore", invalid="ignore"):
        checked = table[1].astype(np.float32)
    return JointStates(
        topic,
        joints,
        np.array(headers, dtype=np.int64),
        np.array(received, dtype=np.int64),
        table[0],
        tuple(places),
        which,
        velocities=None if np.isnan(checked).all() else checked,
        n_malformed=n_malformed,
    )


def joined(first: JointStates, second: JointStates) -> JointStates:
    """Joint states followed by others, those of the same topic or of another one."""
    names = tuple(dict.fromkeys((*first.joint_names, *second.joint_names)))
    layouts = tuple(dict.fromkeys((*first.layouts, *second.layouts)))
    parts = [states.in_columns(names) for states in (first, second)]
    velocities = [
        np.full(x.positions.shape, np.nan, np.float32) if x.velocities is None else x.velocities
        for x in parts
    ]
    have_none = first.velocities is None and second.velocities is None
    places = [np.array([layouts.index(y) for y in x.layouts], dtype=np.int64) for x in parts]
    return JointStates(
        second.topic,
        names,
        np.concatenate([x.header_stamps for x in parts]),
        np.concatenate([x.receive_stamps for x in parts]),
        np.concatenate([x.positions for x in parts]),
        layouts,
        np.concatenate([own[x.layout_of] for own, x in zip(places, parts, strict=True)]),
        velocities=None if have_none else np.concatenate(velocities),
        n_malformed=first.n_malformed + second.n_malformed,
        notes=tuple(dict.fromkeys((*first.notes, *second.notes))),
    )
