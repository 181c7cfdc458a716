# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""From recordings to demonstrations, with a report on each; the useless is refused by name."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..arrays import FloatArray
from ..exceptions import (
    RecordingError,
    UnusableRecordingError,
    unknown_name,
)
from ..mocap.marker_joint_states import MarkerResidual, MarkerSource, solve_markers
from ..mocap.markers import MarkerFinding, find_markers
from .bags import (
    JOINT_TRAJECTORY,
    Bag,
    BagFormat,
    Topic,
    checksum,
    choose_topic,
    find_recordings,
    open_bag,
    recording_format,
    recording_names,
    stored_size,
)
from .cluster import map_on_cluster
from .demonstration import Demonstration
from .joint_trajectories import read_trajectories, repair_trajectories
from .processes import Outcome, map_in_processes
from .repair import CleanRecording, Piece, repair
from .segmentation import (
    MIN_EXTENT,
    SegmentationOptions,
    SpeedThresholds,
    extent,
    find_motions,
    joint_speed,
    large_motions,
    least_extent,
    least_extent_of_set,
    speed_thresholds,
    trim,
)
from .segments_file import Segment, read_segments
from .smoothing import SmoothPiece, smooth

N_OVERVIEW = 1000
"""Samples of an overview, about: as many as a picture can show."""


@dataclass(frozen=True)
class Motion:
    """Where in a recording a motion is.

    Attributes
    ----------
    start, end : float
        Times since the recording's first message [s].
    label : str
        What the table of segments calls it.
    extent : float
        Norm over the joints of how far each of them moves [rad or m].
    """

    start: float
    end: float
    label: str = ""
    extent: float = 0.0


@dataclass(frozen=True, eq=False)
class Overview:
    """A whole recording in few samples, to be looked at.

    Attributes
    ----------
    times : array, shape (n_samples,)
        Times since the recording's first message [s]; NaN between the pieces.
    positions : array, shape (n_samples, n_joints)
        Joint positions [rad or m].
    speed : array, shape (n_samples,)
        Highest norm of the joint velocities up to the next sample [rad/s or m/s].
    """

    times: FloatArray
    positions: FloatArray
    speed: FloatArray


@dataclass(frozen=True)
class Refusal:
    """A recording that can't be used, and why."""

    recording: str
    reason: str


@dataclass(frozen=True)
class RecordingReport:
    """What was found in a recording and what was made of it.

    Attributes
    ----------
    name, path, format, topic : str
        The recording and its topic of joint states.
    n_messages : int
        Messages on the topic.
    rate : float
        Usual rate [Hz].
    duration : float
        Time from the first to the last usable message [s].
    joint_names : tuple of str
        Names of the joints taken.
    checksum : str
        SHA-256 of the stored bytes.
    repairs : dict
        How often each kind of repair was made, see :data:`.repair.REPAIRS`.
    motions : tuple of Motion
        The motions, in order.
    thresholds : SpeedThresholds
        Speeds that told rest from motion, taken from the recording.
    notes : tuple of str
        What else is worth knowing, one sentence each.
    overview : Overview or None
        The recording to be looked at, if asked for.
    marker_residuals : dict
        How far each marker is from its place on the model; empty unless markers were recorded.
    """

    name: str
    path: str
    format: BagFormat
    topic: str
    n_messages: int
    rate: float
    duration: float
    joint_names: tuple[str, ...]
    checksum: str
    repairs: dict[str, int]
    motions: tuple[Motion, ...]
    thresholds: SpeedThresholds
    notes: tuple[str, ...]
    overview: Overview | None = None
    marker_residuals: dict[str, MarkerResidual] = field(default_factory=dict)


@dataclass(frozen=True)
class RecordingSet:
    """Demonstrations from several recordings, with a report or a refusal for each of these.

    Attributes
    ----------
    demonstrations : tuple of Demonstration
        Those of all recordings, in order.
    reports : tuple of RecordingReport
        One for each recording that is used.
    refused : tuple of Refusal
        One for each that is not.
    summaries : tuple
        What was made of the demonstrations of each recording that is used, if that was asked for.
    """

    demonstrations: tuple[Demonstration, ...]
    reports: tuple[RecordingReport, ...]
    refused: tuple[Refusal, ...]
    summaries: tuple[Any, ...] = ()


