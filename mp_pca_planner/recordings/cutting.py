# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions cut out of a repaired recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..exceptions import RecordingError
from .demonstration import Demonstration
from .repair import CleanRecording, Piece
from .segmentation import (
    SegmentationOptions,
    SpeedThresholds,
    extent,
    find_motions,
    large_motions,
    least_extent,
    trim,
)
from .segments_file import SegmentRow
from .smoothing import SmoothPiece


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
