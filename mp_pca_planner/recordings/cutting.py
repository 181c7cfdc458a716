# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions cut out of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..exceptions import RecordingError
from .demonstration import Demonstration, Overview
from .joint_states import RawJointStates
from .repair import CleanRecording, Piece, repair
from .segmentation import (
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
from .segments_file import SegmentRow
from .smoothing import SmoothingOptions, SmoothPiece, smooth


@dataclass(frozen=True, eq=False)
class Cut:
    """A motion: the piece that contains it, its first and last step, its label."""

    piece: SmoothPiece
    first: int
    last: int
    label: str = ""

    @property
    def extent(self) -> float:
        """Norm over the joints of the distance that each of them covers [rad or m]."""
        return extent(self.piece.positions[self.first : self.last + 1])

    def demonstration(
        self, joint_names: tuple[str, ...], recording: str, checksum: str
    ) -> Demonstration:
        """The motion as a demonstration."""
        piece, steps = self.piece, slice(self.first, self.last + 1)
        return Demonstration(
            joint_names,
            piece.times[steps] - piece.times[self.first],
            piece.positions[steps],
            piece.velocities[steps],
            piece.accelerations[steps],
            recording=recording,
            start_time=float(piece.times[self.first]),
            end_time=float(piece.times[self.last]),
            label=self.label,
            checksum=checksum,
        )


@dataclass(frozen=True, eq=False)
class SmoothRecording:
    """A repaired recording, its smoothed pieces, and the speeds of its rests and motions."""

    clean: CleanRecording
    pieces: list[SmoothPiece]
    thresholds: SpeedThresholds

    @classmethod
    def of(
        cls, clean: CleanRecording, smoothing: SmoothingOptions, segmentation: SegmentationOptions
    ) -> SmoothRecording:
        """Smooth a repaired recording."""
        pieces = [smooth(piece, clean.sample_rate, smoothing) for piece in clean.pieces]
        speed = np.concatenate([joint_speed(piece.velocities) for piece in pieces])
        return cls(clean, pieces, speed_thresholds(speed, segmentation))


def cut_joint_states(
    raw: RawJointStates, joints: Sequence[str] | None, options: SegmentationOptions
) -> tuple[list[Cut], CleanRecording]:
    """Cut joint states as :func:`.load_recordings` cuts a bag that holds nothing else.

    Parameters
    ----------
    raw :
        Joint states as recorded.
    joints :
        Names of the joints; by default all that every message lists.
    options :
        Thresholds.

    Raises
    ------
    RecordingError
        If they can't be used, or hold no motion.
    """
    recording = SmoothRecording.of(repair(raw, joints), SmoothingOptions(), options)
    cuts, clean = cut_motions(recording, options)
    extents = [cut.extent for cut in cuts]
    least = least_extent_of_set(extents, options) if cuts else 0.0
    if cuts and min(extents) <= least:
        cuts, clean = cut_motions(recording, options, least)
    return cuts, clean


def cut_motions(
    recording: SmoothRecording,
    options: SegmentationOptions,
    least_of_set: float = 0.0,
    *,
    is_whole: bool = False,
) -> tuple[list[Cut], CleanRecording]:
    """Cut a recording into its motions.

    Parameters
    ----------
    recording :
        The recording.
    options :
        Thresholds.
    least_of_set :
        Smallest extent of a motion by those of all recordings [rad or m].
    is_whole :
        Whether each piece is one motion.

    Returns
    -------
    cuts : list of Cut
        The motions.
    clean : CleanRecording
        The recording with notes and a count of what is left out.

    Raises
    ------
    RecordingError
        If all movements are within the extent of noise and sway.
    """
    clean = recording.clean
    notes: tuple[str, ...] = ()
    if is_whole:
        cuts = cut_whole_pieces(recording.pieces, recording.thresholds)
    else:
        cuts, notes = cut_at_rests_and_valleys(recording.pieces, recording.thresholds, options)
    kept = without_rest(cuts, clean.pieces, least_of_set, options)
    n_rest = len(cuts) - len(kept)
    repairs = {**clean.repairs, "rest": n_rest} if n_rest else clean.repairs
    return kept, replace(clean, repairs=repairs, notes=clean.notes + notes)


def cut_by_hand(pieces: Sequence[SmoothPiece], rows: Sequence[SegmentRow]) -> list[Cut]:
    """Cut the motions of a table of segments.

    Raises
    ------
    RecordingError
        If one of them is not within a piece.
    """
    return [_cut_row(pieces, row) for row in rows]


def _cut_row(pieces: Sequence[SmoothPiece], row: SegmentRow) -> Cut:
    for piece in pieces:
        first, last = (
            round((time - float(piece.times[0])) * piece.rate) for time in (row.start, row.end)
        )
        # A last time that was rounded up may be a little behind the last sample.
        if first >= 0 and first < last <= piece.times.size:
            return Cut(piece, first, min(last, piece.times.size - 1), row.label)
    spans = ", ".join(f"{p.times[0]:.3f} s to {p.times[-1]:.3f} s" for p in pieces)
    raise RecordingError(
        f"{row.where}: {row.start:g} s to {row.end:g} s is not within the "
        f"recording, which has samples from {spans}"
    )


def cut_whole_pieces(pieces: Sequence[SmoothPiece], thresholds: SpeedThresholds) -> list[Cut]:
    """Take each piece as one motion, without the stillness at both ends."""
    spans = ((piece, trim(piece, thresholds)) for piece in pieces)
    return [Cut(piece, *span) for piece, span in spans if span is not None]


def cut_at_rests_and_valleys(
    pieces: Sequence[SmoothPiece], thresholds: SpeedThresholds, options: SegmentationOptions
) -> tuple[list[Cut], tuple[str, ...]]:
    """Cut at rests and valleys; motions that are small beside the largest are left out.

    Returns
    -------
    cuts : list of Cut
        The motions.
    notes : tuple of str
        A note if some are left out.
    """
    cuts = [
        Cut(piece, *span) for piece in pieces for span in find_motions(piece, thresholds, options)
    ]
    large = large_motions([cut.extent for cut in cuts], options)
    kept = [cut for cut, is_large in zip(cuts, large, strict=True) if is_large]
    if len(kept) == len(cuts):
        return kept, ()
    note = (
        f"{len(cuts) - len(kept)} motions over less than {options.extent_ratio:.0%} of the extent "
        "of the largest are left out"
    )
    return kept, (note,)


def without_rest(
    cuts: Sequence[Cut],
    pieces: Sequence[Piece],
    least_of_set: float,
    options: SegmentationOptions,
) -> list[Cut]:
    """Leave out movements within the extent of noise and sway, or small beside the set's motions.

    Raises
    ------
    RecordingError
        If none is left.
    """
    least = max(least_extent(pieces, options), least_of_set)
    kept = [cut for cut in cuts if cut.extent > least]
    if cuts and not kept:
        if least == least_of_set:
            why = "by the extent of the other recordings' motions"
        else:
            sways = least <= options.min_extent
            why = "as an arm that is held still sways" if sways else "by its noise"
        raise RecordingError(
            f"it holds no motion: its joints move over {max(cut.extent for cut in cuts):.2g} rad "
            f"(or m) at most, and up to {least:.2g} is taken for rest, {why}; give a table of "
            "segments if these are motions nevertheless"
        )
    return kept


def absurd_reason(largest: float, absurd: float) -> str:
    """Why a recording with a motion of an absurdly large extent is rejected [rad or m]."""
    return (
        f"its joints move over {largest:.3g} rad (or m), and over {absurd:.3g} is absurd beside "
        "the other recordings' motions: positions must be in radians (or m), not in degrees; "
        "choose the joints, or give a table of segments if these are motions nevertheless"
    )


def demonstrations(
    cuts: Sequence[Cut], clean: CleanRecording, recording: str, checksum: str
) -> list[Demonstration]:
    """Demonstrations of the motions of a recording.

    Raises
    ------
    RecordingError
        If there is no motion.
    """
    if not cuts:
        raise RecordingError("no motion was found in it")
    return [cut.demonstration(clean.joint_names, recording, checksum) for cut in cuts]


def overview(pieces: Sequence[SmoothPiece]) -> Overview:
    """About 1000 samples of a recording, the resolution of a figure."""
    k = max(1, sum(piece.times.size for piece in pieces) // 1000)
    parts = []
    for piece in pieces:
        chosen = np.arange(0, piece.times.size, k)
        speed = np.maximum.reduceat(joint_speed(piece.velocities), chosen)
        columns = (piece.times[chosen], piece.positions[chosen], speed)
        parts.append(np.column_stack(columns))
        parts.append(np.full((1, parts[0].shape[1]), np.nan))
    table = np.concatenate(parts)
    return Overview(table[:, 0], table[:, 1:-1], table[:, -1])
