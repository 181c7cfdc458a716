# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""From joint states as recorded to clean samples of the chosen joints, every repair counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, unique_names
from ..exceptions import (
    DamagedRecordingError,
    RecordingError,
    UnusableRecordingError,
    quote_names,
    unknown_name,
)
from .byte_layout import NS_PER_S
from .joint_states import IntArray, RawJointStates, joined, listed_names
from .velocity_check import VelocityCheck

_Number = TypeVar("_Number", np.int64, np.float64)

REPAIRS = {
    "malformed": "message dropped: not one position for each name, a name listed twice, or "
    "points whose times don't increase",
    "missing_joints": "message dropped: it lacks a chosen joint (another publisher's, for example)",
    "reordered": "message that lists the joints in another order than the first: taken by name",
    "non_finite": "message dropped: a position of a chosen joint (or the duration of a commanded "
    "motion) is NaN, infinite or absurd",
    "unstamped": "message dropped: no header stamp, while most have one",
    "stray_stamps": "message dropped: its stamp is far from those before and after it",
    "clock_jumps": "stamps step back by more than the longest gap: cut there",
    "out_of_order": "message with an earlier stamp than one before it: sorted in",
    "repeated_stamps": "message dropped: another one has the same stamp and positions",
    "contradicting": "message dropped: another one has the same stamp and other positions",
    "gaps": "no message for longer than the longest gap: cut there",
    "zeros": "message dropped: zeros that alternate with positions (a driver that knows none)",
    "wrapped": "jump of a joint by full turns: taken out",
    "spikes": "message dropped: a joint is elsewhere in it, farther than a motor gets and back",
    "jumps": "a joint gets elsewhere faster than a motor could: cut there",
    "replaced": "commanded motion cut short: another one started before its end",
    "single_points": "commanded motion dropped: one point, from nobody knows where",
    "short_pieces": "piece between cuts dropped: too few samples",
    "rest": "movement dropped: not farther than noise and sway go, taken for rest",
}
"""What is repaired, by the name under which it is counted."""

MIN_SAMPLES = 10
"""Fewer samples than that are no motion."""

MIN_TRAVEL = 1e-3
"""A recording in which no joint travels that far [rad or m] holds no motion, only noise."""

ENOUGH_RATE = 100.0
"""Motions of arms hold nothing that needs a higher rate [Hz]: where a recording has twice that, or
more, as many samples are averaged as leave it."""

QUIET = 50
QUIET_SEARCH = 4096
QUIET_PERIODS = 3.0
"""A long recording is divided where for so many messages before and after no step is longer than
that many usual periods, and nothing else is wrong; looked for among so many messages."""

MAX_JOINTS = 500
"""More joints than that are no robot's."""

MAX_RATE = 5000.0
"""Joint states faster than this [Hz] were not recorded as they happened."""

MAX_POSITION = 1e6
"""No joint gets there [rad or m], but drivers mark what they don't know by huge numbers."""

MAX_GAP = 0.5
MAX_GAP_PERIODS = 5
"""A gap is longer than `MAX_GAP` [s] and than that many usual periods."""

MAX_CONFLICTS = 0.01
MIN_CONFLICTS = 10
CONFLICT = 0.01
"""There are two publishers if over that share of the messages, and over that number of them,
contradict others: they have the same stamp and other positions, or come late and are farther than
`CONFLICT` [rad or m] from where those that came in order are at that time."""

FULL_TURN_TOLERANCE = 1.0
"""How much a jump may differ from a full turn [rad]; the joint moves between samples as well."""

MIN_JUMP = 0.05
JUMP_RATIO = 10.0
JUMP_ISOLATION = 5.0
MAX_SPEED = 20.0
"""A joint jumps if it gets farther than `MIN_JUMP` [rad or m] and than `JUMP_RATIO` usual steps
from one sample to the next, faster than `MAX_SPEED` [/s] and `JUMP_ISOLATION` times as far as from
and to the samples before and after. One that is back in the sample after need not be as fast."""

MAX_JUMPS = 0.05
"""Share of samples behind a jump from which on there must be two publishers."""

MIN_ALTERNATIONS = 10
FAR_FROM_ZERO = 0.05
"""So many changes from zeros to positions as far as that [rad or m], or back, are no accident."""

END_WINDOW = 0.1
END_SPEED = 0.2
"""A recording that begins or ends, for `END_WINDOW` [s], with that share of its highest speed has
cut a motion off."""

YEAR_NS = 365 * 24 * 3600 * NS_PER_S

