# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Loading of recordings as demonstrations; unusable recordings are rejected with a reason."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from ..arrays import check_number
from ..exceptions import RecordingError, unknown_name
from . import bags, cutting
from .cache import ReadingCache, key_of
from .cluster import map_on_cluster
from .demonstration import (
    Demonstration,
    MarkerResidual,
    RecordingReport,
    RecordingSet,
    Refusal,
    Segment,
)
from .joint_states import RawJointStates
from .processes import Outcome, map_in_processes
from .reading import read_clean
from .repair import CleanRecording, RepairOptions, repair
from .segmentation import SegmentationOptions, absurd_extent, extent, least_extent_of_set
from .segments_file import SegmentRow, segments_by_hand
from .smoothing import SmoothingOptions
from .spool import GatheredSets

__all__ = ["LoadOptions", "RecordingReport", "RecordingSet", "load_recordings"]

SEGMENTATIONS = ("auto", "none")


class MarkerSolver(Protocol):
    """Finds joint states from markers, see :class:`.marker_joint_states.MarkerSource`."""

    def joint_states(
        self, path: Path, *, salvage: bool = False
    ) -> tuple[RawJointStates, dict[str, MarkerResidual]]:
        """Joint states of a recording, and the residuals of the markers by name."""


@dataclass(frozen=True)
class LoadOptions:
    """Choice of the motions to load, and how they are repaired, cut and smoothed.

    Attributes
    ----------
    topic : str or None
        Topic of the joint states; by default the only one.
    joints : sequence of str or None
        Names of the joints; by default all that every message lists.
    segment : str
        "auto" cuts at rests and valleys of the speed, "none" takes each recording as one motion
        and only trims the stillness at both ends (a recording with gaps: one motion per piece).
    segments_csv : path or None
        A table of motions cut by hand, see :func:`.segments_file.read_segments`; instead of
        `segment`.
    segmentation : SegmentationOptions
        Thresholds of "auto".
    smoothing : SmoothingOptions
        Filter and rate of the demonstrations.
    labels : sequence of str or None
        Labels in `segments_csv` of the motions to take; by default all.
    markers : MarkerSolver or None
        Finds the joint states from markers, see :func:`.marker_joint_states.marker_source`;
        `topic` and `joints` are not used then.
    state_field : str or None
        The field of the topic's messages that is a JointState, with dots where it is a field of a
        field; needs `topic`. By default the messages themselves are.
    repair : RepairOptions
        Thresholds of the repairs.
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
    segment: Literal["auto", "none"] = "auto"
    segments_csv: str | Path | None = None
    segmentation: SegmentationOptions = field(default_factory=SegmentationOptions)
    smoothing: SmoothingOptions = field(default_factory=SmoothingOptions)
    labels: Sequence[str] | None = None
    markers: MarkerSolver | None = None
    state_field: str | None = None
    repair: RepairOptions = field(default_factory=RepairOptions)
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
                f"the field '{self.state_field}' needs the topic whose messages have it"
            )


def load_recordings(
    paths: str | Path | Iterable[str | Path],
    *,
    jobs: int = 1,
    dask: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    known_extents: Sequence[float] = (),
    resume: str | Path | None = None,
    on_disk: bool = False,
    **options: Any,
) -> RecordingSet:
    """Load the demonstrated motions of recordings.

    Parameters
    ----------
    paths :
        Bag files, rosbag2 folders, folders of bags, glob patterns, and URLs of these (s3, gs,
        https, file); one of them or several.
    jobs :
        Processes that read recordings at the same time. The result is always the same.
    dask :
        Address of the scheduler of a Dask cluster that reads them instead, see
        :func:`.cluster.map_on_cluster`. The result is the same.
    progress :
        Called with the bytes of recordings done and in all.
    known_extents :
        Extents of further motions of the set, which are not loaded again [rad or m].
    resume :
        A folder that keeps what was read of each recording, so that an interrupted run continues
        where it was. What it holds is not read again.
    on_disk :
        Holds demonstrations, reports and summaries in temporary files: they can be iterated over,
        and each takes little memory.
    **options :
        The fields of :class:`LoadOptions`.

    Raises
    ------
    RecordingError
        If a path holds no recording, the table of segments is malformed, there are no motions of a
        label, or the cluster can't be used. Errors of a single recording are in `refused` instead.
    """
    settings = LoadOptions(**options)
    check_number(jobs, "the number of jobs", RecordingError, 1, is_whole=True)
    tasks = _tasks(bags.find_recordings(paths), settings, is_absolute=dask is not None)
    kept = ReadingCache() if resume is None else ReadingCache.resumed(resume)
    loaded = GatheredSets(len(tasks), on_disk=on_disk)
    _load_all(dict(enumerate(tasks)), loaded, kept, jobs, dask, progress)
    again = _tasks_again(tasks, loaded, known_extents)
    _load_all(again, loaded, kept, jobs, dask, None)
    settings.cache.prune()
    return loaded.result()


@dataclass(frozen=True, slots=True)
class _LoadTask:
    """A recording to load; its motions, if they were cut by hand; the set's least extent."""

    path: bags.Recording
    name: str
    segments: tuple[SegmentRow, ...] | None
    options: LoadOptions
    least_extent: float = 0.0


