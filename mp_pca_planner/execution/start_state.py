# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Starts of motions: on the motion that the robot follows, or at a measured rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, TrajectoryError
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from .commanded import CommandedMotion
from .following import LAGGING, OFF, ON_TIME, Following, MotionFollower
from .joined import TRANSPORT, USUAL_TRANSPORT, Joined
from .parameters import MEASURED

START_TOLERANCE = 0.005
"""How far a joint may have come from a measured start before its motion is published [rad or m].

It bounds the jump that the controller has to absorb.
"""

# A motion that continues another one leaves it so long after planning is expected to end [s].
_PLANNED_TRANSPORT = 2.0 * TRANSPORT
# So near to 1 the rate is that of the clock.
_FULL_RATE = 0.01
# What is kept of a motion that another one continues [s].
_LEAD = 0.35


class TooLateError(TrajectoryError):
    """The robot is no longer where a planned motion starts."""


@dataclass(frozen=True, eq=False)
class Start:
    """A state to plan from.

    Attributes
    ----------
    state : JointState
        The state.
    following : Following or None
        The motion that it is on, if the robot follows one; None at a rest elsewhere.
    last : CommandedMotion or None
        The motion that was published last, whether the robot follows it or not.
    place : float
        Where on it the state is [s].
    time : float
        When the robot is there [s].
    measured : JointState
        What was measured when it was chosen.
    at_once : bool
        Whether the place need not be known to the fraction of a millisecond.
    """

    state: JointState
    following: Following | None
    last: CommandedMotion | None
    place: float
    time: float
    measured: JointState
    at_once: bool = False

    @property
    def deadline(self) -> float:
        """When a motion from a start in motion must be sent at last [s]."""
        return self.time - TRANSPORT

    @property
    def is_in_motion(self) -> bool:
        """Whether the robot moves on a motion."""
        return self.following is not None and self.following.is_running