SIMULATION_TIME = (
    "header stamps are not the time of day (simulation time, for example): they are used"
)


@dataclass(frozen=True, eq=False)
class Piece:
    """Samples without interruption.

    Attributes
    ----------
    times : array, shape (n_samples,)
        Times since the recording's first message [s], strictly increasing.
    positions : array, shape (n_samples, n_joints)
        Joint positions [rad or m], unwrapped.
    """

    times: FloatArray
    positions: FloatArray


@dataclass(frozen=True, eq=False)
class CleanRecording:
    """Repaired samples of the chosen joints.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints.
    pieces : tuple of Piece
        The samples between gaps and clock jumps, in order of time.
    rate : float
        The usual rate [Hz]: one over the median period.
    sample_rate : float
        That of the samples in the pieces [Hz]: of a fast recording some at a time are averaged.
    duration : float
        Time from the first to the last sample [s].
    repairs : dict
        How often each kind of :data:`REPAIRS` was made; only those that were.
    notes : tuple of str
        What was found and needed no repair, one sentence each.
    topic : str
        The topic that was read.
    n_messages : int
        Messages on it.
    listed_joints : tuple of str
        All joints that its messages list.
    pieces_are_motions : bool
        Whether each piece is a motion by itself, which needs no cutting.
    """

    joint_names: tuple[str, ...]
    pieces: tuple[Piece, ...]
    rate: float
    sample_rate: float
    duration: float
    repairs: dict[str, int]
    notes: tuple[str, ...]
    topic: str
    n_messages: int
    listed_joints: tuple[str, ...]
    pieces_are_motions: bool = False


def repair(
    raw: RawJointStates, joints: Sequence[str] | None = None, *, max_gap: float | None = None
) -> CleanRecording:
    """Clean joint states; count every repair, refuse what can't be repaired.

    Parameters
    ----------
    raw :
        What was recorded.
    joints :
        Names of the joints to take; by default those that all messages list, in the order of
        the first.
    max_gap :
        The longest time without messages [s] that is no gap; by default :data:`MAX_GAP`, or some
        usual periods where these are longer.

    Raises
    ------
    UnusableRecordingError
        If a joint is unknown, the time is unusable, samples are too few, publishers contradict
        each other, or nothing moves.
    """
    repairs: Counter[str] = Counter()
    with told_on_refusal(raw, repairs):
        gathered = _Gathered(joints, max_gap, repairs)
        gathered.add(raw)
        return gathered.result()


def repair_parts(
    parts: Iterator[RawJointStates],
    joints: Sequence[str] | None = None,
    *,
    max_gap: float | None = None,
) -> CleanRecording | None:
    """Clean a recording part by part, so that its messages need not be in memory all together.

    It is divided where nothing is wrong for some messages before and after, so that no repair
    needs to look over such a place. What depends on the recording as a whole (its joints, its
    clock, whether there are two publishers) is seen to be the same in each part.

    Parameters
    ----------
    parts :
        Messages in order, at least one part.
    joints, max_gap :
        See :func:`repair`.

    Returns
    -------
    :
        The same as :func:`repair` of all parts together, but for thresholds that depend on the
        usual step; None if that is not sure, or they would be refused.

    Raises
    ------
    UnusableRecordingError
        If there is one part only, and it is refused.
    """
    pending = next(parts)
    following = next(parts, None)
    if following is None:
        return repair(pending, joints, max_gap=max_gap)
    gathered = _Gathered(joints, max_gap, Counter(), one_of_several=True)
    try:
        for part in chain([following], parts):
            place = _quiet_place(pending)
            if place is not None:
                head, pending = pending.divided(place)
                gathered.add(head)
            pending = joined([pending, part])
        gathered.add(pending)
        return gathered.result()
    except DamagedRecordingError:
        raise
    except RecordingError:
        return None


class Recorded(Protocol):
    """What a topic holds, whatever its messages are."""

    @property
    def topic(self) -> str:
        """Its name."""

    @property
    def n_messages(self) -> int:
        """Number of messages."""

    @property
    def listed_joints(self) -> tuple[str, ...]:
        """All joints that messages list."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth knowing about how they were read."""


@contextmanager
def told_on_refusal(raw: Recorded, repairs: Counter[str]) -> Iterator[None]:
    """Tell with a refusal what was read, and the repairs counted so far."""
    try:
        yield
    except RecordingError as error:
        raise UnusableRecordingError(
            str(error),
            counted(repairs),
            raw.topic,
            raw.n_messages,
            raw.listed_joints,
            raw.notes,
        ) from None