@dataclass(frozen=True)
class RecordingInspection:
    """What is in a recording, also in one that can't be used.

    Attributes
    ----------
    name, path : str
        The recording.
    format : str
        Its storage format.
    topics : tuple of Topic
        All topics with their types and counts; empty if it can't be read.
    topic : str or None
        The topic of joint states that was looked into.
    n_messages : int
        Messages on it.
    joint_names : tuple of str
        All joints that its messages list.
    rate, duration : float or None
        Usual rate [Hz] and duration [s], if its time is usable.
    repairs : dict
        How often each kind of repair is needed, see :data:`.repair.REPAIRS`.
    notes : tuple of str
        What else is worth knowing, one sentence each.
    refusal : str or None
        Why its joint states can't be used, if so.
    markers : tuple of MarkerFinding
        Markers and frames on its other topics.
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


def load_recordings(
    paths: str | Path | Iterable[str | Path],
    *,
    topic: str | None = None,
    joints: Sequence[str] | None = None,
    segment: Literal["auto", "none"] = "auto",
    segments_csv: str | Path | None = None,
    segmentation: SegmentationOptions | None = None,
    labels: Sequence[str] | None = None,
    markers: MarkerSource | None = None,
    state_field: str | None = None,
    max_gap: float | None = None,
    salvage: bool = False,
    overviews: bool = False,
    summarise: Callable[[Sequence[Demonstration]], Any] | None = None,
    most_samples: int | None = None,
    jobs: int = 1,
    dask: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RecordingSet:
    """Load the demonstrated motions of recordings.

    Parameters
    ----------
    paths :
        Bag files, rosbag2 folders, folders of bags, glob patterns; one of them or several.
    topic :
        Topic of the joint states; by default the only one.
    joints :
        Names of the joints; by default all that every message lists.
    segment :
        "auto" cuts at rests and valleys of the speed, "none" takes each recording as one motion
        and only trims the stillness at both ends (a recording with gaps: one motion per piece).
    segments_csv :
        A file of motions cut by hand, see :func:`.segments_file.read_segments`; instead of
        `segment`.
    segmentation :
        How motions are told apart for "auto"; by default as :class:`SegmentationOptions` says.
    labels :
        Take only the motions that `segments_csv` labels so; by default all.
    markers :
        Find the joint states from markers, see :func:`.marker_joint_states.marker_source`; `topic`
        and `joints` are not used then.
    state_field :
        The field of the topic's messages that is a JointState, with dots where it is a field of a
        field; needs `topic`. By default the messages themselves are.
    max_gap :
        The longest time without messages [s] that is no gap, see :func:`.repair.repair`.
    salvage :
        Of a damaged recording, take what is before the damage.
    overviews :
        Whether the reports shall hold overviews of the recordings.
    summarise :
        Called with the demonstrations of each recording, where that is read: a function of a
        module, or a :func:`functools.partial` of one. What it returns is in `summaries`.
    most_samples :
        Samples to be kept of each demonstration at most, after `summarise` has seen all of them;
        0 keeps no demonstrations. By default all samples are kept.
    jobs :
        Processes that read recordings at the same time. The result is always the same.
    dask :
        Address of the scheduler of a Dask cluster that reads them instead, see
        :func:`.cluster.map_on_cluster`. The result is the same.
    progress :
        Called with the bytes of recordings done and in all.

    Raises
    ------
    RecordingError
        If a path holds no recording, the file of segments is faulty, there are no motions of a
        label, or the cluster can't be used. What is wrong with a single recording is in `refused`
        instead.
    """
    if segment not in WAYS_TO_SEGMENT:
        raise RecordingError(unknown_name("way to segment", segment, WAYS_TO_SEGMENT))
    if state_field is not None and topic is None:
        raise RecordingError(f"the field '{state_field}' needs the topic whose messages have it")
    if jobs < 1:
        raise RecordingError(f"the number of jobs must be 1 or more, got {jobs}")
    found = find_recordings(paths)
    names = recording_names(found)
    by_hand = _segments_by_hand(segments_csv, names, labels)
    settings = _Settings(
        topic=topic,
        joints=None if joints is None else tuple(joints),
        segment=segment,
        segmentation=segmentation or SegmentationOptions(),
        markers=markers,
        state_field=state_field,
        max_gap=max_gap,
        salvage=salvage,
        overview=overviews,
        summarise=summarise,
        most_samples=most_samples,
    )
    tasks = [
        _Task(path, name, None if by_hand is None else tuple(by_hand.get(name, ())), settings)
        for path, name in zip(found, names, strict=True)
        # Where the table has only motions of other labels, there is nothing to do.
        if by_hand is None or by_hand.get(name) != []
    ]
    outcomes = _all_outcomes(tasks, jobs, dask, progress)
    again = _tasks_again(tasks, outcomes)
    repeated = _all_outcomes(list(again.values()), jobs, dask, None)
    for index, outcome in zip(again, repeated, strict=True):
        outcomes[index] = outcome
    loaded = [outcome for outcome in outcomes if isinstance(outcome, _Loaded)]
    return RecordingSet(
        tuple(motion for one in loaded for motion in one.demonstrations),
        tuple(one.report for one in loaded),
        tuple(outcome for outcome in outcomes if isinstance(outcome, Refusal)),
        () if summarise is None else tuple(one.summary for one in loaded),
    )


def inspect_recording(
    path: str | Path,
    topic: str | None = None,
    *,
    state_field: str | None = None,
    salvage: bool = False,
) -> RecordingInspection:
    """Find out what is in a recording; what makes it useless is told, not raised.

    Parameters
    ----------
    path :
        The recording.
    topic :
        Topic of the joint states; by default the only one.
    state_field :
        The field of the topic's messages that is a JointState; needs `topic`.
    salvage :
        Of a damaged recording, look at what is before the damage.

    Raises
    ------
    RecordingError
        If there is nothing at the path, more than one recording, or something else.
    """
    found = find_recordings([path])
    if len(found) > 1:
        raise RecordingError(f"there are {len(found)} recordings at '{path}': inspect one of them")
    inspection = RecordingInspection(
        recording_names(found)[0], str(found[0]), recording_format(found[0])
    )
    try:
        with open_bag(found[0], salvage=salvage) as bag:
            inspection = replace(inspection, topics=bag.topics)
            markers, marker_notes = _found_markers(bag)
            inspection = replace(inspection, markers=markers, notes=marker_notes)
            clean = _cleaned_motions(bag, topic, None, state_field)
    except UnusableRecordingError as error:
        return replace(
            inspection,
            topic=error.topic,
            n_messages=error.n_messages,
            joint_names=error.listed_joints,
            repairs=error.repairs,
            notes=(*error.notes, *inspection.notes),
            refusal=str(error),
        )
    except RecordingError as error:
        return replace(inspection, refusal=str(error))
    return replace(
        inspection,
        topic=clean.topic,
        n_messages=clean.n_messages,
        joint_names=clean.listed_joints,
        rate=clean.rate,
        duration=clean.duration,
        repairs=clean.repairs,
        notes=(*clean.notes, *inspection.notes),
    )


def _found_markers(bag: Bag) -> tuple[tuple[MarkerFinding, ...], tuple[str, ...]]:
    """Markers, and a note if they can't be read: the joint states may be good nevertheless."""
    try:
        return find_markers(bag), ()
    except RecordingError as error:
        return (), (f"its markers can't be read: {error}",)


