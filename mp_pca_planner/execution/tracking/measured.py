# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Measured states of the last moments, and the clock of the robot that their stamps show.

Messages are converted only when they are needed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError, quote_names
from ...input_limits import INPUT_LIMITS
from ...motion.goal import JointState
from ..options import Tracking

Clock = Callable[[], float]

Read = Callable[[Sequence[str]], JointState]
"""Returns the state of some joints of a message; raises a `GoalError` if it is unusable."""


@dataclass(frozen=True, eq=False)
class Message:
    """A message, when it was received, and when it was sent.

    Attributes
    ----------
    read : callable
        Returns what it says of some joints; raises a `GoalError` if it is unusable.
    received : float
        Time of the receipt by a clock that is never set back [s].
    local : float
        The same by the clock of the node [s].
    stamp : float
        When its content was measured, by the clock of the robot [s]; 0 if unknown.
    number : int
        How many messages its publisher had sent by then; 0 if unknown.
    """

    read: Any
    received: float
    local: float
    stamp: float
    number: int = 0


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

    Attributes
    ----------
    offset : float
        Time of the node minus time of the robot [s], as it is used.
    estimate : float
        The same as the newest stamps show it, with the shortest usual delay of messages [s].
    is_usable : bool
        Whether the stamps are times of the robot's clock.
    """

    def __init__(self, receipt_clock: Clock, node_clock: Clock) -> None:
        self._receipt_clock, self._node_clock = receipt_clock, node_clock
        self.offset = self.estimate = 0.0
        self.is_usable = True
        self._is_constant, self._lead = False, Tracking.max_stamp_lead
        self._differences: deque[float] = deque(maxlen=Tracking.max_stamps)
        self._compared = (-float("inf"), -float("inf"))
        # Times of both clocks, to convert ages: simulated time has its own rate.
        self._rates: deque[tuple[float, float]] = deque(maxlen=10)

    @property
    def is_certain(self) -> bool:
        """Whether enough stamps show that. The first are late if the machine stalls at start."""
        return len(self._differences) >= Tracking.min_stamps

    def now(self) -> float:
        """The time of the robot [s]."""
        return self._node_clock() - self.offset

    def message(self, read: Any, age: float, stamp: float, number: int = 0) -> Message:
        """A message of some age [s] with a stamp [s], 0 if it has none."""
        now, local = self._receipt_clock(), self._node_clock()
        if not self._rates or now - self._rates[-1][0] >= 0.05:
            self._rates.append((now, local))
        since, passed = now - self._rates[0][0], local - self._rates[0][1]
        rate = passed / since if since >= 0.1 and 0.0 <= passed <= 10.0 * since else 1.0
        found = Message(cache(read), now - age, local - rate * age, stamp, number)
        if stamp != 0.0:
            self._compare(found, local)
        return found

    def time(self, message: Message) -> float:
        """When the content of a message was measured, by the clock of the robot [s]."""
        if message.stamp != 0.0 and self.is_usable:
            return message.stamp
        return message.local - self.offset

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

    def _compare(self, message: Message, local: float) -> None:
        """Compare the clocks again, once for each time of the node's clock."""
        last, last_local = self._compared
        if local == last_local and self._differences:
            # Simulated time stands still: the newest message has the smallest age.
            self._differences.pop()
        elif message.received - last < Tracking.stamp_spacing:
            return
        self._compared = message.received, local
        self._differences.append(message.local - message.stamp)
        every = list(self._differences)
        older, newer = every[: len(every) // 2], every[len(every) // 2 :]
        self.estimate = _quantile(every)
        # Simulated time that comes in steps differs by parts of a step.
        spread = _quantile(every, 0.75) - self.estimate
        self._lead = Tracking.max_stamp_lead + min(spread, Tracking.max_stamp_delay)
        self._is_constant = self.is_certain and abs(
            _quantile(newer) - _quantile(older)
        ) <= Tracking.max_stamp_lead + 0.5 * min(spread, Tracking.max_stamp_delay)
        # Twice the lead, so that a difference near the bound does not come and go.
        self.is_usable = self._is_near(self.estimate - self.offset, 2.0 * self._lead)

    def _is_near(self, difference: float, lead: float) -> bool:
        return -lead <= difference <= Tracking.max_stamp_delay


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

    def contradiction(self, joint_names: Sequence[str]) -> str:
        """Which positions change as those of no robot do; empty if all are plausible."""
        if len(self.times) < 2:
            return ""
        steps, since = np.diff(self.positions, axis=0), np.diff(self.times)[:, None]
        excess = np.abs(steps) - Tracking.max_step - Tracking.max_speed * np.abs(since)
        there, back, longest = steps[:-1], steps[1:], np.maximum(since[:-1], since[1:])
        reversal = np.where(there * back < 0.0, np.minimum(np.abs(there), np.abs(back)), 0.0)
        reversal -= Tracking.max_reversal + Tracking.max_acceleration * longest**2
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


class StateSource:
    """The messages with the same joints: those of one publisher, unless several contradict.

    Attributes
    ----------
    joint_names : tuple of str
        The joints.
    newest : Message
        The newest message.
    """

    def __init__(self, joint_names: tuple[str, ...], clock: RobotClock) -> None:
        self.joint_names, self._clock = joint_names, clock
        self.newest: Message
        # The planning thread reads a copy of them.
        self._kept: deque[Message] = deque(maxlen=int(Tracking.window / Tracking.spacing))
        self._latest: deque[Message] = deque(maxlen=3)
        self._conflict, self._conflict_time = "", -float("inf")
        # The samples as of a message: one goal asks for them ten times.
        self._sampled: tuple[tuple[Message, float, bool], MeasuredSamples] | None = None

    @property
    def state(self) -> JointState:
        """The state in the newest message; raises a `GoalError` if it is unusable."""
        state: JointState = self.newest.read(self.joint_names)
        return state

    def receive(self, message: Message) -> None:
        """Keep a message, unless it hardly differs in time from the last one that was kept."""
        last, spacing = (self._kept[-1] if self._kept else None), Tracking.spacing
        # After a stall, many are received at once.
        if (
            last is None
            or message.received - last.received >= spacing
            or self._clock.time(message) - self._clock.time(last) >= spacing
        ):
            self._kept.append(message)
        self.newest = message
        self._latest.append(message)
        with suppress(GoalError):
            if found := self._disagreement():
                self._conflict, self._conflict_time = found, message.received

    def samples(self) -> MeasuredSamples:
        """The usable states of the last moments."""
        messages, last, clock = list(self._kept), self.newest, self._clock
        key, sampled = (last, clock.offset, clock.is_usable), self._sampled
        if sampled is not None and sampled[0] == key:
            return sampled[1]
        if messages and last is not messages[-1]:
            messages.append(last)
        times, positions, newest = [], [], clock.time(last)
        for message in messages:
            time = clock.time(message)
            if max(last.received - message.received, newest - time) > Tracking.window:
                continue
            with suppress(GoalError):
                positions.append(message.read(self.joint_names).positions)
                times.append(time)
        shape = (-1, len(self.joint_names))
        found = MeasuredSamples(np.array(times), np.reshape(positions, shape))
        self._sampled = key, found
        return found

    def conflict(self) -> str:
        """How two publishers disagreed in the last moments; empty if they did not."""
        since = self.newest.received - self._conflict_time
        return self._conflict if since <= Tracking.window else ""

    def _disagreement(self) -> str:
        """How a message differs from the two of another publisher around it; empty if not."""
        latest = self._latest
        if len(latest) < 3 or latest[2].number != latest[0].number + 1:
            return ""
        q, own, end = (one.read(self.joint_names).positions for one in latest)
        before, other, after = map(self._clock.time, latest)
        span, since = after - before, other - before
        expected = q + (end - q) * (since / span if span > 0.0 else 0.0)
        excess = np.abs(own - expected) - Tracking.max_disagreement
        excess -= Tracking.max_acceleration * max(abs(span), abs(since)) ** 2
        j = int(excess.argmax())
        if not excess[j] > 0.0:
            return ""
        return _contradiction(self.joint_names[j], expected[j], own[j], since)


def _overlap_conflict(one: StateSource, other: StateSource) -> str:
    """How the joints that two sources share differ; empty if they do not."""
    shared = [name for name in one.joint_names if name in other.joint_names]
    samples = [source.samples() for source in (one, other)]
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
        if abs(first - second) > Tracking.max_reversal + uncertain:
            return _contradiction(name, first, second, 0.0)
    return ""


class LateStateError(GoalError):
    """The newest state is too old; a newer one may come soon."""


class MeasuredStates:
    """Keeps the states of the last moments.

    A robot may send its joints in several messages. Then a state is that of the newest time for
    which all joints are known; the positions of joints that are sent at other times are
    interpolated.

    Parameters
    ----------
    receipt_clock :
        The clock of message ages [s]: never set back.
    node_clock :
        The clock of the node [s].
    fetch :
        Called before the newest state is used; adds messages that still wait in a queue.

    Attributes
    ----------
    clock : RobotClock
        The clock of motions and of the times of states.
    joint_names : tuple of str
        The joints whose state is needed.
    n_incomplete : int
        Messages that have none of these joints.
    n_unusable : int
        Messages that were rejected when a goal needed them.
    """

    max_sources = 30
    """Most sets of joints that messages may have."""

    def __init__(
        self,
        receipt_clock: Clock,
        node_clock: Clock,
        fetch: Callable[[], None] = lambda: None,
    ) -> None:
        self.joint_names: tuple[str, ...] = ()
        self.n_incomplete = self.n_unusable = 0
        self._receipt_clock = receipt_clock
        self._fetch = fetch
        self.clock = RobotClock(receipt_clock, node_clock)
        self._sources: dict[tuple[str, ...], StateSource] = {}
        # Reads the newest message with each further joint.
        self._others: dict[str, Read] = {}

    def expect(self, joint_names: Sequence[str]) -> None:
        """Set the joints whose state is needed, and discard the states of others."""
        if self.joint_names:
            self._fetch()  # messages that still wait are discarded, too
        self.joint_names = tuple(joint_names)
        self._sources = {}

    def receive(
        self,
        joint_names: Collection[str],
        read: Read,
        stamp: float = 0.0,
        age: float = 0.0,
        number: int = 0,
    ) -> None:
        """Keep a message with all, or some, of the joints.

        Parameters
        ----------
        joint_names : collection of str
            The joints of the message.
        read : callable
            Returns the state of some of them; raises a `GoalError` if it is unusable.
        stamp : float
            When the state was measured by the clock of the robot [s]; 0 if unknown.
        age : float
            Time since the message was received [s].
        number : int
            How many messages its publisher has sent by now; 0 if unknown.
        """
        given = frozenset(joint_names)
        own = tuple(name for name in self.joint_names if name in given)
        if len(own) < len(given):
            self._others |= dict.fromkeys(given.difference(own), read)
            for name in list(self._others)[: -INPUT_LIMITS.joints]:
                del self._others[name]
        if not own:
            self.n_incomplete += 1
            return
        source = self._sources.get(own) or StateSource(own, self.clock)
        source.receive(self.clock.message(read, age, stamp, number))
        if own not in self._sources:
            # The planning thread may be reading the old ones.
            newest = sorted(self._sources.values(), key=lambda one: -one.newest.received)
            kept = newest[: self.max_sources - 1]
            self._sources = {one.joint_names: one for one in [*kept, source]}

    @property
    def others(self) -> dict[str, float]:
        """The newest usable positions of further joints by name.

        They count however old they are: grippers may send theirs on a change only.
        """
        self._fetch()
        found = {}
        for name, read in list(self._others.items()):
            with suppress(GoalError):
                found[name] = float(read((name,)).positions[0])
        return found

    @property
    def age(self) -> float | None:
        """Age of the oldest message that is needed [s]; None if a joint has none."""
        sources, missing = self._chosen()
        if missing or not sources:
            return None
        return self._receipt_clock() - min(one.newest.received for one in sources)

    @property
    def newest_time(self) -> float:
        """Time of the newest state by the clock of the robot [s]; 0 if there is none."""
        sources, missing = self._chosen()
        if missing or not sources:
            return 0.0
        return min(self.clock.time(one.newest) for one in sources)

    def newest(self, timeout: float, *, fetch: bool = True) -> JointState:
        """The newest state.

        Parameters
        ----------
        timeout : float
            Age above which a message is too old [s]; 0 accepts any.
        fetch : bool
            Whether messages that wait are read first.

        Raises
        ------
        LateStateError
            If it is too old.
        GoalError
            If there is none, it is unusable, or the last ones contradict each other.
        """
        if fetch:
            self._fetch()
        sources, missing = self._chosen()
        if missing or not sources:
            ignored = f" ({self.n_incomplete} without them were ignored)" * bool(self.n_incomplete)
            raise GoalError(
                "the present state is not known: no joint_states message with the joints "
                f"{quote_names(missing)} has arrived{ignored}"
            )
        oldest = min(sources, key=lambda one: one.newest.received)
        age = self._receipt_clock() - oldest.newest.received
        if 0.0 < timeout < age:
            which = f" with {quote_names(oldest.joint_names)}" if len(sources) > 1 else ""
            raise LateStateError(
                f"the present state is not known: the newest joint_states message{which} is "
                f"{age:.3g} s old, at most {timeout:g} s (parameter state_timeout) is accepted"
            )
        try:
            state = self._state(sources)
        except GoalError:
            self.n_unusable += 1
            raise
        contradiction = self.history().contradiction(self.joint_names)
        if contradiction := contradiction or self._conflict():
            raise GoalError(
                f"the present state is not known: {contradiction}; check that only one node "
                "publishes them, then send the goal again"
            )
        return state

    def history(self) -> MeasuredSamples:
        """The usable states of the last moments."""
        sources, missing = self._chosen()
        if missing or not sources:
            return MeasuredSamples(np.zeros(0), np.zeros((0, len(self.joint_names))))
        parts = [source.samples() for source in sources]
        if len(parts) == 1:
            return parts[0]
        n = len(self.joint_names)
        if any(len(part.times) == 0 for part in parts):
            return MeasuredSamples(np.zeros(0), np.zeros((0, n)))
        slowest = min(parts, key=lambda part: len(part.times))
        begin, end = max(p.times[0] for p in parts), min(p.times[-1] for p in parts)
        inside = slowest.times[(slowest.times >= begin) & (slowest.times < end)]
        times = np.append(inside, end)
        positions = np.empty((len(times), n))
        for source, part in zip(sources, parts, strict=True):
            for k, name in enumerate(source.joint_names):
                column = np.interp(times, part.times, part.positions[:, k])
                positions[:, self.joint_names.index(name)] = column
        return MeasuredSamples(times, positions)

    def _state(self, sources: Sequence[StateSource]) -> JointState:
        """The newest state of some sources, which together have all joints."""
        states = [source.state for source in sources]
        if len(states) == 1:
            return states[0]
        velocities = {
            name: v
            for source, state in zip(sources, states, strict=True)
            for name, v in zip(source.joint_names, state.velocities, strict=True)
        }
        names = self.joint_names
        return JointState(names, self.history().positions[-1], [velocities[n] for n in names])

    def _chosen(self) -> tuple[list[StateSource], list[str]]:
        """The fewest present sources with all joints, and the joints that have none."""
        # Most robots have such a one, and a stop asks for it eight times.
        whole = self._sources.get(self.joint_names)
        if whole is not None and whole in self._live():
            return [whole], []
        every = sorted(self._sources.values(), key=lambda one: -len(one.joint_names))
        chosen, missing = list[StateSource](), list[str]()
        for name in self.joint_names:
            having = [source for source in every if name in source.joint_names]
            if not having:
                missing.append(name)
                continue
            newest = max(source.newest.received for source in having)
            live = [s for s in having if newest - s.newest.received <= Tracking.window]
            if not any(source in chosen for source in live):
                chosen.append(live[0])
        return chosen, missing

    def _live(self) -> list[StateSource]:
        """The sources that are not silent while others send."""
        every = list(self._sources.values())
        newest = max(source.newest.received for source in every)
        return [one for one in every if newest - one.newest.received <= Tracking.window]

    def _conflict(self) -> str:
        """How several publishers of a joint contradict each other; empty if they do not."""
        live = self._live()
        for source in live:
            if found := source.conflict():
                return found
        for one, other in combinations(live, 2):
            if found := _overlap_conflict(one, other):
                return found
        return ""

    def velocities(self, state: JointState) -> FloatArray:
        """Velocities of the robot [rad/s or m/s], shape (n_joints,); exactly 0 for joints at rest.

        They are computed from positions: reported velocities are noisy, and many robots report
        none.
        """
        samples = self.history()
        times, positions = samples.times, samples.positions
        v, spread = np.array(state.velocities), np.ptp([*positions, state.positions], axis=0)
        span = float(np.ptp(times)) if len(times) else 0.0
        rough = np.where(spread > Tracking.rest_spread, spread / max(span, Tracking.spacing), 0.0)
        if len(times) < 3 or span < Tracking.min_span:
            return np.where(np.abs(v) <= Tracking.rest_velocity, rough, v)
        since = times - times.mean()
        slope = since @ positions / (since @ since)
        moving = np.abs(slope) > Tracking.rest_slope
        if moving.any():
            # For a decelerating robot, the mean slope differs from the present velocity.
            newest = times >= times[-1] - Tracking.min_span
            now = np.linalg.pinv(np.vander(times[newest] - times[-1], 3))[1] @ positions[newest]
            slope = np.where(moving, now, 0.0)
        return np.where(np.abs(v) > Tracking.clear_velocity, v, np.where(moving, slope, rough))