def counted(repairs: Counter[str]) -> dict[str, int]:
    """Kinds of repairs that were made, in the order of :data:`REPAIRS`."""
    return {kind: repairs[kind] for kind in REPAIRS if repairs[kind]}


class _Gathered:
    """A recording as far as it is repaired; its last piece may go on in the next part."""

    def __init__(
        self,
        joints: Sequence[str] | None,
        max_gap_s: float | None,
        repairs: Counter[str],
        *,
        one_of_several: bool = False,
    ) -> None:
        self._joints, self._max_gap_s, self._repairs = joints, max_gap_s, repairs
        self._one_of_several = one_of_several
        self._names: tuple[str, ...] = ()
        self._order: list[str] | None = None
        self._shift: int | None = None
        self._clock_notes: tuple[str, ...] | None = None
        self._velocities: VelocityCheck | None = None
        self._periods: list[float] = []
        self._pieces = _Pieces()
        self._raw: list[tuple[str, tuple[str, ...], int]] = []
        self._notes: tuple[str, ...] = ()

    def add(self, raw: RawJointStates) -> None:
        """Repair a part."""
        repairs: Counter[str] = Counter(malformed=raw.n_malformed)
        try:
            self._add(raw, repairs)
        finally:
            self._repairs.update(repairs)

    def result(self) -> CleanRecording:
        """The recording; there is no part left."""
        pieces = _long_pieces(self._pieces.closed(), self._repairs)
        refuse_stillness(pieces)
        assert self._clock_notes is not None
        velocity_notes = () if self._velocities is None else self._velocities.notes()
        rate = NS_PER_S / float(np.median(self._periods))
        return CleanRecording(
            joint_names=self._names,
            pieces=pieces,
            rate=rate,
            sample_rate=rate / self._pieces.n_averaged,
            duration=float(pieces[-1].times[-1] - pieces[0].times[0]),
            repairs=counted(self._repairs),
            notes=(
                *self._notes,
                *self._clock_notes,
                *velocity_notes,
                *motion_notes(self._names, pieces),
            ),
            topic=self._raw[0][0],
            n_messages=sum(n for _, _, n in self._raw),
            listed_joints=listed_names(names for _, names, _ in self._raw),
        )

    def _add(self, raw: RawJointStates, repairs: Counter[str]) -> None:
        self._choose(raw)
        messages, positions = self._take_joints(raw, repairs)
        stamps = self._stamps(raw, messages)
        first_stamp = int(stamps[np.argmax(stamps > 0)])
        kept = _usable_rows(stamps, positions, repairs)
        stamps, positions = _taken(kept, stamps), _taken(kept, positions)
        _refuse_few(stamps)

        max_gap = _longest_gap(_usual_period(stamps), self._max_gap_s)
        kept = _without_strays(stamps, max_gap, repairs)
        stamps, positions = _taken(kept, stamps), _taken(kept, positions)
        _refuse_few(stamps)
        times, ordered, self._shift = _to_continuous_time(
            stamps, first_stamp, self._shift, max_gap, repairs
        )
        positions = _taken(ordered, positions)
        _refuse_late_contradictions(times, positions, ordered)
        distinct = _distinct_stamps(times, positions, repairs)
        times, positions = _taken(distinct, times), _taken(distinct, positions)
        known = _without_zeros(positions, repairs, must_be_none=self._one_of_several)
        times, positions = _taken(known, times), _taken(known, positions)
        _refuse_few(times)

        period = _usual_period(times)
        self._periods.append(period)
        max_gap = _longest_gap(period, self._max_gap_s)
        pieces = _cut_at_gaps(times / NS_PER_S, positions, max_gap, repairs)
        pieces = tuple(Piece(p.times, _unwrapped(p.positions, repairs)) for p in pieces)
        self._pieces.add(_without_jumps(pieces, repairs), NS_PER_S / period)
        self._check_velocities(raw)

    def _choose(self, raw: RawJointStates) -> None:
        """Choose the joints by the first part; the others must have them all."""
        listed = [layout.joint_names for layout in raw.layouts]
        self._raw.append((raw.topic, raw.listed_joints, raw.n_messages))
        self._notes = raw.notes
        if not self._names:
            self._names = choose_joints(listed, raw.topic, self._joints)
        elif self._joints is None and not all(set(self._names) <= set(names) for names in listed):
            raise RecordingError("some joints are not in every message of each part")

    def _take_joints(
        self, raw: RawJointStates, repairs: Counter[str]
    ) -> tuple[IntArray, FloatArray]:
        """Pick the joints by name; return which messages have them all, and their positions."""
        messages: list[IntArray] = []
        positions: list[FloatArray] = []
        for layout in raw.layouts:
            if not set(self._names) <= set(layout.joint_names):
                repairs["missing_joints"] += layout.messages.size
                continue
            order = [name for name in layout.joint_names if name in self._names]
            self._order = self._order or order
            if order != self._order:
                repairs["reordered"] += layout.messages.size
            messages.append(layout.messages)
            columns = [layout.joint_names.index(name) for name in self._names]
            own = layout.positions
            positions.append(own if columns == list(range(own.shape[1])) else own[:, columns])
        if not messages:
            raise RecordingError(
                f"no message lists all of the joints {quote_names(self._names)} together"
            )
        if len(messages) == 1:
            return messages[0], positions[0]
        merged = np.concatenate(messages)
        order_of_reception = np.argsort(merged)
        return merged[order_of_reception], np.concatenate(positions)[order_of_reception]

    def _stamps(self, raw: RawJointStates, messages: IntArray) -> IntArray:
        stamps, notes = _choose_clock(raw, messages)
        if self._clock_notes not in (None, notes):
            raise RecordingError("the parts have different clocks")
        self._clock_notes = notes
        return stamps

    def _check_velocities(self, raw: RawJointStates) -> None:
        """Check the velocities of the messages that are most alike."""
        if raw.computed:
            return
        self._velocities = self._velocities or VelocityCheck(self._names)
        fitting = [layout for layout in raw.layouts if set(self._names) <= set(layout.joint_names)]
        layout = max(fitting, key=lambda layout: layout.messages.size)
        if layout.velocities is None:
            self._velocities.add_without(layout.messages.size)
            return
        stamps, _ = _choose_clock(raw, layout.messages)
        latest = np.maximum.accumulate(stamps)
        rows = np.flatnonzero(np.append(True, stamps[1:] > latest[:-1]) & (stamps > 0))
        columns = [layout.joint_names.index(name) for name in self._names]
        self._velocities.add(stamps, layout.positions, layout.velocities, rows, columns)


