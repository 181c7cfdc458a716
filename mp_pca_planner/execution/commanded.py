# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Published motions as the controller interpolates them, and how other motions continue them.

The controller interpolates between points by quintic polynomials, so a published trajectory says
where the robot is commanded to be at every moment, whatever planned it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..motion.goal import JointState
from ..motion.interpolation import hermite_functions, segment_ends
from ..motion.trajectory import Trajectory

# Messages give times in nanoseconds. Between points that are nearer to each other than this [s],
# that rounding would be a jerk; where the wait is shorter, there is nothing to lead with.
_SHORTEST_STEP = 5e-3
_SHORTEST_WAIT = 1e-4


@dataclass(frozen=True, eq=False)
class CommandedMotion:
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
            Times since the start [s]; those outside the motion count as its nearest end.

        Returns
        -------
        q, v, a : array, shape (n_places, n_joints)
            Positions and their derivatives [rad or m, /s, /s²].
        """
        old = self.trajectory
        columns = (old.positions, old.velocities, old.accelerations)
        if old.n_steps == 1:
            q, v, a = (np.repeat(x, len(places), axis=0) for x in columns)
            return q, v, a
        places = np.clip(places, 0.0, old.duration)
        segment = np.clip(np.searchsorted(old.times, places, "right") - 1, 0, old.n_steps - 2)
        steps = np.diff(old.times)[segment]
        phases = (places - old.times[segment]) / steps
        ends = self._ends[segment]
        q, v, a = (
            np.einsum("ki,kij->kj", hermite_functions(phases, d), ends) / steps[:, None] ** d
            for d in range(3)
        )
        return q, v, a

    def followed_by(self, rest: Trajectory, switch: float, here: float) -> Trajectory:
        """Continue the motion until the switch, and then with the rest.

        Parameters
        ----------
        rest : Trajectory
            Starts where this motion is at the place `switch`.
        switch, here : float
            Places [s], the switch not before here.
        """
        wait = round(switch - here, 6)
        if wait < _SHORTEST_WAIT:
            return rest
        old = self.trajectory
        begin = switch - wait
        inside = np.flatnonzero(
            (old.times > begin + _SHORTEST_STEP) & (old.times < switch - _SHORTEST_STEP)
        )
        columns = (old.positions, old.velocities, old.accelerations)
        following = (rest.positions, rest.velocities, rest.accelerations)
        efforts = None
        if old.efforts is not None and rest.efforts is not None:
            first = [np.interp(begin, old.times, effort) for effort in old.efforts.T]
            efforts = np.vstack([first, old.efforts[inside], rest.efforts])
        times = np.concatenate([[0.0], old.times[inside] - begin, rest.times + wait])
        q, v, a = (
            np.vstack([first, x[inside], y])
            for first, x, y in zip(self.sample(np.array([begin])), columns, following, strict=True)
        )
        return Trajectory(old.joint_names, times, q, v, a, efforts)

    @cached_property
    def _ends(self) -> FloatArray:
        old = self.trajectory
        return segment_ends(old.times, old.positions, old.velocities, old.accelerations)
