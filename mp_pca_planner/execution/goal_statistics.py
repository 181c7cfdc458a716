# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What became of the goals so far."""

from __future__ import annotations

import threading
from collections import defaultdict, deque

import numpy as np

from ..motion.goal import Goal

# Enough for a 99th percentile; older ones say little about the present.
_N_REMEMBERED = 1000
# The latest of each kind tell how long the next one of it may take, …
_N_RECENT = 100
# … with a margin; before the first there is only this guess [s].
_MARGIN = 1.5
_FIRST_LATENCY = 0.1


class GoalStatistics:
    """Counts of goals and their latest times, for several threads.

    Attributes
    ----------
    n_served, n_refused : int
        Goals with and without a published motion.
    n_under_way : int
        Goals that asked for what was under way already.
    n_overtaken : int
        Goals that were given up for newer ones, or by a stop.
    """

    def __init__(self) -> None:
        self.n_served = 0
        self.n_refused = 0
        self.n_under_way = 0
        self.n_overtaken = 0
        self._lock = threading.Lock()
        self._solve_times: deque[float] = deque(maxlen=_N_REMEMBERED)
        # Sequences take longer than single goals.
        self._latencies: defaultdict[type[Goal], deque[float]] = defaultdict(
            lambda: deque(maxlen=_N_RECENT)
        )
        self._expected: defaultdict[type[Goal], float] = defaultdict(lambda: _FIRST_LATENCY)

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
        """Count a goal that asked for what was under way already."""
        with self._lock:
            self.n_under_way += 1

    def overtaken(self) -> None:
        """Count a goal that was given up."""
        with self._lock:
            self.n_overtaken += 1

    def expected_latency(self, kind: type[Goal]) -> float:
        """Time from choosing a start to publishing that a kind of goal hardly ever exceeds [s]."""
        return self._expected[kind]

    def solve_time_percentiles(self) -> dict[str, float]:
        """Percentiles of the latest solve times by name [s]; none before the first goal."""
        with self._lock:
            times = list(self._solve_times)
        if not times:
            return {}
        ranks = (50, 90, 99)
        values = np.percentile(times, ranks)
        return {f"solve_time_p{r}_s": float(v) for r, v in zip(ranks, values, strict=True)}
