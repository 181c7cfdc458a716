# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repair of recorded motions: gaps, jumps, wrapped angles, wrong velocities and units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...exceptions import RecordingError, quote_names
from ..joint_states import NS_PER_S, IntArray, JointLayout, RawJointStates
from .messages import choose_clock
from .recording import (
    MIN_SAMPLES,
    NOISE_DEVIATIONS,
    Defect,
    Piece,
    Samples,
    count,
    noise_deviation,
    taken,
)

# Joints of an arm stay within this [rad]: a turn, and a little more.
LARGEST_ANGLE = 6.5
# A jump is a full turn if it differs from one by less than this [rad].
_MAX_TURN_ERROR = 1.0
# A jump is longer than this [rad or m] and than this many usual steps.
_MIN_JUMP = 0.05
_JUMP_RATIO = 10.0
# A jump is faster than this [/s] and longer than this many times the steps before and after it. A
# spike, which returns in the next sample, need not be as fast.
_JUMP_SPEED = 20.0
_JUMP_ISOLATION = 5.0
# Joints that repeat their positions exactly before a jump were not measured if they moved at more
# than this [/s] just before, and at more than this share of the speed that makes up for the jump,
# and of the speed even earlier: a motion that ends slows down.
_FROZEN_SPEED = 0.05
_FROZEN_SHARE = 0.5
# Each of these speeds is a mean over this time [s].
_FROZEN_WINDOW = 0.1
# A step of the clock is longer than this [s] and than this many periods. In such a time just before
# and after it, the joints move by more than this [rad or m]. During it, they move at less than this
# share of their speed there.
_CLOCK_STEP = 0.1
_CLOCK_PERIODS = 5
_CLOCK_EXTENT = 0.02
_CLOCK_SHARE = 0.5
# From this share of jumping samples on there are two publishers.
_MAX_JUMPS = 0.05


def refuse_degrees(pieces: Sequence[Piece], repairs: Counter[str]) -> Sequence[Piece]:
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
        return pieces
    raise RecordingError(
        f"{n_far} of its {reach.size} joints are beyond {LARGEST_ANGLE:g} rad, one at "
        f"{reach.max():.3g}: positions must be in radians (or m), not in degrees (or mm); if these "
        "are degrees, convert them with --degrees (degrees=True in Python); if they are LeRobot's "
        "shares from -100 to 100, with --scale (scale=); else choose the joints of the arm"
    )


UNITS = Defect({}, refuse_degrees)


def cut_at_gaps(samples: Samples, repairs: Counter[str]) -> list[Piece]:
    """Cut a recording at gaps, and where the clock was set forward."""
    times = samples.times / NS_PER_S
    gaps = np.diff(times) > samples.longest_gap / NS_PER_S
    steps = _clock_steps(times, samples.positions, samples.period / NS_PER_S) & ~gaps
    repairs["gaps"] += count(gaps) - repairs["clock_jumps"]
    repairs["clock_steps"] += count(steps)
    cuts = np.flatnonzero(gaps | steps) + 1
    return long_pieces(Piece(times, samples.positions).cut(cuts.tolist()), repairs)


def _clock_steps(times: FloatArray, positions: FloatArray, period: float) -> NDArray[np.bool_]:
    """Intervals during which the joints hardly move, but move before and after them.

    Taken for time, such an interval would be a rest within a motion.
    """
    intervals = np.diff(times)
    stepped = np.zeros(intervals.size, dtype=bool)
    n_beside = max(_CLOCK_PERIODS, int(np.ceil(_CLOCK_STEP / period)))
    holes = np.flatnonzero(intervals > n_beside * period)
    # Near an end of the recording there is nothing to compare with.
    holes = holes[(holes >= n_beside) & (holes + 1 + n_beside < times.size)]
    first, last = holes - n_beside, holes + 1 + n_beside
    before = np.linalg.norm(positions[holes] - positions[first], axis=1)
    after = np.linalg.norm(positions[last] - positions[holes + 1], axis=1)
    across = np.linalg.norm(positions[holes + 1] - positions[holes], axis=1)
    # Messages that were delayed and come in a burst after the hole show a motion faster than it is.
    prompt = times[last] - times[holes + 1] > 0.5 * n_beside * period
    noise = np.linalg.norm([noise_deviation(position) for position in positions.T])
    extent = max(_CLOCK_EXTENT, NOISE_DEVIATIONS * float(noise))
    moving = np.minimum(before, after)
    expected = moving * intervals[holes] / (n_beside * period)
    stepped[holes] = prompt & (moving > extent) & (across < _CLOCK_SHARE * expected)
    return stepped


