# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where the next motion starts: at the measured state, or on the motion that runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, TrajectoryError, quote_names
from ..goal import JointState
from ..trajectory import Trajectory
from .commanded import CommandedMotion
from .parameters import COMMANDED

START_TOLERANCE = 0.02
"""How far a joint may have come from a measured start before its motion is published [rad or m].

It bounds the jump that the controller has to absorb.
"""

LATE_TOLERANCE = 1e-3
"""How late a motion may be that starts on the one that runs [s]: a cycle of the controller."""

REST_VELOCITY = 0.01
"""Velocity up to which a robot that has left its motion counts as at rest [rad/s or m/s]."""

Clock = Callable[[], float]


class TooLateError(TrajectoryError):
    """The robot is no longer where a planned motion starts."""


class StateReader(Protocol):
    """Reads states from messages, which may stay serialised until they are needed."""

    def names_all(self, message: bytes, joint_names: Sequence[str]) -> bool:
        """Whether the message has all of these joints."""

    def read(self, message: bytes, joint_names: Sequence[str]) -> JointState:
        """Read the state of these joints; a `GoalError` says what is wrong with it."""


@dataclass(frozen=True, eq=False)
class Start:
    """A state to plan from.

    Attributes
    ----------
    state : JointState
        The state.
    commanded : CommandedMotion or None
        The motion it is taken from; None if it was measured.
    time : float
        When the robot is there, by the clock of motions [s].
    """

    state: JointState
    commanded: CommandedMotion | None
    time: float


