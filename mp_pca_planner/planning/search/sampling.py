# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Collision-free paths between two configurations by OMPL."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from ...arrays import FloatArray
from ...exceptions import MissingDependencyError, require

# OMPL has one seed and one log level per process: one thread at a time makes sources of random
# numbers. The log level stays.
_LOCK = threading.Lock()
_BEYOND = np.pi  # Range beyond the ends of joints without limits [rad].
# Longest distance by which a tree grows at once [rad or m], and shortcuts that are tried at most.
_RANGE, _N_SHORTCUTS = 0.5, 50


def missing_planner() -> str:
    """What is missing for the search; empty if OMPL can be imported."""
    try:
        require("ompl.base", "ompl", "the search for detours")
    except MissingDependencyError as error:
        return str(error)
    return ""


def sampled_path(
    collides: Callable[[FloatArray], bool],
    bounds: tuple[FloatArray, FloatArray],
    ends: tuple[FloatArray, FloatArray],
    should_stop: Callable[[], bool] = lambda: False,
    *,
    seed: int = 1,
    step: float = 0.1,
    max_checks: int = 100_000,
    smooths: bool = False,
) -> FloatArray | None:
    """Find a path by RRT-Connect, and shorten it.

    The same arguments give the same path, in any thread, unless `should_stop` ends the search.

    Parameters
    ----------
    collides : callable
        Whether a configuration is in collision.
    bounds : tuple of (array, shape (n_joints,))
        Least and largest positions.
    ends : tuple of (array, shape (n_joints,))
        Start and goal.
    should_stop : callable
        Whether to end the search.
    seed : int
        Seed of the random numbers, at least 1.
    step : float
        Distance between the configurations of a path that are checked [rad or m].
    max_checks : int
        Largest number of configurations that are checked.
    smooths : bool
        Whether the corners of the path are rounded.

    Returns
    -------
    path : array, shape (n_points, n_joints), or None
        Points of the path, with straight lines between them; None if none was found.

    Raises
    ------
    MissingDependencyError
        If OMPL is not installed.
    """
    base, geometric, util = (
        require(f"ompl.{name}", "ompl", "the search for detours")
        for name in ("base", "geometric", "util")
    )
    n_joints, n_checks = ends[0].size, 0

    def is_free(state: Any) -> bool:
        nonlocal n_checks
        n_checks += 1
        return not collides(np.array(state[0:n_joints]))

    def ends_now() -> bool:
        return n_checks > max_checks or should_stop()

    setup: Any = None
    try:
        with _LOCK:
            # It logs an error when the seed is set again, but uses it.
            util.setLogLevel(util.LogLevel.LOG_NONE)
            util.RNG.setSeed(seed)
            setup = geometric.SimpleSetup(_space(base, bounds, ends, step))
            setup.setStateValidityChecker(is_free)
            setup.setStartAndGoalStates(*(_state(setup, end) for end in ends))
            planner = geometric.RRTConnect(setup.getSpaceInformation())
            planner.setRange(_RANGE)
            setup.setPlanner(planner)
            # A search that ends at once: its sources of random numbers are made by then.
            setup.solve(base.PlannerTerminationCondition(lambda: True))
            simplifier = geometric.PathSimplifier(setup.getSpaceInformation())
        setup.solve(base.PlannerTerminationCondition(ends_now))
        if not setup.haveExactSolutionPath():
            return None
        path = setup.getSolutionPath()
        simplifier.reduceVertices(path)
        simplifier.partialShortcutPath(path, _N_SHORTCUTS, _N_SHORTCUTS // 2)
        simplifier.reduceVertices(path)
        if smooths:
            simplifier.smoothBSpline(path, 4)
        return np.array([state[0:n_joints] for state in path.getStates()])
    finally:
        # Without this, the setup and its checker keep each other.
        if setup is not None:
            setup.setStateValidityChecker(lambda state: True)


def _space(
    base: Any,
    bounds: tuple[FloatArray, FloatArray],
    ends: tuple[FloatArray, FloatArray],
    step: float,
) -> Any:
    """The space of configurations, which contains both ends."""
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    low = np.where(np.isfinite(bounds[0]), np.minimum(low, bounds[0]), low - _BEYOND)
    high = np.where(np.isfinite(bounds[1]), np.maximum(high, bounds[1]), high + _BEYOND)
    space, box = base.RealVectorStateSpace(low.size), base.RealVectorBounds(low.size)
    for i in range(low.size):
        box.setLow(i, float(low[i]))
        box.setHigh(i, float(high[i]))
    space.setBounds(box)
    space.setLongestValidSegmentFraction(min(step / space.getMaximumExtent(), 1.0))
    return space


def _state(setup: Any, q: FloatArray) -> Any:
    state = setup.getStateSpace().allocState()
    state[0 : q.size] = q.tolist()
    return state
