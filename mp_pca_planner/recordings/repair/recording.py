# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings before and after their repair."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...exceptions import RecordingError, UnusableRecordingError, quote_names
from ..joint_states import NS_PER_S, IntArray

GAP_TIME, GAP_PERIODS = 0.5, 5
"""See :func:`longest_gap` [s, periods]."""

MIN_SAMPLES = 10
"""Least number of samples of a motion."""

NOISE_DEVIATIONS = 8.0
"""Errors of positions up to this many standard deviations of the noise are noise."""

FINGERPRINT_SIZE = 32
"""Largest number of hashes of a fingerprint."""

# Samples of a fingerprint are in steps of this [rad or m], less than noise and more than errors of
# other formats, and in runs of so many.
_QUANTUM = 1e-4
_RUN = 3
# A joint that travels less than this is still; it is about the noise of encoders [rad or m].
_MIN_TRAVEL = 1e-3


class Defect(NamedTuple):
    """A defect of recordings.

    Attributes
    ----------
    counts : mapping of str to str
        The names under which its repairs are counted, with a sentence on each.
    repair : callable
        A function of the samples (or of the pieces, once they are cut) and of the counts, which it
        raises. It returns the repaired samples or pieces, and raises a
        RecordingError if the defect can't be repaired.
    """

    counts: Mapping[str, str]
    repair: Callable[[Any, Counter[str]], Any]


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

    def cut(self, places: Sequence[int]) -> list[Piece]:
        """Parts of the piece, each from one of the places (indices of samples) to the next."""
        parts = zip(np.split(self.times, places), np.split(self.positions, places), strict=True)
        return [Piece(times, positions) for times, positions in parts]


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
        Rate of the samples in the pieces [Hz]; lower than `rate` where samples were averaged.
    repairs : dict
        Counts of the repairs that were made, by their names in :data:`.REPAIRS`.
    notes : tuple of str
        Findings that needed no repair, one sentence each.
    topic : str
        The topic that was read.
    n_messages : int
        Number of its messages.
    listed_joints : tuple of str
        All joints that its messages list.
    pieces_are_motions : bool
        Whether each piece is one motion, which is not segmented.
    still_joints : tuple of str
        The joints of `joint_names` that never move.
    fingerprint : tuple of int
        See :func:`fingerprint`.
    episodes : tuple of (float, int or str)
        Start [s] and name of each episode of a table, see :data:`.tables.Episodes`.
    """

    joint_names: tuple[str, ...]
    pieces: tuple[Piece, ...]
    rate: float
    sample_rate: float
    repairs: dict[str, int]
    notes: tuple[str, ...]
    topic: str
    n_messages: int
    listed_joints: tuple[str, ...]
    pieces_are_motions: bool = False
    still_joints: tuple[str, ...] = ()
    fingerprint: tuple[int, ...] = ()
    episodes: tuple[tuple[float, int | str], ...] = ()

    def episode_at(self, time: float) -> int | str | None:
        """Name of the episode at a time [s]; None without episodes."""
        return next((name for start, name in reversed(self.episodes) if start <= time), None)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.pieces[-1].times[-1] - self.pieces[0].times[0])


def findings(raw: Any, repairs: Counter[str], notes: Sequence[str] = ()) -> dict[str, Any]:
    """Fields of a :class:`CleanRecording` on the messages `raw`, and what was found in them."""
    return {
        "repairs": {kind: n for kind, n in repairs.items() if n},
        "topic": raw.topic,
        "n_messages": raw.n_messages,
        "listed_joints": raw.listed_joints,
        "notes": (*raw.notes, *notes),
    }


@contextmanager
def findings_on_refusal(raw: Any, repairs: Counter[str]) -> Iterator[None]:
    """Add the facts on the messages and the repairs until then to an error."""
    try:
        yield
    except RecordingError as error:
        raise UnusableRecordingError(str(error), findings(raw, repairs)) from None


def motion_findings(
    names: tuple[str, ...], pieces: Sequence[Piece]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The joints that never move; notes on these and on motions that are cut off at an end.

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
    still = tuple(name for name, distance in moved if distance < _MIN_TRAVEL)
    notes = [f"joints that never move: {quote_names(still)}"] if still else []
    speeds = [_window_speeds(piece) for piece in pieces]
    # At a fifth of the highest speed a joint is within its motion.
    fast = 0.2 * max(float(speed.max()) for speed in speeds)
    for speed, what in ((speeds[0][0], "begins"), (speeds[-1][-1], "ends")):
        if speed > fast:
            notes.append(f"the recording {what} in a motion, which may be cut off there")
    return still, tuple(notes)


def _window_speeds(piece: Piece) -> FloatArray:
    """Norm of the joint speeds over windows of about 0.1 s, in order of time [/s]."""
    n_windows = max(1, round((piece.times[-1] - piece.times[0]) / 0.1))
    edges = np.linspace(0, piece.times.size - 1, min(n_windows, piece.times.size - 1) + 1)
    marks = edges.round().astype(np.int64)
    distance = np.linalg.norm(np.diff(piece.positions[marks], axis=0), axis=1)
    return np.asarray(distance / np.diff(piece.times[marks]), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of one recording.

    Attributes
    ----------
    times : array of int, shape (n_samples,)
        Stamps, or times since the first message once they are in order [ns].
    positions : array, shape (n_samples, n_joints)
        Joint positions [rad or m].
    received : array of int, shape (n_samples,)
        Place of each sample in the order of reception.
    first_stamp : int
        Stamp of the recording's first message [ns].
    joint_names : tuple of str
        Names of the joints.
    max_gap : float or None
        See :func:`longest_gap`.
    """

    times: IntArray
    positions: FloatArray
    received: IntArray
    first_stamp: int
    joint_names: tuple[str, ...]
    max_gap: float | None

    @property
    def period(self) -> float:
        """Median period [ns], whatever the order of the samples."""
        steps = np.diff(np.sort(self.times))
        return float(np.median(steps[steps > 0]))

    @property
    def longest_gap(self) -> float:
        """Longest time between samples that is no gap [ns]."""
        return longest_gap(self.period, self.max_gap)

    def taken(self, rows: IntArray) -> Samples:
        """Some of the samples, in the order of `rows`."""
        times, positions, received = (
            taken(rows, values) for values in (self.times, self.positions, self.received)
        )
        return replace(self, times=times, positions=positions, received=received)

    def refuse_few(self) -> None:
        """Raise a RecordingError if there are too few different times."""
        # Sorting is several times faster than np.unique, which hashes.
        n_samples = min(1, self.times.size) + count(np.diff(np.sort(self.times)))
        if n_samples < MIN_SAMPLES:
            raise RecordingError(
                f"there are {n_samples} usable samples, at least {MIN_SAMPLES} are needed"
            )


