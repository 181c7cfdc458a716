# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Pieces of a recording: cut at gaps, long enough, and averaged where the rate is high."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from ...exceptions import RecordingError
from ..byte_layout import NS_PER_S
from .options import RepairOptions
from .recording import MIN_SAMPLES, Piece
from .samples import Samples


def cut_at_gaps(samples: Samples, options: RepairOptions, repairs: Counter[str]) -> list[Piece]:
    """Cut a recording where no message comes for longer than the longest gap."""
    max_gap = options.longest_gap(samples.period)
    times = samples.times / NS_PER_S
    cuts = np.flatnonzero(np.diff(times) > max_gap / NS_PER_S) + 1
    repairs["gaps"] += cuts.size - repairs["clock_jumps"]
    return long_pieces(Piece(times, samples.positions).cut(cuts.tolist()), repairs)


def long_pieces(pieces: Sequence[Piece], repairs: Counter[str]) -> list[Piece]:
    """Drop pieces with too few samples.

    Raises
    ------
    RecordingError
        If none is left.
    """
    long = [piece for piece in pieces if piece.times.size >= MIN_SAMPLES]
    repairs["short_pieces"] += len(pieces) - len(long)
    if not long:
        raise RecordingError(
            f"it is all in pieces: there are gaps or jumps in {len(pieces) - 1} places, and "
            f"nothing between them has the {MIN_SAMPLES} samples that are needed"
        )
    return long


def averaged(piece: Piece, n_averaged: int) -> Piece:
    """Means of `n_averaged` consecutive samples each; the last one may be of fewer."""
    if n_averaged == 1:
        return piece
    starts = np.arange(0, piece.times.size, n_averaged)
    sizes = np.diff(starts, append=piece.times.size)
    return Piece(
        np.add.reduceat(piece.times, starts) / sizes,
        np.add.reduceat(piece.positions, starts) / sizes[:, None],
    )
