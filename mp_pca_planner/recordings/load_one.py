# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One recording as demonstrations, or the reason why it can't be used."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..exceptions import RecordingError, UnusableRecordingError
from . import bags, cutting
from .demonstration import Demonstration
from .reading import LoadOptions, read_recording
from .recording_set import MarkerResidual, RecordingReport, RecordingSet, Refusal, Segment
from .repair import CleanRecording, repair
from .segmentation import (
    ABSURD_EXTENT,
    SmoothPiece,
    SpeedThresholds,
    extent,
)

# Distance beyond a limit that is no reason for a note, as of soft limits and noise, and one for
# which a recording is rejected: half a turn is beyond any calibration [rad or m].
_LIMIT_TOLERANCE = 0.0175
_ABSURD_EXCESS = 3.14


@dataclass(frozen=True, slots=True)
class LoadTask:
    """A recording to load; its motions, if cut by hand; the set's least extent; notes on it."""

    path: Path
    name: str
    segments: tuple[Segment, ...] | None
    options: LoadOptions
    least_extent: float = 0.0
    notes: tuple[str, ...] = ()


def load_one(task: LoadTask) -> RecordingSet:
    """Load one recording, in this process or another one."""
    try:
        if task.segments == ():
            raise RecordingError("the table of segments lists no motion of it")
        began = time.perf_counter()
        found = _loaded(task)
        seconds = time.perf_counter() - began
        return replace(found, reports=tuple(replace(x, seconds=seconds) for x in found.reports))
    except RecordingError as error:
        findings = error.findings if isinstance(error, UnusableRecordingError) else {}
        joints = findings.get("listed_joints", ())
        return RecordingSet.rejected(Refusal(task.name, str(error), joints))


def _loaded(task: LoadTask) -> RecordingSet:
    """Load a recording; one that can't be used raises a RecordingError."""
    path, options = task.path, task.options
    clean, residuals = _clean(path, options)
    pieces, thresholds = cutting.smoothed(clean)
    cuts, clean = _cut(task, clean, pieces, thresholds)
    checksum = bags.checksum(path)
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
        path=str(path),
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
    return RecordingSet(tuple(motions), (report,))


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


def _clean(path: Path, options: LoadOptions) -> tuple[CleanRecording, dict[str, MarkerResidual]]:
    """Repaired joint states, and the residuals of the markers that they come from."""
    if options.markers is not None:
        raw, residuals = options.markers.joint_states(path, salvage=options.salvage)
        return repair(raw, None, options.max_gap), residuals
    return read_recording(path, options), {}
