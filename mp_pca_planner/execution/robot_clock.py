# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The clock of the robot, as the stamps of its joint states show it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from .options import FollowingOptions

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
