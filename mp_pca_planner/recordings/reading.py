# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repaired joint states of a bag, from joint states or commanded motions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..exceptions import RecordingError
from .bags import JOINT_TRAJECTORY, Bag, Topic, choose_topic
from .joint_trajectories import read_trajectories, repair_trajectories
from .repair import CleanRecording, RepairOptions, repair


def read_clean(
    bag: Bag,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    *,
    state_field: str | None = None,
    options: RepairOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> CleanRecording:
    """Read joint states or commanded motions, and repair them.

    Parameters
    ----------
    bag :
        The opened recording.
    topic :
        Topic of the joint states; by default the only one.
    joints :
        Names of the joints; by default all that every message lists.
    state_field :
        The field of the topic's messages that is a JointState; needs `topic`.
    options :
        Thresholds of the repairs.
    progress :
        Called with the share of the messages that is read.

    Raises
    ------
    RecordingError
        If the recording can't be read or repaired.
    """
    if topic is None or state_field is None:
        chosen = _chosen_topic(bag, topic)
        if chosen.type == JOINT_TRAJECTORY:
            return repair_trajectories(read_trajectories(bag, chosen), joints, options)
        topic = chosen.name
    raw = bag.joint_states(topic, field=state_field, progress=progress)
    return repair(raw, joints, options)


def _chosen_topic(bag: Bag, topic: str | None) -> Topic:
    """The topic to read; an error lists the messages that have joint states as a field."""
    try:
        return choose_topic(bag.topics, topic)
    except RecordingError as error:
        hints = [
            f"'--topic {name} --field {field}'"
            for name, field in bag.embedded_states()
            if topic in (None, name)
        ]
        if not hints:
            raise
        raise RecordingError(
            f"{error}; other messages hold joint states: read them with {' or '.join(hints)}"
        ) from None
