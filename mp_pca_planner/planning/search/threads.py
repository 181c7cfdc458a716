# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One thread for linear algebra while a planner works.

Its matrices are small: with two threads on two cores, which wait for each other, plans with many
weights were measured to take 2 to 3 times as long.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
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
