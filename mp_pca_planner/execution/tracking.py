# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where the robot is: on the command that its controller states, or on the motion published last.

Four rules, in this order:

1. The controller states its command: that is where the robot is.
2. Else it follows the published motion: its measured state is near where the motion was a moment
   ago, as servos lag. Then the motion, by the clock, is the command. A robot that lags more than
   it usually does is slowed or held by something else.
3. Else it rests: its measured state is the command.
4. Else it moves, and where its command is can't be known: no motion can be joined to it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, TrajectoryError
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from .motions import TRANSPORT, USUAL_TRANSPORT, PublishedMotion
from .parameters import AUTO, MEASURED, Settings
from .states import Clock, MeasuredState, MeasuredStates, UnconfirmedError

# Age of a state up to which a motion is joined, and a stated command counts [s].
_MAX_AGE = 0.1
# Distance from the measured state, beside the lag of the servos, up to which a stated command is
# believed, and distance from a path up to which it is on it [rad or m].
_BELIEVED, _ON_PATH = 0.1, 1.5e-4
# Rate of a controller on time differs less from 1; a robot slower than this is being stopped, or
# held; a rate that changes faster is not joined [1/s].
_FULL_RATE, _MIN_RATE, _HELD_RATE, _MAX_CHANGE = 0.01, 0.05, 1e-3, 0.5
# A rate that follows from two commands is 1 if it differs by less.
_ABOUT = 0.1
# Distance that a robot at rest may move from the choice of a start to publishing [rad or m].
_START_TOLERANCE = 0.005
# Shortest part of a motion that another one continues [s]; else that begins at its end.
_LAST = 0.05
# Part of a motion that is kept when another one continues it [s]; more than servos lag.
_LEAD = 0.35
# How far states may be ahead of their time, as stamps and clocks are rounded [s].
_AHEAD = 0.002
# Samples of the last moments of a motion, and of a whole path.
_N_MOMENTS, _N_PLACES = 20, 200
# A robot's own lag is known from so many observations, at this speed [rad/s or m/s] or more; it
# varies by so much [s].
_FEWEST_LAGS, _MOST_LAGS, _CLEAR_SPEED, _LAG_SPREAD = 10, 100, 0.1, 0.015


class TooLateError(TrajectoryError):
    """The robot is no longer where a planned motion starts."""


@dataclass(frozen=True, eq=False)
class StatedCommand:
    """The command that a controller has stated.

    Attributes
    ----------
    state : JointState
        The command; velocities and accelerations are those of its trajectory, by the clock of that.
    rate : float
        Speed of that clock, 1 for that of the world.
    time : float
        When that was [s].
    change : float
        Rate at which the rate changes [1/s].
    """

    state: JointState
    rate: float
    time: float = 0.0
    change: float = 0.0

    @property
    def at_rest(self) -> bool:
        """Whether a position is held."""
        return self.rate < _HELD_RATE or not self.state.velocities.any()

    @property
    def held(self) -> FloatArray:
        """Where a controller at rest holds the robot [rad or m]: a cycle ahead of its state."""
        return self.state.positions + USUAL_TRANSPORT * self.state.velocities

    def at(self, time: float) -> JointState:
        """The command at a time soon after [s], if its acceleration stays."""
        since = self.rate * (time - self.time)
        q, v, a = self.state.positions, self.state.velocities, self.state.accelerations
        return JointState(
            self.state.joint_names, q + v * since + 0.5 * a * since**2, v + a * since, a
        )


