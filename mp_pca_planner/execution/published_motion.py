# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Published motions as the controller interpolates them, and motions that continue them.

The controller interpolates between points by quintic polynomials, so a published trajectory says
where the robot is commanded to be at every moment.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..motion.goal import JointState
from ..motion.interpolation import hermite_functions, segment_ends
from ..motion.trajectory import Trajectory

# Messages state times in nanoseconds. Between points closer than this [s], that rounding is a
# noticeable jerk.
_MIN_STEP = 5e-3
# Two motions closer than this [s] are joined without points in between.
_MIN_LEAD = 1e-4


def states_of(trajectory: Trajectory) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and accelerations of a trajectory."""
    return trajectory.positions, trajectory.velocities, trajectory.accelerations


@dataclass(frozen=True, eq=False)
class PublishedMotion:
    """A trajectory that was published.

    Attributes
    ----------
    trajectory : Trajectory
        As it was published.
    began : float
        When its first point is commanded [s].
    """

    trajectory: Trajectory
    began: float

    @property
    def duration(self) -> float:
        """Its duration [s]."""
        return self.trajectory.duration

    @property
    def end(self) -> FloatArray:
        """Its last positions [rad or m], shape (n_joints,)."""
        return np.asarray(self.trajectory.positions[-1])

    def state(self, place: float) -> JointState:
        """The commanded state at a place [s]; after the end, the last positions are held."""
        q, v, a = (x[0] for x in self.sample(np.array([place])))
        return JointState(self.trajectory.joint_names, q, v, a)

    def sample(self, places: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The commanded states at places.

        Parameters
        ----------
        places : array, shape (n_places,)
            Times since the start [s], clipped to the duration of the motion.

        Returns
        -------
        q, v, a : array, shape (n_places, n_joints)
            Positions and their derivatives [rad or m, /s, /s²].
        """
        points = self.trajectory
        if points.n_steps == 1:
            q, v, a = (np.repeat(x, len(places), axis=0) for x in states_of(points))
            return q, v, a
        places = np.clip(places, 0.0, points.duration)
        segment = np.searchsorted(points.times, places, "right") - 1
        segment = np.clip(segment, 0, points.n_steps - 2)
        steps = np.diff(points.times)[segment]
        phases, ends = (places - points.times[segment]) / steps, self._ends[segment]
        q, v, a = (
            np.einsum("ki,kij->kj", hermite_functions(phases, d), ends) / steps[:, None] ** d
            for d in range(3)
        )
        return q, v, a

    def followed_by(self, rest: Trajectory, switch: float, here: float) -> Trajectory:
        """The motion from one place up to another one, and then another trajectory.

        Parameters
        ----------
        rest : Trajectory
            Starts at the state of this motion at the place `switch`.
        switch, here : float
            Places [s], the switch not before here.
        """
        lead = round(switch - here, 6)
        if lead < _MIN_LEAD:
            return rest
        old, begin = self.trajectory, switch - lead
        inside = (old.times > begin + _MIN_STEP) & (old.times < switch - _MIN_STEP)
        times = np.concatenate([[0.0], old.times[inside] - begin, rest.times + lead])
        first = self.sample(np.array([begin]))
        columns = zip(first, states_of(old), states_of(rest), strict=True)
        q, v, a = (np.vstack([x, y[inside], z]) for x, y, z in columns)
        efforts = None
        if old.efforts is not None and rest.efforts is not None:
            effort = [np.interp(begin, old.times, one) for one in old.efforts.T]
            efforts = np.vstack([effort, old.efforts[inside], rest.efforts])
        return Trajectory(old.joint_names, times, q, v, a, efforts)

    @cached_property
    def _ends(self) -> FloatArray:
        return segment_ends(self.trajectory.times, *states_of(self.trajectory))