WAYS_TO_SEGMENT = ("auto", "none")

Cut = tuple[SmoothPiece, int, int, str]
"""A motion: the piece it is in, its first and last step, its label."""


@dataclass(frozen=True)
class _Settings:
    """What holds for all recordings, see :func:`load_recordings`."""

    topic: str | None
    joints: tuple[str, ...] | None
    segment: Literal["auto", "none"]
    segmentation: SegmentationOptions
    markers: MarkerSource | None
    state_field: str | None
    max_gap: float | None
    salvage: bool
    overview: bool
    summarise: Callable[[Sequence[Demonstration]], Any] | None
    most_samples: int | None


@dataclass(frozen=True)
class _Task:
    """A recording to be loaded; its motions, if they were cut by hand; the set's least extent."""

    path: Path
    name: str
    segments: tuple[Segment, ...] | None
    settings: _Settings
    least_extent: float = 0.0


@dataclass(frozen=True, eq=False)
class _Loaded:
    """What a recording gives."""

    demonstrations: tuple[Demonstration, ...]
    report: RecordingReport
    summary: Any


class _BytesDone:
    """Tells how much of all recordings is done."""

    def __init__(self, tasks: Sequence[_Task], progress: Callable[[int, int], None] | None) -> None:
        self._tell = progress
        self._sizes = [] if progress is None else [stored_size(task.path) for task in tasks]
        self._done = 0

    def within(self, index: int, share: float) -> None:
        """Tell that a share of a recording is read."""
        if self._tell is not None:
            self._tell(self._done + int(share * self._sizes[index]), sum(self._sizes))

    def finished(self, index: int) -> None:
        """Tell that a recording is done."""
        if self._tell is not None:
            self._done += self._sizes[index]
            self._tell(self._done, sum(self._sizes))