def _with_rates(command: StatedCommand, last: StatedCommand | None) -> StatedCommand:
    """A command with its rate, and how that changes since the last one, if that was just before.

    Controllers of ros2_controllers before 4.39 state a rate of 0 at any speed: then it is how far
    the command moved by its velocities, and NaN where there is no last command.
    """
    rate, v = command.rate, command.state.velocities
    if last is not None:
        is_same = last.state.joint_names == command.state.joint_names
        last = last if is_same and 0.0 < command.time - last.time <= _MAX_AGE else None
    if rate == 0.0 and v.any():
        rate = math.nan
        if last is not None:
            mean = 0.5 * (last.state.velocities + v)
            moved = command.state.positions - last.state.positions
            full = float(mean @ mean) * (command.time - last.time)
            rate = float(mean @ moved) / max(full, 1e-12)
            rate = 1.0 if abs(rate - 1.0) < _ABOUT else max(rate, 0.0)
    if last is None or not math.isfinite(last.rate):
        return replace(command, rate=rate)
    return replace(command, rate=rate, change=(rate - last.rate) / (command.time - last.time))


def _is_believed(command: StatedCommand, measured: MeasuredState, settings: Settings) -> bool:
    """Whether a command is of the joints that were measured, has a rate, and is near them."""
    names = command.state.joint_names
    if names != measured.state.joint_names or not math.isfinite(command.rate):
        return False
    lag = settings.servo_lag * np.abs(command.state.velocities)
    away = np.abs(command.state.positions - measured.positions)
    return bool(np.all(away <= _BELIEVED + lag))


class How(Enum):
    """How a robot follows a motion."""

    ON_TIME = "on time"
    SCALED = "at another speed"
    BEHIND = "behind its motion"
    HELD = "held"
    LED = "led to a point"
    OFF = "off its path"


@dataclass(frozen=True, eq=False)
class Following:
    """How a robot follows a motion.

    Attributes
    ----------
    motion : PublishedMotion
        The motion.
    how : How
        How the robot follows it. On time, and at another speed, its command is known.
    time, place : float
        The place of the command on the motion at a time [s].
    rate, change : float
        Speed of the place, and the rate at which that changes [1/s].
    distance : float
        Largest distance of a joint from the motion [rad or m].
    joint : str
        The joint with that distance.
    at_rest : bool
        Whether the robot rests.
    """

    motion: PublishedMotion
    how: How
    time: float
    place: float
    rate: float
    distance: float
    joint: str
    at_rest: bool
    change: float = 0.0

    def at(self, time: float) -> float:
        """The place at another time [s]."""
        since = time - self.time
        if self.change < 0.0:  # a robot that slows down stops; it does not reverse
            since = min(since, -self.rate / self.change)
        return self.place + self.rate * since + 0.5 * self.change * since**2

    @property
    def is_over(self) -> bool:
        """Whether the command is the end of the motion."""
        return self.how is How.ON_TIME and self.place >= self.motion.duration

    @property
    def is_running(self) -> bool:
        """Whether the command moves along the motion."""
        return self.how in (How.ON_TIME, How.SCALED) and not self.is_over


@dataclass(frozen=True, eq=False)
class Where:
    """Where a robot is.

    Attributes
    ----------
    now : float
        The time [s].
    measured : MeasuredState
        The measured state.
    command : StatedCommand or None
        What the controller states of its command.
    following : Following or None
        How the robot follows the motion that was published last, or the one before if the
        controller has not taken that one; None if there is none.
    may_stamp : bool
        Whether motions may be stamped.
    may_be_slowed : bool
        Whether the robot lags, and it is not known that it usually does.
    """

    now: float
    measured: MeasuredState
    command: StatedCommand | None
    following: Following | None
    may_stamp: bool
    may_be_slowed: bool = False

    @property
    def at_rest(self) -> bool:
        """Whether the robot rests, and is commanded to."""
        return self.measured.at_rest and (self.command is None or self.command.at_rest)


