# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Measured states of the last moments, converted only when they are needed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, quote_names
from ..motion.goal import JointState
from .options import FollowingOptions

Clock = Callable[[], float]


@dataclass(frozen=True, eq=False)
class MeasuredSamples:
    """Measured positions of the last moments.

    Attributes
    ----------
    times : array, shape (n_samples,)
        Times on the clock of motions [s], the newest last.
    positions : array, shape (n_samples, n_joints)
        Positions [rad or m].
    """

    times: FloatArray
    positions: FloatArray

    def contradiction(self, joint_names: Sequence[str], options: FollowingOptions) -> str:
        """Which positions change as those of no robot do; empty if all are plausible."""
        if len(self.times) < 2:
            return ""
        steps, since = np.diff(self.positions, axis=0), np.diff(self.times)[:, None]
        excess = np.abs(steps) - options.max_step - options.max_speed * np.abs(since)
        there, back, longest = steps[:-1], steps[1:], np.maximum(since[:-1], since[1:])
        reversal = np.where(there * back < 0.0, np.minimum(np.abs(there), np.abs(back)), 0.0)
        reversal -= options.max_reversal + options.max_acceleration * longest**2
        excess[1:] = np.maximum(excess[1:], reversal)
        k, j = map(int, np.unravel_index(int(excess.argmax()), excess.shape))
        if not excess[k, j] > 0.0:
            return ""
        one, other = self.positions[k : k + 2, j]
        return _contradiction(joint_names[j], one, other, since[k, 0])


def _contradiction(joint: str, one: float, other: float, since: float) -> str:
    return (
        f"joint_states contradict each other, joint '{joint}' is at {one:.4g} and {other:.4g} rad "
        f"(or m) within {abs(since):.2g} s"
    )


@dataclass(eq=False)
class _Message:
    """A message, its number, and its time by the receipt clock and by the clock of motions."""

    read: Callable[[], JointState]
    received: float
    time: float
    number: int = 0

    @cached_property
    def state(self) -> JointState:
        return self.read()


def _disagreement(
    latest: Sequence[_Message], joint_names: Sequence[str], options: FollowingOptions
) -> str:
    """How a message differs from the two of another publisher around it; empty if it does not."""
    if len(latest) < 3 or latest[2].number != latest[0].number + 1:
        return ""
    before, other, after = latest
    q, own, end = (one.state.positions for one in latest)
    span, since = after.time - before.time, other.time - before.time
    expected = q + (end - q) * (since / span if span > 0.0 else 0.0)
    excess = np.abs(own - expected) - options.max_disagreement
    excess -= options.max_acceleration * max(abs(span), abs(since)) ** 2
    j = int(excess.argmax())
    if not excess[j] > 0.0:
        return ""
    return _contradiction(joint_names[j], expected[j], own[j], since)


