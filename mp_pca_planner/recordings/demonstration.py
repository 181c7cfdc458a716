# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One demonstrated motion, cut out of a recording and cleaned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
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
        When it starts and ends, in seconds after the first message of the recording.
    label : str
        What it was labelled as ('' if not).
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
    recording: str
    start_time: float
    end_time: float
    label: str = ""
    checksum: str = ""

    def __init__(
        self,
        joint_names: Sequence[str],
        times: ArrayLike,
        positions: ArrayLike,
        velocities: ArrayLike,
        accelerations: ArrayLike,
        *,
        recording: str,
        start_time: float,
        end_time: float,
        label: str = "",
        checksum: str = "",
    ) -> None:
        where = f"motion at {start_time:.3f} s of '{recording}'"
        names = unique_names(joint_names, f"joints of the {where}", RecordingError)
        stamps = frozen_array(times, (None,), f"times of the {where}", RecordingError)
        if stamps.size < 2:
            raise RecordingError(f"the {where} has {stamps.size} samples, at least 2 are needed")
        steps = np.diff(stamps)
        if stamps[0] != 0.0 or steps.min() <= 0.0 or np.ptp(steps) > 1e-6 * steps.mean():
            raise RecordingError(f"the times of the {where} must start at 0 and be evenly spaced")
        object.__setattr__(self, "joint_names", names)
        object.__setattr__(self, "times", stamps)
        for field, values in (
            ("positions", positions),
            ("velocities", velocities),
            ("accelerations", accelerations),
        ):
            array = frozen_array(
                values, (stamps.size, len(names)), f"{field} of the {where}", RecordingError
            )
            object.__setattr__(self, field, array)
        for field, text in (("recording", recording), ("label", label), ("checksum", checksum)):
            object.__setattr__(self, field, str(text))
        object.__setattr__(self, "start_time", float(start_time))
        object.__setattr__(self, "end_time", float(end_time))

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Arrays that come from another process are writeable.
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        self.__dict__.update(state)

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
        """The same motion in fewer samples, to be looked at.

        Parameters
        ----------
        most_samples : int
            How many at most, at least 2. A motion that has no more stays as it is.
        """
        if self.times.size <= most_samples:
            return self
        times = np.linspace(0.0, self.times[-1], most_samples)
        curves = (self.positions, self.velocities, self.accelerations)
        thin = [make_interp_spline(self.times, curve, k=3)(times) for curve in curves]
        return Demonstration(
            self.joint_names,
            times,
            *thin,
            recording=self.recording,
            start_time=self.start_time,
            end_time=self.end_time,
            label=self.label,
            checksum=self.checksum,
        )