class Tracker:
    """Where the robot is, and which motions were published.

    Parameters
    ----------
    measured : MeasuredStates
        The measured states.
    clock :
        The clock of the node, of motions and of stamps [s].

    Attributes
    ----------
    measured, clock
        As given.
    motion : PublishedMotion or None
        The motion that was published last.
    """

    def __init__(self, measured: MeasuredStates, clock: Clock) -> None:
        self.measured, self.clock = measured, clock
        self._stated: StatedCommand | None = None
        self.motion: PublishedMotion | None = None
        # The motion that the robot may follow instead, and the one that it follows for all we know.
        self._before: PublishedMotion | None = None
        self._current: PublishedMotion | None = None
        # Whether it was seen to follow the one before.
        self._is_lossy = False
        # Until it was at rest again, a robot that is slowed looks like one with slow servos.
        self._lags: deque[float] = deque(maxlen=_MOST_LAGS)
        self._is_lag_known = False
        self._observed = -math.inf

    def expect(self, joint_names: tuple[str, ...]) -> None:
        """Set the joints whose state is needed; states and motions of others are forgotten."""
        self.measured.expect(joint_names)
        self.motion = self._before = self._current = None

    def receive(self, command: StatedCommand) -> None:
        """Keep the command that the controller has stated last."""
        self._stated = _with_rates(command, self._stated)

    @property
    def hears_controller(self) -> bool:
        """Whether the controller has stated a command lately."""
        return self._stated is not None and abs(self.clock() - self._stated.time) <= _MAX_AGE

    def publish(self, motion: PublishedMotion) -> None:
        """Record that a motion was published."""
        self._before = self._current
        if motion.began >= motion.time and not motion.sent.velocities[0].any():
            # A robot at rest stays there if the controller does not take the motion.
            held = Trajectory.at_rest(motion.sent.joint_names, motion.sent.positions[0])
            self._before = PublishedMotion(held, motion.time)
        self.motion = self._current = motion

    def give_up(self) -> None:
        """Record that the controller has not taken the motion that was published last."""
        self.motion = self._current = self._before or self.motion
        self._before = None

    def where(self, settings: Settings) -> Where:
        """Where the robot is.

        Raises
        ------
        GoalError
            If there is no usable measured state.
        """
        now, measured = self.clock(), self.measured.newest(settings.state_timeout)
        command = self._stated if self.hears_controller else None
        if command is not None and not _is_believed(command, measured, settings):
            command = None
        if self.motion is not None and now < self.motion.began - 1.0:
            self.motion = self._before = self._current = None  # time was set back
        following = self._followed(now, measured, command, settings)
        may_stamp = settings.stamp_trajectories and self.measured.stamps.is_usable
        lags = bool(self._lags) and self._lags[-1] > _LAG_SPREAD and not self._is_lag_known
        return Where(now, measured, command, following, may_stamp, lags and command is None)

    def _followed(
        self, now: float, measured: MeasuredState, command: StatedCommand | None, settings: Settings
    ) -> Following | None:
        """How the newest motion is followed, or one before if the robot is on that instead."""
        if self.motion is None:
            return None
        lag = settings.servo_lag
        if len(self._lags) >= _FEWEST_LAGS:
            lag = min(lag, sorted(self._lags)[3 * len(self._lags) // 4])
            self._is_lag_known |= measured.at_rest
        arguments = now, measured, command, settings, lag
        found = _follow(self.motion, *arguments)
        if found.how is How.ON_TIME and command is None:
            self._observe_lag(found.motion, measured, settings)
        before = None if self._before is None else _follow(self._before, *arguments)
        is_known = (How.ON_TIME, How.SCALED)
        if before is None or before.how not in is_known:
            if found.how in is_known:
                self._before, self._is_lossy = None, False
        elif found.how in is_known:
            if self._is_lossy and measured.at_rest:  # perhaps at the end of the one before
                found = min(found, before, key=lambda one: one.distance)
        elif found.how is How.LED:
            pass  # at first, that is near the motion before, too
        elif command is None and measured.time <= self.motion.time:
            # A state of before the motion was sent says nothing on it.
            place = now - self.motion.began
            found = replace(before, motion=self.motion, place=place, rate=1.0)
        elif not before.is_over or measured.at_rest or found.how is not How.BEHIND:
            found, self._is_lossy = before, True  # else it has left the end of the one before
        self._current = found.motion
        return found

    def _observe_lag(
        self, motion: PublishedMotion, measured: MeasuredState, settings: Settings
    ) -> None:
        """Note by how much a robot lags behind a motion that it follows."""
        if measured.time - self._observed < _AHEAD:
            return
        self._observed = measured.time
        lags = np.linspace(0.0, settings.servo_lag, 4 * _N_MOMENTS)
        q, v, _ = motion.sample(measured.time - motion.began - lags)
        k = int(np.square(q - measured.positions).sum(axis=1).argmin())
        if np.abs(v[k]).max() >= _CLEAR_SPEED:
            self._lags.append(float(lags[k]))


def _follow(
    motion: PublishedMotion,
    now: float,
    measured: MeasuredState,
    command: StatedCommand | None,
    settings: Settings,
    lag: float,
) -> Following:
    """How a robot whose servos lag by so much at most [s] follows a motion."""
    known = motion.is_path_known
    if command is not None and known:
        stated = _by_command(motion, now, measured, command)
        if stated is not None:
            return stated
    # Where the motion was in the last moments, by the clock.
    then = measured.time - motion.began
    moments = np.linspace(then - lag - _LAG_SPREAD, then + _AHEAD, _N_MOMENTS)
    q, _, _ = motion.sample(moments)
    low, high = q.min(axis=0), q.max(axis=0)
    away = np.maximum(np.maximum(low - measured.positions, measured.positions - high), 0.0)
    place = now - motion.began
    is_unseen = then < motion.duration <= place and now - measured.time > _MAX_AGE
    if is_unseen and np.any(np.abs(motion.end - measured.positions) > settings.following_tolerance):
        place = math.nextafter(motion.duration, 0.0)  # no state says that the robot is at the end
    is_near = bool(np.all(away <= settings.following_tolerance))
    # A controller leads to a single point by a path of its own.
    is_there = known or (measured.at_rest and then >= motion.duration)
    if is_near and command is None and (is_there or not measured.at_rest):
        how, rate = (How.ON_TIME, 1.0) if is_there else (How.LED, 0.0)
        return _seen(motion, how, now, place, rate, q, measured)
    places = np.linspace(0.0, motion.duration, _N_PLACES)
    path, _, _ = motion.sample(places)
    k = int(np.abs(path - measured.positions).max(axis=1).argmin())
    distance = float(np.abs(path[k] - measured.positions).max())
    how = How.OFF
    if distance <= settings.following_tolerance and known:
        how = How.HELD if measured.at_rest else How.BEHIND
    return _seen(motion, how, now, float(places[k]), 0.0, path[k : k + 1], measured)


def _seen(
    motion: PublishedMotion,
    how: How,
    now: float,
    place: float,
    rate: float,
    near: FloatArray,
    measured: MeasuredState,
) -> Following:
    """How a robot follows a motion, with its distance from the nearest of some positions."""
    away = np.abs(near - measured.positions)
    away = away[away.max(axis=1).argmin()]
    worst = int(away.argmax())
    joint, distance = measured.state.joint_names[worst], float(away[worst])
    return Following(motion, how, now, place, rate, distance, joint, measured.at_rest)


def _by_command(
    motion: PublishedMotion, now: float, measured: MeasuredState, command: StatedCommand
) -> Following | None:
    """How a robot follows a motion by the command that its controller states; None if it is off."""
    by_clock = command.time - motion.began
    place = _nearest(motion, command.state.positions, by_clock)
    if place is None:
        return None
    at_end = place >= motion.duration
    rate = 0.0 if command.at_rest and not at_end else command.rate
    if at_end:  # there, time goes on
        place, rate = max(place, by_clock), 1.0
    since, change = now - command.time, command.change if rate and not at_end else 0.0
    place += rate * since + 0.5 * change * since**2
    is_full = abs(rate - 1.0) <= _FULL_RATE
    how = How.ON_TIME if is_full else How.SCALED
    if not at_end and command.at_rest and measured.at_rest and by_clock > 0.0:
        how = How.HELD
        if place <= TRANSPORT and by_clock <= _MAX_AGE:  # its message is on its way
            how, rate = How.ON_TIME, 1.0
    # The measured state lags behind the command.
    moments = np.linspace(by_clock - 0.2, by_clock, _N_MOMENTS) + (place - (now - motion.began))
    q, _, _ = motion.sample(moments)
    return replace(_seen(motion, how, now, place, rate, q, measured), change=change)


def _nearest(motion: PublishedMotion, positions: FloatArray, guess: float) -> float | None:
    """The place on a motion with some positions, near a guess or elsewhere; None if none."""
    places = np.linspace(0.0, motion.duration, _N_PLACES)
    path, _, _ = motion.sample(places)
    anywhere = float(places[np.square(path - positions).sum(axis=1).argmin()])
    for first in (min(max(guess, 0.0), motion.duration), anywhere):
        place = first
        for _ in range(6):
            q, v, _ = (x[0] for x in motion.sample(np.array([place])))
            step = float(v @ (positions - q)) / max(float(v @ v), 1e-9)
            place = min(max(place + float(np.clip(step, -0.1, 0.1)), 0.0), motion.duration)
        if np.abs(motion.state(place).positions - positions).max() <= _ON_PATH:
            return place
    return None


@dataclass(frozen=True, eq=False)
class MotionStart:
    """A state to plan from.

    Attributes
    ----------
    state : JointState
        The state.
    following : Following or None
        The motion that the robot follows; None at a rest off any motion.
    place : float
        The place of the state on the motion that is followed [s].
    time : float
        Time at which the robot is at the state [s].
    measured : MeasuredState
        The measured state at the time of the choice.
    """

    state: JointState
    following: Following | None
    place: float
    time: float
    measured: MeasuredState


def choose_start(where: Where, settings: Settings, latency: float) -> MotionStart:
    """Choose the start of the next motion by the four rules.

    Parameters
    ----------
    where : Where
        Where the robot is.
    settings : Settings
        With `start_from`.
    latency : float
        Time that planning may take [s].

    Raises
    ------
    GoalError
        If the robot moves, and not along a motion of this node.
    UnconfirmedError
        If the place of the robot on its motion is not known yet.
    """
    following, now = where.following, where.now
    if following is not None and following.is_running:
        if settings.start_from == MEASURED:
            raise GoalError(_motion_refusal(where, settings))
        check_joinable(where)
        if where.may_be_slowed:
            raise UnconfirmedError(
                "the robot lags, and whether it usually does is known after its first motion only; "
                "send the goal again when it is at rest"
            )
        then = now + latency + 2.0 * TRANSPORT
        expected = following.at(then)
        place, end = following.motion.near_point(expected), following.motion.duration
        # What is left of a motion at its jerk limit could not be displaced.
        place = end if place > end - _LAST else place
        then += place - expected
        state = following.motion.state(place)
        return MotionStart(state, following, place, then, where.measured)
    measured = where.measured
    names, here, held = measured.state.joint_names, measured.positions, None
    if settings.start_from != MEASURED and following is not None and following.is_over:
        here, held = following.motion.end, following
    elif settings.start_from != MEASURED and where.command is not None and where.command.at_rest:
        here = where.command.held
    elif not where.at_rest:
        raise GoalError(_motion_refusal(where, settings))
    place = following.place if held is not None and following is not None else 0.0
    return MotionStart(JointState(names, here), held, place, now, measured)


def join(rest: Trajectory, start: MotionStart, where: Where) -> PublishedMotion:
    """Join a motion to the present state of the robot.

    Parameters
    ----------
    rest : Trajectory
        The motion from the chosen start.
    start : MotionStart
        Its start.
    where : Where
        Where the robot is now.

    Raises
    ------
    TooLateError
        If the robot is no longer at its start, or too near to it for a message.
    """
    following, old, now = where.following, start.following, where.now
    begin = PublishedMotion.after_wait if where.may_stamp else PublishedMotion.on_receipt
    if old is None or following is None:
        _check_rest(start, where)
        return begin(rest, now)
    is_held = following.is_over and start.place >= following.motion.duration
    if is_held and old.motion is following.motion:
        return begin(rest, now)
    if following.how is not old.how or following.motion is not old.motion:
        raise TooLateError(
            f"the robot was {old.how.value} when planning began and is {following.how.value} now; "
            "send the goal again"
        )
    check_joinable(where)
    return continued(rest, start.place, following, now, stamp=where.may_stamp)


def continued(
    rest: Trajectory, place: float, following: Following, now: float, *, stamp: bool
) -> PublishedMotion:
    """The running motion up to a place on it [s], and the rest from there.

    Raises
    ------
    TooLateError
        If the robot is too near to that place for a message.
    """
    rate, here = following.rate, following.at(now)
    left = place - here
    if left < TRANSPORT * rate:
        raise TooLateError(
            "planning took too long: the motion should have been sent "
            f"{TRANSPORT - left:.3g} s ago; send the goal again"
        )
    is_timed = stamp and rate > 0.5
    # Until the message arrives, the robot advances at its rate. A stamped motion advances
    # meanwhile at the rate of the clock, another one not at all.
    here += USUAL_TRANSPORT * (rate - is_timed)
    if is_timed:
        cut = following.motion.near_point(here)
        now += cut - here
        here = cut
    began = now if is_timed else now + USUAL_TRANSPORT
    lead = min(_LEAD, here)
    motion = following.motion.followed_by(rest, place, here - lead)
    sent = following.motion.followed_by(rest, place, here)
    return PublishedMotion(motion, began - lead, sent, now, is_timed)


def check_joinable(where: Where) -> None:
    """Raise an `UnconfirmedError` if the place of a moving robot is not known precisely."""
    following = where.following
    if following is None or not following.is_running:
        return
    if where.measured.age > _MAX_AGE:
        raise UnconfirmedError(
            f"the newest joint_states message is {where.measured.age:.3g} s old, at most "
            f"{_MAX_AGE:g} s is accepted while the robot moves; send the goal again"
        )
    is_stopping = following.how is How.SCALED and following.rate < _MIN_RATE
    if is_stopping or abs(following.change) > _MAX_CHANGE:
        raise UnconfirmedError(
            "the speed of the robot changes (speed scaling); send the goal again when it is steady"
        )


def _check_rest(start: MotionStart, where: Where) -> None:
    """Raise a `TooLateError` if the robot has left the rest that a motion starts from."""
    moved = np.abs(where.measured.positions - start.measured.positions)
    worst = int(moved.argmax())
    if not moved[worst] <= _START_TOLERANCE or not where.measured.at_rest:
        raise TooLateError(
            f"planning took too long: joint '{where.measured.state.joint_names[worst]}' has moved "
            f"{moved[worst]:.3g} rad (or m) away from the start of the motion meanwhile, at most "
            f"{_START_TOLERANCE} at rest is accepted; send the goal again"
        )


def _motion_refusal(where: Where, settings: Settings) -> str:
    """The reason why no motion can start while the robot moves."""
    if settings.start_from == MEASURED:
        return (
            "the robot moves, but start_from is 'measured', which accepts goals only at rest: send "
            f"the goal again when the robot is at rest, or set start_from to '{AUTO}'"
        )
    following, why = where.following, ""
    if following is not None and following.how is How.BEHIND:
        why = ": it is on its path, but not at its time (a slowed controller?)"
    elif following is not None:
        why = f": joint '{following.joint}' is {following.distance:.3g} rad (or m) away"
    return (
        f"the robot moves, and not along a motion of this node{why}; send the goal again when it "
        "is at rest, or call ~/stop. With control_msgs and the topic 'controller_state' of the "
        "controller, goals for slowed and held robots are served, too"
    )