def _tasks(
    found: Sequence[bags.Recording], options: LoadOptions, *, is_absolute: bool
) -> list[_LoadTask]:
    names = bags.recording_names(found)
    by_hand = segments_by_hand(options.segments_csv, options.labels, names)
    tasks = []
    for path, name in zip(found, names, strict=True):
        rows = None if by_hand is None else tuple(by_hand.get(name, ()))
        # A recording with motions of other labels only has nothing to load.
        if by_hand is None or by_hand.get(name) != []:
            if is_absolute and isinstance(path, Path):
                path = path.absolute()
            tasks.append(_LoadTask(path, name, rows, options))
    return tasks


def _load_all(
    tasks: Mapping[int, _LoadTask],
    loaded: GatheredSets,
    kept: ReadingCache,
    jobs: int,
    dask: str | None,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Load recordings by index."""
    indices, left = array("q", tasks), array("q")
    sizes = array("q", [bags.stored_size(x.path) if progress else 0 for x in tasks.values()])
    total, done = sum(sizes), 0
    for position, index in enumerate(indices):
        found = kept.value(_key(tasks[index])) if kept.folder else None
        if isinstance(found, RecordingSet):
            loaded[index] = found
            done += sizes[position]
        else:
            left.append(position)

    def within(item: int, share: float) -> None:
        if progress is not None:
            progress(done + int(share * sizes[left[item]]), total)

    with closing(_outcomes([tasks[indices[i]] for i in left], jobs, dask, within)) as ready:
        for outcome in ready:
            position = left[outcome.index]
            index = indices[position]
            loaded[index] = _final(outcome, tasks[index].name)
            # What was refused is tried again: the reason may have been the network.
            if kept.folder and outcome.result is not None and not outcome.result.refused:
                kept.keep(_key(tasks[index]), outcome.result)
            done += sizes[position]
            within(outcome.index, 0.0)


def _key(task: _LoadTask) -> str:
    return key_of(task, bags.stored_state(task.path))


def _tasks_again(
    tasks: Sequence[_LoadTask], loaded: GatheredSets, known_extents: Sequence[float]
) -> dict[int, _LoadTask]:
    """Recordings to load again by what the others hold, by index.

    Movements of some count as rest relative to the motions of the set, and some list the joints
    in another order than the first does. Those of absurdly large motions are rejected.
    """
    extents, smallest, largest = array("d", known_extents), array("d"), array("d")
    again: dict[int, _LoadTask] = {}
    orders: dict[frozenset[str], tuple[str, ...]] = {}
    for index, task in enumerate(tasks):
        reports = loaded.reports(index)
        own = [m.extent for x in reports for m in x.motions if task.segments is None]
        extents.extend(own)
        smallest.append(min(own, default=np.inf))
        largest.append(max(own, default=0.0))
        for names in (report.joint_names for report in reports):
            order = orders.setdefault(frozenset(names), names)
            if order != names and task.options.markers is None:
                again[index] = replace(task, options=replace(task.options, joints=order))
    options = tasks[0].options.segmentation if tasks else SegmentationOptions()
    absurd = absurd_extent([*known_extents, *filter(None, largest)], options)
    for index in np.flatnonzero(np.asarray(largest) > absurd).tolist():
        reason = cutting.absurd_reason(largest[index], absurd)
        loaded[index] = RecordingSet(refused=(Refusal(tasks[index].name, reason),))
        again.pop(index, None)
        smallest[index] = np.inf
    if np.isfinite(smallest).any():
        least = least_extent_of_set([x for x in extents if x <= absurd], options)
        for index in np.flatnonzero(np.asarray(smallest) <= least).tolist():
            again[index] = replace(again.get(index, tasks[index]), least_extent=least)
    return again


def _outcomes(
    tasks: Sequence[_LoadTask],
    jobs: int,
    dask: str | None,
    within: Callable[[int, float], None],
) -> Generator[Outcome[RecordingSet], None, None]:
    if dask is not None and tasks:
        yield from map_on_cluster(_load, tasks, dask, _local_path)
    elif jobs > 1 and len(tasks) > 1:
        yield from map_in_processes(_load, tasks, jobs)
    else:
        for index, task in enumerate(tasks):
            yield Outcome(index, _load(task, partial(within, index)))


def _local_path(task: _LoadTask) -> str:
    return str(task.path) if isinstance(task.path, Path) else ""


def _final(outcome: Outcome[RecordingSet], name: str) -> RecordingSet:
    """The result for a recording, with what happened to the processes that read it."""
    found = outcome.result
    if found is None:
        reason = "every process that tried to read it died: it was killed, or memory ran out"
        return RecordingSet(refused=(Refusal(name, reason),))
    if not outcome.repeated:
        return found
    note = "read a second time, after a process had died"
    reports = (replace(report, notes=(*report.notes, note)) for report in found.reports)
    return replace(found, reports=tuple(reports))


def _load(task: _LoadTask, progress: Callable[[float], None] | None = None) -> RecordingSet:
    """Load one recording, in this process or another one."""
    try:
        if task.segments == ():
            raise RecordingError("the table of segments names no motion in it")
        began = time.perf_counter()
        with bags.local_copy(task.path) as path:
            found = _loaded(task, path, progress)
        seconds = time.perf_counter() - began
        return replace(found, reports=tuple(replace(x, seconds=seconds) for x in found.reports))
    except RecordingError as error:
        return RecordingSet(refused=(Refusal(task.name, str(error)),))


def _loaded(task: _LoadTask, path: Path, progress: Callable[[float], None] | None) -> RecordingSet:
    """Load the file or folder of a recording; one that can't be used raises a RecordingError."""
    options = task.options
    clean, residuals = _clean(path, options, progress)
    smoothed = cutting.SmoothRecording.of(clean, options.smoothing, options.segmentation)
    cuts, clean = _cut(task, smoothed)
    motions = cutting.demonstrations(cuts, clean, task.name, options.cache.checksum(path))
    segments = (Segment(m.start_time, m.end_time, m.label, extent(m.positions)) for m in motions)
    report = RecordingReport(
        name=task.name,
        path=str(task.path),
        format=bags.recording_format(path),
        topic=clean.topic,
        n_messages=clean.n_messages,
        rate=clean.rate,
        duration=clean.duration,
        joint_names=clean.joint_names,
        checksum=motions[0].checksum,
        repairs=clean.repairs,
        motions=tuple(segments),
        thresholds=smoothed.thresholds,
        notes=clean.notes,
        overview=cutting.overview(smoothed.pieces) if options.overviews else None,
        marker_residuals=residuals,
    )
    summaries = () if options.summarise is None else (options.summarise(motions),)
    n = options.most_samples
    kept = motions if n is None else [motion.thinned(n) for motion in motions if n > 0]
    return RecordingSet(tuple(kept), (report,), summaries=summaries)


def _clean(
    path: Path, options: LoadOptions, progress: Callable[[float], None] | None
) -> tuple[CleanRecording, dict[str, MarkerResidual]]:
    if options.markers is not None:
        raw, residuals = options.markers.joint_states(path, salvage=options.salvage)
        return repair(raw, None, options.repair), residuals
    read = partial(_read, path, options, progress)
    chosen = (options.topic, options.joints, options.state_field, options.salvage, options.repair)
    return options.cache.clean(path, repr(chosen), read), {}


def _read(
    path: Path, options: LoadOptions, progress: Callable[[float], None] | None
) -> CleanRecording:
    """Read joint states, and repair them."""
    with bags.open_bag(path, salvage=options.salvage) as bag:
        return read_clean(
            bag,
            options.topic,
            options.joints,
            state_field=options.state_field,
            options=options.repair,
            progress=progress,
        )


def _cut(
    task: _LoadTask, recording: cutting.SmoothRecording
) -> tuple[list[cutting.Cut], CleanRecording]:
    """Cut a recording into its motions; return them with additional notes and repairs."""
    if task.segments is not None:
        return cutting.cut_by_hand(recording.pieces, task.segments), recording.clean
    is_whole = recording.clean.pieces_are_motions or task.options.segment == "none"
    return cutting.cut_motions(
        recording, task.options.segmentation, task.least_extent, is_whole=is_whole
    )
