# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the controller was told last: where it is on it, and how to leave it smoothly.

The controller interpolates between points by quintic polynomials, so a published trajectory says
where the robot is commanded to be at every moment, whatever planned it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..goal import JointState
from ..limits import JointLimits
from ..primitives.boundary import hermite_functions
from ..robot import Robot
from ..trajectory import Trajectory
from ..validation import check_limits

# Messages give times in nanoseconds. Between points that are nearer to each other than this [s],
# that rounding would be a jerk; where the wait is shorter, there is nothing to lead with.
_SHORTEST_STEP = 5e-3
_SHORTEST_WAIT = 1e-4

# Times that a stop may take [s], the shortest that the limits allow is used.
_STOPPING_TIMES = 0.05 * 1.2 ** np.arange(26)


@dataclass(frozen=True, eq=False)
class CommandedMotion:
    """A trajectory that was published.

    Attributes
    ----------
    trajectory : Trajectory
        As it was published.
    began : float
        When it was published [s].
    """

    trajectory: Trajectory
    began: float

    def is_over(self, time: float) -> bool:
        """Whether it has ended by then, or time was set back to before it began."""
        return not 0.0 <= time - self.began < self.trajectory.duration

    def state(self, time: float) -> JointState:
        """State at a time [s]; after the end the goal is held."""
        q, v, a = _evaluate(self.trajectory, self._elapsed(time))
        return JointState(self.trajectory.joint_names, q, v, a)

    def followed_by(self, rest: Trajectory, switch: float, now: float) -> Trajectory:
        """Go on with the motion until the switch, and then with the rest.

        Parameters
        ----------
        rest : Trajectory
            Starts where this motion is at the time `switch`.
        switch, now : float
            Times [s], the switch not before now.
        """
        wait = round(switch - now, 6)
        if wait < _SHORTEST_WAIT:
            return rest
        # After its end the motion holds the goal, so the switch may come later than that.
        end = switch - self.began
        begin = end - wait
        old = self.trajectory
        inside = np.flatnonzero(
            (old.times > begin + _SHORTEST_STEP) & (old.times < end - _SHORTEST_STEP)
        )
        first = _evaluate(old, begin)
        columns = (old.positions, old.velocities, old.accelerations)
        following = (rest.positions, rest.velocities, rest.accelerations)
        efforts = None
        if old.efforts is not None and rest.efforts is not None:
            here = [np.interp(begin, old.times, effort) for effort in old.efforts.T]
            efforts = np.vstack([here, old.efforts[inside], rest.efforts])
        times = np.concatenate([[0.0], old.times[inside] - begin, rest.times + wait])
        q, v, a = (
            np.vstack([here, x[inside], y])
            for here, x, y in zip(first, columns, following, strict=True)
        )
        return Trajectory(old.joint_names, times, q, v, a, efforts)

    def _elapsed(self, time: float) -> float:
        return min(max(time - self.began, 0.0), self.trajectory.duration)


def stopping_motion(state: JointState, robot: Robot, limits: JointLimits) -> Trajectory | None:
    """Come to rest as fast as the limits allow.

    Parameters
    ----------
    state : JointState
        Where the robot is and how it moves.
    robot : Robot
        Has the joints of the state, in their order.
    limits : JointLimits
        Limits to be kept.

    Returns
    -------
    motion : Trajectory or None
        Two points, the quintic between them is the motion; none if every stop breaks a limit.
    """
    q, v, a = state.positions, state.velocities, state.accelerations
    zero = np.zeros_like(q)
    for time in _STOPPING_TIMES:
        # With this end the quintic is the quartic of least jerk, and without an acceleration
        # to start from (few robots measure one) the controller's cubic is an even braking.
        end = q + v * time / 2.0 + a * time**2 / 12.0
        motion = Trajectory(state.joint_names, [0.0, time], [q, end], [v, zero], [a, zero])
        if not check_limits(motion, robot, limits).violations:
            return motion
    return None


def _evaluate(trajectory: Trajectory, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and accelerations at a time within the trajectory."""
    times = trajectory.times
    columns = (trajectory.positions, trajectory.velocities, trajectory.accelerations)
    k = int(np.searchsorted(times, time, side="right")) - 1
    if k >= len(times) - 1:
        return columns[0][-1], columns[1][-1], columns[2][-1]
    step = times[k + 1] - times[k]
    ends = np.stack([x[i] * step**order for i in (k, k + 1) for order, x in enumerate(columns)])
    fraction = np.array([(time - times[k]) / step])
    q, v, a = (hermite_functions(fraction, d)[0] @ ends / step**d for d in range(3))
    return q, v, a
