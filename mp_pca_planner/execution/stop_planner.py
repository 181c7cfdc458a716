# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Choice of a stop, by what is known of the robot's place."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError
from ..motion.goal import JointState
from ..robot.limits import JointLimits
from .assembly import Model
from .following import UnconfirmedError
from .joined import Joined
from .start_state import StartStates, TooLateError
from .stopping import braking_ends, ends_at, ends_on_path, hold, stop_at_point, stop_on_path


@dataclass(frozen=True)
class StoppingOptions:
    """Parameters of stops.

    Attributes
    ----------
    latency : float
        Time to find a stop [s].
    acceleration_share, jerk_share : float
        Shares of the limits for a robot whose velocity is estimated, 0 to 1.
    n_places : int
        Places on its motion at which a silent robot may be, ≥ 2.
    """

    latency: float = 0.02
    acceleration_share: float = 0.7
    jerk_share: float = 0.5
    n_places: int = 6


class StopPlanner:
    """Finds stops: along the path of a robot that follows its motion, else at a point.

    Parameters
    ----------
    states :
        Where the robot is.
    options :
        Parameters.
    """

    def __init__(self, states: StartStates, options: StoppingOptions | None = None) -> None:
        self._states = states
        self._options = options or StoppingOptions()

    def find(self, model: Model) -> tuple[str, Joined]:
        """Find a stop.

        Returns
        -------
        message : str
            How the robot stops, one sentence.
        joined : Joined
            What to publish.

        Raises
        ------
        GoalError
            If nothing is known of the robot.
        """
        states = self._states
        try:
            measured = states.measured.newest(model.settings.state_timeout)
            following = states.follow(model.settings)
        except GoalError as error:
            return self._stop_silent(model, error)
        now = states.motion_time
        if following is not None and following.is_running:
            with suppress(UnconfirmedError, TooLateError):
                return self._stop_on_path(model)
        v = states.measured.velocities(measured)
        if following is None:
            return self._stop_unknown(measured, v, model)
        on_path = following.motion.state(following.progress.place)
        if following.is_over:
            return _holding(measured, on_path.positions, now)
        state = JointState(measured.joint_names, measured.positions, v)
        by_clock = following.motion.state(now - following.motion.began)
        ends = braking_ends(state) if v.any() else ends_at(state.positions - states.load_offset)
        places = [state, on_path, by_clock, *states.alternatives]
        return self._stop_at_point(places, ends, model)

    def _stop_unknown(
        self, measured: JointState, v: FloatArray, model: Model
    ) -> tuple[str, Joined]:
        """Stop a robot that follows no motion of this node: its state is estimated."""
        now, q = self._states.motion_time, measured.positions
        if not v.any():
            return _holding(measured, q, now)
        # Since it was measured it has moved, at this velocity or a lower one.
        way = v * max(now - self._states.measured.newest_time, 0.0)
        here, *moved = [
            JointState(measured.joint_names, q + share * way, v) for share in (0.0, 0.5, 1.0)
        ]
        # The controller itself starts from the reported velocities.
        reported = [measured] if measured.velocities.any() else []
        model = replace(model, limits=self._reduced(model.limits))
        return self._stop_at_point([here, *reported, *moved], braking_ends(moved[0]), model)

    def _stop_on_path(self, model: Model) -> tuple[str, Joined]:
        settings, states = model.settings, self._states
        start = states.choose(settings, self._options.latency, at_once=True)
        if start.following is None or not start.is_in_motion:
            raise TooLateError("the robot has just come to rest")
        motion, period = start.following.motion, settings.sample_period
        stop = stop_on_path(motion, start.place, model.robot, model.limits, period)
        joined = states.join(stop, start, settings)
        duration = joined.trajectory.duration
        return f"the robot comes to rest on its path within {duration:.3g} s", joined

    def _stop_silent(self, model: Model, error: GoalError) -> tuple[str, Joined]:
        """Stop a robot that sends no joint_states, so it may be anywhere on its motion."""
        motion, seen = self._states.commanded, self._states.last_place
        if motion is None:
            raise error
        latest = max(self._states.motion_time - motion.began, seen)
        places = np.linspace(seen, latest, self._options.n_places)
        moving = [motion.state(place) for place in places]
        resting = [JointState(state.joint_names, state.positions) for state in moving]
        ends = ends_on_path(motion, float(places[-1]))
        said, joined = self._stop_at_point([*moving, *resting], ends, model)
        return f"{said}; it is not known whether the robot stops: {error}", joined

    def _stop_at_point(
        self, states: list[JointState], ends: Sequence[FloatArray], model: Model
    ) -> tuple[str, Joined]:
        request = ends, model.robot, model.limits
        stop = stop_at_point(states, *request) or stop_at_point(states[:1], *request)
        if stop is not None:
            said = f"the robot is sent to a single point, at rest within {stop.duration:.3g} s"
        else:
            # A controller does the same when its goal is cancelled.
            stop = hold(states[0].joint_names, states[0].positions)
            said = "no stop within the limits was found: the robot is sent to hold its position"
        return said, Joined.to_last_point(stop, self._states.motion_time)

    def _reduced(self, limits: JointLimits) -> JointLimits:
        """Limits with a margin for errors of an estimated state."""
        columns = {
            "min_position": limits.lower,
            "max_position": limits.upper,
            "max_velocity": limits.velocity,
            "max_acceleration": self._options.acceleration_share * limits.acceleration,
            "max_jerk": self._options.jerk_share * limits.jerk,
            "max_effort": limits.effort,
        }
        names = limits.joint_names
        by_joint = {
            name: {key: values[j] for key, values in columns.items()}
            for j, name in enumerate(names)
        }
        return JointLimits(names, by_joint)


def _holding(measured: JointState, positions: FloatArray, now: float) -> tuple[str, Joined]:
    """The stop of a robot at rest."""
    joined = Joined.on_receipt(hold(measured.joint_names, positions), now)
    return "the robot is at rest and holds its position", joined
