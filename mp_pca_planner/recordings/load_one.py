# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One recording: read and repaired, then cut into demonstrations, or the reason why it isn't."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..exceptions import RecordingError, UnusableRecordingError, quote_names, unknown_name
from . import bags, cutting
from .cache import ReadingCache
from .demonstration import Demonstration
from .joint_states import JointLayout, RawJointStates
from .joint_trajectories import read_trajectories, repair_trajectories
from .recording_set import MarkerResidual, RecordingReport, RecordingSet, Refusal, Segment
from .repair import CleanRecording, repair
from .repair.motion import LARGEST_ANGLE
from .segmentation import (
    ABSURD_EXTENT,
    SegmentationOptions,
    SmoothPiece,
    SpeedThresholds,
    extent,
)
from .tables import FORMATS, read_table, whole_episodes

SEGMENTATIONS = ("auto", "none")

# Distance beyond a limit that is no reason for a note, as of soft limits and noise, and one for
# which a recording is rejected: half a turn is beyond any calibration [rad or m].
_LIMIT_TOLERANCE = 0.0175
_ABSURD_EXCESS = 3.14


@dataclass(frozen=True)
class LoadOptions:
    """Choice of the motions to load, and how they are repaired and cut.

    Attributes
    ----------
    topic : str or None
        Topic of the joint states; by default the only one. Of a LeRobot dataset the column; by
        default :data:`.tables.STATE`.
    joints : sequence of str or None
        Names of the joints; by default all that every message lists.
    moving_only : bool
        Leaves out those of `joints` that a recording does not list, or that never move in any
        recording, such as a gripper's. They are noted. Without effect on `markers`.
    degrees : bool
        Whether all recorded positions are in degrees, and not in radians.
    segment : str
        "auto" cuts at rests and valleys of the speed, "none" takes each recording as one motion
        and only trims the stillness at both ends (a recording with gaps: one motion per piece).
    segments_csv : path or None
        A table of motions cut by hand, see :func:`.cutting.read_segments`; instead of
        `segment`.
    segmentation : SegmentationOptions
        Shortest rest and motion of "auto".
    labels : sequence of str or None
        Labels in `segments_csv` of the motions to take; by default all.
    markers : MarkerSource or None
        Finds the joint states from markers, see :func:`.marker_joint_states.marker_source`;
        `topic` and `joints` are not used then.
    state_field : str or None
        The field of the topic's messages that is a JointState, with dots where it is a field of a
        field; needs `topic`. By default the messages themselves are.
    episodes : sequence of int or str, or None
        The episodes of LeRobot datasets or of CSV files to take; by default all.
    max_gap : float or None
        Longest time without messages that doesn't cut a recording [s], over 0. By default 0.5 s, or
        5 usual periods where these are longer.
    position_limits : mapping of str to tuple of float
        Least and largest position of joints by name [rad or m]; none unless given. Motions beyond
        them are noted. See :func:`.load.position_limits`.
    salvage : bool
        Takes the messages before the damage of a damaged recording.
    overviews : bool
        Adds overviews of the recordings to the reports.
    summarise : callable or None
        Called with the demonstrations of each recording, in the process that reads it: a function
        of a module, or a :func:`functools.partial` of one. Its results are in `summaries`.
    cache : ReadingCache
        Keeps what is read, except joint states from markers; by default nothing.
    most_samples : int or None
        Largest number of samples kept of each demonstration, after `summarise` was called;
        0 keeps no demonstrations. By default all samples are kept.

    Raises
    ------
    RecordingError
        If `segment` is unknown or `state_field` is given without `topic`.
    """

    topic: str | None = None
    joints: Sequence[str] | None = None
    moving_only: bool = False
    degrees: bool = False
    segment: Literal["auto", "none"] = "auto"
    segments_csv: str | Path | None = None
    segmentation: SegmentationOptions = field(default_factory=SegmentationOptions)
    labels: Sequence[str] | None = None
    markers: Any = None
    state_field: str | None = None
    episodes: Sequence[int | str] | None = None
    max_gap: float | None = None
    position_limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    salvage: bool = False
    overviews: bool = False
    summarise: Callable[[Sequence[Demonstration]], Any] | None = None
    most_samples: int | None = None
    cache: ReadingCache = field(default_factory=ReadingCache)

    def __post_init__(self) -> None:
        if self.segment not in SEGMENTATIONS:
            raise RecordingError(unknown_name("segmentation", self.segment, SEGMENTATIONS))
        if self.state_field is not None and self.topic is None:
            raise RecordingError(
                f"the field '{self.state_field}' needs a topic whose messages have this field"
            )


