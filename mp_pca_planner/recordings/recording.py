# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A repaired recording: its samples in pieces, and what was found in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..exceptions import quote_names

if TYPE_CHECKING:
    from .cutting import Overview
    from .demonstration import Demonstration
    from .segmentation import SpeedThresholds

MIN_SAMPLES = 10
"""Least number of samples of a motion."""

REPAIRS = {
    "malformed": "message dropped: not one position for each name, or a name listed twice",
    "missing_joints": "message dropped: it lacks a chosen joint, as another publisher's",
    "non_finite": "message dropped: a position of a chosen joint is NaN, infinite or absurd",
    "unstamped": "message dropped: no header stamp, while most have one",
    "stray_stamps": "message dropped: its stamp is far from those before and after it",
    "clock_jumps": "the clock was set back, or forward by more than a day: cut there",
    "out_of_order": "message with an earlier stamp than one before it: sorted in",
    "repeated_stamps": "message dropped: another one has the same stamp and positions",
    "contradicting": "message dropped: another one has the same stamp and other positions",
    "zeros": "message dropped: zeros that alternate with positions (a driver without data)",
    "gaps": "no message for longer than the longest gap: cut there",
    "wrapped": "jump of a joint by full turns: removed",
    "spikes": "message dropped: a joint is farther away in it than a motor could move it",
    "jumps": "a joint moves faster than a motor could: cut there",
    "frozen": "message before such a jump dropped: it repeats positions of moving joints",
    "short_pieces": "piece between cuts dropped: too few samples",
    "cut_off": "motion dropped: an end of the recording, a gap or a jump cuts it off",
    "rest": "movement dropped: within the extent of noise and sway, taken for rest",
    "turns": "motion shifted by full turns of a continuous joint, to the other motions' turn",
}
"""Kinds of repairs, by the name under which they are counted, in the order in which they are made.
The last three are made where motions are cut, or compared."""

DROPPED = {"short_pieces", "cut_off", "rest"}
"""Kinds of repairs that leave a motion out."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples without interruption.

    Attributes
    ----------
    times : array, shape (n_samples,)
        Times since the recording's first message [s], increasing.
    positions : array, shape (n_samples, n_joints)
        Joint positions [rad or m].
    """

    times: FloatArray
    positions: FloatArray

    def cut(self, places: Sequence[int]) -> list[Samples]:
        """Parts of the samples, each from one of the places (indices) to the next."""
        parts = zip(np.split(self.times, places), np.split(self.positions, places), strict=True)
        return [Samples(times, positions) for times, positions in parts]


@dataclass(frozen=True)
class MarkerResidual:
    """Distances of a marker on the model from its measured positions.

    Attributes
    ----------
    median, percentile_95 : float
        Of the distances [m].
    n_frames : int
        Frames in which it was seen and used.
    """

    median: float
    percentile_95: float
    n_frames: int


@dataclass(frozen=True)
class Refusal:
    """A recording that can't be used, and why.

    Attributes
    ----------
    recording, reason : str
        Its name, and the reason.
    joint_names : tuple of str
        All joints that its messages list, if they can be read.
    """

    recording: str
    reason: str
    joint_names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Recording:
    """A repaired recording and what was found in it; once it is cut, its motions.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints.
    pieces : tuple of Samples
        The samples between gaps and clock jumps, in order of time; none once it is cut.
    rate : float
        The usual rate [Hz]: one over the median period.
    sample_rate : float
        Rate of the samples in the pieces [Hz]; lower than `rate` where samples were averaged.
    duration : float
        Time from the first to the last sample, of episodes their sum [s].
    repairs : dict
        Counts of the repairs that were made, by their names in :data:`REPAIRS`.
    notes : tuple of str
        Findings that needed no repair, one sentence each.
    topic : str
        The topic that was read.
    n_messages : int
        Number of its messages.
    listed_joints : tuple of str
        All joints that its messages list.
    still_joints : tuple of str
        The joints of `joint_names` that never move.
    fingerprint : tuple of int
        See :func:`.copies.fingerprint`.
    episodes : tuple of (float, int or str)
        Start [s] and name of each episode of a table, see :data:`.tables.Episodes`. Each piece is
        one motion then, unless cuts are asked for.
    marker_residuals : dict
        Residual of each marker; empty unless markers were recorded.
    checksum : str
        SHA-256 of the stored bytes.
    name, path, format : str
        Its name, its place and its storage format.
    motions : tuple of Demonstration
        The motions that are cut out of it, in order.
    thresholds : SpeedThresholds
        Speeds of rest and motion, determined from the recording.
    overview : tuple of array
        Few of its samples, for a figure, see :data:`.cutting.Overview`.
    """

    joint_names: tuple[str, ...]
    pieces: tuple[Samples, ...]
    rate: float
    sample_rate: float
    duration: float
    repairs: dict[str, int]
    notes: tuple[str, ...]
    topic: str
    n_messages: int
    listed_joints: tuple[str, ...]
    still_joints: tuple[str, ...] = ()
    fingerprint: tuple[int, ...] = ()
    episodes: tuple[tuple[float, int | str], ...] = ()
    marker_residuals: dict[str, MarkerResidual] = field(default_factory=dict)
    checksum: str = ""
    name: str = ""
    path: str = ""
    format: str = ""
    motions: tuple[Demonstration, ...] = ()
    thresholds: SpeedThresholds | None = None
    overview: Overview | None = None

    @property
    def all_notes(self) -> tuple[str, ...]:
        """The notes, with one on the joints that never move."""
        if not self.still_joints:
            return self.notes
        return (*self.notes, f"joints that never move: {quote_names(self.still_joints)}")

    def episode_at(self, time: float) -> int | str | None:
        """Name of the episode at a time [s]; None without episodes."""
        # Times are rounded to nanoseconds.
        return next((x for start, x in reversed(self.episodes) if start <= time + 1e-6), None)

    def with_joints(self, joints: Sequence[str]) -> Recording:
        """The recording of some of its joints, in this order; the others never move."""
        if joints == self.joint_names:
            return self
        columns = [self.joint_names.index(name) for name in joints]
        return replace(
            self,
            joint_names=tuple(joints),
            pieces=tuple(Samples(x.times, x.positions[:, columns]) for x in self.pieces),
            still_joints=tuple(name for name in self.still_joints if name in joints),
        )

    def noted(self, *notes: str, **repairs: int) -> Recording:
        """The recording with further notes, and further repairs by their names."""
        counts = Counter(self.repairs) + Counter(repairs)
        return replace(self, notes=(*self.notes, *notes), repairs=dict(counts))
