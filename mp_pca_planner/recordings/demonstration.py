# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrated motions, cut out of repaired and smoothed recordings, or given as arrays."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import (
    MAX_SIZE,
    FloatArray,
    frozen_array,
    set_frozen,
    unique_names,
)
from ..exceptions import RecordingError
from ..lazy import LazyModule

if TYPE_CHECKING:
    from .segmentation import SmoothPiece

interpolate = LazyModule("scipy.interpolate")

TIME_COLUMNS = ("time", "t", "time_s", "timestamp", "stamp", "__time")
"""Names of a column of times [s]."""

MIN_SAMPLES = 5
"""Fewest samples of a motion that is given as arrays."""

SUSPICIOUS_PERIOD = 0.5
"""Time between samples [s] from which on times are probably milliseconds, of 2 kHz."""

# Longest motion that is given as arrays [s], twelve days: longer ones are in other units.
_MAX_SPAN = 1e6


def other_unit_of_time(name: str, times: FloatArray) -> str:
    """A sentence if the times of a table or of arrays [s] look like another unit; else empty."""
    period = float(np.median(np.diff(times))) if times.size > 1 else 0.0
    if period < SUSPICIOUS_PERIOD:
        return ""
    units = {500.0: "milliseconds", 5e5: "microseconds", np.inf: "nanoseconds"}
    unit = next(unit for end, unit in units.items() if period < end)
    return (
        f"the samples of '{name}' are {period:.3g} s apart: times must be in seconds, and these "
        f"look like {unit}"
    )


