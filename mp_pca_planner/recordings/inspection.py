# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Inspection of a recording: topics, joint states, and the defects of these."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..exceptions import RecordingError, UnusableRecordingError
from .bags import (
    BagFormat,
    Recording,
    Topic,
    find_recordings,
    local_copy,
    open_bag,
    recording_format,
    recording_names,
)
from .reading import read_clean


@dataclass(frozen=True)
class RecordingInspection:
    """Content of a recording, also of one that can't be used.

    Attributes
    ----------
    name, path : str
        The recording.
    format : str
        Its storage format.
    topics : tuple of Topic
        All topics with their types and counts; empty if it can't be read.
    topic : str or None
        The topic of joint states that was inspected.
    n_messages : int
        Messages on it.
    joint_names : tuple of str
        All joints that its messages list.
    rate, duration : float or None
        Usual rate [Hz] and duration [s], if its time is usable.
    repairs : dict
        Counts of the repairs that are needed, by their names in :data:`.repair.REPAIRS`.
    notes : tuple of str
        Other findings, one sentence each.
    refusal : str or None
        Reason why its joint states can't be used, if so.
    """

    name: str
    path: str
    format: BagFormat
    topics: tuple[Topic, ...] = ()
    topic: str | None = None
    n_messages: int = 0
    joint_names: tuple[str, ...] = ()
    rate: float | None = None
    duration: float | None = None
    repairs: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    refusal: str | None = None


def inspect_recording(
    path: str | Recording,
    topic: str | None = None,
    *,
    state_field: str | None = None,
    salvage: bool = False,
) -> RecordingInspection:
    """Inspect a recording; defects that make it unusable are reported, not raised.

    Parameters
    ----------
    path :
        The recording.
    topic :
        Topic of the joint states; by default the only one.
    state_field :
        The field of the topic's messages that is a JointState; needs `topic`.
    salvage :
        Inspects the messages before the damage of a damaged recording.

    Raises
    ------
    RecordingError
        If there is nothing at the path, more than one recording, or something else.
    """
    paths = find_recordings([path])
    if len(paths) > 1:
        raise RecordingError(f"there are {len(paths)} recordings at '{path}': inspect one of them")
    (recording,) = paths
    with local_copy(recording) as copy:
        inspection = RecordingInspection(
            recording_names(paths)[0], str(recording), recording_format(copy)
        )
        try:
            with open_bag(copy, salvage=salvage) as bag:
                inspection = replace(inspection, topics=bag.topics)
                clean = read_clean(bag, topic, state_field=state_field)
            found, refusal = vars(clean) | {"duration": clean.duration}, None
        except UnusableRecordingError as error:
            found, refusal = error.findings, str(error)
        except RecordingError as error:
            return replace(inspection, refusal=str(error))
    facts = ("topic", "n_messages", "rate", "duration", "repairs", "notes")
    return replace(
        inspection,
        joint_names=found["listed_joints"],
        refusal=refusal,
        **{fact: found[fact] for fact in facts if fact in found},
    )
