# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repair of joint states, with a count of every repair.

Each step takes samples and returns them repaired, with the counts of its repairs by their names in
:data:`.recording.REPAIRS`; it raises a RecordingError if a defect can't be repaired.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, unique_names
from ..exceptions import RecordingError, UnusableRecordingError, quote_names, unknown_name
from ..input_limits import INPUT_LIMITS
from .continuity import (
    NOISE_DEVIATIONS,
    count,
    cut_at_gaps,
    cut_at_jumps,
    long_pieces,
    longest_gap,
    median_period,
    noise_deviation,
    refuse_degrees,
    unwrap,
)
from .copies import fingerprint
from .joint_states import NS_PER_S, IntArray, JointStates, Names
from .recording import MIN_SAMPLES, Recording, Samples
from .velocities import velocity_notes

Counts = dict[str, int]

# Arm motions need no higher sample rate [Hz]. Of a recording with at least twice this rate,
# consecutive samples are averaged.
_ENOUGH_RATE = 100.0
# Stamps that step back by more than this and go on from there are those of a clock that was set
# back [s]; at most so many steps are judged.
_CLOCK_STEP = 0.1
_MAX_CLOCK_STEPS = 100
# A longer time between two messages is that of a clock that was set forward [s].
_LONGEST_PAUSE = 86_400.0
# A second publisher is present if more than this share of the messages, and more than this number,
# contradict others.
_MAX_CONFLICTS = 0.01
_MIN_CONFLICTS = 10
# A late message contradicts the others if it is farther than this from their positions at its time
# [rad or m].
_CONFLICT = 0.01
# A publisher of zeros is present from this number of changes between zeros and positions on.
_MIN_ALTERNATIONS = 10
# Positions beside zeros are another publisher's if they exceed this [rad or m].
_FAR_FROM_ZERO = 0.05
# A joint that travels less than this is still; it is about the noise of encoders [rad or m].
_MIN_TRAVEL = 1e-3