class MeasuredStates:
    """Keeps the states of the last moments.

    Parameters
    ----------
    receipt_clock :
        The clock of message ages [s]: never set back.
    motion_clock :
        The clock of motions [s].
    fetch :
        Called before the newest state is used; adds messages that still wait in a queue.
    options :
        Parameters.

    Attributes
    ----------
    motion_clock, options
        As given.
    joint_names : tuple of str
        The joints whose state is needed.
    n_incomplete : int
        Messages ignored because they lack a joint.
    n_unusable : int
        Messages that were rejected when a goal needed them.
    """

    def __init__(
        self,
        receipt_clock: Clock,
        motion_clock: Clock,
        fetch: Callable[[], None] = lambda: None,
        options: FollowingOptions | None = None,
    ) -> None:
        self.joint_names: tuple[str, ...] = ()
        self.n_incomplete = self.n_unusable = 0
        self._receipt_clock = receipt_clock
        self.motion_clock = motion_clock
        self._fetch = fetch
        self.options = options = options or FollowingOptions()
        # The planning thread reads a copy of them.
        self._kept: deque[_Message] = deque(maxlen=int(options.window / options.spacing))
        self._newest: _Message | None = None
        self._latest: deque[_Message] = deque(maxlen=3)
        self._conflict, self._conflict_time = "", 0.0
        # Times from the stamps to the receipts, on the clock of motions.
        self._delays: deque[float] = deque(maxlen=20)

    def expect(self, joint_names: Sequence[str]) -> None:
        """Set the joints whose state is needed, and discard the states of others."""
        if self.joint_names:
            self._fetch()  # messages that still wait are discarded, too
        self.joint_names = tuple(joint_names)
        self._newest, self._conflict = None, ""
        self._kept.clear()
        self._latest.clear()

    def receive(
        self,
        joint_names: Collection[str],
        read: Callable[[], JointState],
        stamp: float = 0.0,
        age: float = 0.0,
        number: int = 0,
    ) -> None:
        """Keep a message that has all joints; other publishers, such as a gripper's, send fewer.

        Parameters
        ----------
        joint_names : collection of str
            The joints of the message.
        read : callable
            Returns the state of the joints that are needed; raises a `GoalError` if it is unusable.
        stamp : float
            When the state was measured by the clock of the robot [s]; 0 if unknown.
        age : float
            Time since the message was received [s].
        number : int
            How many messages its publisher has sent by now; 0 if unknown.
        """
        if not set(self.joint_names).issubset(joint_names):
            self.n_incomplete += 1
            return
        received, time = self._receipt_clock() - age, self.motion_clock() - age
        message = _Message(read, received, time, number)
        is_kept = not self._kept or received - self._kept[-1].received >= self.options.spacing
        if is_kept and stamp != 0.0:
            self._delays.append(time - stamp)
        if stamp != 0.0 and self.clocks_agree:
            message.time = stamp
        if is_kept:
            self._kept.append(message)
        self._newest = message
        self._latest.append(message)
        with suppress(GoalError):
            if found := _disagreement(self._latest, self.joint_names, self.options):
                self._conflict, self._conflict_time = found, received

    @property
    def age(self) -> float | None:
        """Age of the newest message [s]; None if there is none."""
        newest = self._newest
        return None if newest is None else self._receipt_clock() - newest.received

    @property
    def newest_time(self) -> float:
        """Time of the newest state on the clock of motions [s]; 0 if there is none."""
        newest = self._newest
        return 0.0 if newest is None else newest.time

    @property
    def clocks_agree(self) -> bool:
        """Whether the stamps are compatible with the clock of motions."""
        return -self.options.max_stamp_lead <= self.clock_difference <= self.options.max_stamp_delay

    @property
    def clock_difference(self) -> float:
        """Shortest time from a stamp to the receipt of its message [s]."""
        return min(list(self._delays), default=0.0)

    def newest(self, timeout: float) -> JointState:
        """The newest state.

        Parameters
        ----------
        timeout : float
            Age above which a message is too old [s]; 0 accepts any.

        Raises
        ------
        GoalError
            If there is none, it is too old or unusable, or the last ones contradict each other.
        """
        self._fetch()
        newest = self._newest
        if newest is None:
            ignored = f" ({self.n_incomplete} without them were ignored)" * bool(self.n_incomplete)
            raise GoalError(
                "the present state is not known: no joint_states message with the joints "
                f"{quote_names(self.joint_names)} has arrived{ignored}"
            )
        age = self._receipt_clock() - newest.received
        if 0.0 < timeout < age:
            raise GoalError(
                f"the present state is not known: the newest joint_states message is {age:.3g} s "
                f"old, at most {timeout:g} s (parameter state_timeout) is accepted"
            )
        try:
            state = newest.state
        except GoalError:
            self.n_unusable += 1
            raise
        contradiction = self.history().contradiction(self.joint_names, self.options)
        if newest.received - self._conflict_time <= self.options.window:
            contradiction = contradiction or self._conflict
        if contradiction:
            raise GoalError(
                f"the present state is not known: {contradiction}; check that only one node "
                "publishes them, then send the goal again"
            )
        return state

    def history(self) -> MeasuredSamples:
        """The usable states of the last moments."""
        messages, last = list(self._kept), self._newest
        if last is not None and messages and last is not messages[-1]:
            messages.append(last)
        times, positions = [], []
        for message in messages:
            if last is None or last.received - message.received > self.options.window:
                continue
            try:
                positions.append(message.state.positions)
            except GoalError:
                continue
            times.append(message.time)
        return MeasuredSamples(np.array(times), np.reshape(positions, (-1, len(self.joint_names))))

    def velocities(self, state: JointState) -> FloatArray:
        """Velocities of the robot [rad/s or m/s], shape (n_joints,); exactly 0 for joints at rest.

        They are computed from positions: reported velocities are noisy, and many robots report
        none.
        """
        options, samples = self.options, self.history()
        times, positions = samples.times, samples.positions
        v, spread = np.array(state.velocities), np.ptp([*positions, state.positions], axis=0)
        span = float(np.ptp(times)) if len(times) else 0.0
        rough = np.where(spread > options.rest_spread, spread / max(span, options.spacing), 0.0)
        if len(times) < 3 or span < options.min_span:
            return np.where(np.abs(v) <= options.rest_velocity, rough, v)
        since = times - times.mean()
        slope = since @ positions / (since @ since)
        moving = np.abs(slope) > options.rest_slope
        if moving.any():
            # For a decelerating robot, the mean slope differs from the present velocity.
            newest = times >= times[-1] - options.min_span
            now = np.linalg.pinv(np.vander(times[newest] - times[-1], 3))[1] @ positions[newest]
            slope = np.where(moving, now, 0.0)
        return np.where(np.abs(v) > options.clear_velocity, v, np.where(moving, slope, rough))