class StartStates:
    """Keeps what is known of the robot's state; the newest message of it, unread.

    Parameters
    ----------
    reader :
        Reads messages.
    receipt_clock :
        Tells the age of messages [s]: never set back.
    motion_clock :
        Tells where a running motion is [s]: the clock of the controller.
    fetch :
        Called before the newest message is used: has those handed over that wait elsewhere.

    Attributes
    ----------
    n_incomplete : int
        Messages ignored because they lack a joint.
    n_unusable : int
        Messages that were refused when a goal needed them.
    """

    def __init__(
        self,
        reader: StateReader,
        receipt_clock: Clock,
        motion_clock: Clock,
        fetch: Callable[[], None] = lambda: None,
    ) -> None:
        self.n_incomplete = 0
        self.n_unusable = 0
        self._joint_names: tuple[str, ...] = ()
        self._reader = reader
        self._receipt_clock = receipt_clock
        self._motion_clock = motion_clock
        self._fetch = fetch
        # One value, since planning reads it in a thread of its own.
        self._newest: tuple[bytes, float] | None = None
        self._commanded: CommandedMotion | None = None

    def expect(self, joint_names: Sequence[str]) -> None:
        """Set the joints whose state is needed; what is known of other joints is forgotten."""
        if self._joint_names != tuple(joint_names):
            self._joint_names = tuple(joint_names)
            self._newest = self._commanded = None

    def receive(self, message: bytes, age: float = 0.0) -> None:
        """Keep a message, unless it is of other joints, as that of a gripper's own publisher.

        Parameters
        ----------
        message : bytes
            What the reader reads.
        age : float
            How long ago it was received [s].
        """
        if self._reader.names_all(message, self._joint_names):
            self._newest = message, self._receipt_clock() - age
        else:
            self.n_incomplete += 1

    def command(self, trajectory: Trajectory) -> None:
        """Note that a trajectory was published just now."""
        self._commanded = CommandedMotion(trajectory, self._motion_clock())

    @property
    def age(self) -> float | None:
        """Age of the newest message [s]; None if there is none."""
        newest = self._newest
        return None if newest is None else self._receipt_clock() - newest[1]

    @property
    def motion_time(self) -> float:
        """The time by the clock of motions [s]; simulated time goes at its own rate."""
        return self._motion_clock()

    @property
    def running(self) -> CommandedMotion | None:
        """The motion that was published last, unless it is over."""
        commanded = self._commanded
        over = commanded is None or commanded.is_over(self._motion_clock())
        return None if over else commanded

    def choose(
        self, start_from: str, timeout: float, latency: float, tolerance: float = np.inf
    ) -> Start:
        """Choose the start of the next motion.

        Parameters
        ----------
        start_from : {'measured', 'commanded'}
            See the parameter of this name.
        timeout : float
            Age at which a message is too old [s]; 0: never.
        latency : float
            Time that planning may take [s].
        tolerance : float
            How far the measured positions may be from the running motion [rad or m]; beyond, that
            motion is forgotten, and the measured state counts.

        Raises
        ------
        GoalError
            If there is no usable measured state. It is needed for a motion that starts on
            another one, too: a robot that nobody hears of may have stopped. Or if the robot has
            left the running motion and still moves.
        """
        measured = self._measured(timeout)
        now = self._motion_clock()
        running = self.running
        if start_from == COMMANDED and running is not None:
            if self._has_left(running, measured, now, tolerance):
                self._commanded = None
                return Start(measured, None, now)
            return Start(running.state(now + latency), running, now + latency)
        return Start(measured, None, now)

    def present(self, timeout: float, tolerance: float = np.inf) -> JointState:
        """Where the robot is: on the motion that runs, else as measured.

        Parameters
        ----------
        timeout, tolerance : float
            See :meth:`choose`; a robot that is further from the running motion than the
            tolerance, moving or not, is where it was measured.

        Raises
        ------
        GoalError
            If no motion runs and there is no usable measured state.
        """
        running = self.running
        if running is None:
            return self._measured(timeout)
        now = self._motion_clock()
        try:
            measured = self._measured(timeout)
        except GoalError:
            return running.state(now)
        away = self._distances(running, measured, now)
        return measured if away.max() > tolerance else running.state(now)

    def join(self, rest: Trajectory, start: Start, timeout: float) -> Trajectory:
        """Lead to a motion from where the robot is by now.

        Parameters
        ----------
        rest : Trajectory
            The motion from the chosen start.
        start : Start
            Its start.
        timeout : float
            See :meth:`choose`.

        Returns
        -------
        trajectory : Trajectory
            What is left of the running motion until the start, then the rest.

        Raises
        ------
        TooLateError
            If the robot has been at the start and gone on.
        GoalError
            If the measured state is too old by now.
        """
        if start.commanded is None:
            self._check_measured(start.state, self._measured(timeout))
            return rest
        now = self._motion_clock()
        if start.commanded is not self._commanded or now < start.commanded.began:
            raise TooLateError("another motion was published while this one was planned")
        if now > start.time + LATE_TOLERANCE:
            raise TooLateError(
                f"planning took too long: the motion should have started "
                f"{now - start.time:.3g} s ago; send the goal again"
            )
        return start.commanded.followed_by(rest, max(start.time, now), now)

    def _has_left(
        self, running: CommandedMotion, measured: JointState, now: float, tolerance: float
    ) -> bool:
        """Whether the robot rests elsewhere than on the running motion."""
        away = self._distances(running, measured, now)
        worst = int(away.argmax())
        if away[worst] <= tolerance:
            return False
        if np.abs(measured.velocities).max() > REST_VELOCITY:
            raise GoalError(
                f"joint '{measured.joint_names[worst]}' is {away[worst]:.3g} rad (or m) away from "
                f"the running motion, at most {tolerance:g} (parameter commanded_tolerance) is "
                "accepted while the robot moves; send the goal again when it is at rest"
            )
        return True

    def _distances(self, running: CommandedMotion, measured: JointState, now: float) -> FloatArray:
        """How far each joint is from the running motion."""
        # What was measured a while ago is compared with where the motion was then.
        expected = running.state(now - (self.age or 0.0))
        return np.asarray(np.abs(measured.positions - expected.positions))

    def _check_measured(self, planned: JointState, present: JointState) -> None:
        moved = np.abs(present.positions - planned.positions)
        worst = int(moved.argmax())
        if not moved[worst] <= START_TOLERANCE:
            raise TooLateError(
                f"planning took too long: joint '{present.joint_names[worst]}' has come "
                f"{moved[worst]:.3g} rad (or m) away from the start of the motion meanwhile, at "
                f"most {START_TOLERANCE} is accepted; send the goal again"
            )

    def _measured(self, timeout: float) -> JointState:
        self._fetch()
        newest = self._newest
        if newest is None:
            ignored = f" ({self.n_incomplete} without them were ignored)" * bool(self.n_incomplete)
            raise GoalError(
                "the present state is not known: no joint_states message with the joints "
                f"{quote_names(self._joint_names)} has arrived{ignored}"
            )
        message, received = newest
        age = self._receipt_clock() - received
        if 0.0 < timeout < age:
            raise GoalError(
                f"the present state is not known: the newest joint_states message is {age:.3g} s "
                f"old, at most {timeout:g} s (parameter state_timeout) is accepted"
            )
        try:
            return self._reader.read(message, self._joint_names)
        except GoalError:
            self.n_unusable += 1
            raise