def _all_outcomes(
    tasks: Sequence[_Task],
    jobs: int,
    dask: str | None,
    progress: Callable[[int, int], None] | None,
) -> list[_Loaded | Refusal]:
    """Load recordings; what became of each, in their order."""
    outcomes: list[_Loaded | Refusal] = [Refusal(task.name, "") for task in tasks]
    if not tasks:
        return outcomes
    bytes_done = _BytesDone(tasks, progress)
    with closing(_outcomes(tasks, jobs, dask, bytes_done.within)) as ready:
        for outcome in ready:
            outcomes[outcome.index] = _told(outcome, tasks[outcome.index].name)
            bytes_done.finished(outcome.index)
    return outcomes


def _tasks_again(tasks: Sequence[_Task], outcomes: Sequence[_Loaded | Refusal]) -> dict[int, _Task]:
    """Recordings with motions that are none beside those of the whole set, by their index."""
    found = {
        index: [motion.extent for motion in outcome.report.motions]
        for index, outcome in enumerate(outcomes)
        if isinstance(outcome, _Loaded) and tasks[index].segments is None
    }
    least = least_extent_of_set([extent for extents in found.values() for extent in extents])
    return {
        index: replace(tasks[index], least_extent=least)
        for index, extents in found.items()
        if min(extents) <= least
    }


def _outcomes(
    tasks: Sequence[_Task],
    jobs: int,
    dask: str | None,
    within: Callable[[int, float], None],
) -> Generator[Outcome[_Loaded | Refusal], None, None]:
    if dask is not None:
        # Workers have working directories of their own.
        tasks = [replace(task, path=task.path.absolute()) for task in tasks]
        yield from map_on_cluster(_load, tasks, dask, [task.path for task in tasks])
        return
    if jobs > 1 and len(tasks) > 1:
        yield from map_in_processes(_load, tasks, jobs)
        return
    for index, task in enumerate(tasks):
        yield Outcome(index, _load(task, partial(within, index)))


def _told(outcome: Outcome[_Loaded | Refusal], name: str) -> _Loaded | Refusal:
    """Say what became of a recording whose process died."""
    result = outcome.result
    if result is None:
        return Refusal(
            name, "every process that tried to read it died: it was killed, or memory ran out"
        )
    if outcome.repeated and isinstance(result, _Loaded):
        notes = (*result.report.notes, "read a second time, after a process had died")
        return replace(result, report=replace(result.report, notes=notes))
    return result


def _load(task: _Task, progress: Callable[[float], None] | None = None) -> _Loaded | Refusal:
    """Load one recording: all that it takes comes with the task, also to another process."""
    settings = task.settings
    try:
        if task.segments is not None and not task.segments:
            raise RecordingError("the table of segments names no motion in it")
        clean, residuals = _cleaned(task.path, settings, progress)
        pieces = [smooth(piece, clean.sample_rate) for piece in clean.pieces]
        thresholds = _thresholds(pieces, settings.segmentation)
        cuts, notes = _cut(task, clean, pieces, thresholds)
        if task.segments is None:
            cuts, n_rest = _without_rest(cuts, clean.pieces, task.least_extent)
            repairs = {"rest": n_rest} if n_rest else {}
            clean = replace(clean, repairs={**clean.repairs, **repairs})
        motions = _demonstrations(cuts, clean, task.name, checksum(task.path))
    except RecordingError as error:
        return Refusal(task.name, str(error))
    notes = clean.notes + notes
    report = _report(task.path, clean, motions, thresholds, notes, residuals)
    if settings.overview:
        report = replace(report, overview=_overview(pieces))
    summary = None if settings.summarise is None else settings.summarise(motions)
    return _Loaded(_kept(motions, settings.most_samples), report, summary)