GAPS = Defect(
    {
        "gaps": "no message for longer than the longest gap: cut there",
        "clock_steps": "the clock was set forward while the joints moved: cut there",
    },
    cut_at_gaps,
)


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


def unwrap(pieces: Sequence[Piece], repairs: Counter[str]) -> list[Piece]:
    """Remove jumps by full turns; other jumps are not those of a wrapping angle."""
    return [Piece(p.times, _unwrapped(p.positions, repairs)) for p in pieces]


def _unwrapped(positions: FloatArray, repairs: Counter[str]) -> FloatArray:
    steps = np.diff(positions, axis=0)
    if np.abs(steps).max(initial=0.0) < np.pi:
        return positions
    turns = np.round(steps / (2.0 * np.pi))
    turns[np.abs(steps - 2.0 * np.pi * turns) >= _MAX_TURN_ERROR] = 0.0
    n_wrapped = count(turns)
    if not n_wrapped:
        return positions
    repairs["wrapped"] += n_wrapped
    unwrapped = positions.copy()
    unwrapped[1:] -= 2.0 * np.pi * np.cumsum(turns, axis=0)
    return unwrapped


WRAPS = Defect(
    {
        "wrapped": "jump of a joint by full turns: removed",
    },
    unwrap,
)


def cut_at_jumps(pieces: Sequence[Piece], repairs: Counter[str]) -> list[Piece]:
    """Drop spikes, and cut where the positions jump and stay there.

    Raises
    ------
    RecordingError
        If there are too many jumps for one publisher, or no piece is long enough.
    """
    parts: list[Piece] = []
    n_spikes = 0
    for piece in pieces:
        good = np.flatnonzero(~_spikes(piece.positions))
        n_spikes += piece.times.size - good.size
        smooth = Piece(taken(good, piece.times), taken(good, piece.positions))
        own = smooth.cut(_jumps(smooth))
        parts += [_without_frozen_end(*pair) for pair in pairwise(own)] + own[-1:]
    n_samples = sum(piece.times.size for piece in pieces)
    n_jumps = len(parts) - len(pieces)
    if n_spikes + n_jumps > _MAX_JUMPS * n_samples + 1:
        raise RecordingError(
            f"the positions jump {n_spikes + n_jumps} times in {n_samples} samples, faster than "
            "any motor could: two publishers of the same joints; record one of them"
        )
    repairs["spikes"] += n_spikes
    repairs["jumps"] += n_jumps
    repairs["frozen"] += n_samples - n_spikes - sum(part.times.size for part in parts)
    return long_pieces(parts, repairs)


def _without_frozen_end(piece: Piece, following: Piece) -> Piece:
    """The piece without repeated positions at its end, if the joints moved before and after.

    A driver that lost its robot repeats the last state. Taken for a rest, it would end a motion.
    """
    moves = np.flatnonzero((piece.positions != piece.positions[-1]).any(axis=1))
    last = int(moves[-1]) + 1 if moves.size else 0  # the first sample of the repeated ones
    windows = piece.times[last] - _FROZEN_WINDOW * np.array([2.0, 1.0])
    earlier, first = np.searchsorted(piece.times, windows).tolist()
    if not earlier < first < last:
        return piece
    places = [earlier, first, last]
    times = np.append(piece.times[places], following.times[0])
    positions = np.vstack([piece.positions[places], following.positions[:1]])
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(times)
    if speeds[1] < max(_FROZEN_SPEED, _FROZEN_SHARE * max(speeds[0], speeds[2])):
        return piece
    return piece.cut([last + 1])[0]


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


def _jumps(piece: Piece) -> list[int]:
    """Samples that follow a jump: a fast step between slow ones."""
    jumps = np.zeros(piece.times.size - 1, dtype=bool)
    for position in piece.positions.T:
        steps = np.abs(np.diff(position))
        beside = np.maximum(np.append(steps[1:], 0.0), np.append(0.0, steps[:-1]))
        jumps |= (
            (steps > _jump_length(position))
            & (steps > _JUMP_SPEED * np.diff(piece.times))
            & (steps > _JUMP_ISOLATION * beside)
        )
    return (np.flatnonzero(jumps) + 1).tolist()


JUMPS = Defect(
    {
        "spikes": "message dropped: a joint is farther away in it than a motor could move it",
        "jumps": "a joint moves faster than a motor could: cut there",
        "frozen": "message before such a jump dropped: it repeats positions of moving joints",
    },
    cut_at_jumps,
)


