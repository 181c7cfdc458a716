# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Inspection of a recording: topics, markers, joint states, and the defects of these."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..exceptions import RecordingError, UnusableRecordingError
from .bags import (
    Bag,
    BagFormat,
    Topic,
    find_recordings,
    open_bag,
    recording_format,
    recording_names,
)
from .reading import read_clean
from .repair import CleanRecording


@dataclass(frozen=True)
class MarkerFinding:
    """Samples of a marker in a recording.

    Attributes
    ----------
    topic : str
        Its topic, as ``--markers`` expects it or, for points and poses, its own.
    name : str
        Name in the recording.
    rate : float or None
        Usual rate of its samples [Hz], if there are several.
    n_samples : int
        Samples with finite numbers.
    missing_share : float
        Share of the frames of its topic (MarkerArray), or of its own samples, without it.
    n_gaps : int
        Number of steps that are too long for interpolation, so that the marker is missing.
    """

    topic: str
    name: str
    rate: float | None
    n_samples: int
    missing_share: float
    n_gaps: int


MarkerFinder = Callable[[Bag], tuple[MarkerFinding, ...]]
"""Finds the markers of a bag, see :func:`mp_pca_planner.mocap.markers.find_markers`."""


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
    markers : tuple of MarkerFinding
        Markers and frames on its other topics.
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
    markers: tuple[MarkerFinding, ...] = ()
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
    find_markers: MarkerFinder | None = None,
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
    find_markers :
        Finds the markers; by default none are reported.

    Raises
    ------
    RecordingError
        If there is nothing at the path, more than one recording, or something else.
    """
    paths = find_recordings([path])
    if len(paths) > 1:
        raise RecordingError(f"there are {len(paths)} recordings at '{path}': inspect one of them")
    found: CleanRecording | UnusableRecordingError | None = None
    inspection = RecordingInspection(
        recording_names(paths)[0], str(paths[0]), recording_format(paths[0])
    )
    try:
        with open_bag(paths[0], salvage=salvage) as bag:
            inspection = replace(inspection, topics=bag.topics)
            markers, notes = _markers(bag, find_markers)
            inspection = replace(inspection, markers=markers, notes=notes)
            found = read_clean(bag, topic, state_field=state_field)
    except RecordingError as error:
        inspection = replace(inspection, refusal=str(error))
        found = error if isinstance(error, UnusableRecordingError) else None
    if found is None:
        return inspection
    return replace(
        inspection,
        topic=found.topic,
        n_messages=found.n_messages,
        joint_names=found.listed_joints,
        rate=getattr(found, "rate", None),
        duration=getattr(found, "duration", None),
        repairs=found.repairs,
        notes=(*found.notes, *inspection.notes),
    )


def _markers(
    bag: Bag, find_markers: MarkerFinder | None
) -> tuple[tuple[MarkerFinding, ...], tuple[str, ...]]:
    """Markers, and a note if they can't be read: the joint states may be good nevertheless."""
    if find_markers is None:
        return (), ()
    try:
        return find_markers(bag), ()
    except RecordingError as error:
        return (), (f"its markers can't be read: {error}",)
