# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repair of motions that are not continuous: gaps, full turns, jumps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import RecordingError
from .recording import MIN_SAMPLES, Samples

Pieces = tuple[list[Samples], dict[str, int]]
"""Pieces of a recording, and the counts of repairs."""

GAP_TIME, GAP_PERIODS = 0.5, 5
"""See :func:`longest_gap` [s, periods]."""

NOISE_DEVIATIONS = 8.0
"""Errors of positions up to this many standard deviations of the noise are noise."""

LARGEST_ANGLE = 6.5
"""Joints of an arm stay within this [rad]: a turn, and a little more."""

# Values beyond two turns are no degrees, and LeRobot's shares of calibrated ranges end at 100.
_MAX_DEGREES, _MAX_SHARE = 720.0, 100.5
# A jump is a full turn if it differs from one by less than this [rad].
_MAX_TURN_ERROR = 1.0
# A jump is longer than this [rad or m] and than this many usual steps.
_MIN_JUMP = 0.05
_JUMP_RATIO = 10.0
# A jump is faster than this [/s] and longer than this many times the steps before and after it. A
# spike, which returns in the next sample, need not be as fast.
_JUMP_SPEED = 20.0
_JUMP_ISOLATION = 5.0
# From this share of jumping samples on there are two publishers.
_MAX_JUMPS = 0.05


def count(mask: NDArray[Any]) -> int:
    """Number of entries that are not zero."""
    return int(np.count_nonzero(mask))


def median_period(times: NDArray[Any]) -> float:
    """Median time between samples, whatever their order, in the unit of the times."""
    steps = np.diff(np.sort(times))
    # Stamps are whole nanoseconds.
    return round(float(np.median(steps[steps > 0])), 10)


def longest_gap(period: float, max_gap: float | None) -> float:
    """Longest time between messages of a usual period that is no gap [s].

    Parameters
    ----------
    period : float
        The usual period [s].
    max_gap : float or None
        That time [s]. By default it is `GAP_TIME`, or `GAP_PERIODS` usual periods where these are
        longer.
    """
    return max(GAP_TIME, GAP_PERIODS * period) if max_gap is None else max_gap


def noise_deviation(position: FloatArray) -> float:
    """Standard deviation of the noise of a joint [rad or m], from its second differences.

    It is taken from the median, which motions during less than half of the time hardly change.
    Where two publishers alternate, only differences over two or three samples show the noise.
    """
    if position.size < 9:
        return 0.0
    middles = [2 * position[k:-k] - position[2 * k :] - position[: -2 * k] for k in (1, 2, 3)]
    # Median of a normal distribution's magnitudes; variance of a sample and two neighbours.
    return min(float(np.median(np.abs(x))) for x in middles) / (0.6745 * float(np.sqrt(6.0)))


def cut_at_gaps(samples: Samples, gap: float, n_jumps: int) -> Pieces:
    """Cut a recording at gaps.

    Parameters
    ----------
    samples :
        Its samples.
    gap :
        Longest time between samples that is no gap [s].
    n_jumps :
        Gaps that are jumps of the clock, which are counted already.
    """
    gaps = np.flatnonzero(np.diff(samples.times) > gap)
    return samples.cut((gaps + 1).tolist()), {"gaps": gaps.size - n_jumps}


def long_pieces(pieces: Sequence[Samples]) -> Pieces:
    """Drop pieces with too few samples.

    Raises
    ------
    RecordingError
        If none is left.
    """
    long = [piece for piece in pieces if piece.times.size >= MIN_SAMPLES]
    if not long:
        raise RecordingError(
            f"it is all in pieces: there are gaps or jumps in {len(pieces) - 1} places, and "
            f"nothing between them has the {MIN_SAMPLES} samples that are needed"
        )
    return long, {"short_pieces": len(pieces) - len(long)}


def unwrap(pieces: Sequence[Samples]) -> Pieces:
    """Remove jumps by full turns; other jumps are not those of a wrapping angle."""
    unwrapped, n_wrapped = [], 0
    for piece in pieces:
        steps = np.diff(piece.positions, axis=0)
        turns = np.round(steps / (2.0 * np.pi))
        turns[np.abs(steps - 2.0 * np.pi * turns) >= _MAX_TURN_ERROR] = 0.0
        positions = piece.positions
        if turns.any():
            n_wrapped += count(turns)
            positions = positions.copy()
            positions[1:] -= 2.0 * np.pi * np.cumsum(turns, axis=0)
        unwrapped.append(Samples(piece.times, positions))
    return unwrapped, {"wrapped": n_wrapped}