# Mean velocities over this time are compared [s]; noise hides those over one period.
_VELOCITY_WINDOW = 0.1
# Number of windows; with fewer no verdict is given.
_VELOCITY_MAX_COMPARED = 20000
_VELOCITY_MIN_COMPARED = 20
# Joints are compared between these speeds [rad/s or m/s]: at rest there is only noise, and a
# faster joint has wrapped or jumped.
_VELOCITY_MIN_SPEED = 0.02
_VELOCITY_MAX_SPEED = 20.0
# A window longer than this share of the median window contains a gap.
_VELOCITY_MAX_STRETCH = 2.0
# Accepted relative error of the scale.
_VELOCITY_MAX_SCALE_ERROR = 0.2
# With a lower correlation the velocities do not follow the positions.
_VELOCITY_MIN_CORRELATION = 0.8


def velocity_notes(raw: RawJointStates, joint_names: Sequence[str]) -> tuple[str, ...]:
    """Notes on missing and wrong velocities of some joints, one sentence each.

    The messages of the layout with most velocities are checked.
    """
    fitting = [layout for layout in raw.layouts if set(joint_names) <= set(layout.joint_names)]
    if raw.computed or not fitting:
        return ()
    n_messages = sum(layout.messages.size for layout in fitting)
    n_missing = n_messages - sum(_n_velocities(layout, joint_names) for layout in fitting)
    if n_missing == n_messages:
        return ("the messages hold no velocities: these follow from the positions, which is fine",)
    notes = []
    if n_missing:
        notes.append(f"velocities are empty or NaN in {n_missing} of {n_messages} messages")
    layout = max(fitting, key=lambda layout: _n_velocities(layout, joint_names))
    columns = [layout.joint_names.index(name) for name in joint_names]
    assert layout.velocities is not None  # it has most of them
    stamps, _ = choose_clock(raw, layout.messages)
    latest = np.maximum.accumulate(stamps)
    rows = np.flatnonzero(np.append(True, stamps[1:] > latest[:-1]) & (stamps > 0))
    verdicts: dict[str, list[str]] = {}
    if rows.size >= _VELOCITY_MIN_COMPARED:
        for name, column in zip(joint_names, columns, strict=True):
            values = layout.positions[rows, column], layout.velocities[rows, column]
            verdict = _verdict(*_mean_velocities(stamps[rows], *values))
            verdicts.setdefault(verdict, []).append(name)
    verdicts.pop("", None)
    notes += [
        f"the velocities of {quote_names(names)} {verdict}: they are not used"
        for verdict, names in verdicts.items()
    ]
    return tuple(notes)


def _n_velocities(layout: JointLayout, joint_names: Sequence[str]) -> int:
    """Number of messages with the velocities of all of the joints."""
    if layout.velocities is None:
        return 0
    columns = [layout.joint_names.index(name) for name in joint_names]
    return count(np.asarray(np.isfinite(layout.velocities[:, columns]).all(axis=1)))


def _mean_velocities(
    stamps: IntArray, position: FloatArray, velocity: NDArray[np.float32]
) -> tuple[FloatArray, FloatArray]:
    """Mean velocities of a joint over short windows: by its positions, and as recorded."""
    width = max(1, round(_VELOCITY_WINDOW * NS_PER_S / float(np.median(np.diff(stamps)))))
    starts = np.arange(0, stamps.size - width, max(1, stamps.size // _VELOCITY_MAX_COMPARED))
    times = (stamps[starts + width] - stamps[starts]) / NS_PER_S
    true = (position[starts + width] - position[starts]) / times
    # Weights of the trapezoidal rule, so that a window of one period is compared rightly, too.
    recorded = np.zeros(starts.size)
    for offset in range(width + 1):
        recorded += (0.5 if offset in (0, width) else 1.0) * velocity[starts + offset]
    recorded /= width
    usable = times < _VELOCITY_MAX_STRETCH * np.median(times) if times.size else times > 0.0
    usable &= np.isfinite(recorded)
    usable &= (np.abs(true) > _VELOCITY_MIN_SPEED) & (np.abs(true) < _VELOCITY_MAX_SPEED)
    return true[usable], recorded[usable]


def _verdict(true: FloatArray, recorded: FloatArray) -> str:
    """The defect of the recorded velocities of a joint; '' if there is none."""
    if true.size < _VELOCITY_MIN_COMPARED:
        return ""
    if not recorded.any():
        return "are zero while the positions change"
    product, true_square, recorded_square = true @ recorded, true @ true, recorded @ recorded
    scale = product / true_square
    if abs(product) < _VELOCITY_MIN_CORRELATION * np.sqrt(true_square * recorded_square):
        return "do not follow the positions"
    if abs(scale - 1.0) <= _VELOCITY_MAX_SCALE_ERROR:
        return ""
    if abs(scale + 1.0) <= _VELOCITY_MAX_SCALE_ERROR:
        return "have the opposite sign"
    return f"are {scale:.2g} times the derivative of the positions"