def _kept(motions: Sequence[Demonstration], most_samples: int | None) -> tuple[Demonstration, ...]:
    if most_samples is None:
        return tuple(motions)
    return tuple(motion.thinned(most_samples) for motion in motions if most_samples > 0)


def _segments_by_hand(
    segments_csv: str | Path | None, names: Sequence[str], labels: Sequence[str] | None
) -> dict[str, list[Segment]] | None:
    """Read the segments, if there are any, and choose those of the labels."""
    if segments_csv is None:
        if labels is not None:
            raise RecordingError("labels select motions of a table of segments: none is given")
        return None
    by_hand = read_segments(segments_csv, names)
    if labels is None:
        return by_hand
    known = sorted({segment.label for rows in by_hand.values() for segment in rows} - {""})
    for label in labels:
        if label not in known:
            raise RecordingError(f"'{segments_csv}': {unknown_name('label', label, known)}")
    return {
        name: [segment for segment in rows if segment.label in labels]
        for name, rows in by_hand.items()
    }


def _cut(
    task: _Task,
    clean: CleanRecording,
    pieces: Sequence[SmoothPiece],
    thresholds: SpeedThresholds,
) -> tuple[list[Cut], tuple[str, ...]]:
    """Cut a recording into its motions; with notes on them."""
    if task.segments is not None:
        return _cut_by_hand(pieces, task.segments), ()
    if clean.pieces_are_motions or task.settings.segment == "none":
        return _cut_nothing(pieces, thresholds), ()
    return _cut_at_rests_and_valleys(pieces, thresholds, task.settings.segmentation)


