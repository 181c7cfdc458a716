# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Starts of motions: on the motion that the robot follows, or at a measured rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError, TrajectoryError
from ...motion.goal import JointState
from ...motion.trajectory import Trajectory
from ..options import Tracking
from ..parameters import AUTO, MEASURED, Settings
from .following import Following, How, MotionFollower, UnconfirmedError
from .published_motion import TRANSPORT, USUAL_TRANSPORT, PublishedMotion

_WORDS = {
    How.ON_TIME: "on time",
    How.LAGGING: "behind its motion",
    How.HELD: "held",
    How.OFF: "off its path",
}


class TooLateError(TrajectoryError):
    """The robot is no longer where a planned motion starts."""


@dataclass(frozen=True, eq=False)
class MotionStart:
    """A state to plan from.

    Attributes
    ----------
    state : JointState
        The state.
    following : Following or None
        The motion that the robot follows; None at a rest off any motion.
    last : PublishedMotion or None
        The motion that was published last, whether the robot follows it or not.
    place : float
        The place of the state on that motion [s].
    time : float
        Time at which the robot is at the state [s].
    measured : JointState
        The measured state at the time of the choice.
    at_once : bool
        Whether an approximate place is accepted.
    """

    state: JointState
    following: Following | None
    last: PublishedMotion | None
    place: float
    time: float
    measured: JointState
    at_once: bool = False

    @property
    def deadline(self) -> float:
        """Latest time to send a motion that starts on a running one [s]."""
        return self.time - TRANSPORT

    @property
    def is_in_motion(self) -> bool:
        """Whether the robot moves on a motion."""
        return self.following is not None and self.following.is_running


def choose_start(
    follower: MotionFollower,
    settings: Settings,
    latency: float,
    *,
    at_once: bool = False,
    seen: tuple[JointState, Following | None] | None = None,
) -> MotionStart:
    """Choose the start of the next motion.

    Parameters
    ----------
    follower : MotionFollower
        Tracks the robot.
    settings : Settings
        With `start_from`, and the parameters of `MotionFollower.follow`.
    latency : float
        Time that planning may take [s].
    at_once : bool
        For stops: accepts an approximate place, whatever `start_from`.
    seen : tuple of JointState and Following, optional
        The measured state and how the robot follows its motion, if the caller has just seen them.

    Raises
    ------
    GoalError
        If there is no usable measured state, or the robot moves and follows no motion of this
        node. A motion that starts on another one needs a measured state, too: a robot without
        fresh states may have stopped.
    UnconfirmedError
        If the place of the robot on its motion is not known yet.
    """
    with follower.lock:
        if seen is None:
            measured = follower.measured.newest(settings.state_timeout)
            seen = measured, follower.follow(settings, measured)
        (measured, following), now = seen, follower.motion_time
        start_from = AUTO if at_once else settings.start_from
        if following is not None and following.is_running:
            if start_from == MEASURED:
                raise GoalError(_motion_refusal(start_from, following, settings))
            then = now + latency + 2.0 * TRANSPORT
            if follower.published is not None:
                follower.published.check_taken(following, then, follower.servo.lag)
            if not at_once:
                _check_place(follower, following, now)
            expected = following.progress.at(then)
            place = following.motion.near_point(expected)
            then += place - expected
            state, last = following.motion.state(place), _last_motion(follower)
            return MotionStart(state, following, last, place, then, measured, at_once)
        return _choose_at_rest(follower, following, measured, now, start_from, settings)


def _choose_at_rest(
    follower: MotionFollower,
    following: Following | None,
    measured: JointState,
    now: float,
    start_from: str,
    settings: Settings,
) -> MotionStart:
    last = follower.published
    holds = may_settle = False
    if following is not None and last is not None:
        if following.how is How.HELD and now < last.motion.time + Tracking.start_time:
            raise UnconfirmedError(
                "the robot rests at the start of the motion before this one, which was "
                f"published less than {Tracking.start_time:g} s ago; send the goal again"
            )
        holds = following.is_over and following.is_path_known and start_from != MEASURED
        # A robot that has just arrived at the end of its motion may still settle.
        may_settle = holds and not last.is_arrived
    if not may_settle and follower.measured.velocities(measured).any():
        if following is not None and following.how is not How.OFF and start_from != MEASURED:
            raise UnconfirmedError(
                "the robot is coming to rest; send the goal again when it is at rest"
            )
        raise GoalError(_motion_refusal(start_from, following, settings))
    here, place = measured.positions, 0.0
    if holds and following is not None:
        here, place = following.motion.end, following.progress.place
        if following.at_rest:
            follower.servo.rest(measured.positions - here)
    elif start_from != MEASURED:
        here = _held(follower, measured, settings)
    state = JointState(measured.joint_names, here)
    held = following if holds else None
    return MotionStart(state, held, _last_motion(follower), place, now, measured)