def repair(
    states: JointStates, joints: Sequence[str] | None = None, max_gap: float | None = None
) -> Recording:
    """Repair joint states.

    Parameters
    ----------
    states :
        Joint states as recorded.
    joints :
        Names of the joints to take; by default those that all messages list, in the order of
        the first.
    max_gap :
        Longest time without messages that is no gap [s], see :func:`.continuity.longest_gap`.

    Raises
    ------
    UnusableRecordingError
        If a joint is unknown, the time is unusable, samples are too few, publishers contradict
        each other, or nothing moves.
    """
    counts: Counter[str] = Counter(malformed=states.n_malformed)
    notes = list(states.notes)
    try:
        names = choose_joints(states.layouts, states.topic, joints)
        if joints is None and (others := [x for x in states.joint_names if x not in names]):
            notes.append(f"joints left out, as not every message has them: {quote_names(others)}")
        rows, positions, done = take_joints(states, names, max_gap)
        counts.update(done)
        if not states.listing(names).any():
            notes.append(
                "no message lists all of the joints: those of several publishers are joined by "
                "interpolation in time"
            )
        stamps, of_clock = choose_clock(states, rows)
        notes += [*of_clock, *velocity_notes(states, names, rows, stamps)]
        first = int(stamps[np.argmax(stamps > 0)])
        stamps, positions, done = drop_unusable(stamps, positions, names)
        counts.update(done)
        refuse_few(stamps)
        samples, done = order_by_time(stamps, positions, first, max_gap)
        counts.update(done)
        for mend in (drop_equal_stamps, drop_zeros):
            samples, done = mend(samples)
            counts.update(done)
            refuse_few(samples.times)
        period = median_period(samples.times)
        pieces, done = cut_at_gaps(samples, longest_gap(period, max_gap), counts["clock_jumps"])
        counts.update(done)
        for mend_pieces in (long_pieces, unwrap, refuse_degrees, cut_at_jumps, long_pieces):
            pieces, done = mend_pieces(pieces)
            counts.update(done)
        # A rate that jitter puts just below a multiple still counts as that multiple.
        n_averaged = max(1, int(1.001 / period // _ENOUGH_RATE))
        pieces, done = long_pieces([_averaged(piece, n_averaged) for piece in pieces])
        counts.update(done)
        still = still_joints(names, pieces)
    except RecordingError as error:
        raise UnusableRecordingError(str(error), _facts(states, counts, notes)) from None
    return Recording(
        joint_names=names,
        pieces=tuple(pieces),
        rate=1.0 / period,
        sample_rate=1.0 / period / n_averaged,
        still_joints=still,
        fingerprint=fingerprint(samples.positions, names),
        **_facts(states, counts, [*notes, *_cut_off_notes(pieces)]),
    )


def _facts(states: JointStates, counts: Counter[str], notes: Sequence[str]) -> dict[str, Any]:
    """The fields of a recording that one has that can't be used, too."""
    return {
        "repairs": {kind: n for kind, n in counts.items() if n},
        "topic": states.topic,
        "n_messages": states.n_messages,
        "listed_joints": states.joint_names,
        "notes": tuple(notes),
    }


def refuse_few(times: NDArray[Any]) -> None:
    """Raise a RecordingError if there are too few different times."""
    # Sorting is several times faster than np.unique, which hashes.
    n_samples = min(1, times.size) + count(np.diff(np.sort(times)))
    if n_samples < MIN_SAMPLES:
        raise RecordingError(
            f"there are {n_samples} usable samples, at least {MIN_SAMPLES} are needed"
        )


def choose_joints(listed: Sequence[Names], topic: str, joints: Sequence[str] | None) -> Names:
    """Choose the joints to take: the requested ones, else those that all messages list.

    Parameters
    ----------
    listed :
        Different lists of joints in messages.
    topic :
        Name of the topic.
    joints :
        Requested names.

    Raises
    ------
    RecordingError
        If there is no message, a name is unknown, no joint is in every message, or the joints
        are more than are accepted.
    """
    if not listed:
        raise RecordingError(f"there is no well-formed message on '{topic}'")
    if joints is None:
        names = _common_joints(listed, topic)
    else:
        known = list(dict.fromkeys(name for layout in listed for name in layout))
        names = unique_names(joints, "chosen joints", RecordingError)
        for name in names:
            if name not in known:
                raise RecordingError(unknown_name("joint", name, known))
    if len(names) > INPUT_LIMITS.joints:
        raise RecordingError(
            f"{len(names)} joints of '{topic}' are more than the {INPUT_LIMITS.joints} accepted: "
            "choose some of them"
        )
    return names


def _common_joints(listed: Sequence[Names], topic: str) -> Names:
    listed = [names for names in listed if names] or listed  # some publishers send empty messages
    common = set.intersection(*map(set, listed))
    if not common:
        choices = "; ".join(quote_names(names) for names in listed[:10])
        raise RecordingError(
            f"no joint is in every message of '{topic}': choose the joints, of one publisher or of "
            f"several, from {choices}"
        )
    return tuple(name for name in listed[0] if name in common)


def take_joints(
    states: JointStates, names: Names, max_gap: float | None
) -> tuple[IntArray, FloatArray, Counts]:
    """Messages that list all of the joints, and their positions in the order of `names`.

    Where none does, those of several publishers are joined: the messages of the one with most,
    with positions of the others at their times, interpolated where these have no gap.

    Raises
    ------
    RecordingError
        If no message lists them all, and publishers can't be joined.
    """
    rows = np.flatnonzero(states.listing(names))
    columns = states.columns(names)
    if rows.size:
        orders = [[x for x in layout if x in names] for layout in states.layouts]
        first = orders[states.layout_of[rows[0]]]
        n_reordered = count(np.array([x != first for x in orders])[states.layout_of[rows]])
        counts = {"reordered": n_reordered, "missing_joints": states.layout_of.size - rows.size}
        return rows, states.positions[rows][:, columns], counts
    sizes = np.bincount(states.layout_of, minlength=len(states.layouts))
    by_size = np.argsort(-sizes, kind="stable").tolist()
    sources = [next(k for k in by_size if name in states.layouts[k]) for name in names]
    base = max(sources, key=lambda source: int(sizes[source]))
    rows_of = {source: np.flatnonzero(states.layout_of == source) for source in sources}
    stamps = states.header_stamps
    if any(x[0] <= 0 or (x[1:] < x[:-1]).any() for x in map(stamps.__getitem__, rows_of.values())):
        stamps = states.receive_stamps
    times = (stamps - stamps.min()) / NS_PER_S
    rows = rows_of[base]
    positions = states.positions[rows][:, columns]
    for column, source in enumerate(sources):
        if source != base:
            values = states.positions[rows_of[source], columns[column]]
            usable = np.abs(values) < INPUT_LIMITS.position
            own_times = times[rows_of[source]][usable]
            positions[:, column] = _between(times[rows], own_times, values[usable], max_gap)
    others = [column for column, source in enumerate(sources) if source != base]
    known = np.asarray(np.isfinite(positions[:, others]).all(axis=1))
    if not known.any():
        raise RecordingError(
            f"no message lists all of the joints {quote_names(names)} together, and the messages "
            "of their publishers don't overlap in time"
        )
    unused = sum(int(n) for k, n in enumerate(sizes) if k not in rows_of)
    return rows[known], positions[known], {"missing_joints": unused + count(~known)}


def _between(
    times: FloatArray, own_times: FloatArray, values: FloatArray, max_gap: float | None
) -> FloatArray:
    """Values at times by interpolation between those before and after; NaN in gaps."""
    if own_times.size < MIN_SAMPLES:
        return np.full(times.size, np.nan)
    after = np.clip(np.searchsorted(own_times, times), 1, own_times.size - 1)
    steps = own_times[after] - own_times[after - 1]
    between = np.interp(times, own_times, values, left=np.nan, right=np.nan)
    between[steps > longest_gap(float(np.median(np.diff(own_times))), max_gap)] = np.nan
    between[np.abs(np.diff(values))[after - 1] > np.pi] = np.nan  # a wrapped angle
    return between


SIMULATION_TIME = (
    "header stamps are not the time of day (simulation time, for example): they are used"
)


def choose_clock(states: JointStates, rows: IntArray) -> tuple[IntArray, tuple[str, ...]]:
    """Take the header stamps, or the times of reception if most messages have no stamp.

    Returns
    -------
    stamps : array of int, shape (n_rows,)
        Stamps of these messages [ns], 0 for those that have none.
    notes : tuple of str
        Notes on the stamps.

    Raises
    ------
    RecordingError
        If neither is a plausible time.
    """
    headers, received = states.header_stamps[rows], states.receive_stamps[rows]
    stamped = headers > 0
    if 2 * count(stamped) > stamped.size and _plausible(headers[stamped]):
        if is_simulation_time(int(headers[stamped][0]), int(received[stamped][0])):
            return headers, (SIMULATION_TIME,)
        return headers, ()
    if _plausible(received):
        return received, ("no usable header stamps: times of reception are used",)
    why = "span no plausible time" if stamped.any() else "are not set"
    raise RecordingError(
        f"there is no usable time: the header stamps {why}, and the {rows.size} messages were "
        f"received in bursts within {np.ptp(received) / NS_PER_S:.3g} s; record them with stamps, "
        "or as they happen"
    )


def is_simulation_time(header: int, received: int) -> bool:
    """Whether a header stamp is more than a year away from the time of reception, both [ns]."""
    return abs(header - received) > 365 * 24 * 3600 * NS_PER_S


def _plausible(stamps: IntArray) -> bool:
    """Whether joint states can have been recorded at these times, not in bursts."""
    steps, shortest = np.diff(stamps), NS_PER_S / INPUT_LIMITS.state_rate
    is_in_bursts = 4 * count(steps > shortest / 2) <= count(steps > 0)
    return bool(stamps.size < 2 or (stamps.size * shortest <= np.ptp(stamps) and not is_in_bursts))


def drop_unusable(
    stamps: IntArray, positions: FloatArray, names: Names
) -> tuple[IntArray, FloatArray, Counts]:
    """Drop samples without a stamp or with an unusable position."""
    # NaN compares false, too.
    usable = np.abs(positions) < INPUT_LIMITS.position
    finite = np.all(usable, axis=1)
    if not finite.any():
        columns = zip(names, usable.T, strict=True)
        never = quote_names(name for name, column in columns if not column.any())
        raise RecordingError(
            f"no message has finite positions of all joints (never of {never}): choose joints that "
            "are measured"
        )
    stamped = stamps > 0
    kept = finite & stamped
    counts = {"non_finite": count(~finite), "unstamped": count(finite & ~stamped)}
    return stamps[kept], positions[kept], counts


def order_by_time(
    stamps: IntArray, positions: FloatArray, first: int, max_gap: float | None
) -> tuple[Samples, Counts]:
    """Sort samples by stamp; where the clock was set, time continues from its last value.

    Parameters
    ----------
    stamps, positions :
        Samples in the order of reception [ns, rad or m].
    first :
        Stamp of the recording's first message [ns].
    max_gap :
        See :func:`repair`.

    Raises
    ------
    RecordingError
        If too many late messages contradict those in order.
    """
    gap = round(longest_gap(median_period(stamps) / NS_PER_S, max_gap) * NS_PER_S)
    # A single wrong stamp between good ones would fake two jumps.
    far = np.abs(np.diff(stamps)) > gap
    stray = np.zeros(stamps.size, dtype=bool)
    stray[1:-1] = far[:-1] & far[1:] & (np.abs(stamps[2:] - stamps[:-2]) <= gap)
    stamps, positions = stamps[~stray], positions[~stray]
    refuse_few(stamps)
    forward = np.flatnonzero(np.diff(stamps) > _LONGEST_PAUSE * NS_PER_S) + 1
    jumps = np.union1d(_set_back(stamps, gap), forward)
    n_late = 0
    times: list[IntArray] = []
    rows: list[IntArray] = []
    for part in np.split(np.arange(stamps.size), jumps):
        own = stamps[part]
        n_late += count(own < np.maximum.accumulate(own))
        order = np.argsort(own, kind="stable")
        start = -min(first, int(own.min()))
        if times:
            # One nanosecond more than the longest gap, so that the pieces remain separate.
            start = int(times[-1][-1]) + gap + 1 - int(own.min())
        times.append(own[order] + start)
        rows.append(part[order])
    received = np.concatenate(rows)
    samples = Samples(np.concatenate(times) / NS_PER_S, positions[received])
    _refuse_late_contradictions(samples, received)
    counts = {"stray_stamps": count(stray), "clock_jumps": jumps.size, "out_of_order": n_late}
    return samples, counts


def _set_back(stamps: IntArray, gap: int) -> IntArray:
    """Messages before which the clock was set back.

    It was if stamps step back by more than the longest gap. It was, too, if they step back by less,
    pass the same times once more, and go on. Late messages fill a hole, or a step follows them.
    """
    steps = np.diff(stamps)
    jumps = steps < -gap
    doubtful = np.flatnonzero(~jumps & (steps < -_CLOCK_STEP * NS_PER_S))
    for before in doubtful[:_MAX_CLOCK_STEPS].tolist():
        behind = stamps[before + 1 :]
        past = int(np.argmax(behind > stamps[before])) or behind.size
        goes_on = past == behind.size or steps[before + past] < -0.5 * steps[before]
        earlier, low = stamps[max(before - past, 0) : before + 1], behind[0]
        passes_again = 2 * count(earlier >= low) > count(behind[:past] <= stamps[before])
        jumps[before] = goes_on and passes_again and past >= MIN_SAMPLES
    return np.flatnonzero(jumps) + 1


def _refuse_late_contradictions(samples: Samples, received: IntArray) -> None:
    """Reject late messages whose positions differ from those of the messages in order.

    Two publishers whose stamps differ by their delays cause such messages. Late messages of a
    single publisher agree with the others.
    """
    times, positions = samples.times, samples.positions
    earliest_behind = np.minimum.accumulate(received[::-1])[::-1]
    late = np.append(received[:-1] > earliest_behind[1:], False)
    if count(late) <= _MIN_CONFLICTS:
        return
    on_time = times[~late]
    differs = np.zeros(count(late), dtype=bool)
    for position in positions.T:
        expected = np.interp(times[late], on_time, position[~late])
        error = np.abs(position[late] - expected)
        error = np.abs(error - 2.0 * np.pi * np.round(error / (2.0 * np.pi)))
        noise = noise_deviation(position[~late])
        differs |= error > max(_CONFLICT, NOISE_DEVIATIONS * noise)
    # Zeros between positions are a second publisher's, too, but they can be dropped.
    differs &= np.any(positions[late] != 0.0, axis=1)
    # Where a block of messages is late, no message in order is near enough to compare with.
    behind = np.clip(np.searchsorted(on_time, times[late]), 1, on_time.size - 1)
    differs &= on_time[behind] - on_time[behind - 1] <= 3 * np.median(np.diff(on_time))
    _refuse_conflicts(differs, times.size, "those that came before them")


def drop_equal_stamps(samples: Samples) -> tuple[Samples, Counts]:
    """Keep one sample for each stamp: the first received, but none of zeros beside others.

    Drivers that start before their robot publish zeros; such a second publisher is recognised.
    For other contradictions the correct message is unknown; only a small number is accepted.

    Raises
    ------
    RecordingError
        If too many samples contradict others.
    """
    times, positions = samples.times, samples.positions
    zero = np.all(positions == 0.0, axis=1)
    # Within equal stamps samples of zeros are last; the stable sort leaves the others as received.
    order = np.lexsort((zero, times))
    same_stamp = np.flatnonzero(np.diff(times) == 0.0) + 1
    sample, before = order[same_stamp], order[same_stamp - 1]
    differs = np.any(positions[sample] != positions[before], axis=1)
    _refuse_conflicts(differs & ~zero[sample], zero.size, "another one with the same stamp")
    kept = np.delete(order, same_stamp)
    counts = {"contradicting": count(differs), "repeated_stamps": count(~differs)}
    return Samples(times[kept], positions[kept]), counts


def _refuse_conflicts(conflicts: NDArray[np.bool_], n_messages: int, what: str) -> None:
    n_conflicts = count(conflicts)
    if n_conflicts > max(_MIN_CONFLICTS, _MAX_CONFLICTS * n_messages):
        raise RecordingError(
            f"{n_conflicts} messages contradict {what}: two publishers of the same joints, or a "
            "clock with coarse steps; record one publisher, with fine stamps"
        )


def drop_zeros(samples: Samples) -> tuple[Samples, Counts]:
    """Drop the zeros that a second publisher puts between positions."""
    zero = np.all(samples.positions == 0.0, axis=1)
    changes = np.flatnonzero(zero[1:] != zero[:-1])
    # A robot that passes its zero is near it before and after.
    beside = samples.positions[changes + zero[changes]]
    alternations = count(np.max(np.abs(beside), axis=1) > _FAR_FROM_ZERO)
    if alternations < _MIN_ALTERNATIONS:
        return samples, {}
    return Samples(samples.times[~zero], samples.positions[~zero]), {"zeros": count(zero)}


def _averaged(piece: Samples, n_averaged: int) -> Samples:
    """Means of `n_averaged` consecutive samples each; the last one may be of fewer."""
    if n_averaged == 1:
        return piece
    starts = np.arange(0, piece.times.size, n_averaged)
    sizes = np.diff(starts, append=piece.times.size)
    return Samples(
        np.add.reduceat(piece.times, starts) / sizes,
        np.add.reduceat(piece.positions, starts) / sizes[:, None],
    )


def still_joints(names: Names, pieces: Sequence[Samples]) -> Names:
    """The joints that never move.

    Raises
    ------
    RecordingError
        If no joint moves.
    """
    low = np.min([piece.positions.min(axis=0) for piece in pieces], axis=0)
    high = np.max([piece.positions.max(axis=0) for piece in pieces], axis=0)
    travel = max(float(np.ptp(piece.positions, axis=0).max()) for piece in pieces)
    if travel < _MIN_TRAVEL:
        raise RecordingError(
            f"nothing moves: no chosen joint travels more than {travel:.2g} rad (or m)"
        )
    moved = zip(names, high - low, strict=True)
    return tuple(name for name, distance in moved if distance < _MIN_TRAVEL)


def _cut_off_notes(pieces: Sequence[Samples]) -> list[str]:
    """Notes on motions that are cut off at an end."""
    speeds = [_window_speeds(piece) for piece in pieces]
    # At a fifth of the highest speed a joint is within its motion.
    fast = 0.2 * max(float(speed.max()) for speed in speeds)
    return [
        f"the recording {what} in a motion, which may be cut off there"
        for speed, what in ((speeds[0][0], "begins"), (speeds[-1][-1], "ends"))
        if speed > fast
    ]


def _window_speeds(piece: Samples) -> FloatArray:
    """Norm of the joint speeds over windows of about 0.1 s, in order of time [/s]."""
    n_windows = max(1, round((piece.times[-1] - piece.times[0]) / 0.1))
    edges = np.linspace(0, piece.times.size - 1, min(n_windows, piece.times.size - 1) + 1)
    marks = edges.round().astype(np.int64)
    distance = np.linalg.norm(np.diff(piece.positions[marks], axis=0), axis=1)
    return np.asarray(distance / np.diff(piece.times[marks]), dtype=np.float64)
