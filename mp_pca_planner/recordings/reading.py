# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One recording, read and repaired: joint states of a bag or of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..exceptions import RecordingError, UnusableRecordingError, quote_names
from . import bags
from .bags import Bag, Topic
from .joint_states import JointLayout, RawJointStates
from .repair import repair
from .repair.motion import LARGEST_ANGLE
from .repair.recording import CleanRecording
from .tables import FORMATS, read_table, whole_episodes


def read_recording(
    path: Path,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    state_field: str | None = None,
    *,
    salvage: bool = False,
    listed_only: bool = False,
    degrees: bool = False,
    max_gap: float | None = None,
    episodes: Sequence[int | str] | None = None,
) -> CleanRecording:
    """Read the joint states of a bag or a table, and repair them.

    Parameters
    ----------
    path :
        The recording.
    topic :
        Topic of the joint states; by default the only one. Of a LeRobot dataset its column.
    joints :
        Names of the joints; by default all that every message lists.
    state_field :
        The field of the topic's messages that is a JointState; needs `topic`.
    salvage :
        Reads the messages before the damage of a damaged bag.
    listed_only :
        Takes only those of `joints` that messages list, and notes the others.
    degrees :
        Whether the positions are in degrees.
    max_gap :
        Longest time without messages that is no gap [s], see :func:`.repair.repair`.
    episodes :
        The episodes of a table to read; all by default.

    Raises
    ------
    RecordingError
        If the recording can't be read or repaired.
    """
    table_format = bags.recording_format(path)
    if table_format in FORMATS:
        if state_field is not None:
            raise RecordingError("--field is for messages of bags: a table has columns")
        raw, found = read_table(path, table_format, topic, joints, max_gap or 0.0, episodes)
        clean = _repaired(raw, joints, max_gap, listed_only=listed_only, degrees=degrees)
        return whole_episodes(clean, found) if found else clean
    if episodes is not None:
        raise RecordingError("a bag holds no episodes: they are chosen from tables only")
    with bags.open_bag(path, salvage=salvage) as bag:
        if topic is None or state_field is None:
            topic = _chosen_topic(bag, topic).name
        raw = bag.joint_states(topic, field=state_field)
    return _repaired(raw, joints, max_gap, listed_only=listed_only, degrees=degrees)


def _repaired(
    raw: RawJointStates,
    joints: Sequence[str] | None,
    max_gap: float | None,
    *,
    listed_only: bool,
    degrees: bool,
) -> CleanRecording:
    if degrees:
        raw = replace(raw, layouts=tuple(map(_in_radians, raw.layouts)))
    taken = _listed(joints, raw.listed_joints) if listed_only else joints
    clean = repair(raw, taken, max_gap)
    reach = np.rad2deg(max(np.abs(piece.positions).max() for piece in clean.pieces))
    if degrees and reach < LARGEST_ANGLE:
        raise RecordingError(
            f"its positions are {reach:.3g} at most, which are radians rather than degrees: leave "
            "out --degrees (degrees=True in Python)"
        )
    return _noted(clean, joints)


def _in_radians(layout: JointLayout) -> JointLayout:
    velocities = None if layout.velocities is None else np.deg2rad(layout.velocities)
    return replace(layout, positions=np.deg2rad(layout.positions), velocities=velocities)


def _listed(joints: Sequence[str] | None, listed: Sequence[str]) -> Sequence[str] | None:
    """The joints that are listed; all of them if none is, which is an error later."""
    return [name for name in joints or () if name in listed] or joints


def _noted(clean: CleanRecording, joints: Sequence[str] | None) -> CleanRecording:
    """The recording with a note on the joints that it lacks."""
    missing = [name for name in joints or () if name not in clean.joint_names]
    if not missing:
        return clean
    note = f"joints left out, as the recording lacks them: {quote_names(missing)}"
    return replace(clean, notes=(*clean.notes, note))


def _chosen_topic(bag: Bag, topic: str | None) -> Topic:
    """The topic to read; an error lists the messages that have joint states as a field."""
    try:
        return bags.choose_topic(bag.topics, topic)
    except RecordingError as error:
        hints = [
            f"field '{field}' of topic '{name}'"
            for name, field in bag.embedded_states()
            if topic in (None, name)
        ]
        if not hints:
            raise
        raise RecordingError(
            f"{error}; other messages hold joint states: read them with {' or '.join(hints)}"
        ) from None


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
    format: bags.RecordingFormat
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
    path: str | Path,
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
    paths = bags.find_recordings([path])
    if len(paths) > 1:
        raise RecordingError(f"there are {len(paths)} recordings at '{path}': inspect one of them")
    (recording,) = paths
    inspection = RecordingInspection(
        bags.recording_names(paths)[0], str(recording), bags.recording_format(recording)
    )
    try:
        if inspection.format not in FORMATS:
            with bags.open_bag(recording, salvage=salvage) as bag:
                inspection = replace(inspection, topics=bag.topics)
        clean = read_recording(recording, topic, state_field=state_field, salvage=salvage)
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
