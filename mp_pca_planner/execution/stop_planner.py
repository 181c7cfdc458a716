# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Choice of a stop, by what is known of where the robot is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError
from ..motion.goal import JointState
from ..robot.limits import JointLimits
from .assembly import Model
from .following import UnconfirmedError
from .joined import Joined
from .parameters import AUTO
from .start_state import StartStates, TooLateError
from .stopping import braking_ends, ends_at, ends_on_path, hold, stop_at_point, stop_on_path

# Time to find a stop [s].
_TIME_TO_STOP = 0.02
# Shares of the limits for stops of a robot whose state is estimated from what was measured.
_ESTIMATED_ACCELERATION, _ESTIMATED_JERK = 0.7, 0.5
# Places on its motion at which a robot that is not heard of may be.
_N_PLACES = 6


class StopPlanner:
    """Finds stops: along the path of a robot that follows its motion, else at a point.

    Parameters
    ----------
    states :
        Where the robot is.
    """

    def __init__(self, states: StartStates) -> None:
        self._states = states

    def find(self, model: Model) -> tuple[str, Joined, bool]:
        """Find a stop.

        Returns
        -------
        said : str
            How the robot stops, one sentence.
        joined : Joined
            What to publish.
        last_point_only : bool
            Whether only the last point of it is sent.

        Raises
        ------
        GoalError
            If nothing is known of the robot.
        """
        settings, states = model.settings, self._states
        timeout, tolerance = settings.state_timeout, settings.commanded_tolerance
        try:
            measured = states.measured.newest(timeout)
            following = states.follow(timeout, tolerance)
        except GoalError as error:
            return self._stop_unheard(model, error)
        now = states.motion_time
        if following is not None and following.is_running:
            try:
                return self._stop_on_path(model)
            except (UnconfirmedError, TooLateError):
                pass
        names = measured.joint_names
        v = states.measured.velocities(measured)
        if following is None:
            return self._stop_unknown(measured, v, model)
        on_path = following.motion.state(following.progress.place)
        if following.is_over:
            return _holding(names, on_path.positions, now)
        state = JointState(names, measured.positions, v)
        by_clock = following.motion.state(now - following.motion.began)
        ends = braking_ends(state) if v.any() else ends_at(state.positions - states.load_offset)
        places = [state, on_path, by_clock, *states.alternatives]
        return self._stop_at_point(places, ends, model, "")

    def _stop_unknown(
        self, measured: JointState, v: FloatArray, model: Model
    ) -> tuple[str, Joined, bool]:
        """Stop a robot that follows no motion of ours: what it does is estimated."""
        now = self._states.motion_time
        names, q = measured.joint_names, measured.positions
        if not v.any():
            return _holding(names, q, now)
        # Since it was heard of it has moved on, evenly or more slowly.
        way = v * max(now - self._states.measured.newest_time, 0.0)
        here, *moved = [JointState(names, q + share * way, v) for share in (0.0, 0.5, 1.0)]
        # The controller itself takes the reported velocities for its own.
        reported = [measured] if measured.velocities.any() else []
        model = replace(model, limits=_drawn_in(model.limits))
        return self._stop_at_point([here, *reported, *moved], braking_ends(moved[0]), model, "")

    def _stop_on_path(self, model: Model) -> tuple[str, Joined, bool]:
        settings, states = model.settings, self._states
        timeout, tolerance = settings.state_timeout, settings.commanded_tolerance
        start = states.choose(AUTO, timeout, _TIME_TO_STOP, tolerance, at_once=True)
        if start.following is None or not start.is_in_motion:
            raise TooLateError("the robot has just come to rest")
        stop = stop_on_path(
            start.following.motion, start.place, model.robot, model.limits, settings.sample_period
        )
        may_stamp = settings.stamp_trajectories
        joined = states.join(stop, start, timeout, tolerance, may_stamp=may_stamp)
        said = f"the robot comes to rest on its path within {joined.trajectory.duration:.3g} s"
        return said, joined, False

    def _stop_unheard(self, model: Model, error: GoalError) -> tuple[str, Joined, bool]:
        """Stop a robot whose joint_states are silent, so it may be anywhere on its motion."""
        motion, seen = self._states.commanded, self._states.last_place
        if motion is None:
            raise error
        now = self._states.motion_time
        places = np.linspace(seen, max(now - motion.began, seen), _N_PLACES)
        moving = [motion.state(place) for place in places]
        resting = [JointState(state.joint_names, state.positions) for state in moving]
        ends = ends_on_path(motion, float(places[-1]))
        said = f"; it is not known whether the robot stops: {error}"
        return self._stop_at_point([*moving, *resting], ends, model, said)

    def _stop_at_point(
        self, states: list[JointState], ends: Sequence[FloatArray], model: Model, more: str
    ) -> tuple[str, Joined, bool]:
        now = self._states.motion_time
        request = ends, model.robot, model.limits
        stop = stop_at_point(states, *request) or stop_at_point(states[:1], *request)
        if stop is not None:
            said = f"the robot is sent to a single point, at rest within {stop.duration:.3g} s"
        else:
            # What a controller does when its goal is cancelled.
            stop = hold(states[0].joint_names, states[0].positions)
            said = "no stop within the limits was found: the robot is sent to hold its position"
        return said + more, Joined.to_last_point(stop, now), True


def _holding(
    joint_names: Sequence[str], positions: FloatArray, now: float
) -> tuple[str, Joined, bool]:
    """The answer to a stop of a robot at rest."""
    said = "the robot is at rest and holds its position"
    return said, Joined.on_receipt(hold(joint_names, positions), now), True


def _drawn_in(limits: JointLimits) -> JointLimits:
    """Limits with room for errors of a state that is estimated."""
    return JointLimits(
        limits.joint_names,
        {
            joint: {
                "min_position": limits.lower[j],
                "max_position": limits.upper[j],
                "max_velocity": limits.velocity[j],
                "max_acceleration": _ESTIMATED_ACCELERATION * limits.acceleration[j],
                "max_jerk": _ESTIMATED_JERK * limits.jerk[j],
                "max_effort": limits.effort[j],
            }
            for j, joint in enumerate(limits.joint_names)
        },
    )
