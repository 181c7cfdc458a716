# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Collision-free paths between two configurations.

A path is a straight line in joint space, or else one of RRT-Connect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ...arrays import FloatArray
from ..context import Context
from ..program.clearance import least_distances
from .budget import Budget
from .sampling import SamplingOptions, missing_planner, sampled_path


def paths(
    context: Context, ends: tuple[FloatArray, FloatArray], budget: Budget
) -> Iterator[FloatArray]:
    """Different paths between two configurations, the cheapest to find first.

    Made one by one: each takes far longer than a motion near it.

    Parameters
    ----------
    context : Context
        Robot, limits and options of the planner, with a collision model.
    ends : tuple of (array, shape (n_joints,))
        Start and goal.
    budget : Budget
        The time for all of it.

    Yields
    ------
    path : array, shape (n_points, n_joints)
        Points with straight lines between them.
    """
    collision, limits, options = context.collision, context.limits, context.options.paths
    assert collision is not None
    bounds = np.minimum(limits.lower, ends[0]), np.maximum(limits.upper, ends[0])
    least = least_distances(np.array(ends), collision, context.options.clearance)
    if np.any(least < 0.0):  # an end is in collision
        return
    if _is_free(collision.collides, *ends, options.step):
        yield np.array(ends)
    checks = (collision.check(least, hulls=hulls) for hulls in (True, False))
    collides = next((one for one in checks if not any(map(one, ends))), None)
    if collides is None or missing_planner():  # OMPL would wait for other ends
        return
    longest = options.max_detour * _length(np.array(ends))
    found: list[FloatArray] = []
    early = budget.share(options.share_of_comparison)
    for seed in range(1, options.n_paths + 1):
        search = budget.share(options.share_of_search)
        # Few searches take far longer than most: another seed is often faster.
        sampling = SamplingOptions(seed, options.step, max_checks=options.n_checks * seed)
        near = _around(ends, options.reach * seed, bounds)
        path = sampled_path(collides, near, ends, sampling, search.is_over)
        if path is not None:
            found.append(path)
        is_last = seed == options.n_paths or early.is_over() or search.is_over()
        if found and (is_last or _length(found[-1]) <= longest):
            yield from sorted(found, key=_length)
            found = []
        if search.is_over():
            return


def corners_of(context: Context, path: FloatArray) -> FloatArray:
    """The points of a path between which straight lines are free of collisions."""
    assert context.collision is not None
    collides, step = context.collision.collides, context.options.paths.fine_step
    kept = [0]
    while kept[-1] < len(path) - 1:
        here, k = path[kept[-1]], len(path) - 1
        while k > kept[-1] + 1 and not _is_free(collides, here, path[k], step):
            k -= 1
        kept.append(k)
    return path[kept]


def _around(
    ends: tuple[FloatArray, FloatArray], reach: float, bounds: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Least and largest positions within a reach of the ends, and within bounds."""
    low, high = np.min(ends, axis=0) - reach, np.max(ends, axis=0) + reach
    return np.maximum(low, bounds[0]), np.minimum(high, bounds[1])


def _length(path: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _is_free(
    collides: Callable[[FloatArray], bool], start: FloatArray, goal: FloatArray, step: float
) -> bool:
    """Whether a straight line is free of collisions, coarsely first."""
    n = 1 + int(np.ceil(np.linalg.norm(goal - start) / step))
    shares = np.linspace(0.0, 1.0, n + 1)
    order = np.concatenate([shares[first::8] for first in (4, 0, 2, 6, 1, 3, 5, 7)])
    return not any(collides(start + share * (goal - start)) for share in order)
