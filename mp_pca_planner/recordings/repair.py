# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repair of joint states, with a count of every repair.

Each step takes samples and returns them repaired, with the counts of its repairs by their names in
:data:`.recording.REPAIRS`; it raises a RecordingError if a defect can't be repaired.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, unique_names
from ..exceptions import RecordingError, UnusableRecordingError, quote_names, unknown_name
from ..input_limits import INPUT_LIMITS
from .continuity import (
    count,
    cut_at_gaps,
    cut_at_jumps,
    long_pieces,
    longest_gap,
    median_period,
    refuse_other_units,
    unwrap,
)
from .copies import fingerprint
from .joint_states import NS_PER_S, IntArray, JointStates, Names
from .recording import MIN_SAMPLES, Recording, Samples

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
# contradict others of the same stamp.
_MAX_CONFLICTS = 0.01
_MIN_CONFLICTS = 10
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
        names = choose_joints(states, joints)
        if joints is None and (others := [x for x in states.joint_names if x not in names]):
            notes.append(f"joints left out, as not every message has them: {quote_names(others)}")
        rows, positions, done = take_joints(states, names, max_gap)
        counts.update(done)
        if not states.listed[rows[0], states.columns(names)].all():
            notes.append(
                "no message lists all of the joints: those of several publishers are joined by "
                "interpolation in time"
            )
        stamps, of_clock = choose_clock(states, rows)
        notes += of_clock
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
        check_units = partial(refuse_other_units, were_degrees=states.were_degrees)
        for mend_pieces in (long_pieces, unwrap, check_units, cut_at_jumps, long_pieces):
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
        duration=float(pieces[-1].times[-1] - pieces[0].times[0]),
        still_joints=still,
        fingerprint=fingerprint(samples.positions, names),
        **_facts(states, counts, notes),
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


def choose_joints(states: JointStates, joints: Sequence[str] | None) -> Names:
    """Choose the joints to take: the requested ones, else those that all messages list.

    Raises
    ------
    RecordingError
        If there is no message, a name is unknown, no joint is in every message, or the joints
        are more than are accepted.
    """
    if not states.header_stamps.size:
        n, why = states.n_malformed, "must name as many different joints as it has positions"
        raise RecordingError(
            f"there is no well-formed message on '{states.topic}'"
            + (f": each of its {n} messages {why}" if n else "")
        )
    if joints is None:
        names = _common_joints(states)
    else:
        names = unique_names(joints, "chosen joints", RecordingError)
        for name in names:
            if name not in states.joint_names:
                raise RecordingError(unknown_name("joint", name, states.joint_names))
    if len(names) > INPUT_LIMITS.joints:
        raise RecordingError(
            f"{len(names)} joints of '{states.topic}' are more than the {INPUT_LIMITS.joints} "
            "accepted: choose some of them"
        )
    return names


def _common_joints(states: JointStates) -> Names:
    listed = states.listed[states.listed.any(axis=1)]  # some publishers send empty messages
    common = listed.all(axis=0)
    if not (listed.size and common.any()):
        several, _ = _publishers(states)
        choices = "; ".join(quote_names(names) for names in several[:10])
        raise RecordingError(
            f"no joint is in every message of '{states.topic}': choose the joints, of one "
            "publisher or of several, by --robot or --joints of build_primitives (robot=, joints= "
            f"in Python), from {choices}"
        )
    return tuple(np.array(states.joint_names, dtype=object)[common])


def _publishers(states: JointStates) -> tuple[list[Names], IntArray]:
    """The different lists of joints in messages, and which of them each message has."""
    lists, first, which = np.unique(states.listed, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    names = np.array(states.joint_names, dtype=object)
    return [tuple(names[lists[i]]) for i in order], np.argsort(order)[which.ravel()]


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
    columns = states.columns(names)
    rows = np.flatnonzero(states.listed[:, columns].all(axis=1))
    if rows.size:
        n_missing = states.header_stamps.size - rows.size
        return rows, states.positions[rows][:, columns], {"missing_joints": n_missing}
    publishers, publisher_of = _publishers(states)
    sizes = np.bincount(publisher_of)
    by_size = np.argsort(-sizes, kind="stable").tolist()
    sources = [next(k for k in by_size if name in publishers[k]) for name in names]
    base = max(sources, key=lambda source: int(sizes[source]))
    rows_of = {source: np.flatnonzero(publisher_of == source) for source in sources}
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
        return headers, ()
    if _plausible(received):
        return received, ("no usable header stamps: times of reception are used",)
    why = "span no plausible time" if stamped.any() else "are not set"
    raise RecordingError(
        f"there is no usable time: the header stamps {why}, and the {rows.size} messages were "
        f"received in bursts within {np.ptp(received) / NS_PER_S:.3g} s; record them with stamps, "
        "or as they happen"
    )


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
    """
    gap = round(longest_gap(median_period(stamps) / NS_PER_S, max_gap) * NS_PER_S)
    # A single wrong stamp would fake two jumps.
    far = np.abs(np.diff(stamps)) > gap
    stray = np.zeros(stamps.size, dtype=bool)
    stray[1:-1] = far[:-1] & far[1:]
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
    samples = Samples(np.concatenate(times) / NS_PER_S, positions[np.concatenate(rows)])
    counts = {"stray_stamps": count(stray), "clock_jumps": jumps.size, "out_of_order": n_late}
    return samples, counts


def _set_back(stamps: IntArray, gap: int) -> IntArray:
    """Messages before which the clock was set back.

    It was if stamps step back by more than the longest gap, or by less for several messages. Of two
    publishers that interleave, only some messages are late.
    """
    steps = np.diff(stamps)
    jumps = steps < -gap
    doubtful = np.flatnonzero(~jumps & (steps < -_CLOCK_STEP * NS_PER_S))
    for before in doubtful[:_MAX_CLOCK_STEPS].tolist():
        jumps[before] = (stamps[before + 1 :][:MIN_SAMPLES] < stamps[before]).sum() == MIN_SAMPLES
    return np.flatnonzero(jumps) + 1


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
    n_conflicts = count(differs & ~zero[sample])
    if n_conflicts > max(_MIN_CONFLICTS, _MAX_CONFLICTS * zero.size):
        raise RecordingError(
            f"{n_conflicts} messages contradict another one with the same stamp: two publishers "
            "of the same joints, or a clock with coarse steps; record one publisher, with fine "
            "stamps"
        )
    kept = np.delete(order, same_stamp)
    counts = {"contradicting": count(differs), "repeated_stamps": count(~differs)}
    return Samples(times[kept], positions[kept]), counts


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
