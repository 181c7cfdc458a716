# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Published motions, with the interpolation of the controller.

The controller interpolates between points by quintic polynomials, so a published trajectory
determines the commanded state at every time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..arrays import FloatArray, set_frozen
from ..motion.goal import JointState
from ..motion.interpolation import interpolate_at, segment_ends
from ..motion.trajectory import Trajectory

TRANSPORT = 0.02
"""Longest time that a message takes to the controller [s]."""

USUAL_TRANSPORT = 0.001
"""Usual time of a message to the next cycle of a controller on the same machine [s]."""

MIN_STEP = 3e-4
"""Shortest time between points that are joined [s]. In a shorter one, the rounding of positions
would be a noticeable jerk."""


@dataclass(frozen=True, eq=False)
class PublishedMotion:
    """A motion that is published at once, or was.

    Attributes
    ----------
    trajectory : Trajectory
        The motion, preceded by the last moments of the one that it continues.
    began : float
        When its first point is commanded [s].
    sent : Trajectory
        The trajectory to publish, by default all of it. It starts where the robot is commanded to
        be.
    time : float
        When the first point of that is commanded [s], by default when the motion began.
    is_timed : bool
        Whether that point belongs to that time, not to the arrival of the message.
    is_path_known : bool
        Whether the controller follows its path. Else only the last point is sent, to which the
        controller leads by a path of its own.
    """

    trajectory: Trajectory
    began: float
    sent: Trajectory = None  # type: ignore[assignment]
    time: float = math.nan
    is_timed: bool = False
    is_path_known: bool = True

    def __post_init__(self) -> None:
        if self.sent is None:
            set_frozen(self, sent=self.trajectory, time=self.began)

    @classmethod
    def on_receipt(cls, trajectory: Trajectory, time: float) -> PublishedMotion:
        """A motion that starts when the controller receives it."""
        return cls(trajectory, time + USUAL_TRANSPORT, trajectory, time)

    @classmethod
    def to_last_point(cls, trajectory: Trajectory, time: float) -> PublishedMotion:
        """A motion of which only the last point is sent."""
        return replace(cls.on_receipt(trajectory, time), is_path_known=False)

    @classmethod
    def after_wait(cls, trajectory: Trajectory, time: float) -> PublishedMotion:
        """A motion from rest that starts after a hold of its first point.

        The hold lasts as long as a message may take, so the start is known precisely. Without it,
        an error of each millisecond would be a jump where another motion continues this one.
        """
        times = np.concatenate([[0.0], trajectory.times + TRANSPORT])
        q, v, a = (np.vstack([x[:1], x]) for x in trajectory.states)
        efforts = trajectory.efforts
        if efforts is not None:
            efforts = np.vstack([efforts[:1], efforts])
        held = Trajectory(trajectory.joint_names, times, q, v, a, efforts)
        return cls(held, time, held, time, is_timed=True)

    @property
    def stamp(self) -> float | None:
        """The time for the header of the message [s], if there is one."""
        return self.time if self.is_timed else None

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
            q, v, a = (np.repeat(x, len(places), axis=0) for x in points.states)
            return q, v, a
        places = np.clip(places, 0.0, points.duration)
        return interpolate_at(places, points.times, self._ends)

    def rest(self, place: float) -> Trajectory:
        """The motion from a place before its end [s]; times count from there.

        Of points less than 0.3 ms away, none but the last remains: see :meth:`near_point`.
        """
        points = self.trajectory
        later = points.times > min(place + MIN_STEP, points.times[-2])
        places = np.concatenate([[place], points.times[later]])
        return Trajectory(points.joint_names, places - place, *self.sample(places))

    def near_point(self, place: float) -> float:
        """The place, or the nearest point of the trajectory if that is too near for a cut [s].

        Cut there, the motion stays the same. A cut beside a point would leave that out, and one
        quintic over both of its sides exceeds limits if the jerk is different on them.
        """
        times = self.trajectory.times
        nearest = float(times[np.abs(times - place).argmin()])
        return nearest if abs(nearest - place) < MIN_STEP else place

    def followed_by(self, rest: Trajectory, switch: float, here: float) -> Trajectory:
        """The motion from one place up to another one, and then another trajectory.

        Of points nearer to these places than 0.3 ms, none remains: see :meth:`near_point`.

        Parameters
        ----------
        rest : Trajectory
            Starts at the state of this motion at the place `switch`.
        switch, here : float
            Places [s], the switch not before here.
        """
        # Messages state times in nanoseconds. The motion is sampled at such times, because their
        # rounding would be a noticeable jerk between near points.
        lead = round(switch - here, 9)
        if lead < MIN_STEP:
            return rest
        old, begin = self.trajectory, switch - lead
        inside = (old.times > begin + MIN_STEP) & (old.times < switch - MIN_STEP)
        since = np.concatenate([[0.0], np.round(old.times[inside] - begin, 9)])
        times = np.concatenate([since, rest.times + lead])
        columns = zip(self.sample(begin + since), rest.states, strict=True)
        q, v, a = (np.vstack(pair) for pair in columns)
        efforts = None
        if old.efforts is not None and rest.efforts is not None:
            effort = [np.interp(begin, old.times, one) for one in old.efforts.T]
            efforts = np.vstack([effort, old.efforts[inside], rest.efforts])
        return Trajectory(old.joint_names, times, q, v, a, efforts)

    @cached_property
    def _ends(self) -> FloatArray:
        return segment_ends(self.trajectory.times, *self.trajectory.states)