@dataclass(frozen=True, eq=False)
class Demonstration:
    """Uniform samples of one motion of the chosen joints, immutable.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints, in the chosen order.
    times : array, shape (n_steps,)
        Times since the start of the motion [s], evenly spaced, first 0.
    positions, velocities, accelerations : array, shape (n_steps, n_joints)
        Smoothed joint positions [rad or m] and the derivatives of the same curve [/s, /s²].
    recording : str
        Name of the recording it comes from.
    start_time, end_time : float
        Start and end [s], since the first message of the recording.
    label : str
        Label in the table of segments ('' if there is none).
    checksum : str
        SHA-256 of the recording's data, for provenance.
    episode : int, str or None
        The episode of a LeRobot dataset or of a CSV file; None of other recordings.

    Raises
    ------
    RecordingError
        If shapes disagree, a number is not finite or the times are not evenly spaced.

    Examples
    --------
    >>> import numpy as np
    >>> import mp_pca_planner as mp
    >>> t = np.linspace(0.0, 1.0, 51)
    >>> motion = mp.Demonstration.from_arrays(["elbow"], t, np.sin(t)[:, None])
    >>> motion.duration
    1.0
    """

    joint_names: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    recording: str = field(kw_only=True)
    start_time: float = field(kw_only=True)
    end_time: float = field(kw_only=True)
    label: str = field(default="", kw_only=True)
    checksum: str = field(default="", kw_only=True)
    episode: int | str | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        where = f"motion at {self.start_time:.3f} s of '{self.recording}'"
        names = unique_names(self.joint_names, f"joints of the {where}", RecordingError)
        times = frozen_array(self.times, (None,), f"times of the {where}", RecordingError)
        if times.size < 2:
            raise RecordingError(f"the {where} has {times.size} samples, at least 2 are needed")
        steps = np.diff(times)
        if times[0] != 0.0 or steps.min() <= 0.0 or np.ptp(steps) > 1e-6 * steps.mean():
            raise RecordingError(f"the times of the {where} must start at 0 and be evenly spaced")
        set_frozen(self, joint_names=names, times=times)
        shape = (times.size, len(names))
        for name in ("positions", "velocities", "accelerations"):
            what = f"{name} of the {where}"
            array = frozen_array(getattr(self, name), shape, what, RecordingError)
            set_frozen(self, **{name: array})

    @classmethod
    def of_curve(
        cls,
        joint_names: Sequence[str],
        curve: Callable[[FloatArray, int], FloatArray],
        times: FloatArray,
        recording: str,
    ) -> Demonstration:
        """A motion that was not recorded.

        Parameters
        ----------
        joint_names : sequence of str
            Names of the joints.
        curve : callable
            A function of times [s] and of the order of the derivative, such as a spline of SciPy.
        times : array, shape (n_steps,)
            Times of the samples [s], evenly spaced, first 0.
        recording : str
            Name of what it comes from.
        """
        states = (curve(times, order) for order in range(3))
        end = float(times[-1])
        return cls(
            tuple(joint_names), times, *states, recording=recording, start_time=0.0, end_time=end
        )

    @classmethod
    def from_arrays(
        cls,
        joint_names: Sequence[str],
        times: ArrayLike,
        positions: ArrayLike,
        *,
        recording: str = "arrays",
        label: str = "",
    ) -> Demonstration:
        """A motion from samples, smoothed and resampled as motions of recordings are.

        The samples are one motion as they are: they are not cut at rests, and rests at the ends
        stay. Let them begin and end at rest.

        Parameters
        ----------
        joint_names : sequence of str
            Names of the joints.
        times : array_like, shape (n_samples,)
            Times of the samples [s], strictly increasing. Half a second or more between samples
            gives a warning (`UserWarning`): these are probably milliseconds.
        positions : array_like, shape (n_samples, n_joints)
            Joint positions [rad or m].
        recording : str
            Name of what they come from.
        label : str
            What the motion is called.

        Raises
        ------
        RecordingError
            If shapes disagree, a number is not finite, or the times don't increase.

        Examples
        --------
        >>> import numpy as np
        >>> import mp_pca_planner as mp
        >>> t = np.linspace(0.0, 1.0, 51)
        >>> q = np.column_stack([np.sin(t), 1.0 - np.cos(t)])
        >>> mp.Demonstration.from_arrays(["shoulder", "elbow"], t, q)
        Demonstration of 'arrays': 2 joints, 0.00 to 1.00 s
        """
        found = cls.of_samples(joint_names, times, positions, recording, label)
        if note := other_unit_of_time(recording, np.asarray(times, dtype=np.float64)):
            warnings.warn(note, stacklevel=2)
        return found

    @classmethod
    def of_samples(
        cls,
        joint_names: Sequence[str],
        times: ArrayLike,
        positions: ArrayLike,
        recording: str,
        label: str = "",
    ) -> Demonstration:
        """The motion of :meth:`from_arrays`, without a warning."""
        from .recording import Samples
        from .segmentation import smooth

        names = unique_names(joint_names, f"joints of '{recording}'", RecordingError)
        t = frozen_array(times, (None,), f"times of '{recording}'", RecordingError)
        what = f"positions of '{recording}' (samples, joints)"
        q = frozen_array(positions, (t.size, len(names)), what, RecordingError)
        if t.size < MIN_SAMPLES:
            raise RecordingError(
                f"'{recording}' has {t.size} samples: {MIN_SAMPLES} or more are needed"
            )
        if np.diff(t).min() <= 0.0:
            index = int(np.argmax(np.diff(t) <= 0.0)) + 1
            raise RecordingError(
                f"the times of '{recording}' must strictly increase, but at index {index} "
                f"{t[index]:.9g} s follows {t[index - 1]:.9g} s"
            )
        span, period = float(t[-1] - t[0]), float(np.median(np.diff(t)))
        if span > _MAX_SPAN or span * len(names) > MAX_SIZE * period:
            raise RecordingError(
                f"the times of '{recording}' must be in seconds and about even, but span "
                f"{span:.3g} s, and half of them are at most {period:.3g} s apart"
            )
        piece = smooth(Samples(t - t[0], q), 1.0 / period)
        checksum = hashlib.sha256(t.tobytes() + q.tobytes()).hexdigest()
        whole = 0, piece.times.size - 1
        return cls.of_piece(
            names, piece, *whole, recording=recording, label=label, checksum=checksum
        )

    @classmethod
    def of_piece(
        cls, joint_names: tuple[str, ...], piece: SmoothPiece, first: int, last: int, **about: Any
    ) -> Demonstration:
        """The motion of a smooth piece from its first to its last step.

        Parameters
        ----------
        joint_names : tuple of str
            Names of the joints.
        piece : SmoothPiece
            It contains the motion.
        first, last : int
            Steps at which the motion begins and ends.
        **about :
            Other attributes, such as `recording`.
        """
        steps = slice(first, last + 1)
        start, end = float(piece.times[first]), float(piece.times[last])
        curves = (x[steps] for x in (piece.positions, piece.velocities, piece.accelerations))
        times = piece.times[steps] - start
        return cls(joint_names, times, *curves, start_time=start, end_time=end, **about)

    def __repr__(self) -> str:
        label = f" '{self.label}'" if self.label else ""
        episode = "" if self.episode is None else f", episode {self.episode}"
        return (
            f"Demonstration{label} of '{self.recording}'{episode}: {self.n_joints} joints, "
            f"{self.start_time:.2f} to {self.end_time:.2f} s"
        )

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.times[-1])

    def at(self, times: FloatArray) -> FloatArray:
        """Joint positions at times [s], shape (n_times, n_joints) [rad or m].

        They are found by cubic Hermite interpolation of positions and velocities.
        """
        curve = interpolate.CubicHermiteSpline(self.times, self.positions, self.velocities, axis=0)
        return np.asarray(curve(times))

    def time_normalised(self, n_phases: int) -> FloatArray:
        """Joint positions at evenly spaced phases from 0 to 1 (linear time normalisation).

        Their shape is (n_phases, n_joints); at least 2 phases are needed.
        """
        return self.at(np.linspace(0.0, self.duration, n_phases))
