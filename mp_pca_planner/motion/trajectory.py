# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A sampled joint motion, the result of planning."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray, frozen_array, set_frozen, unique_names
from ..exceptions import TrajectoryError, require


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

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> zero = [[0.0], [0.0]]
    >>> mp.Trajectory(["elbow"], [0.0, 1.0], [[0.0], [0.5]], zero, zero)
    Trajectory: 1 joints, 2 points, 1 s
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
        set_frozen(self, joint_names=names, times=stamps, efforts=None)
        columns = {"positions": positions, "velocities": velocities, "accelerations": accelerations}
        if efforts is not None:
            columns["efforts"] = efforts
        for field, values in columns.items():
            set_frozen(self, **{field: frozen_array(values, shape, field, TrajectoryError)})

    @classmethod
    def at_rest(cls, joint_names: Sequence[str], positions: FloatArray) -> Self:
        """A single point at which the robot rests at positions of shape (n_joints,) [rad or m]."""
        zero = np.zeros((1, len(positions)))
        return cls(joint_names, [0.0], [positions], zero, zero)

    def __repr__(self) -> str:
        return f"Trajectory: {self.n_joints} joints, {self.n_steps} points, {self.duration:.3g} s"

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

    @property
    def states(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, velocities and accelerations."""
        return self.positions, self.velocities, self.accelerations

    @property
    def effort_cost(self) -> float:
        """J = ½∫‖τ‖²dt [N²·m²·s], by the trapezoidal rule; NaN without efforts."""
        if self.efforts is None:
            return float("nan")
        power = np.square(self.efforts).sum(axis=1)
        return float(0.25 * np.diff(self.times) @ (power[1:] + power[:-1]))

    def columns(self) -> dict[str, FloatArray]:
        """Times and values of all points, by the names of the public interface."""
        names = ("times", "positions", "velocities", "accelerations", "efforts")
        columns = {name: getattr(self, name) for name in names}
        return {name: values for name, values in columns.items() if values is not None}

    def with_efforts(self, efforts: FloatArray | None) -> Trajectory:
        """The same points with efforts [N·m or N], shape (n_steps, n_joints), or without any."""
        other, shape = copy(self), self.positions.shape
        if efforts is not None:
            efforts = frozen_array(efforts, shape, "efforts", TrajectoryError)
        set_frozen(other, efforts=efforts)
        return other

    def plot(self) -> Any:
        """Plot the motion in a new pyplot figure; return the array of its Axes.

        ``plt.savefig("motion.png")`` writes it.
        """
        figures = import_module("..plotting.motion", __package__)
        return figures.plot_trajectory(self)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the trajectory to a .csv, .json or .npz file, or to a bag.

        The columns are those of the command ``plan --output``; bags are .bag and .mcap files, and
        folders of rosbag2, which have no ending.

        Raises
        ------
        PlannerError
            If the format is unknown, the file exists and may not be overwritten, or it can't be
            written.
        """
        files = import_module("..recordings.trajectory_files", __package__)
        files.save_trajectory(self, Path(path), overwrite=overwrite)

    def to_message(self, *, with_efforts: bool = False) -> Any:
        """Convert the trajectory to a ``trajectory_msgs/JointTrajectory``.

        Parameters
        ----------
        with_efforts : bool
            Whether points carry efforts; a controller without an effort interface refuses them.

        Raises
        ------
        MissingDependencyError
            If ROS 2 is not installed.
        TrajectoryError
            If efforts are requested and the trajectory has none.
        """
        require("trajectory_msgs.msg", "ros", "a message")
        messages = import_module("..ros.serialised", __package__)
        return messages.trajectory_message(self, with_efforts=with_efforts)