def fingerprint(positions: FloatArray, joint_names: Sequence[str]) -> tuple[int, ...]:
    """Smallest hashes of short runs of samples, without their times, in which a joint moves.

    Runs that two recordings have in common are in both fingerprints, whatever their formats and
    times. Noise makes others differ.

    Parameters
    ----------
    positions : array, shape (n_samples, n_joints)
        Samples in order [rad or m].
    joint_names :
        Names of the joints; their order does not matter.
    """
    order = np.argsort(np.array(joint_names, dtype=object), kind="stable")
    steps = np.rint(positions[:, order] / _QUANTUM).astype(np.int64).view(np.uint64)
    factors = np.random.default_rng(1).integers(1 << 62, size=len(order), dtype=np.uint64) * 2 + 1
    rows = _mixed((steps * factors.astype(np.uint64)).sum(axis=1, dtype=np.uint64))
    moves = rows[1:] != rows[:-1]
    n = rows.size - _RUN + 1
    if n < 1:
        return ()
    runs, moving = np.zeros(n, dtype=np.uint64), np.ones(n, dtype=bool)
    for k in range(_RUN):
        runs = _mixed(runs ^ rows[k : k + n])
        if k:
            moving &= moves[k - 1 : k - 1 + n]
    return tuple(np.unique(runs[moving] >> np.uint64(1))[:FINGERPRINT_SIZE].tolist())


def _mixed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Values whose bits are spread evenly, by the finaliser of SplitMix64."""
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(values ^ (values >> np.uint64(31)))


def longest_gap(period: float, max_gap: float | None) -> float:
    """Longest time between messages of a usual period that is no gap.

    Parameters
    ----------
    period : float
        The usual period [ns].
    max_gap : float or None
        That time [s]. By default it is `GAP_TIME`, or `GAP_PERIODS` usual periods where these are
        longer.

    Returns
    -------
    :
        [ns].
    """
    if max_gap is not None:
        return max_gap * NS_PER_S
    return max(GAP_TIME * NS_PER_S, GAP_PERIODS * period)


def count(mask: NDArray[Any]) -> int:
    """Number of entries that are not zero."""
    return int(np.count_nonzero(mask))


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


def taken(rows: IntArray, values: NDArray[Any]) -> NDArray[Any]:
    """Some rows of an array; the array itself where these are all, since it may be large."""
    if rows.size == len(values) and np.array_equal(rows, np.arange(rows.size)):
        return values
    return values[rows]