class StartStates(MotionFollower):
    """Chooses where motions start, and leads to them.

    See `MotionFollower` for its parameters.
    """

    def choose(
        self,
        start_from: str,
        timeout: float,
        latency: float,
        tolerance: float,
        *,
        at_once: bool = False,
    ) -> Start:
        """Choose the start of the next motion.

        Parameters
        ----------
        start_from : {'auto', 'measured', 'commanded'}
            See the parameter of this name.
        timeout, tolerance : float
            See :meth:`follow`.
        latency : float
            Time that planning may take [s].
        at_once : bool
            Whether to take a place that is not known to the fraction of a millisecond.

        Raises
        ------
        GoalError
            If there is no usable measured state, which a motion that starts on another one needs,
            too: a robot without fresh states may have stopped. Or if the robot moves and follows
            no motion of ours.
        """
        with self._lock:
            following = self.follow(timeout, tolerance)
            now = self._motion_clock()
            measured = self.measured.newest(timeout)
            last = self._commanded
            if following is not None and following.is_running:
                if start_from == MEASURED:
                    raise GoalError(_refusal_of_moving(start_from, following, tolerance))
                then = now + latency + _PLANNED_TRANSPORT
                place = following.progress.at(then)
                self._check_confirmed(following, then)
                if not at_once:
                    self._check_known(following, now)
                state = following.motion.state(place)
                return Start(state, following, last, place, then, measured, at_once)
            if following is not None:
                self._check_resting(following, now)
            holds = following is not None and following.is_over and start_from != MEASURED
            holds = holds and self._is_path_known
            # A robot that has just come to the end of its motion may still settle.
            if not (holds and not self._is_arrived) and self.measured.velocities(measured).any():
                raise GoalError(_refusal_of_moving(start_from, following, tolerance))
            here, place = measured.positions, 0.0
            if holds and following is not None:
                place = following.progress.place
                here = following.motion.end
                if following.at_rest:
                    self._servo.rest(measured.positions - here)
            elif start_from != MEASURED:
                here = self._held(measured.positions)
            state = JointState(measured.joint_names, here)
            return Start(state, following if holds else None, last, place, now, measured)

    def join(
        self,
        rest: Trajectory,
        start: Start,
        timeout: float,
        tolerance: float,
        *,
        may_stamp: bool,
    ) -> Joined:
        """Lead to a motion from where the robot is by now.

        Parameters
        ----------
        rest : Trajectory
            The motion from the chosen start.
        start : Start
            Its start.
        timeout, tolerance : float
            See :meth:`follow`.
        may_stamp : bool
            Whether a motion may carry the time at which its first point is commanded.

        Raises
        ------
        TooLateError
            If the robot is no longer at its start, or too near to it for a message.
        GoalError
            If the measured state is too old by now.
        """
        with self._lock:
            following = self.follow(timeout, tolerance)
            now = self._motion_clock()
            if self._commanded is not start.last:
                raise TooLateError(
                    "another motion was published while this one was planned; send the goal again"
                )
            may_stamp = may_stamp and self.measured.clocks_agree
            old = start.following
            if old is None or following is None:
                self._check_rest(start.measured, self.measured.newest(timeout))
            if old is None or following is None or (following.is_over and old.is_over):
                return (Joined.after_wait if may_stamp else Joined.on_receipt)(rest, now)
            if following.how != old.how:
                raise TooLateError(
                    f"the robot was {_in_words(old.how)} when planning began and is "
                    f"{_in_words(following.how)} now; send the goal again"
                )
            # Computing how the robot follows has taken a moment, too.
            here = following.progress.at(now)
            left = start.place - here
            if left < TRANSPORT * following.progress.rate:
                raise TooLateError(
                    "planning took too long: the motion should have been sent "
                    f"{TRANSPORT - left:.3g} s ago; send the goal again"
                )
            if not start.at_once:
                self._check_known(following, now)
            rate = following.progress.rate
            is_timed = may_stamp and rate > 0.5
            # While a message takes its usual time, the robot advances at its rate; the motion does
            # at that of the clock if it is stamped, and not at all if it is not.
            here += USUAL_TRANSPORT * (rate - is_timed) * (following.how == LAGGING)
            # The last moments say where the robot is, and how fast.
            lead = min(_LEAD, here)
            motion = following.motion.followed_by(rest, start.place, here - lead)
            return Joined(
                following.motion.followed_by(rest, start.place, here),
                CommandedMotion(motion, now - lead),
                now,
                is_timed,
                # A robot at the rate of the clock is on time again once it takes a stamped motion.
                is_timed and abs(rate - 1.0) <= _FULL_RATE,
            )

    def _held(self, measured: FloatArray) -> FloatArray:
        """Where a robot that rests elsewhere than its motion ends is commanded to be."""
        for before in self.alternatives:
            is_near = np.abs(measured - before.positions).max() <= START_TOLERANCE
            if is_near and not before.velocities.any():
                # The controller has not taken the last motion: what it holds is known.
                self._servo.rest(measured - before.positions)
                return before.positions
        return measured - self._servo.load

    def _check_rest(self, planned: JointState, present: JointState) -> None:
        """Refuse a motion from rest if the robot has left it meanwhile."""
        moved = np.abs(present.positions - planned.positions)
        worst = int(moved.argmax())
        if not moved[worst] <= START_TOLERANCE or self.measured.velocities(present).any():
            raise TooLateError(
                f"planning took too long: joint '{present.joint_names[worst]}' has come "
                f"{moved[worst]:.3g} rad (or m) away from the start of the motion meanwhile, at "
                f"most {START_TOLERANCE} at rest is accepted; send the goal again"
            )


def _in_words(how: str) -> str:
    words = {ON_TIME: "on time", LAGGING: "behind its motion", OFF: "off its path"}
    return words.get(how, how)


def _refusal_of_moving(start_from: str, following: Following | None, tolerance: float) -> str:
    """Why no motion can start on a robot that moves."""
    if start_from == MEASURED:
        return (
            "the robot moves, but start_from is 'measured', which accepts goals only at rest: send "
            "the goal again when the robot is at rest, or set start_from to 'auto'"
        )
    if following is None:
        return (
            "the robot moves, but on no motion of this node: send the goal again when it is at rest"
        )
    return (
        f"joint '{following.joint}' is {following.distance:.3g} rad (or m) away from the running "
        f"motion, at most {tolerance:g} (parameter commanded_tolerance) is accepted while the "
        "robot moves; send the goal again when it is at rest"
    )
