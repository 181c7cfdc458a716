# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Reports on loaded recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from ..arrays import FloatArray
from ..exceptions import RecordingError
from .bags import BagFormat
from .demonstration import Demonstration
from .segmentation import SpeedThresholds


@dataclass(frozen=True)
class Segment:
    """Interval of a recording that holds one motion.

    Attributes
    ----------
    start, end : float
        Times since the recording's first message [s].
    label : str
        Label in the table of segments ('' if there is none).
    extent : float
        Norm over the joints of the distance that each of them covers [rad or m].
    """

    start: float
    end: float
    label: str = ""
    extent: float = 0.0


@dataclass(frozen=True, eq=False)
class Overview:
    """A whole recording in few samples, for a figure.

    Attributes
    ----------
    times : array, shape (n_samples,)
        Times since the recording's first message [s]; NaN between the pieces.
    positions : array, shape (n_samples, n_joints)
        Joint positions [rad or m].
    speed : array, shape (n_samples,)
        Highest norm of the joint velocities up to the next sample [rad/s or m/s].
    """

    times: FloatArray
    positions: FloatArray
    speed: FloatArray


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
    """A recording that can't be used, and why."""

    recording: str
    reason: str


@dataclass(frozen=True)
class RecordingReport:
    """Content of a recording, its repairs and its motions.

    Attributes
    ----------
    name, path, format, topic : str
        The recording and its topic of joint states.
    n_messages : int
        Messages on the topic.
    rate : float
        Usual rate [Hz].
    duration : float
        Time from the first to the last usable message [s].
    joint_names : tuple of str
        Names of the joints taken.
    checksum : str
        SHA-256 of the stored bytes.
    repairs : dict
        Counts of the repairs, by their names in :data:`.repair.REPAIRS`.
    motions : tuple of Segment
        The motions, in order.
    thresholds : SpeedThresholds
        Speeds of rest and motion, determined from the recording.
    notes : tuple of str
        Other findings, one sentence each.
    overview : Overview or None
        The recording in few samples, on request.
    marker_residuals : dict
        Residual of each marker; empty unless markers were recorded.
    """

    name: str
    path: str
    format: BagFormat
    topic: str
    n_messages: int
    rate: float
    duration: float
    joint_names: tuple[str, ...]
    checksum: str
    repairs: dict[str, int]
    motions: tuple[Segment, ...]
    thresholds: SpeedThresholds
    notes: tuple[str, ...]
    overview: Overview | None = None
    marker_residuals: dict[str, MarkerResidual] = field(default_factory=dict)


@dataclass(frozen=True)
class RecordingSet:
    """Demonstrations from several recordings, with a report or a refusal for each of these.

    Attributes
    ----------
    demonstrations : tuple of Demonstration
        Those of all recordings, in order.
    reports : tuple of RecordingReport
        One for each recording that is used.
    refused : tuple of Refusal
        One for each that is not.
    summaries : tuple
        Results of `summarise` for the recordings that are used, if it was given.
    """

    demonstrations: tuple[Demonstration, ...] = ()
    reports: tuple[RecordingReport, ...] = ()
    refused: tuple[Refusal, ...] = ()
    summaries: tuple[Any, ...] = ()

    def __len__(self) -> int:
        return len(self.demonstrations)

    def __iter__(self) -> Iterator[Demonstration]:
        return iter(self.demonstrations)

    def __getitem__(self, index: int) -> Demonstration:
        return self.demonstrations[index]

    def __repr__(self) -> str:
        return (
            f"RecordingSet: {len(self.demonstrations)} demonstrations of {len(self.reports)} "
            f"recording(s), {len(self.refused)} rejected"
        )

    @property
    def report(self) -> str:
        """What was repaired and rejected, one line for each kind and recording."""
        repairs = Counter[str]()
        for one in self.reports:
            repairs.update({kind: count for kind, count in one.repairs.items() if count})
        return "\n".join(
            [
                f"{len(self.demonstrations)} motions in {len(self.reports)} usable recording(s)",
                *(f"repaired: {count} {kind}" for kind, count in sorted(repairs.items())),
                *(f"{one.name}: {note}" for one in self.reports for note in one.notes),
                *(f"rejected {one.recording}: {one.reason}" for one in self.refused),
            ]
        )

    def require_motion(self) -> None:
        """Raise a RecordingError, with the first reason, if no recording holds a motion."""
        if self.demonstrations or self.summaries:
            return
        if not self.refused:
            n = len(self.reports)
            raise RecordingError(f"no motion was found: {n} recordings hold no motion")
        first, *others = self.refused
        more = f" (and {len(others)} more refused)" if others else ""
        raise RecordingError(f"no motion was found: {first.recording}: {first.reason}{more}")
