# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Measured states of the last moments, converted only when they are needed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from itertools import combinations

import numpy as np

from ...arrays import FloatArray
from ...exceptions import GoalError, quote_names
from ...input_limits import INPUT_LIMITS
from ...motion.goal import JointState
from ..options import FollowingOptions
from .state_sources import (
    Clock,
    MeasuredSamples,
    Read,
    RobotClock,
    StateMessage,
    StateSource,
    overlap_conflict,
)


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
    options :
        Parameters.

    Attributes
    ----------
    options
        As given.
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
        options: FollowingOptions | None = None,
    ) -> None:
        self.joint_names: tuple[str, ...] = ()
        self.n_incomplete = self.n_unusable = 0
        self._receipt_clock = receipt_clock
        self._fetch = fetch
        self.options = options = options or FollowingOptions()
        self.clock = RobotClock(receipt_clock, node_clock, options)
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
        message = StateMessage(read, own, self.clock.receipt(age, stamp), number)
        source = self._sources.get(own) or StateSource(own, self.options)
        source.receive(message, self.clock)
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
        return min(self.clock.time(one.newest.receipt) for one in sources)

    def newest(self, timeout: float) -> JointState:
        """The newest state.

        Parameters
        ----------
        timeout : float
            Age above which a message is too old [s]; 0 accepts any.

        Raises
        ------
        LateStateError
            If it is too old.
        GoalError
            If there is none, it is unusable, or the last ones contradict each other.
        """
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
        contradiction = self.history().contradiction(self.joint_names, self.options)
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
        window = self.options.window
        parts = [source.samples(self.clock, window) for source in sources]
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
        states = [source.newest.state for source in sources]
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
        every = sorted(self._sources.values(), key=lambda one: -len(one.joint_names))
        chosen, missing = list[StateSource](), list[str]()
        for name in self.joint_names:
            having = [source for source in every if name in source.joint_names]
            if not having:
                missing.append(name)
                continue
            newest = max(source.newest.received for source in having)
            live = [s for s in having if newest - s.newest.received <= self.options.window]
            if not any(source in chosen for source in live):
                chosen.append(live[0])
        return chosen, missing

    def _conflict(self) -> str:
        """How several publishers of a joint contradict each other; empty if they do not."""
        every = list(self._sources.values())
        newest = max(source.newest.received for source in every)
        live = [s for s in every if newest - s.newest.received <= self.options.window]
        for source in live:
            if found := source.conflict():
                return found
        for one, other in combinations(live, 2):
            if found := overlap_conflict(one, other, self.clock, self.options):
                return found
        return ""

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