def _overview(pieces: Sequence[SmoothPiece]) -> Overview:
    """Take every k-th sample."""
    k = max(1, sum(piece.times.size for piece in pieces) // N_OVERVIEW)
    times: list[FloatArray] = []
    positions: list[FloatArray] = []
    speeds: list[FloatArray] = []
    for piece in pieces:
        chosen = np.arange(0, piece.times.size, k)
        speed = np.maximum.reduceat(joint_speed(piece.velocities), chosen)
        times += [piece.times[chosen], np.array([np.nan])]
        positions += [piece.positions[chosen], np.full((1, piece.positions.shape[1]), np.nan)]
        speeds += [speed, np.array([np.nan])]
    joined = (np.concatenate(parts) for parts in (times, positions, speeds))
    return Overview(*joined)


def _cleaned(
    path: Path, settings: _Settings, progress: Callable[[float], None] | None
) -> tuple[CleanRecording, dict[str, MarkerResidual]]:
    if settings.markers is not None:
        solved = solve_markers(path, settings.markers, salvage=settings.salvage)
        return repair(solved.joint_states, max_gap=settings.max_gap), solved.residuals
    with open_bag(path, salvage=settings.salvage) as bag:
        clean = _cleaned_motions(
            bag,
            settings.topic,
            settings.joints,
            settings.state_field,
            settings.max_gap,
            progress,
        )
    return clean, {}


def _cleaned_motions(
    bag: Bag,
    topic: str | None,
    joints: Sequence[str] | None,
    state_field: str | None,
    max_gap: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> CleanRecording:
    """Read joint states or commanded motions, and clean them."""
    if topic is None or state_field is None:
        chosen = _chosen_topic(bag, topic)
        if chosen.type == JOINT_TRAJECTORY:
            return repair_trajectories(read_trajectories(bag, chosen), joints)
        topic = chosen.name

    raw = bag.joint_states(topic, field=state_field, progress=progress)
    return repair(raw, joints, max_gap=max_gap)


def _chosen_topic(bag: Bag, topic: str | None) -> Topic:
    """The topic to read; where there is none, say which messages hold joint states."""
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


def _thresholds(pieces: Sequence[SmoothPiece], options: SegmentationOptions) -> SpeedThresholds:
    speed = np.concatenate([joint_speed(piece.velocities) for piece in pieces])
    return speed_thresholds(speed, options)


def _cut_at_rests_and_valleys(
    pieces: Sequence[SmoothPiece], thresholds: SpeedThresholds, options: SegmentationOptions
) -> tuple[list[Cut], tuple[str, ...]]:
    """Cut at rests and valleys; what is small beside the largest motion is left out."""
    cuts: list[Cut] = [
        (piece, first, last, "")
        for piece in pieces
        for first, last in find_motions(piece, thresholds, options)
    ]
    extents = [extent(piece.positions[first : last + 1]) for piece, first, last, _ in cuts]
    large = large_motions(extents, options)
    kept = [cut for cut, is_large in zip(cuts, large, strict=True) if is_large]
    if len(kept) == len(cuts):
        return kept, ()
    note = (
        f"{len(cuts) - len(kept)} motions over less than {options.extent_ratio:.0%} of the extent "
        "of the largest are left out"
    )
    return kept, (note,)


def _without_rest(
    cuts: Sequence[Cut], pieces: Sequence[Piece], least_of_set: float
) -> tuple[list[Cut], int]:
    """Leave out what is no motion by its extent; also return how many movements that are."""
    least = max(least_extent(pieces), least_of_set)
    extents = [extent(piece.positions[first : last + 1]) for piece, first, last, _ in cuts]
    kept = [cut for cut, size in zip(cuts, extents, strict=True) if size > least]
    if cuts and not kept:
        raise RecordingError(
            f"it holds no motion: its joints move over {max(extents):.2g} rad (or m) at most, and "
            f"up to {least:.2g} is taken for rest, {_why(least, least_of_set)}; give a table of "
            "segments if these are motions nevertheless"
        )
    return kept, len(cuts) - len(kept)


def _why(least: float, least_of_set: float) -> str:
    if least == least_of_set:
        return "by the extent of the other recordings' motions"
    return "by its noise" if least > MIN_EXTENT else "as an arm that is held still sways"


def _cut_nothing(pieces: Sequence[SmoothPiece], thresholds: SpeedThresholds) -> list[Cut]:
    spans = ((piece, trim(piece, thresholds)) for piece in pieces)
    return [(piece, *span, "") for piece, span in spans if span is not None]


def _cut_by_hand(pieces: Sequence[SmoothPiece], segments: Sequence[Segment]) -> list[Cut]:
    cuts = []
    for segment in segments:
        for piece in pieces:
            first, last = (
                round((time - float(piece.times[0])) * piece.rate)
                for time in (segment.start, segment.end)
            )
            # A last time that was rounded up may lie a little behind the last sample.
            if first >= 0 and first < last <= piece.times.size:
                cuts.append((piece, first, min(last, piece.times.size - 1), segment.label))
                break
        else:
            spans = ", ".join(f"{p.times[0]:.3f} s to {p.times[-1]:.3f} s" for p in pieces)
            raise RecordingError(
                f"{segment.where}: {segment.start:g} s to {segment.end:g} s is not within the "
                f"recording, which has samples from {spans}"
            )
    return cuts


def _demonstrations(
    cuts: Sequence[Cut], clean: CleanRecording, name: str, digest: str
) -> list[Demonstration]:
    if not cuts:
        raise RecordingError("no motion was found in it")
    return [
        Demonstration(
            clean.joint_names,
            piece.times[first : last + 1] - piece.times[first],
            piece.positions[first : last + 1],
            piece.velocities[first : last + 1],
            piece.accelerations[first : last + 1],
            recording=name,
            start_time=float(piece.times[first]),
            end_time=float(piece.times[last]),
            label=label,
            checksum=digest,
        )
        for piece, first, last, label in cuts
    ]


def _report(
    path: Path,
    clean: CleanRecording,
    motions: Sequence[Demonstration],
    thresholds: SpeedThresholds,
    notes: tuple[str, ...],
    marker_residuals: dict[str, MarkerResidual],
) -> RecordingReport:
    return RecordingReport(
        name=motions[0].recording,
        path=str(path),
        format=recording_format(path),
        topic=clean.topic,
        n_messages=clean.n_messages,
        rate=clean.rate,
        duration=clean.duration,
        joint_names=clean.joint_names,
        checksum=motions[0].checksum,
        repairs=clean.repairs,
        motions=tuple(
            Motion(m.start_time, m.end_time, m.label, extent(m.positions)) for m in motions
        ),
        thresholds=thresholds,
        notes=notes,
        marker_residuals=marker_residuals,
    )