@dataclass(frozen=True, slots=True)
class LoadTask:
    """A recording to load; its motions, if cut by hand; the set's least extent; notes on it."""

    path: bags.Recording
    name: str
    segments: tuple[Segment, ...] | None
    options: LoadOptions
    least_extent: float = 0.0
    notes: tuple[str, ...] = ()


def load_one(task: LoadTask, progress: Callable[[float], None] | None = None) -> RecordingSet:
    """Load one recording, in this process or another one."""
    try:
        if task.segments == ():
            raise RecordingError("the table of segments lists no motion of it")
        began = time.perf_counter()
        with bags.local_copy(task.path) as path:
            found = _loaded(task, path, progress)
        seconds = time.perf_counter() - began
        return replace(found, reports=tuple(replace(x, seconds=seconds) for x in found.reports))
    except RecordingError as error:
        findings = error.findings if isinstance(error, UnusableRecordingError) else {}
        joints = findings.get("listed_joints", ())
        return RecordingSet(refused=(Refusal(task.name, str(error), joints),))


def _loaded(task: LoadTask, path: Path, progress: Callable[[float], None] | None) -> RecordingSet:
    """Load the file or folder of a recording; one that can't be used raises a RecordingError."""
    options = task.options
    clean, residuals = _clean(path, options, progress)
    pieces, thresholds = cutting.smoothed(clean)
    cuts, clean = _cut(task, clean, pieces, thresholds)
    checksum = options.cache.checksum(path)
    motions = [
        replace(
            cut.demonstration(clean.joint_names, task.name, checksum),
            episode=clean.episode_at(cut.piece.times[0] + 1e-6),
        )
        for cut in cuts
    ]
    beyond = _beyond_limits(motions, options)
    segments = [Segment(m.start_time, m.end_time, m.label, extent(m.positions)) for m in motions]
    report = RecordingReport(
        name=task.name,
        path=str(task.path),
        format=bags.recording_format(path),
        topic=clean.topic,
        n_messages=clean.n_messages,
        rate=clean.rate,
        duration=clean.duration,
        joint_names=clean.joint_names,
        checksum=checksum,
        repairs=clean.repairs,
        motions=tuple(segments),
        thresholds=thresholds,
        notes=(*clean.notes, *task.notes, *beyond),
        overview=cutting.overview(pieces) if options.overviews else None,
        marker_residuals=residuals,
        still_joints=clean.still_joints,
        fingerprint=clean.fingerprint,
    )
    summaries = () if options.summarise is None else (options.summarise(motions),)
    n = options.most_samples
    kept = motions if n is None else [motion.thinned(n) for motion in motions if n > 0]
    return RecordingSet(tuple(kept), (report,), summaries=summaries)


def _beyond_limits(motions: Sequence[Demonstration], options: LoadOptions) -> tuple[str, ...]:
    """A note if motions are beyond the limits of the robot.

    Raises
    ------
    RecordingError
        If they are absurdly far beyond.
    """
    found: list[tuple[float, float, str]] = []
    for motion in motions:
        for name, q in zip(motion.joint_names, motion.positions.T.tolist(), strict=True):
            low, high = options.position_limits.get(name, (-np.inf, np.inf))
            found += [(low - min(q), min(q), name), (max(q) - high, max(q), name)]
    excess, position, name = max(found, default=(0.0, 0.0, ""))
    if excess <= _LIMIT_TOLERANCE:
        return ()
    text = (
        f"joint '{name}' is at {position:.3g} rad (or m), {excess:.3g} beyond its limit in the "
        "robot description"
    )
    if excess > _ABSURD_EXCESS:
        raise RecordingError(
            f"{text}: positions must be in radians (or m), not in degrees (or mm), and of this "
            "robot"
        )
    return (f"{text}: check that it is of this robot, and its zero position",)


