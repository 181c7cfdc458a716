# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Measured joint states of the last moments, and whether their stamps are times of the node."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True, eq=False)
class _Sample:
    """A message: when it was measured and received [s], and its numbers, or why it is unusable."""

    time: float
    received: float
    positions: FloatArray
    velocities: FloatArray
    flaw: str = ""


class _Source:
    """The messages with the same joints."""

    def __init__(self, joint_names: tuple[str, ...], message_names: tuple[str, ...]) -> None:
        self.joint_names = joint_names
        self._index = [message_names.index(name) for name in joint_names]
        self.newest: _Sample
        self._kept: deque[_Sample] = deque(maxlen=int(_WINDOW / _SPACING))

    def receive(
        self, q: Sequence[float], v: Sequence[float], n_names: int, time: float, received: float
    ) -> None:
        sample = self._read(q, v, n_names, time, received)
        if not self._kept or received - self._kept[-1].received >= _SPACING:
            self._kept.append(sample)
        self.newest = sample

    def _read(
        self, q: Sequence[float], v: Sequence[float], n_names: int, time: float, received: float
    ) -> _Sample:
        none = np.zeros(len(self._index))
        for field, values, lengths in (
            ("positions", q, (n_names,)),
            ("velocities", v, (0, n_names)),
        ):
            if len(values) not in lengths:
                flaw = f"it names {n_names} joints and has {len(values)} {field}"
                return _Sample(time, received, none, none, flaw)
        positions = np.array([q[i] for i in self._index], dtype=float)
        for name, position in zip(self.joint_names, positions, strict=True):
            if not math.isfinite(position):
                flaw = f"the position of joint '{name}' is {position}"
                return _Sample(time, received, none, none, flaw)
        # A velocity that is NaN was not measured: positions decide whether the robot moves.
        reported = np.nan_to_num([v[i] for i in self._index], posinf=0.0, neginf=0.0) if v else none
        return _Sample(time, received, positions, reported)

    def velocities(self) -> FloatArray:
        """Velocities of the joints [rad/s or m/s]; exactly 0 for joints at rest.

        They are computed from positions: reported velocities are noisy, and many robots report
        none.
        """
        last, v = self.newest, self.newest.velocities
        usable = [s for s in self._kept if not s.flaw and last.received - s.received <= _WINDOW]
        usable += [] if usable and usable[-1] is last else [last]
        times, q = np.array([s.time for s in usable]), np.array([s.positions for s in usable])
        spread, span = np.ptp(q, axis=0), float(np.ptp(times))
        rough = np.where(spread > _REST_SPREAD, spread / max(span, _SPACING), 0.0)
        if len(times) < 3 or span < _MIN_SPAN:
            return np.where(np.abs(v) <= _REST_VELOCITY, rough, v)
        since = times - times.mean()
        slope = since @ q / (since @ since)
        moving = np.abs(slope) > _REST_SLOPE
        if moving.any():
            # For a decelerating robot, the mean slope differs from the present velocity.
            newest = times >= min(times[-1] - _MIN_SPAN, np.sort(times)[-3])
            now = np.linalg.pinv(np.vander(times[newest] - times[-1], 3))[1] @ q[newest]
            slope = np.where(moving, now, 0.0)
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
        names, received, now = tuple(joint_names), self._receipt_clock() - age, self._node_clock()
        if stamp:
            self.stamps.compare(stamp, now, received)
        source = self._sources.get(names)
        if source is None:
            own = tuple(name for name in self.joint_names if names.count(name) == 1)
            source = _Source(own, names)
            if len(self._sources) < INPUT_LIMITS.joints:
                self._sources[names] = source
        if len(source.joint_names) < len(names) == len(positions):
            pairs = zip(names, positions, strict=True)
            own = source.joint_names
            self.others |= {n: q for n, q in pairs if n not in own and math.isfinite(q)}
        if not source.joint_names:
            self.n_incomplete += 1
            return
        measured = stamp if stamp and self.stamps.is_usable else now - age
        source.receive(positions, velocities, len(names), measured, received)
        self.n_unusable += bool(source.newest.flaw)

    @property
    def age(self) -> float | None:
        """Age of the oldest message that is needed [s]; None if a joint has none."""
        sources = self._newest_sources()
        if not sources or None in sources:
            return None
        return self._receipt_clock() - min(one.newest.received for one in sources if one)

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
        found = self._newest_sources()
        sources = [one for one in found if one is not None]
        if len(sources) < len(self.joint_names) or not sources:
            pairs = zip(self.joint_names, found, strict=True)
            missing = [name for name, one in pairs if one is None]
            ignored = f" ({self.n_incomplete} without them were ignored)" * bool(self.n_incomplete)
            raise GoalError(
                "the present state is not known: no joint_states message with the joints "
                f"{quote_names(missing)}, each once, has arrived{ignored}"
            )
        oldest = min(sources, key=lambda one: one.newest.received)
        age = self._receipt_clock() - oldest.newest.received
        if 0.0 < timeout < age:
            which = f" with {quote_names(oldest.joint_names)}" if len(set(sources)) > 1 else ""
            raise UnconfirmedError(
                f"the present state is not known: the newest joint_states message{which} is "
                f"{age:.3g} s old, at most {timeout:g} s (parameter state_timeout) is accepted"
            )
        columns = np.zeros((3, len(self.joint_names)))
        velocities = {one: one.velocities() for one in set(sources)}
        for k, (name, source) in enumerate(zip(self.joint_names, sources, strict=True)):
            sample = source.newest
            if sample.flaw:
                raise GoalError(
                    f"the present state is not known: the newest joint_states message can't be "
                    f"used: {sample.flaw}; one finite number for each joint is accepted"
                )
            place = source.joint_names.index(name)
            columns[:, k] = [
                x[place] for x in (sample.positions, sample.velocities, velocities[source])
            ]
        q, reported, v = columns
        time = min(source.newest.time for source in sources)
        return MeasuredState(JointState(self.joint_names, q, reported), v, time, age)

    def _newest_sources(self) -> list[_Source | None]:
        """The source of each joint; None for a joint without one."""
        return [self._source_of(name) for name in self.joint_names]

    def _source_of(self, name: str) -> _Source | None:
        having = [one for one in self._sources.values() if name in one.joint_names]
        last = max((one.newest.received for one in having), default=0.0)

        # A second publisher of some joints does not replace the complete state.
        def rank(one: _Source) -> tuple[bool, int, float]:
            received = one.newest.received
            return last - received <= _WINDOW, len(one.joint_names), received

        return max(having, key=rank, default=None)
