# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What planning may use: its time, and the threads of linear algebra.

The matrices are small: with two threads on two cores, which wait for each other, plans with many
weights were measured to take 2 to 3 times as long as with one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from typing import Any


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Use one thread in BLAS during a block, then as many as before.

    No effect if threadpoolctl is not installed, as in ROS workspaces that lack it.
    """
    several = []
    for library in _libraries():
        if (n_threads := library.num_threads or 1) > 1:
            several.append((library, n_threads))
            library.set_num_threads(1)
    try:
        yield
    finally:
        for library, n_threads in several:
            library.set_num_threads(n_threads)


@cache
def _libraries() -> list[Any]:
    """The BLAS libraries of the process; NumPy's and SciPy's are loaded when planning begins."""
    try:
        from threadpoolctl import ThreadpoolController
    except ImportError:
        return []
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


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