def _cut(
    task: LoadTask,
    clean: CleanRecording,
    pieces: Sequence[SmoothPiece],
    thresholds: SpeedThresholds,
) -> tuple[list[cutting.Cut], CleanRecording]:
    """Motions of a recording, and the recording with further repairs and notes."""
    options = task.options.segmentation
    if task.segments is not None:
        cuts = [cutting.cut_row(pieces, row) for row in task.segments]
    else:
        is_whole = clean.pieces_are_motions or task.options.segment == "none"
        found, clean = cutting.cut_motions(
            clean, pieces, thresholds, options, task.least_extent, is_whole=is_whole
        )
        cuts = found
        if not clean.pieces_are_motions:
            cuts = cutting.without_cut_off(found, pieces, whole=is_whole)
            n_short = 0 if is_whole else cutting.count_short_halves(pieces, thresholds, found)
            clean = cutting.counted(clean, "cut_off", len(found) - len(cuts) + n_short)
    if not cuts:
        raise RecordingError("no motion was found in it")
    ranges = np.max([cut.ranges for cut in cuts], axis=0)
    if ranges.max() > ABSURD_EXTENT:
        who = f"joint '{clean.joint_names[ranges.argmax()]}' moves"
        note = cutting.far_moving(who, ranges.max(), ABSURD_EXTENT)
        clean = replace(clean, notes=(*clean.notes, note))
    return cuts, clean


def _clean(
    path: Path, options: LoadOptions, progress: Callable[[float], None] | None
) -> tuple[CleanRecording, dict[str, MarkerResidual]]:
    """Repaired joint states, and the residuals of the markers that they come from."""
    if options.markers is not None:
        raw, residuals = options.markers.joint_states(path, salvage=options.salvage)
        return repair(raw, None, options.max_gap), residuals
    chosen: dict[str, Any] = {
        "topic": options.topic,
        "joints": options.joints,
        "state_field": options.state_field,
        "salvage": options.salvage,
        "listed_only": options.moving_only,
        "degrees": options.degrees,
        "max_gap": options.max_gap,
        "episodes": options.episodes,
    }
    read = partial(read_recording, path, progress=progress, **chosen)
    return options.cache.clean(path, repr(chosen), read), {}


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
    progress: Callable[[float], None] | None = None,
) -> CleanRecording:
    """Read the joint states or commanded motions of a bag or a table, and repair them.

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
    progress :
        Called with the share of the messages that is read.

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
            chosen = _chosen_topic(bag, topic)
            if chosen.type == bags.JOINT_TRAJECTORY:
                if degrees:
                    raise RecordingError("--degrees is for joint states, not for commanded motions")
                motions = read_trajectories(bag, chosen)
                taken = _listed(joints, motions.listed_joints) if listed_only else joints
                return _noted(repair_trajectories(motions, taken), joints)
            topic = chosen.name
        raw = bag.joint_states(topic, field=state_field, progress=progress)
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


def _chosen_topic(bag: bags.Bag, topic: str | None) -> bags.Topic:
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
    topics: tuple[bags.Topic, ...] = ()
    topic: str | None = None
    n_messages: int = 0
    joint_names: tuple[str, ...] = ()
    rate: float | None = None
    duration: float | None = None
    repairs: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    refusal: str | None = None


def inspect_recording(
    path: str | bags.Recording,
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
    with bags.local_copy(recording) as copy:
        inspection = RecordingInspection(
            bags.recording_names(paths)[0], str(recording), bags.recording_format(copy)
        )
        try:
            if inspection.format not in FORMATS:
                with bags.open_bag(copy, salvage=salvage) as bag:
                    inspection = replace(inspection, topics=bag.topics)
            clean = read_recording(copy, topic, state_field=state_field, salvage=salvage)
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
