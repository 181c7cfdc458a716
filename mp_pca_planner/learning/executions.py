# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Effort and tracking error of an executed motion, measured from its recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import trapezoid

from ..arrays import FloatArray
from ..exceptions import RecordingError
from ..motion.interpolation import interpolate
from ..motion.trajectory import Trajectory
from ..recordings.efforts import measured_states


@dataclass(frozen=True)
class MeasuredExecution:
    """One execution of a trajectory.

    Attributes
    ----------
    effort : float
        Measured ½∫‖τ‖²dt over the time of the motion [N²·m²·s].
    tracking_error : float
        RMS over time of the distance ‖q − q_desired‖ [rad or m].
    started : float
        Start of the motion after the first joint state of the recording [s].
    """

    effort: float
    tracking_error: float
    started: float


def measure_execution(
    path: Path, trajectory: Trajectory, topic: str | None = None, step: float = 0.005
) -> MeasuredExecution:
    """Find a trajectory's execution in a recording, and measure it.

    It starts where the recorded positions follow the desired ones best.

    Parameters
    ----------
    path : Path
        The recording, of joint states with efforts.
    trajectory : Trajectory
        The executed motion.
    topic : str, optional
        Topic of the joint states; the only one by default.
    step : float
        Resolution of the search for the start of the motion in the recording [s].

    Raises
    ------
    RecordingError
        If it can't be read, lacks positions or efforts of a joint, holds numbers that aren't
        finite, or is shorter than the trajectory.
    """
    times, q, tau = measured_states(path, trajectory.joint_names, topic)
    duration = float(trajectory.times[-1])
    spare = float(times[-1]) - duration
    if spare < -step:
        raise RecordingError(
            f"'{path}' lasts {times[-1]:.3f} s, but the executed motion {duration:.3f} s: "
            "record it from its start to its end"
        )
    desired = interpolate(trajectory, step)
    starts = np.arange(0.0, max(spare, 0.0) + step, step)
    errors = [_distance(times - start, q, desired.times, desired.q) for start in starts]
    best = int(np.argmin(errors))
    grid = np.union1d(desired.times + starts[best], times)
    grid = grid[(grid >= starts[best]) & (grid <= starts[best] + duration)]
    squares = np.sum(_at(grid, times, tau) ** 2, axis=1)
    return MeasuredExecution(
        0.5 * float(trapezoid(squares, grid)), errors[best], float(starts[best])
    )


def _distance(times: FloatArray, q: FloatArray, when: FloatArray, desired: FloatArray) -> float:
    squares = np.sum((_at(when, times, q) - desired) ** 2, axis=1)
    return float(np.sqrt(trapezoid(squares, when) / (when[-1] - when[0])))


def _at(when: FloatArray, times: FloatArray, values: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(when, times, column) for column in values.T])