def join(
    follower: MotionFollower, rest: Trajectory, start: MotionStart, settings: Settings
) -> PublishedMotion:
    """Join a motion to the present state of the robot.

    Parameters
    ----------
    follower : MotionFollower
        Tracks the robot.
    rest : Trajectory
        The motion from the chosen start.
    start : MotionStart
        Its start.
    settings : Settings
        With `stamp_trajectories`, and the parameters of `MotionFollower.follow`.

    Raises
    ------
    TooLateError
        If the robot is no longer at its start, or too near to it for a message.
    GoalError
        If the measured state is too old by now.
    """
    with follower.lock:
        measured = follower.measured.newest(settings.state_timeout)
        following, old = follower.follow(settings, measured), start.following
        now = follower.motion_time
        if _last_motion(follower) is not start.last:
            raise TooLateError(
                "another motion was published while this one was planned; send the goal again"
            )
        may_stamp = settings.stamp_trajectories and follower.measured.clock.is_usable
        if old is None or following is None:
            _check_rest(follower, start.measured, measured)
        if old is None or following is None or (following.is_over and old.is_over):
            begin = PublishedMotion.after_wait if may_stamp else PublishedMotion.on_receipt
            return begin(rest, now)
        if following.how is not old.how:
            raise TooLateError(
                f"the robot was {_WORDS[old.how]} when planning began and is "
                f"{_WORDS[following.how]} now; send the goal again"
            )
        if not start.at_once:
            _check_place(follower, following, now)
        return _continued(rest, start, following, now, stamp=may_stamp)


def _continued(
    rest: Trajectory, start: MotionStart, following: Following, now: float, *, stamp: bool
) -> PublishedMotion:
    """The running motion up to a start on it, and the rest from there."""
    rate, here = following.progress.rate, following.progress.at(now)
    left = start.place - here
    if left < TRANSPORT * rate:
        raise TooLateError(
            "planning took too long: the motion should have been sent "
            f"{TRANSPORT - left:.3g} s ago; send the goal again"
        )
    is_timed = stamp and rate > 0.5
    # Until the message arrives, the robot advances at its rate. A stamped motion advances
    # meanwhile at the rate of the clock, another one not at all.
    here += USUAL_TRANSPORT * (rate - is_timed) * (following.how is How.LAGGING)
    if is_timed:
        cut = following.motion.near_point(here)
        now += cut - here
        here = cut
    # The last moments before show the place of the robot and its rate.
    lead = min(Tracking.lead, here)
    motion = following.motion.followed_by(rest, start.place, here - lead)
    return PublishedMotion(
        motion,
        now - lead,
        following.motion.followed_by(rest, start.place, here),
        now,
        is_timed,
        # A robot at full rate is on time again once it takes a stamped motion.
        is_timed and abs(rate - 1.0) <= Tracking.full_rate,
    )


def _last_motion(follower: MotionFollower) -> PublishedMotion | None:
    return None if follower.published is None else follower.published.current.motion


def _held(follower: MotionFollower, measured: JointState, settings: Settings) -> FloatArray:
    """Commanded positions of a robot that rests away from the end of its motion."""
    command, q = follower.stated_command(measured, settings), measured.positions
    if command is not None and command.at_rest:
        held = command.state.positions
        # No plausible load pulls a robot farther away from what it is commanded to hold.
        if np.abs(q - held).max() <= Tracking.missed_distance:
            follower.servo.rest(q - held)
            return held
    for before in follower.alternatives:
        away = np.abs(q - before.positions).max()
        if away <= Tracking.start_tolerance and not before.velocities.any():
            # The controller has not accepted the last motion, so its held positions are known.
            follower.servo.rest(q - before.positions)
            return before.positions
    return q - follower.servo.load


def _check_place(follower: MotionFollower, following: Following, now: float) -> None:
    """Raise an `UnconfirmedError` if the place of a moving robot is not known precisely."""
    progress = following.progress
    age = now - follower.measured.newest_time
    if age > Tracking.max_age:
        raise UnconfirmedError(
            f"the newest joint_states message is {age:.3g} s old, at most {Tracking.max_age:g} "
            "s is accepted while the robot moves; send the goal again"
        )
    is_precise = progress.error <= Tracking.precision + follower.servo.noise
    is_steady = abs(progress.change) <= Tracking.max_change
    if following.how is How.LAGGING and not (is_precise and is_steady):
        raise UnconfirmedError(
            "the speed of the robot changes (speed scaling), so its place on the motion is not "
            "known precisely; send the goal again"
        )


def _check_rest(follower: MotionFollower, planned: JointState, present: JointState) -> None:
    """Raise a `TooLateError` if the robot has left the rest that a motion starts from."""
    moved, most = np.abs(present.positions - planned.positions), Tracking.start_tolerance
    worst = int(moved.argmax())
    if not moved[worst] <= most or follower.measured.velocities(present).any():
        raise TooLateError(
            f"planning took too long: joint '{present.joint_names[worst]}' has moved "
            f"{moved[worst]:.3g} rad (or m) away from the start of the motion meanwhile, at "
            f"most {most} at rest is accepted; send the goal again"
        )


def _motion_refusal(start_from: str, following: Following | None, settings: Settings) -> str:
    """The reason why no motion can start while the robot moves."""
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
        f"motion, at most {settings.commanded_tolerance:g} (parameter commanded_tolerance) is "
        "accepted while the robot moves; send the goal again when it is at rest"
    )
