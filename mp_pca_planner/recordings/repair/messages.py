# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Repair of messages: joints by name, stamps, and messages of a second publisher."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray, unique_names
from ...exceptions import RecordingError, quote_names, unknown_name
from ...input_limits import INPUT_LIMITS
from ..joint_states import NS_PER_S, IntArray, RawJointStates, listed_names
from .recording import (
    MIN_SAMPLES,
    NOISE_DEVIATIONS,
    Defect,
    Samples,
    count,
    longest_gap,
    noise_deviation,
)

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

COUNTS = {
    "malformed": "message dropped: not one position for each name, or a name listed twice",
    "missing_joints": "message dropped: it lacks a chosen joint (another publisher's, for example)",
    "reordered": "message that lists the joints in another order than the first: taken by name",
}
"""Counts of messages of other joints or in another order."""


def choose_joints(
    listed: Sequence[tuple[str, ...]], topic: str, joints: Sequence[str] | None
) -> tuple[str, ...]:
    """Choose the joints to take: the requested ones, else those that all messages list.

    Parameters
    ----------
    listed :
        Names of the joints in each message, or in each kind of messages.
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
    names = _common_joints(listed, topic) if joints is None else _known_joints(listed, joints)
    if len(names) > INPUT_LIMITS.joints:
        raise RecordingError(
            f"{len(names)} joints of '{topic}' are more than the {INPUT_LIMITS.joints} accepted: "
            "choose some of them"
        )
    return names


def _known_joints(listed: Sequence[tuple[str, ...]], joints: Sequence[str]) -> tuple[str, ...]:
    known = listed_names(listed)
    names = unique_names(joints, "chosen joints", RecordingError)
    for name in names:
        if name not in known:
            raise RecordingError(unknown_name("joint", name, known))
    return names


def _common_joints(listed: Sequence[tuple[str, ...]], topic: str) -> tuple[str, ...]:
    listed = [names for names in listed if names] or listed  # some publishers send empty messages
    common = set.intersection(*map(set, listed))
    if not common:
        choices = "; ".join(quote_names(names) for names in list(dict.fromkeys(listed))[:10])
        raise RecordingError(
            f"no joint is in every message of '{topic}': choose the joints, of one publisher or of "
            f"several, from {choices}"
        )
    return tuple(name for name in listed[0] if name in common)


def left_out_notes(raw: RawJointStates, names: tuple[str, ...]) -> tuple[str, ...]:
    """A note on the joints that are not taken, if there are any."""
    left_out = [name for name in raw.listed_joints if name not in names]
    if not left_out:
        return ()
    return (f"joints left out, as not every message has them: {quote_names(left_out)}",)


def take_joints(
    raw: RawJointStates, names: tuple[str, ...], max_gap: float | None, repairs: Counter[str]
) -> tuple[IntArray, FloatArray]:
    """Messages that list all of the joints, and their positions in the order of `names`.

    Where none does, those of several publishers are joined, see :func:`_joined_publishers`.

    Raises
    ------
    RecordingError
        If no message lists them all, and publishers can't be joined.
    """
    whole = [layout for layout in raw.layouts if set(names) <= set(layout.joint_names)]
    if not whole:
        return _joined_publishers(raw, names, max_gap, repairs)
    orders = [[name for name in layout.joint_names if name in names] for layout in whole]
    for layout, order in zip(whole, orders, strict=True):
        repairs["reordered"] += layout.messages.size if order != orders[0] else 0
    repairs["missing_joints"] += sum(x.messages.size for x in raw.layouts if x not in whole)
    positions = []
    for layout in whole:
        columns = [layout.joint_names.index(name) for name in names]
        own = layout.positions
        positions.append(own if columns == list(range(own.shape[1])) else own[:, columns])
    if len(whole) == 1:
        return whole[0].messages, positions[0]
    messages = np.concatenate([layout.messages for layout in whole])
    order_of_reception = np.argsort(messages)
    return messages[order_of_reception], np.concatenate(positions)[order_of_reception]


def _joined_publishers(
    raw: RawJointStates, names: tuple[str, ...], max_gap: float | None, repairs: Counter[str]
) -> tuple[IntArray, FloatArray]:
    """Messages of the publisher with most, with positions of the others at their times.

    These are interpolated between messages without a gap between them.
    """
    by_size = sorted(raw.layouts, key=lambda layout: -layout.messages.size)
    sources = [next(layout for layout in by_size if name in layout.joint_names) for name in names]
    base = max(sources, key=lambda layout: layout.messages.size)
    stamps = raw.header_stamps
    if any(x[0] <= 0 or (x[1:] < x[:-1]).any() for x in (stamps[y.messages] for y in sources)):
        stamps = raw.receive_stamps
    stamps = stamps - stamps.min()  # exact as floating-point numbers
    positions = np.empty((base.messages.size, len(names)))
    known = np.ones(base.messages.size, dtype=bool)
    for column, (name, source) in enumerate(zip(names, sources, strict=True)):
        own = source.positions[:, source.joint_names.index(name)]
        if source is not base:
            usable = np.abs(own) < INPUT_LIMITS.position
            times = stamps[source.messages][usable]
            own = _between(stamps[base.messages], times, own[usable], max_gap)
            known &= np.isfinite(own)
        positions[:, column] = own
    if not known.any():
        raise RecordingError(
            f"no message lists all of the joints {quote_names(names)} together, and the messages "
            "of their publishers don't overlap in time"
        )
    unused = sum(x.messages.size for x in raw.layouts if x not in sources)
    repairs["missing_joints"] += unused + count(~known)
    return base.messages[known], positions[known]


def _between(
    stamps: IntArray, own_stamps: IntArray, values: FloatArray, max_gap: float | None
) -> FloatArray:
    """Values at stamps by interpolation between those before and after; NaN in gaps."""
    if own_stamps.size < MIN_SAMPLES:
        return np.full(stamps.size, np.nan)
    after = np.clip(np.searchsorted(own_stamps, stamps), 1, own_stamps.size - 1)
    steps = own_stamps[after] - own_stamps[after - 1]
    found = np.interp(stamps, own_stamps, values, left=np.nan, right=np.nan)
    found[steps > longest_gap(float(np.median(np.diff(own_stamps))), max_gap)] = np.nan
    found[np.abs(np.diff(values))[after - 1] > np.pi] = np.nan  # a wrapped angle
    return found


def joined_notes(raw: RawJointStates, names: tuple[str, ...]) -> tuple[str, ...]:
    """A note if the joints are those of several publishers."""
    if any(set(names) <= set(layout.joint_names) for layout in raw.layouts):
        return ()
    return (
        "no message lists all of the joints: those of several publishers are joined by "
        "interpolation in time",
    )


SIMULATION_TIME = (
    "header stamps are not the time of day (simulation time, for example): they are used"
)


def choose_clock(raw: RawJointStates, messages: IntArray) -> tuple[IntArray, tuple[str, ...]]:
    """Take the header stamps, or the times of reception if most messages have no stamp.

    Returns
    -------
    stamps : array of int, shape (n_messages,)
        Stamps of these messages [ns], 0 for those that have none.
    notes : tuple of str
        Notes on the stamps.

    Raises
    ------
    RecordingError
        If neither is a plausible time.
    """
    headers, received = raw.header_stamps[messages], raw.receive_stamps[messages]
    stamped = headers > 0
    if 2 * count(stamped) > stamped.size and _plausible(headers[stamped]):
        if is_simulation_time(int(headers[stamped][0]), int(received[stamped][0])):
            return headers, (SIMULATION_TIME,)
        return headers, ()
    if _plausible(received):
        return received, ("no usable header stamps: times of reception are used",)
    why = "span no plausible time" if stamped.any() else "are not set"
    raise RecordingError(
        f"there is no usable time: the header stamps {why}, and the {messages.size} messages were "
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


def drop_unusable(samples: Samples, repairs: Counter[str]) -> Samples:
    """Drop samples without a stamp or with an unusable position."""
    # NaN compares false, too.
    usable = np.abs(samples.positions) < INPUT_LIMITS.position
    finite = np.all(usable, axis=1)
    if not finite.any():
        columns = zip(samples.joint_names, usable.T, strict=True)
        never = quote_names(name for name, column in columns if not column.any())
        raise RecordingError(
            f"no message has finite positions of all joints (never of {never}): choose joints that "
            "are measured"
        )
    stamped = samples.times > 0
    repairs["non_finite"] += count(~finite)
    repairs["unstamped"] += count(finite & ~stamped)
    return samples.taken(np.flatnonzero(finite & stamped))


UNUSABLE = Defect(
    {
        "non_finite": "message dropped: a position of a chosen joint is NaN, infinite or absurd",
        "unstamped": "message dropped: no header stamp, while most have one",
    },
    drop_unusable,
)


def order_by_time(samples: Samples, repairs: Counter[str]) -> Samples:
    """Sort samples by stamp; where the clock was set, time continues from its last value.

    Returns
    -------
    :
        Samples with times since the recording's first message [ns], not decreasing.
    """
    max_gap = samples.longest_gap
    samples = _without_strays(samples, max_gap, repairs)
    samples.refuse_few()
    back = _set_back(samples.times, max_gap)
    forward = np.flatnonzero(np.diff(samples.times) > _LONGEST_PAUSE * NS_PER_S) + 1
    jumps = np.union1d(back, forward)
    repairs["clock_jumps"] += jumps.size
    times: list[IntArray] = []
    rows: list[IntArray] = []
    for part in np.split(np.arange(samples.times.size), jumps):
        own = samples.times[part]
        repairs["out_of_order"] += count(own < np.maximum.accumulate(own))
        order = np.argsort(own, kind="stable")
        start = -min(samples.first_stamp, int(own.min()))
        if times:
            # One nanosecond more than the longest gap, so that the pieces remain separate.
            start = int(times[-1][-1]) + int(max_gap) + 1 - int(own.min())
        times.append(own[order] + start)
        rows.append(part[order])
    return replace(samples.taken(np.concatenate(rows)), times=np.concatenate(times))


def _set_back(stamps: IntArray, max_gap: float) -> IntArray:
    """Messages before which the clock was set back.

    It was if stamps step back by more than the longest gap. It was, too, if they step back by less,
    pass the same times once more, and go on. Late messages fill a hole, or a step follows them.
    """
    steps = np.diff(stamps)
    jumps = steps < -max_gap
    doubtful = np.flatnonzero(~jumps & (steps < -_CLOCK_STEP * NS_PER_S))
    for before in doubtful[:_MAX_CLOCK_STEPS].tolist():
        behind = stamps[before + 1 :]
        past = int(np.argmax(behind > stamps[before])) or behind.size
        goes_on = past == behind.size or steps[before + past] < -0.5 * steps[before]
        earlier, low = stamps[max(before - past, 0) : before + 1], behind[0]
        passes_again = 2 * count(earlier >= low) > count(behind[:past] <= stamps[before])
        jumps[before] = goes_on and passes_again and past >= MIN_SAMPLES
    return np.flatnonzero(jumps) + 1


def _without_strays(samples: Samples, max_gap: float, repairs: Counter[str]) -> Samples:
    """Drop samples with a single wrong stamp between good ones, which would fake two jumps."""
    stamps = samples.times
    far = np.abs(np.diff(stamps)) > max_gap
    near_across = np.abs(stamps[2:] - stamps[:-2]) <= max_gap
    stray = np.zeros(stamps.size, dtype=bool)
    stray[1:-1] = far[:-1] & far[1:] & near_across
    repairs["stray_stamps"] += count(stray)
    return samples.taken(np.flatnonzero(~stray))


DISORDER = Defect(
    {
        "stray_stamps": "message dropped: its stamp is far from those before and after it",
        "clock_jumps": "the clock was set back, or forward by more than a day: cut there",
        "out_of_order": "message with an earlier stamp than one before it: sorted in",
    },
    order_by_time,
)


def refuse_late_contradictions(samples: Samples, repairs: Counter[str]) -> Samples:
    """Reject late messages whose positions differ from those of the messages in order.

    Two publishers whose stamps differ by their delays cause such messages. Late messages of a
    single publisher agree with the others.

    Raises
    ------
    RecordingError
        If there are too many of them.
    """
    times, positions, received = samples.times, samples.positions, samples.received
    earliest_behind = np.minimum.accumulate(received[::-1])[::-1]
    late = np.append(received[:-1] > earliest_behind[1:], False)
    if count(late) <= _MIN_CONFLICTS:
        return samples
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
    return samples


LATE = Defect({}, refuse_late_contradictions)


def drop_equal_stamps(samples: Samples, repairs: Counter[str]) -> Samples:
    """Keep one sample for each stamp: the first received, but none of zeros beside others.

    Drivers that start before their robot publish zeros; such a second publisher is recognised.
    For other contradictions the correct message is unknown; only a small number is accepted.

    Raises
    ------
    RecordingError
        If too many samples contradict others.
    """
    zero = np.all(samples.positions == 0.0, axis=1)
    # Within equal stamps samples of zeros are last; the stable sort leaves the others as received.
    order = np.lexsort((zero, samples.times))
    same_stamp = np.flatnonzero(np.diff(samples.times) == 0) + 1
    sample, before = order[same_stamp], order[same_stamp - 1]
    differs = np.any(samples.positions[sample] != samples.positions[before], axis=1)
    _refuse_conflicts(differs & ~zero[sample], zero.size, "another one with the same stamp")
    repairs["contradicting"] += count(differs)
    repairs["repeated_stamps"] += count(~differs)
    return samples.taken(np.delete(order, same_stamp))


def _refuse_conflicts(conflicts: NDArray[np.bool_], n_messages: int, what: str) -> None:
    n_conflicts = count(conflicts)
    if n_conflicts > max(_MIN_CONFLICTS, _MAX_CONFLICTS * n_messages):
        raise RecordingError(
            f"{n_conflicts} messages contradict {what}: two publishers of the same joints, or a "
            "clock with coarse steps; record one publisher, with fine stamps"
        )


EQUAL_STAMPS = Defect(
    {
        "repeated_stamps": "message dropped: another one has the same stamp and positions",
        "contradicting": "message dropped: another one has the same stamp and other positions",
    },
    drop_equal_stamps,
)


def drop_zeros(samples: Samples, repairs: Counter[str]) -> Samples:
    """Drop the zeros that a second publisher puts between positions."""
    zero = np.all(samples.positions == 0.0, axis=1)
    changes = np.flatnonzero(zero[1:] != zero[:-1])
    # A robot that passes its zero is near it before and after.
    beside = samples.positions[changes + zero[changes]]
    alternations = count(np.max(np.abs(beside), axis=1) > _FAR_FROM_ZERO)
    if alternations < _MIN_ALTERNATIONS:
        return samples
    repairs["zeros"] += count(zero)
    return samples.taken(np.flatnonzero(~zero))


ZEROS = Defect(
    {
        "zeros": "message dropped: zeros that alternate with positions (a driver without data)",
    },
    drop_zeros,
)
