# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Messages with the states of some joints, and the clock of the robot that their stamps show."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError
from ...motion.goal import JointState
from ..options import FollowingOptions

Clock = Callable[[], float]


@dataclass(frozen=True)
class Receipt:
    """When a message was received, and when it was sent.

    Attributes
    ----------
    received : float
        Time of the receipt by a clock that is never set back [s].
    local : float
        The same by the clock of the node [s].
    stamp : float
        When its content was measured, by the clock of the robot [s]; 0 if unknown.
    """

    received: float
    local: float
    stamp: float


class RobotClock:
    """Compares stamps with the times of their receipt, and keeps the time of the robot.

    A low quantile over many messages is compared, so late messages, stalls of a machine and
    simulated time that advances in steps do not matter. Clocks with a constant difference are as
    good as equal ones: all times of motions are those of the robot's clock.

    Parameters
    ----------
    receipt_clock :
        The clock of message ages [s]: never set back.
    node_clock :
        The clock of the node [s], which may be simulated.
    options :
        Parameters.

    Attributes
    ----------
    offset : float
        Time of the node minus time of the robot [s], as it is used.
    estimate : float
        The same as the newest stamps show it, with the shortest usual delay of messages [s].
    is_usable : bool
        Whether the stamps are times of the robot's clock.
    """

    def __init__(self, receipt_clock: Clock, node_clock: Clock, options: FollowingOptions) -> None:
        self._receipt_clock, self._node_clock, self._options = receipt_clock, node_clock, options
        self.offset = self.estimate = 0.0
        self.is_usable = True
        self._is_constant, self._lead = False, options.max_stamp_lead
        self._differences: deque[float] = deque(maxlen=options.max_stamps)
        self._compared = (-float("inf"), -float("inf"))
        # Times of both clocks, to convert ages: simulated time has its own rate.
        self._rates: deque[tuple[float, float]] = deque(maxlen=10)

    def now(self) -> float:
        """The time of the robot [s]."""
        return self._node_clock() - self.offset

    def receipt(self, age: float, stamp: float) -> Receipt:
        """The receipt of a message of some age [s] with a stamp [s], 0 if it has none."""
        now, local = self._receipt_clock(), self._node_clock()
        if not self._rates or now - self._rates[-1][0] >= 0.05:
            self._rates.append((now, local))
        since, passed = now - self._rates[0][0], local - self._rates[0][1]
        rate = passed / since if since >= 0.1 and 0.0 <= passed <= 10.0 * since else 1.0
        found = Receipt(now - age, local - rate * age, stamp)
        if stamp != 0.0:
            self._compare(found, local)
        return found

    def time(self, receipt: Receipt) -> float:
        """When the content of a message was measured, by the clock of the robot [s]."""
        if receipt.stamp != 0.0 and self.is_usable:
            return receipt.stamp
        return receipt.local - self.offset

    def settle(self, *, is_idle: bool) -> None:
        """Use the difference that the stamps show.

        Parameters
        ----------
        is_idle : bool
            Whether no motion is being executed: only then the time of the robot may jump.
        """
        target = 0.0 if self._is_near(self.estimate, self._lead) else self.estimate
        is_small = abs(target - self.offset) <= self._lead
        if self._is_constant and (is_idle or is_small):
            self.offset, self.is_usable = target, True

    def _compare(self, receipt: Receipt, local: float) -> None:
        """Compare the clocks again, once for each time of the node's clock."""
        last, last_local = self._compared
        if local == last_local and self._differences:
            # Simulated time stands still: the newest message has the smallest age.
            self._differences.pop()
        elif receipt.received - last < self._options.stamp_spacing:
            return
        self._compared = receipt.received, local
        self._differences.append(receipt.local - receipt.stamp)
        every = list(self._differences)
        older, newer = every[: len(every) // 2], every[len(every) // 2 :]
        options, self.estimate = self._options, _quantile(every)
        # Simulated time that comes in steps differs by parts of a step.
        spread = _quantile(every, 0.75) - self.estimate
        self._lead = options.max_stamp_lead + min(spread, options.max_stamp_delay)
        self._is_constant = len(every) >= options.min_stamps and abs(
            _quantile(newer) - _quantile(older)
        ) <= options.max_stamp_lead + 0.5 * min(spread, options.max_stamp_delay)
        # Twice the lead, so that a difference near the bound does not come and go.
        self.is_usable = self._is_near(self.estimate - self.offset, 2.0 * self._lead)

    def _is_near(self, difference: float, lead: float) -> bool:
        return -lead <= difference <= self._options.max_stamp_delay


def _quantile(values: list[float], share: float = 0.25) -> float:
    return sorted(values)[int(share * len(values))]


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

    def since(self, time: float, offset: FloatArray) -> MeasuredSamples:
        """Those from a time on [s], without an offset of the positions [rad or m]."""
        later = self.times >= time
        return MeasuredSamples(self.times[later], self.positions[later] - offset)

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


Read = Callable[[Sequence[str]], JointState]
"""Returns the state of some joints of a message; raises a `GoalError` if it is unusable."""


@dataclass(eq=False)
class StateMessage:
    """A message with the joints that are read of it, and its number."""

    read: Read
    joint_names: tuple[str, ...]
    receipt: Receipt
    number: int = 0

    @property
    def received(self) -> float:
        """Time of its receipt [s]."""
        return self.receipt.received

    @cached_property
    def state(self) -> JointState:
        """The state of its joints; raises a `GoalError` if it is unusable."""
        return self.read(self.joint_names)


class StateSource:
    """The messages with the same joints: those of one publisher, unless several contradict.

    Attributes
    ----------
    joint_names : tuple of str
        The joints.
    newest : StateMessage
        The newest message.
    """

    def __init__(self, joint_names: tuple[str, ...], options: FollowingOptions) -> None:
        self.joint_names, self._options = joint_names, options
        self.newest: StateMessage
        # The planning thread reads a copy of them.
        self._kept: deque[StateMessage] = deque(maxlen=int(options.window / options.spacing))
        self._latest: deque[StateMessage] = deque(maxlen=3)
        self._conflict, self._conflict_time = "", -float("inf")
        # The samples as of a message: one goal asks for them ten times.
        self._sampled: tuple[tuple[StateMessage, float, bool, float], MeasuredSamples] | None = None

    def receive(self, message: StateMessage, clock: RobotClock) -> None:
        """Keep a message, unless it hardly differs in time from the last one that was kept."""
        last, spacing = (self._kept[-1] if self._kept else None), self._options.spacing
        # After a stall, many are received at once.
        if (
            last is None
            or message.received - last.received >= spacing
            or clock.time(message.receipt) - clock.time(last.receipt) >= spacing
        ):
            self._kept.append(message)
        self.newest = message
        self._latest.append(message)
        with suppress(GoalError):
            if found := _disagreement(self._latest, clock, self.joint_names, self._options):
                self._conflict, self._conflict_time = found, message.received

    def samples(self, clock: RobotClock, window: float) -> MeasuredSamples:
        """The usable states of the last moments [s]."""
        messages, last = list(self._kept), self.newest
        key, sampled = (last, clock.offset, clock.is_usable, window), self._sampled
        if sampled is not None and sampled[0] == key:
            return sampled[1]
        if messages and last is not messages[-1]:
            messages.append(last)
        times, positions, newest = [], [], clock.time(last.receipt)
        for message in messages:
            time = clock.time(message.receipt)
            if max(last.received - message.received, newest - time) > window:
                continue
            with suppress(GoalError):
                positions.append(message.state.positions)
                times.append(time)
        shape = (-1, len(self.joint_names))
        found = MeasuredSamples(np.array(times), np.reshape(positions, shape))
        self._sampled = key, found
        return found

    def conflict(self) -> str:
        """How two publishers disagreed in the last moments; empty if they did not."""
        since = self.newest.received - self._conflict_time
        return self._conflict if since <= self._options.window else ""


def _disagreement(
    latest: Sequence[StateMessage],
    clock: RobotClock,
    joint_names: Sequence[str],
    options: FollowingOptions,
) -> str:
    """How a message differs from the two of another publisher around it; empty if it does not."""
    if len(latest) < 3 or latest[2].number != latest[0].number + 1:
        return ""
    q, own, end = (one.state.positions for one in latest)
    before, other, after = (clock.time(one.receipt) for one in latest)
    span, since = after - before, other - before
    expected = q + (end - q) * (since / span if span > 0.0 else 0.0)
    excess = np.abs(own - expected) - options.max_disagreement
    excess -= options.max_acceleration * max(abs(span), abs(since)) ** 2
    j = int(excess.argmax())
    if not excess[j] > 0.0:
        return ""
    return _contradiction(joint_names[j], expected[j], own[j], since)


def overlap_conflict(
    one: StateSource, other: StateSource, clock: RobotClock, options: FollowingOptions
) -> str:
    """How the joints that two sources share differ; empty if they do not."""
    shared = [name for name in one.joint_names if name in other.joint_names]
    samples = [source.samples(clock, options.window) for source in (one, other)]
    if not shared or any(len(found.times) < 2 for found in samples):
        return ""
    time = min(found.times[-1] for found in samples)
    for name in shared:
        columns = [
            found.positions[:, source.joint_names.index(name)]
            for source, found in zip((one, other), samples, strict=True)
        ]
        first, second = (
            float(np.interp(time, found.times, column))
            for found, column in zip(samples, columns, strict=True)
        )
        # Without stamps, the times of both are uncertain by a tenth of the window.
        uncertain = 0.1 * max(map(np.ptp, columns))
        if abs(first - second) > options.max_reversal + uncertain:
            return _contradiction(name, first, second, 0.0)
    return ""
