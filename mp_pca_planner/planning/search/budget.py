# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time budgets of planning."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Budget:
    """The time that a search may take.

    Attributes
    ----------
    deadline : float
        When it ends, by the clock of `time.perf_counter` [s].
    is_cancelled : callable
        Returns whether the result is no longer needed.
    """

    deadline: float
    is_cancelled: Callable[[], bool] = lambda: False

    def is_over(self) -> bool:
        """Whether the time ran out or the search was cancelled."""
        return time.perf_counter() > self.deadline or self.is_cancelled()

    def share(self, part: float) -> Budget:
        """A budget of a share of the remaining time, 0 to 1."""
        now = time.perf_counter()
        return replace(self, deadline=now + part * max(self.deadline - now, 0.0))
