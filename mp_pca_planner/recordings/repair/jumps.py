# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Gaps and jumps: a recording is cut at both; full turns are removed, spikes are dropped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...exceptions import RecordingError
from ..byte_layout import NS_PER_S
from .recording import MIN_SAMPLES, Piece
from .samples import RepairOptions, Samples, count, taken


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


def unwrap(pieces: Sequence[Piece], options: RepairOptions, repairs: Counter[str]) -> list[Piece]:
    """Remove jumps by full turns; other jumps are not those of a wrapping angle."""
    return [Piece(p.times, _unwrapped(p.positions, options, repairs)) for p in pieces]


def _unwrapped(positions: FloatArray, options: RepairOptions, repairs: Counter[str]) -> FloatArray:
    steps = np.diff(positions, axis=0)
    turns = np.round(steps / (2.0 * np.pi))
    turns[np.abs(steps - 2.0 * np.pi * turns) >= options.max_turn_error] = 0.0
    n_wrapped = count(turns)
    if not n_wrapped:
        return positions
    repairs["wrapped"] += n_wrapped
    unwrapped = positions.copy()
    unwrapped[1:] -= 2.0 * np.pi * np.cumsum(turns, axis=0)
    return unwrapped


def cut_at_jumps(
    pieces: Sequence[Piece], options: RepairOptions, repairs: Counter[str]
) -> list[Piece]:
    """Drop spikes, and cut where the positions jump and stay there.

    Raises
    ------
    RecordingError
        If there are too many jumps for one publisher, or no piece is long enough.
    """
    parts: list[Piece] = []
    n_spikes = 0
    for piece in pieces:
        good = np.flatnonzero(~_spikes(piece.positions, options))
        n_spikes += piece.times.size - good.size
        smooth = Piece(taken(good, piece.times), taken(good, piece.positions))
        parts += smooth.cut(_jumps(smooth, options))
    n_samples = sum(piece.times.size for piece in pieces)
    n_jumps = len(parts) - len(pieces)
    if n_spikes + n_jumps > options.max_jumps * n_samples + 1:
        raise RecordingError(
            f"the positions jump {n_spikes + n_jumps} times in {n_samples} samples, faster than "
            "any motor could: two publishers of the same joints; record one of them"
        )
    repairs["spikes"] += n_spikes
    repairs["jumps"] += n_jumps
    return long_pieces(parts, repairs)


def _jump_length(position: FloatArray, options: RepairOptions) -> float:
    """Shortest step of a joint that may be a jump, from its usual steps while it moves."""
    # Where two publishers alternate, only steps over two or three messages show the motion.
    usual = min(_usual_step(position, lag) for lag in (1, 2, 3))
    return max(options.min_jump, options.jump_ratio * usual)


def _usual_step(position: FloatArray, lag: int) -> float:
    steps = np.abs(position[lag:] - position[:-lag]) / lag
    moving = steps[steps > 1e-6]
    return float(np.median(moving)) if moving.size else 0.0


def _spikes(positions: FloatArray, options: RepairOptions) -> NDArray[np.bool_]:
    """Samples that are far from both neighbours while these are near each other."""
    spikes = np.zeros(len(positions), dtype=bool)
    for position in positions.T:
        across = np.abs(position[2:] - position[:-2])
        aside = np.abs(position[1:-1] - 0.5 * (position[2:] + position[:-2]))
        spikes[1:-1] |= (aside > _jump_length(position, options)) & (across < 0.5 * aside)
    return spikes


def _jumps(piece: Piece, options: RepairOptions) -> list[int]:
    """Samples that follow a jump: a fast step between slow ones."""
    jumps = np.zeros(piece.times.size - 1, dtype=bool)
    for position in piece.positions.T:
        steps = np.abs(np.diff(position))
        beside = np.maximum(np.append(steps[1:], 0.0), np.append(0.0, steps[:-1]))
        jumps |= (
            (steps > _jump_length(position, options))
            & (steps > options.jump_speed * np.diff(piece.times))
            & (steps > options.jump_isolation * beside)
        )
    return (np.flatnonzero(jumps) + 1).tolist()