class _Pieces:
    """Pieces of a recording, each perhaps over several parts; of a fast one in fewer samples."""

    def __init__(self) -> None:
        self.n_averaged = 0
        self._done: list[Piece] = []
        self._growing: list[Piece] = []
        self._rest: Piece | None = None

    def add(self, pieces: Sequence[Piece], rate: float) -> None:
        """Add the pieces of a part, the first of which goes on with the last one before."""
        if not self.n_averaged:
            self.n_averaged = max(1, int(rate * (1 + 1e-3) // ENOUGH_RATE))
        for number, piece in enumerate(pieces):
            if number:
                self._close()
            self._go_on(piece)

    def closed(self) -> list[Piece]:
        """All pieces; there are no more."""
        self._close()
        return self._done

    def _go_on(self, piece: Piece) -> None:
        if self._rest is not None:
            # Each part was unwrapped by itself.
            step = self._rest.positions[-1] - piece.positions[0]
            turns = 2.0 * np.pi * np.round(step / (2.0 * np.pi))
            piece = _concatenated([self._rest, Piece(piece.times, piece.positions + turns)])
        # At least one sample is left over: it tells the turns.
        n = (piece.times.size - 1) // self.n_averaged * self.n_averaged
        whole, self._rest = _divided(piece, n)
        self._growing.append(_averaged(whole, self.n_averaged))

    def _close(self) -> None:
        if self._rest is not None:
            self._growing.append(_averaged(self._rest, self.n_averaged))
        self._done.append(_concatenated(self._growing))
        self._growing, self._rest = [], None


def _concatenated(pieces: Sequence[Piece]) -> Piece:
    return Piece(
        np.concatenate([piece.times for piece in pieces]),
        np.concatenate([piece.positions for piece in pieces]),
    )


def _divided(piece: Piece, n_samples: int) -> tuple[Piece, Piece]:
    return (
        Piece(piece.times[:n_samples], piece.positions[:n_samples]),
        Piece(piece.times[n_samples:], piece.positions[n_samples:]),
    )


def _averaged(piece: Piece, n_averaged: int) -> Piece:
    """Means of so many samples each, the last perhaps of fewer."""
    if n_averaged == 1 or not piece.times.size:
        return piece
    starts = np.arange(0, piece.times.size, n_averaged)
    sizes = np.diff(starts, append=piece.times.size)
    return Piece(
        np.add.reduceat(piece.times, starts) / sizes,
        np.add.reduceat(piece.positions, starts) / sizes[:, None],
    )


def _quiet_place(raw: RawJointStates) -> int | None:
    """Find a late message with nothing wrong for :data:`QUIET` messages before and after it."""
    stamps, _ = _choose_clock(raw, np.arange(raw.n_messages))
    layout = max(raw.layouts, key=lambda layout: layout.messages.size)
    first = max(0, raw.n_messages - QUIET_SEARCH)
    rows = np.searchsorted(layout.messages, first)
    stamps = stamps[first:]
    positions = np.full((stamps.size, layout.positions.shape[1]), np.nan)
    positions[layout.messages[rows:] - first] = layout.positions[rows:]
    steps = np.diff(stamps)
    # NaN compares false, too; where there are zeros a second publisher may have put them.
    good = np.asarray(np.max(np.abs(np.diff(positions, axis=0)), axis=1) < MIN_JUMP)
    good &= np.any(positions[1:] != 0.0, axis=1)
    good &= (steps > 0) & (steps < QUIET_PERIODS * np.median(steps))
    runs = np.concatenate([[0], np.cumsum(good)])
    n_before = np.arange(QUIET, stamps.size - QUIET)
    quiet = runs[n_before + QUIET] - runs[n_before - QUIET] == 2 * QUIET
    # A message that comes late belongs before the place.
    latest, earliest = np.maximum.accumulate(stamps), np.minimum.accumulate(stamps[::-1])[::-1]
    quiet &= (latest[n_before - 1] < earliest[n_before]) & (stamps[n_before - QUIET] > 0)
    found = np.flatnonzero(quiet)
    return first + int(n_before[found[-1]]) if found.size else None


def choose_joints(
    listed: Sequence[tuple[str, ...]], topic: str, joints: Sequence[str] | None
) -> tuple[str, ...]:
    """Choose the joints to take: those asked for, else those that all messages list.

    Parameters
    ----------
    listed :
        Names of the joints in each message, or in each kind of messages.
    topic :
        Name of the topic.
    joints :
        Names asked for.

    Raises
    ------
    RecordingError
        If there is no message, a name is unknown, or no joint is in every message.
    """
    if not listed:
        raise RecordingError(f"there is no well-formed message on '{topic}'")
    if joints is not None:
        known = listed_names(listed)
        names = unique_names(joints, "chosen joints", RecordingError)
        for name in names:
            if name not in known:
                raise RecordingError(unknown_name("joint", name, known))
        return _not_too_many(names, topic)
    common = set.intersection(*map(set, listed))
    if not common:
        choices = "; ".join(quote_names(names) for names in list(dict.fromkeys(listed))[:10])
        raise RecordingError(
            f"no joint is in every message of '{topic}', choose joints that come together: "
            f"{choices}"
        )
    return _not_too_many(tuple(name for name in listed[0] if name in common), topic)


def _not_too_many(names: tuple[str, ...], topic: str) -> tuple[str, ...]:
    if len(names) > MAX_JOINTS:
        raise RecordingError(
            f"{len(names)} joints of '{topic}' are more than the {MAX_JOINTS} accepted: choose "
            "some of them (--joints)"
        )
    return names


def _choose_clock(raw: RawJointStates, messages: IntArray) -> tuple[IntArray, tuple[str, ...]]:
    """Take the header stamps, or the times of reception if most of the messages have no stamp.

    Returns
    -------
    stamps : array of int, shape (n_messages,)
        Stamps of these messages [ns], 0 for those that have none.
    notes : tuple of str
        What is worth knowing about them.
    """
    headers, received = raw.header_stamps[messages], raw.receive_stamps[messages]
    stamped = headers > 0
    if 2 * _count(stamped) > stamped.size and _plausible(headers[stamped]):
        if abs(int(headers[stamped][0] - received[stamped][0])) > YEAR_NS:
            return headers, (SIMULATION_TIME,)
        return headers, ()
    if _plausible(received):
        return received, ("no usable header stamps: times of reception are used",)
    why = "span no plausible time" if stamped.any() else "are not set"
    raise RecordingError(
        f"there is no usable time: the header stamps {why}, and the {messages.size} messages were "
        f"received within {np.ptp(received) / 1e6:.3g} ms; record them with stamps, or as they "
        "happen"
    )


def _plausible(stamps: IntArray) -> bool:
    """Tell whether joint states can have been recorded at these times."""
    return bool(stamps.size < 2 or stamps.size <= np.ptp(stamps) / NS_PER_S * MAX_RATE)


def _usable_rows(stamps: IntArray, positions: FloatArray, repairs: Counter[str]) -> IntArray:
    # NaN compares false, too.
    finite = np.all(np.abs(positions) < MAX_POSITION, axis=1)
    stamped = stamps > 0
    repairs["non_finite"] += _count(~finite)
    repairs["unstamped"] += _count(finite & ~stamped)
    return np.flatnonzero(finite & stamped)


def _taken(rows: IntArray, values: NDArray[_Number]) -> NDArray[_Number]:
    """Take these rows; the array itself where these are all, in order: it may be large."""
    if rows.size == len(values) and np.array_equal(rows, np.arange(rows.size)):
        return values
    return values[rows]


def _longest_gap(period: float, max_gap_s: float | None) -> float:
    """Longest time between messages [ns] that is no gap."""
    if max_gap_s is not None:
        return max_gap_s * NS_PER_S
    return max(MAX_GAP * NS_PER_S, MAX_GAP_PERIODS * period)


def _count(mask: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(mask))


def _refuse_few(stamps: IntArray) -> None:
    n_samples = np.unique(stamps).size
    if n_samples < MIN_SAMPLES:
        raise RecordingError(
            f"there are {n_samples} usable samples, at least {MIN_SAMPLES} are needed"
        )


def _usual_period(stamps: IntArray) -> float:
    """Median period [ns] of the stamps, in whatever order they are."""
    steps = np.diff(np.sort(stamps))
    return float(np.median(steps[steps > 0]))


def _without_strays(stamps: IntArray, max_gap: float, repairs: Counter[str]) -> IntArray:
    """Find the stamps that are no single errors between good ones, which would fake two jumps."""
    far = np.abs(np.diff(stamps)) > max_gap
    near_across = np.abs(stamps[2:] - stamps[:-2]) <= max_gap
    stray = np.zeros(stamps.size, dtype=bool)
    stray[1:-1] = far[:-1] & far[1:] & near_across
    repairs["stray_stamps"] += _count(stray)
    return np.flatnonzero(~stray)


def _to_continuous_time(
    stamps: IntArray, first_stamp: int, shift: int | None, max_gap: float, repairs: Counter[str]
) -> tuple[IntArray, IntArray, int]:
    """Order samples by stamp; where the clock was set back, go on from where it was.

    Parameters
    ----------
    first_stamp : int
        That of the first message [ns], which has time 0.
    shift : int or None
        What was added to the stamps of the part before this one in the end [ns], if there is one.

    Returns
    -------
    times : array of int, shape (n_samples,)
        Times since the first message [ns], not decreasing.
    ordered : array of int, shape (n_samples,)
        Which sample each of them belongs to.
    shift : int
        What is added to the stamps in the end [ns].
    """
    jumps = np.flatnonzero(np.diff(stamps) < -max_gap) + 1
    repairs["clock_jumps"] += jumps.size
    times: list[IntArray] = []
    ordered: list[IntArray] = []
    for part in np.split(np.arange(stamps.size), jumps):
        own = stamps[part]
        repairs["out_of_order"] += _count(np.asarray(own < np.maximum.accumulate(own)))
        order = np.argsort(own, kind="stable")
        if times:
            # One more nanosecond than the longest gap, so that the pieces stay apart.
            shift = int(times[-1][-1]) + int(max_gap) + 1 - int(own.min())
        elif shift is None:
            shift = -min(first_stamp, int(own.min()))
        times.append(own[order] + shift)
        ordered.append(part[order])
    assert shift is not None
    return np.concatenate(times), np.concatenate(ordered), shift


def _distinct_stamps(times: IntArray, positions: FloatArray, repairs: Counter[str]) -> IntArray:
    """Keep one sample for each stamp: the first received, but none of zeros beside others.

    Drivers that start before their robot publish zeros; such a second publisher can be told
    apart. Of any other, nobody knows which one is right: they are accepted as rare accidents only.
    """
    zero = np.all(positions == 0.0, axis=1)
    # Within equal stamps samples of zeros go last; the stable sort leaves the others as received.
    order = np.lexsort((zero, times))
    same_stamp = np.flatnonzero(np.diff(times) == 0) + 1
    sample, before = order[same_stamp], order[same_stamp - 1]
    differs = np.any(positions[sample] != positions[before], axis=1)
    undecided = _count(differs & ~zero[sample])
    _refuse_conflicts(undecided, times.size, "another one with the same stamp")
    repairs["contradicting"] += _count(differs)
    repairs["repeated_stamps"] += _count(~differs)
    return np.asarray(np.delete(order, same_stamp), dtype=np.int64)


def _refuse_conflicts(n_conflicts: int, n_messages: int, what: str) -> None:
    if n_conflicts > max(MIN_CONFLICTS, MAX_CONFLICTS * n_messages):
        raise RecordingError(
            f"{n_conflicts} messages contradict {what}: two publishers of the same joints; record "
            "one of them"
        )


def _refuse_late_contradictions(
    times: IntArray, positions: FloatArray, order_of_reception: IntArray
) -> None:
    """Refuse late messages that are elsewhere than those that came in order.

    Two publishers whose stamps differ by their delays look so; late messages of one publisher
    are where the others are.
    """
    earliest_behind = np.minimum.accumulate(order_of_reception[::-1])[::-1]
    late = np.append(order_of_reception[:-1] > earliest_behind[1:], False)
    if _count(late) <= MIN_CONFLICTS:
        return
    on_time = times[~late]
    elsewhere = np.zeros(_count(late), dtype=bool)
    for position in positions.T:
        expected = np.interp(times[late], on_time, position[~late])
        off = np.abs(position[late] - expected)
        elsewhere |= np.abs(off - 2.0 * np.pi * np.round(off / (2.0 * np.pi))) > CONFLICT
    # Zeros between positions are another publisher's, too, but can be told apart.
    elsewhere &= np.any(positions[late] != 0.0, axis=1)
    # Where a block of messages comes late, nothing is near enough to say where they should be.
    behind = np.clip(np.searchsorted(on_time, times[late]), 1, on_time.size - 1)
    elsewhere &= on_time[behind] - on_time[behind - 1] <= 3 * np.median(np.diff(on_time))
    _refuse_conflicts(_count(elsewhere), times.size, "those that came before them")


def _cut_at_gaps(
    times: FloatArray, positions: FloatArray, max_gap: float, repairs: Counter[str]
) -> tuple[Piece, ...]:
    cuts = np.flatnonzero(np.diff(times) > max_gap / NS_PER_S) + 1
    repairs["gaps"] += cuts.size - repairs["clock_jumps"]
    pieces = [
        Piece(t, q) for t, q in zip(np.split(times, cuts), np.split(positions, cuts), strict=True)
    ]
    return _long_pieces(pieces, repairs)


def _long_pieces(pieces: Sequence[Piece], repairs: Counter[str]) -> tuple[Piece, ...]:
    long = tuple(piece for piece in pieces if piece.times.size >= MIN_SAMPLES)
    repairs["short_pieces"] += len(pieces) - len(long)
    if not long:
        raise RecordingError(
            f"it is all in pieces: there are gaps or jumps in {len(pieces) - 1} places, and "
            f"nothing between them has the {MIN_SAMPLES} samples that are needed"
        )
    return long


def _without_zeros(positions: FloatArray, repairs: Counter[str], *, must_be_none: bool) -> IntArray:
    """Find the samples that are none of the zeros a second publisher puts between positions."""
    zero = np.all(positions == 0.0, axis=1)
    changes = np.flatnonzero(zero[1:] != zero[:-1])
    # A robot that passes its zero is near it before and after.
    beside = positions[changes + zero[changes]]
    alternations = _count(np.max(np.abs(beside), axis=1) > FAR_FROM_ZERO)
    if alternations and must_be_none:
        raise RecordingError("whether a second publisher puts zeros shows in all parts together")
    if alternations < MIN_ALTERNATIONS:
        return np.arange(zero.size)
    repairs["zeros"] += _count(zero)
    return np.flatnonzero(~zero)


def _unwrapped(positions: FloatArray, repairs: Counter[str]) -> FloatArray:
    """Take out jumps by full turns; other jumps are none of a wrapping angle."""
    unwrapped = positions
    for joint, position in enumerate(positions.T):
        steps = np.diff(position)
        turns: FloatArray = np.round(steps / (2.0 * np.pi))
        turns[np.abs(steps - 2.0 * np.pi * turns) >= FULL_TURN_TOLERANCE] = 0.0
        if turns.any():
            if unwrapped is positions:
                unwrapped = positions.copy()
            repairs["wrapped"] += _count(turns != 0.0)
            unwrapped[1:, joint] -= 2.0 * np.pi * np.cumsum(turns)
    return unwrapped


def _without_jumps(pieces: Sequence[Piece], repairs: Counter[str]) -> tuple[Piece, ...]:
    """Drop samples that are elsewhere, and cut where the positions stay elsewhere."""
    n_samples = sum(piece.times.size for piece in pieces)
    parts: list[Piece] = []
    n_spikes = 0
    for piece in pieces:
        good = np.flatnonzero(~_spikes(piece.positions))
        n_spikes += piece.times.size - good.size
        times, positions = _taken(good, piece.times), _taken(good, piece.positions)
        cuts = _jumps(times, positions)
        parts += map(Piece, np.split(times, cuts), np.split(positions, cuts))
    n_jumps = len(parts) - len(pieces)
    if n_spikes + n_jumps > MAX_JUMPS * n_samples + 1:
        raise RecordingError(
            f"the positions jump {n_spikes + n_jumps} times in {n_samples} samples, faster than "
            "any motor could: two publishers of the same joints; record one of them"
        )
    repairs["spikes"] += n_spikes
    repairs["jumps"] += n_jumps
    return _long_pieces(parts, repairs)


def _far_step(position: FloatArray) -> float:
    """How far no joint gets between two samples, by what this one does when it moves."""
    # Where two publishers take turns, only steps over two or three messages tell of a motion.
    usual = min(_usual_step(position, lag) for lag in (1, 2, 3))
    return max(MIN_JUMP, JUMP_RATIO * usual)


def _usual_step(position: FloatArray, lag: int) -> float:
    steps = np.abs(position[lag:] - position[:-lag]) / lag
    moving = steps[steps > 1e-6]
    return float(np.median(moving)) if moving.size else 0.0


def _spikes(positions: FloatArray) -> NDArray[np.bool_]:
    spikes = np.zeros(len(positions), dtype=bool)
    for position in positions.T:
        across = np.abs(position[2:] - position[:-2])
        aside = np.abs(position[1:-1] - 0.5 * (position[2:] + position[:-2]))
        spikes[1:-1] |= (aside > _far_step(position)) & (across < 0.5 * aside)
    return spikes


def _jumps(times: FloatArray, positions: FloatArray) -> IntArray:
    """Which samples come after a jump: a fast step between slow ones."""
    jumps = np.zeros(len(times) - 1, dtype=bool)
    for position in positions.T:
        steps = np.abs(np.diff(position))
        beside = np.maximum(np.append(steps[1:], 0.0), np.append(0.0, steps[:-1]))
        jumps |= (
            (steps > _far_step(position))
            & (steps > MAX_SPEED * np.diff(times))
            & (steps > JUMP_ISOLATION * beside)
        )
    return np.flatnonzero(jumps) + 1


def motion_notes(names: tuple[str, ...], pieces: Sequence[Piece]) -> tuple[str, ...]:
    """Say which joints never move, and whether a motion is cut off at an end."""
    low = np.min([piece.positions.min(axis=0) for piece in pieces], axis=0)
    high = np.max([piece.positions.max(axis=0) for piece in pieces], axis=0)
    still = [name for name, travel in zip(names, high - low, strict=True) if travel < MIN_TRAVEL]
    notes = [f"joints that never move: {quote_names(still)}"] if still else []
    speeds = [_window_speeds(piece) for piece in pieces]
    fast = END_SPEED * max(float(speed.max()) for speed in speeds)
    for speed, what in ((speeds[0][0], "begins"), (speeds[-1][-1], "ends")):
        if speed > fast:
            notes.append(f"the recording {what} in a motion, which may be cut off there")
    return tuple(notes)


def _window_speeds(piece: Piece) -> FloatArray:
    """Speed of all joints together over short windows, from the first to the last [/s]."""
    n_windows = max(1, round((piece.times[-1] - piece.times[0]) / END_WINDOW))
    edges = np.linspace(0, piece.times.size - 1, min(n_windows, piece.times.size - 1) + 1)
    marks = edges.round().astype(np.int64)
    way = np.linalg.norm(np.diff(piece.positions[marks], axis=0), axis=1)
    return np.asarray(way / np.diff(piece.times[marks]), dtype=np.float64)


def refuse_stillness(pieces: Sequence[Piece]) -> None:
    """Refuse pieces in which nothing moves."""
    travel = max(float(np.ptp(piece.positions, axis=0).max()) for piece in pieces)
    if travel < MIN_TRAVEL:
        raise RecordingError(
            f"nothing moves: no chosen joint travels more than {travel:.2g} rad (or m)"
        )
