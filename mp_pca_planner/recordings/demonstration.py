# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One demonstrated motion, cut out of a repaired recording and smoothed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from ..arrays import FloatArray, frozen_array, unique_names
from ..exceptions import RecordingError


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

    Raises
    ------
    RecordingError
        If shapes disagree, a number is not finite or the times are not evenly spaced.
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

    def __post_init__(self) -> None:
        where = f"motion at {self.start_time:.3f} s of '{self.recording}'"
        names = unique_names(self.joint_names, f"joints of the {where}", RecordingError)
        times = frozen_array(self.times, (None,), f"times of the {where}", RecordingError)
        if times.size < 2:
            raise RecordingError(f"the {where} has {times.size} samples, at least 2 are needed")
        steps = np.diff(times)
        if times[0] != 0.0 or steps.min() <= 0.0 or np.ptp(steps) > 1e-6 * steps.mean():
            raise RecordingError(f"the times of the {where} must start at 0 and be evenly spaced")
        object.__setattr__(self, "joint_names", names)
        object.__setattr__(self, "times", times)
        for name in ("positions", "velocities", "accelerations"):
            array = frozen_array(
                getattr(self, name),
                (times.size, len(names)),
                f"{name} of the {where}",
                RecordingError,
            )
            object.__setattr__(self, name, array)

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Arrays that come from another process are writeable.
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        self.__dict__.update(state)

    def __repr__(self) -> str:
        label = f" '{self.label}'" if self.label else ""
        return (
            f"Demonstration{label} of '{self.recording}': {self.n_joints} joints, "
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

    def time_normalised(self, n_phases: int) -> FloatArray:
        """Positions at evenly spaced phases from 0 to 1 (linear time normalisation).

        Parameters
        ----------
        n_phases : int
            Number of phases, at least 2.

        Returns
        -------
        positions : array, shape (n_phases, n_joints)
            Joint positions [rad or m], by cubic Hermite interpolation of positions and velocities.
        """
        spline = CubicHermiteSpline(self.times, self.positions, self.velocities, axis=0)
        return np.asarray(spline(np.linspace(0.0, self.times[-1], n_phases)), dtype=np.float64)

    def thinned(self, most_samples: int) -> Demonstration:
        """The same motion in fewer samples, for a figure.

        Parameters
        ----------
        most_samples : int
            Largest number of samples, at least 2. A motion that has no more is returned unchanged.
        """
        if self.times.size <= most_samples:
            return self
        times = np.linspace(0.0, self.times[-1], most_samples)
        positions, velocities, accelerations = (
            make_interp_spline(self.times, curve, k=3)(times)
            for curve in (self.positions, self.velocities, self.accelerations)
        )
        return replace(
            self,
            times=times,
            positions=positions,
            velocities=velocities,
            accelerations=accelerations,
        )
