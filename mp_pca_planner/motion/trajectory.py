# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A sampled joint motion: what the planner hands out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray, frozen_array, unique_names
from ..exceptions import TrajectoryError


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples of a joint motion, immutable.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints, n_joints of them.
    times : array, shape (n_steps,)
        Times since the start [s]; the first is 0, strictly increasing.
    positions, velocities, accelerations : array, shape (n_steps, n_joints)
        Joint positions [rad or m] and their derivatives [/s, /s²].
    efforts : array, shape (n_steps, n_joints), or None
        Joint torques [N·m] or forces [N], if they were computed.

    Raises
    ------
    TrajectoryError
        If shapes disagree, a number is not finite, or the times don't increase from 0.
    """

    joint_names: tuple[str, ...]
    times: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    efforts: FloatArray | None = None

    def __init__(
        self,
        joint_names: Sequence[str],
        times: ArrayLike,
        positions: ArrayLike,
        velocities: ArrayLike,
        accelerations: ArrayLike,
        efforts: ArrayLike | None = None,
    ) -> None:
        names = unique_names(joint_names, "joints of a trajectory", TrajectoryError)
        stamps = frozen_array(times, (None,), "times", TrajectoryError)
        shape = (stamps.size, len(names))
        if stamps.size == 0:
            raise TrajectoryError("a trajectory needs at least one point, got none")
        if stamps[0] != 0.0 or np.any(np.diff(stamps) <= 0.0):
            raise TrajectoryError("times must start at 0 and strictly increase")
        object.__setattr__(self, "joint_names", names)
        object.__setattr__(self, "times", stamps)
        for field, values in (
            ("positions", positions),
            ("velocities", velocities),
            ("accelerations", accelerations),
        ):
            object.__setattr__(self, field, frozen_array(values, shape, field, TrajectoryError))
        object.__setattr__(
            self,
            "efforts",
            None if efforts is None else frozen_array(efforts, shape, "efforts", TrajectoryError),
        )

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def n_steps(self) -> int:
        """Number of points."""
        return int(self.times.size)

    @property
    def duration(self) -> float:
        """Time from the first to the last point [s]."""
        return float(self.times[-1])