def refuse_other_units(pieces: Sequence[Samples], *, were_degrees: bool) -> Pieces:
    """Reject positions of which two joints, and half of all, are beyond any angle in radians.

    Raises
    ------
    RecordingError
        If they are.
    """
    reach = np.max([np.abs(piece.positions).max(axis=0) for piece in pieces], axis=0)
    n_far = count(reach > LARGEST_ANGLE)
    # A single joint may turn on and on.
    if n_far < 2 or 2 * n_far < reach.size:
        return list(pieces), {}
    raise RecordingError(
        f"{n_far} of its {reach.size} joints are beyond {LARGEST_ANGLE:g} rad, one at "
        f"{reach.max():.3g}: positions must be in radians (or m), not in degrees (or mm); "
        f"{units_advice(float(reach.max()), were_degrees=were_degrees)}"
    )


def units_advice(reach: float, *, were_degrees: bool) -> str:
    """How to convert positions that reach so far, unless other joints are meant."""
    factor = "--scale JOINT=FACTOR (scale=), such as 0.001 for mm or 0.001534 for 4096 ticks a turn"
    if were_degrees:
        advice = f"instead of --degrees, give the whole factor to rad with {factor}"
    else:
        shares = "LeRobot's shares from -100 to 100 with --scale CALIBRATION.json (scale=)"
        ways = ["degrees with --degrees (degrees=True)"] if reach <= _MAX_DEGREES else []
        ways += [shares] if reach <= _MAX_SHARE else []
        advice = f"convert {', '.join([*ways, f'other units with {factor}'])}"
    return f"{advice}; or choose the joints of the arm with --joints (joints=)"


def cut_at_jumps(pieces: Sequence[Samples]) -> Pieces:
    """Drop spikes, and cut where the positions jump and stay there.

    Raises
    ------
    RecordingError
        If there are too many jumps for one publisher.
    """
    parts: list[Samples] = []
    n_spikes = 0
    for piece in pieces:
        good = ~_spikes(piece.positions)
        n_spikes += count(~good)
        smooth = Samples(piece.times[good], piece.positions[good])
        *before, last = smooth.cut(_jumps(smooth))
        parts += [*map(_without_frozen_end, before), last]
    n_samples = sum(piece.times.size for piece in pieces)
    n_jumps = len(parts) - len(pieces)
    if n_spikes + n_jumps > _MAX_JUMPS * n_samples + 1:
        raise RecordingError(
            f"the positions jump {n_spikes + n_jumps} times in {n_samples} samples, faster than "
            "any motor could: two publishers of the same joints; record one of them"
        )
    n_frozen = n_samples - n_spikes - sum(part.times.size for part in parts)
    return parts, {"spikes": n_spikes, "jumps": n_jumps, "frozen": n_frozen}


def _without_frozen_end(piece: Samples) -> Samples:
    """The piece without repeated positions at its end, if the joints did not slow down before them.

    A driver that lost its robot repeats the last state. Taken for a rest, it would end a motion.
    """
    moves = np.flatnonzero((piece.positions != piece.positions[-1]).any(axis=1))
    last = int(moves.max(initial=-1)) + 1  # the first sample of the repeated ones
    places = np.maximum([last - 2 * MIN_SAMPLES, last - MIN_SAMPLES, last], 0)
    earlier, way = np.linalg.norm(np.diff(piece.positions[places], axis=0), axis=1)
    return piece.cut([last + 1])[0] if way > max(_MIN_JUMP, 0.5 * earlier) else piece


def _jump_length(position: FloatArray) -> float:
    """Shortest step of a joint that may be a jump, from its usual steps while it moves."""
    # Where two publishers alternate, only steps over two or three messages show the motion.
    usual = min(_usual_step(position, lag) for lag in (1, 2, 3))
    noise = NOISE_DEVIATIONS * noise_deviation(position)
    return max(_MIN_JUMP, _JUMP_RATIO * usual, noise)


def _usual_step(position: FloatArray, lag: int) -> float:
    steps = np.abs(position[lag:] - position[:-lag]) / lag
    moving = steps[steps > 1e-6]
    return float(np.median(moving)) if moving.size else 0.0


def _spikes(positions: FloatArray) -> NDArray[np.bool_]:
    """Samples that are far from both neighbours while these are near each other."""
    spikes = np.zeros(len(positions), dtype=bool)
    for position in positions.T:
        across = np.abs(position[2:] - position[:-2])
        aside = np.abs(position[1:-1] - 0.5 * (position[2:] + position[:-2]))
        spikes[1:-1] |= (aside > _jump_length(position)) & (across < 0.5 * aside)
    return spikes


def _jumps(piece: Samples) -> list[int]:
    """Samples that follow a jump: a fast step between slow ones."""
    jumps = np.zeros(piece.times.size - 1, dtype=bool)
    for position in piece.positions.T:
        steps = np.abs(np.diff(position))
        beside = np.maximum(np.append(steps[1:], 0.0), np.append(0.0, steps[:-1]))
        is_fast = steps > _JUMP_SPEED * np.diff(piece.times)
        jumps |= is_fast & (steps > _jump_length(position)) & (steps > _JUMP_ISOLATION * beside)
    return (np.flatnonzero(jumps) + 1).tolist()
