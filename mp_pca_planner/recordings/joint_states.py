# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint states as recorded: the messages of a topic as arrays."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import RecordingError, quote_names
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

    Recorded velocities are not among them: those of motions follow from their positions.

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
    listed : array of bool, shape (n_messages, n_joints)
        Which joints each message lists.
    n_malformed : int
        Further messages: as many positions as names are missing, or a name is listed twice.
    notes : tuple of str
        Notes on the reading, one sentence each.
    were_degrees : bool
        Whether positions were converted from degrees.
    """

    topic: str
    joint_names: Names
    header_stamps: IntArray
    receive_stamps: IntArray
    positions: FloatArray
    listed: NDArray[np.bool_]
    n_malformed: int = 0
    notes: tuple[str, ...] = ()
    were_degrees: bool = False

    @property
    def n_messages(self) -> int:
        """Number of messages, malformed ones included."""
        return self.header_stamps.size + self.n_malformed

    def columns(self, names: Iterable[str]) -> list[int]:
        """Columns of some joints."""
        return [self.joint_names.index(name) for name in names]

    def without(self, joints: Collection[str]) -> JointStates:
        """The states without some joints."""
        kept = tuple(name for name in self.joint_names if name not in joints)
        columns = self.columns(kept)
        positions, listed = self.positions[:, columns], self.listed[:, columns]
        return replace(self, joint_names=kept, positions=positions, listed=listed)

    def renamed(self, rename: Rename) -> JointStates:
        """The states by the new names of their joints.

        Raises
        ------
        RecordingError
            If two joints of a message get the same name.
        """
        if not rename:
            return self
        new = [new_name(name, rename, self.topic) for name in self.joint_names]
        for name in set(new):
            several = [i for i, own in enumerate(new) if own == name]
            if (self.listed[:, several].sum(axis=1) > 1).any():
                olds = quote_names(self.joint_names[i] for i in several)
                raise RecordingError(f"{olds} can't be renamed to '{name}': a message has them all")
        return self._in_columns(tuple(dict.fromkeys(new)), new)

    def scaled(self, factors: Mapping[str, float]) -> JointStates:
        """The states with some joints multiplied by factors."""
        own = np.array([factors.get(name, 1.0) for name in self.joint_names])
        return replace(self, positions=self.positions * own)

    def followed_by(self, others: JointStates) -> JointStates:
        """These states followed by others, those of the same topic or of another one."""
        names = tuple(dict.fromkeys((*self.joint_names, *others.joint_names)))
        parts = [states._in_columns(names, states.joint_names) for states in (self, others)]
        return JointStates(
            others.topic,
            names,
            np.concatenate([x.header_stamps for x in parts]),
            np.concatenate([x.receive_stamps for x in parts]),
            np.concatenate([x.positions for x in parts]),
            np.concatenate([x.listed for x in parts]),
            self.n_malformed + others.n_malformed,
            tuple(dict.fromkeys((*self.notes, *others.notes))),
        )

    def _in_columns(self, names: Names, of_joints: Sequence[str]) -> JointStates:
        """The states in a table of other columns; each joint goes into the column of its name."""
        positions = np.full((len(self.positions), len(names)), np.nan)
        listed = np.zeros(positions.shape, dtype=bool)
        for own, name in enumerate(of_joints):
            rows, column = self.listed[:, own], names.index(name)
            positions[rows, column] = self.positions[rows, own]
            listed[rows, column] = True
        return replace(self, joint_names=names, positions=positions, listed=listed)


def collect_joint_states(topic: str, messages: Iterable[tuple[int, Any]]) -> JointStates:
    """Collect the numbers of joint states.

    Parameters
    ----------
    topic :
        Name of their topic.
    messages :
        Time of reception [ns] of each, and the ``sensor_msgs/JointState``.
    """
    headers, received = array("q"), array("q")
    # Rows and positions of the messages with the same names.
    groups: dict[Names, tuple[list[int], array[float]]] = {}
    n_malformed = 0
    for stamp, message in messages:
        names, since = tuple(message.name), message.header.stamp
        if len(message.position) != len(names) or len(set(names)) != len(names):
            n_malformed += 1
            continue
        rows, values = groups.setdefault(names, ([], array("d")))
        rows.append(len(headers))
        values.extend(message.position)
        headers.append(since.sec * NS_PER_S + since.nanosec)
        received.append(stamp)
    joints = tuple(dict.fromkeys(name for names in groups for name in names))
    positions = np.full((len(headers), len(joints)), np.nan)
    listed = np.zeros(positions.shape, dtype=bool)
    for names, (rows, values) in groups.items():
        places = np.ix_(rows, [joints.index(name) for name in names])
        positions[places] = np.array(values).reshape(len(rows), len(names))
        listed[places] = True
    stamps, times = (np.array(x, dtype=np.int64) for x in (headers, received))
    return JointStates(topic, joints, stamps, times, positions, listed, n_malformed)
