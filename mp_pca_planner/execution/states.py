# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Measured joint states of the last moments, and whether their stamps are times of the node."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, quote_names
from ..input_limits import INPUT_LIMITS
from ..motion.goal import JointState

Clock = Callable[[], float]

# Time that states are kept for, and the least between two of them [s].
_WINDOW, _SPACING = 0.3, 0.008
# Reported velocity up to which a robot is at rest, and above which it moves in any case; slope of
# its positions, which has less noise, up to which it is at rest [rad/s or m/s].
_REST_VELOCITY, _CLEAR_VELOCITY, _REST_SLOPE = 0.01, 0.1, 0.003
# Change of a position over the window up to which a joint may be at rest [rad or m], and the time
# that positions must span to give a velocity [s].
_REST_SPREAD, _MIN_SPAN = 0.005, 0.08
# Usual time from a stamp to its receipt at which both clocks agree [s]: messages take a while, and
# simulated time advances in steps.
_LEAST_DELAY, _LARGEST_DELAY = -0.02, 0.1
# Stamps that are compared: their least distance [s], the fewest that show a difference, the most.
_STAMP_SPACING, _FEWEST, _MOST = 0.02, 50, 250


class UnconfirmedError(GoalError):
    """Where the robot is is not known yet; it may be soon."""


