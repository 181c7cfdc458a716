# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What became of the goals so far."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np

# Enough for a 99th percentile; older ones say little about the present.
_N_REMEMBERED = 1000
# The latest of them tell how long the next goal may take, …
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
    n_overtaken : int
        Goals that were given up for newer ones, or by a stop.
    """

    def __init__(self) -> None:
        self.n_served = 0
        self.n_refused = 0
        self.n_overtaken = 0
        self._expected = _FIRST_LATENCY
        self._lock = threading.Lock()
        self._solve_times: deque[float] = deque(maxlen=_N_REMEMBERED)
        self._latencies: deque[float] = deque(maxlen=_N_REMEMBERED)

    def served(self, solve_time: float, latency: float) -> None:
        """Count a goal whose motion was published.

        Parameters
        ----------
        solve_time : float
            Time that the planner took [s].
        latency : float
            Time from choosing the start to publishing [s].
        """
        with self._lock:
            self.n_served += 1
            self._solve_times.append(solve_time)
            self._latencies.append(latency)
            recent = list(self._latencies)[-_N_RECENT:]
            self._expected = _MARGIN * float(np.percentile(recent, 90))

    def refused(self) -> None:
        """Count a goal that could not be served."""
        with self._lock:
            self.n_refused += 1

    def overtaken(self) -> None:
        """Count a goal that was given up."""
        with self._lock:
            self.n_overtaken += 1

    @property
    def expected_latency(self) -> float:
        """Time from choosing a start to publishing that is hardly ever exceeded [s]."""
        return self._expected

    def solve_time_percentiles(self) -> dict[str, float]:
        """Percentiles of the latest solve times by name [s]; none before the first goal."""
        with self._lock:
            times = list(self._solve_times)
        if not times:
            return {}
        ranks = (50, 90, 99)
        values = np.percentile(times, ranks)
        return {f"solve_time_p{r}_s": float(v) for r, v in zip(ranks, values, strict=True)}
