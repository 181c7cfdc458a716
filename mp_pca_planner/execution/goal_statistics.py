# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Counts of goals and the times they took."""

from __future__ import annotations

import threading
from collections import defaultdict, deque

import numpy as np

from ..motion.goal import Goal

# Latencies are expected to stay below this multiple of the 90th percentile; before the first goal
# of a kind, below the second number [s].
_MARGIN, _INITIAL_LATENCY = 1.5, 0.1


class GoalStatistics:
    """Counts of goals and their latest times, for several threads.

    Attributes
    ----------
    n_served, n_refused : int
        Goals with and without a published motion.
    n_under_way : int
        Goals that were the same as the one under way.
    n_overtaken : int
        Goals that were preempted by newer ones, or by a stop.
    """

    def __init__(self) -> None:
        self.n_served = self.n_refused = self.n_under_way = self.n_overtaken = 0
        self._lock = threading.Lock()
        # Enough times for a 99th percentile; older ones are discarded, because they may be
        # outdated.
        self._solve_times: deque[float] = deque(maxlen=1000)
        # By kind: sequences take longer than single goals.
        self._latencies: dict[type[Goal], deque[float]] = defaultdict(lambda: deque(maxlen=100))
        self._expected: dict[type[Goal], float] = {}

    def served(self, kind: type[Goal], solve_time: float, latency: float) -> None:
        """Count a goal whose motion was published.

        Parameters
        ----------
        kind : type
            Kind of the goal.
        solve_time : float
            Time that the planner took [s].
        latency : float
            Time from choosing the start to publishing [s].
        """
        with self._lock:
            self.n_served += 1
            self._solve_times.append(solve_time)
            recent = self._latencies[kind]
            recent.append(latency)
            self._expected[kind] = _MARGIN * float(np.percentile(recent, 90))

    def refused(self) -> None:
        """Count a goal that could not be served."""
        with self._lock:
            self.n_refused += 1

    def under_way(self) -> None:
        """Count a goal that is the same as the one under way."""
        with self._lock:
            self.n_under_way += 1

    def overtaken(self) -> None:
        """Count a goal that was preempted."""
        with self._lock:
            self.n_overtaken += 1

    def expected_latency(self, kind: type[Goal]) -> float:
        """Time from choosing a start to publishing that few goals of a kind exceed [s]."""
        return self._expected.get(kind, _INITIAL_LATENCY)

    def solve_time_percentiles(self) -> dict[str, float]:
        """Percentiles of the latest solve times by name [s]; none before the first goal."""
        with self._lock:
            times = list(self._solve_times)
        if not times:
            return {}
        return {f"solve_time_p{rank}_s": float(np.percentile(times, rank)) for rank in (50, 90, 99)}