class StampClock:
    """Whether the stamps of messages are times of the node's clock.

    A low quantile over many messages is compared, so late messages, stalls of a machine and
    simulated time that advances in steps do not matter.

    Attributes
    ----------
    difference : float
        Usual time from a stamp to its receipt [s].
    is_usable : bool
        Whether the clocks agree; true until enough stamps show that they do not.
    is_certain : bool
        Whether enough stamps were compared.
    """

    def __init__(self) -> None:
        self.difference, self.is_usable, self.is_certain = 0.0, True, False
        self._compared = -math.inf
        self._differences: deque[float] = deque(maxlen=_MOST)

    def compare(self, stamp: float, now: float, received: float) -> None:
        """Compare a stamp with the node's time of its receipt [s].

        Parameters
        ----------
        stamp, now :
            The stamp, and the time by the node's clock [s].
        received :
            The time by a clock that is never set back [s].
        """
        if received - self._compared < _STAMP_SPACING:
            return
        self._compared = received
        self._differences.append(now - stamp)
        every = sorted(self._differences)
        self.difference = every[len(every) // 4]
        self.is_certain = len(every) >= _FEWEST
        is_near = _LEAST_DELAY <= self.difference <= _LARGEST_DELAY
        self.is_usable = is_near or not self.is_certain


@dataclass(frozen=True, eq=False)
class MeasuredState:
    """The newest state of a robot.

    Attributes
    ----------
    state : JointState
        Positions and reported velocities.
    velocities : array, shape (n_joints,)
        Velocities as the positions of the last moments show them, too [rad/s or m/s]; exactly 0 for
        joints at rest.
    time : float
        When it was measured, by the clock of the node [s].
    age : float
        Time since it was received [s].
    """

    state: JointState
    velocities: FloatArray
    time: float
    age: float

    @property
    def positions(self) -> FloatArray:
        """The positions [rad or m], shape (n_joints,)."""
        return self.state.positions

    @property
    def at_rest(self) -> bool:
        """Whether no joint moves."""
        return not self.velocities.any()


class _Sample(NamedTuple):
    """A message: when it was measured and received [s], positions, and reported velocities."""

    time: float
    received: float
    positions: FloatArray
    reported: FloatArray


class _Source:
    """The messages with the same joints: the newest usable one, and whether none is newer."""

    newest: _Sample

    def __init__(self, joint_names: tuple[str, ...], message_names: tuple[str, ...]) -> None:
        self.joint_names, self._n_names = joint_names, len(message_names)
        self._index = [message_names.index(name) for name in joint_names]
        self._kept: deque[_Sample] = deque(maxlen=int(_WINDOW / _SPACING))
        self.received, self.is_usable = 0.0, False

    def receive(
        self, positions: Sequence[float], velocities: Sequence[float], time: float, received: float
    ) -> None:
        n, self.received, self.is_usable = self._n_names, received, False
        if len(positions) != n or len(velocities) not in (0, n):
            return
        q = np.array([positions[i] for i in self._index], dtype=float)
        if not np.isfinite(q).all():
            return
        # A velocity that is NaN was not measured: positions decide whether the robot moves.
        v = [velocities[i] for i in self._index] if velocities else np.zeros_like(q)
        self.newest = _Sample(time, received, q, np.nan_to_num(v, posinf=0.0, neginf=0.0))
        self.is_usable = True
        if not self._kept or received - self._kept[-1].received >= _SPACING:
            self._kept.append(self.newest)

    def velocities(self) -> FloatArray:
        """Velocities of the joints [rad/s or m/s]; exactly 0 for joints at rest.

        They are computed from positions: reported velocities are noisy, and many robots report
        none.
        """
        last, v = self.newest, self.newest.reported
        recent = [s for s in self._kept if s is not last and last.received - s.received <= _WINDOW]
        recent.append(last)
        times, q = np.array([s.time for s in recent]), np.array([s.positions for s in recent])
        spread, span = np.ptp(q, axis=0), float(np.ptp(times))
        rough = np.where(spread > _REST_SPREAD, spread / max(span, _SPACING), 0.0)
        if len(times) < 3 or span < _MIN_SPAN:
            return np.where(np.abs(v) <= _REST_VELOCITY, rough, v)
        since = times - times.mean()
        moving = np.abs(since @ q / (since @ since)) > _REST_SLOPE
        # For a decelerating robot, the mean slope differs from the present velocity.
        newest = times >= min(times[-1] - _MIN_SPAN, np.sort(times)[-3])
        slope = np.linalg.pinv(np.vander(times[newest] - times[-1], 3))[1] @ q[newest]
        return np.where(np.abs(v) > _CLEAR_VELOCITY, v, np.where(moving, slope, rough))


class MeasuredStates:
    """Keeps the joint states of the last moments; a robot may send its joints in several messages.

    Parameters
    ----------
    receipt_clock :
        The clock of message ages [s]: never set back.
    node_clock :
        The clock of the node [s], which may be simulated.

    Attributes
    ----------
    joint_names : tuple of str
        The joints whose state is needed.
    stamps : StampClock
        Whether the stamps are times of the node's clock.
    others : dict of str to float
        The newest positions of further joints [rad or m]. They count however old they are: grippers
        may send theirs on a change only.
    n_incomplete, n_unusable : int
        Messages that had none of the joints, and those with unusable numbers.
    """

    def __init__(self, receipt_clock: Clock, node_clock: Clock) -> None:
        self._receipt_clock, self._node_clock = receipt_clock, node_clock
        self.stamps = StampClock()
        self.n_incomplete = self.n_unusable = 0
        self.expect(())

    def expect(self, joint_names: Sequence[str]) -> None:
        """Set the joints whose state is needed, and discard the states of others."""
        self.joint_names = tuple(joint_names)
        self.others: dict[str, float] = {}
        self._sources: dict[tuple[str, ...], _Source] = {}

    def receive(
        self,
        joint_names: Sequence[str],
        positions: Sequence[float],
        velocities: Sequence[float] = (),
        stamp: float = 0.0,
        age: float = 0.0,
    ) -> None:
        """Keep a message with all, or some, of the joints.

        Parameters
        ----------
        joint_names, positions, velocities :
            As in the message [rad or m, /s]; velocities may be missing or NaN.
        stamp : float
            When the state was measured [s]; 0 if unknown.
        age : float
            Time since the message was received [s].
        """
        names, received = tuple(joint_names), self._receipt_clock() - age
        if stamp:
            self.stamps.compare(stamp, self._node_clock(), received)
        source = self._sources.get(names)
        if source is None:
            own = tuple(name for name in self.joint_names if names.count(name) == 1)
            source = _Source(own, names)
            if len(self._sources) < INPUT_LIMITS.joints:
                self._sources[names] = source
        own = source.joint_names
        if len(own) < len(names) == len(positions):
            pairs = zip(names, positions, strict=True)
            self.others |= {n: q for n, q in pairs if n not in own and math.isfinite(q)}
        if own:
            source.receive(positions, velocities, self.time_of(stamp, age), received)
            self.n_unusable += not source.is_usable
        else:
            self.n_incomplete += 1

    def time_of(self, stamp: float, age: float) -> float:
        """When a message was sent, by the clock of the node [s]: its stamp, or its receipt."""
        return stamp if stamp and self.stamps.is_usable else self._node_clock() - age

    @property
    def age(self) -> float | None:
        """Age of the oldest message that is needed [s]; None if a joint has none."""
        sources = [self._source_of(name) for name in self.joint_names]
        received = [source.received for source in sources if source is not None]
        if not sources or len(received) < len(sources):
            return None
        return self._receipt_clock() - min(received)

    def newest(self, timeout: float) -> MeasuredState:
        """The newest state.

        Parameters
        ----------
        timeout : float
            Age above which a message is too old [s]; 0 accepts any.

        Raises
        ------
        UnconfirmedError
            If it is too old.
        GoalError
            If there is none, or it is unusable.
        """
        found = {name: self._source_of(name) for name in self.joint_names}
        missing = [name for name, source in found.items() if source is None]
        if missing or not found:
            ignored = f" ({self.n_incomplete} without them were ignored)" * bool(self.n_incomplete)
            raise GoalError(
                "the present state is not known: no joint_states message with the joints "
                f"{quote_names(missing)}, each once, has arrived{ignored}"
            )
        sources = list(dict.fromkeys(source for source in found.values() if source is not None))
        oldest = min(sources, key=lambda source: source.received)
        age = self._receipt_clock() - oldest.received
        which = f" with {quote_names(oldest.joint_names)}" if len(sources) > 1 else ""
        if 0.0 < timeout < age:
            raise UnconfirmedError(
                f"the present state is not known: the newest joint_states message{which} is "
                f"{age:.3g} s old, at most {timeout:g} s (parameter state_timeout) is accepted"
            )
        if not all(source.is_usable for source in sources):
            raise GoalError(
                "the present state is not known: the newest joint_states message can't be used; "
                "expected one finite position per joint, and as many velocities or none"
            )
        values = {
            name: column
            for source in sources
            for name, *column in zip(
                source.joint_names,
                source.newest.positions,
                source.newest.reported,
                source.velocities(),
                strict=True,
            )
            if found[name] is source
        }
        q, reported, v = np.array([values[name] for name in self.joint_names]).T
        time = min(source.newest.time for source in sources)
        return MeasuredState(JointState(self.joint_names, q, reported), v, time, age)

    def _source_of(self, name: str) -> _Source | None:
        having = [source for source in self._sources.values() if name in source.joint_names]
        last = max((source.received for source in having), default=0.0)

        # A second publisher of some joints does not replace the complete state.
        def rank(source: _Source) -> tuple[bool, int, float]:
            return last - source.received <= _WINDOW, len(source.joint_names), source.received

        return max(having, key=rank, default=None)
