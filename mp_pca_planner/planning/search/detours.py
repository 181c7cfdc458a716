# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Detours: motions that start from collision-free paths, where descent finds no motion.

A path is a straight line in joint space, or else one of RRT-Connect.

The program lowers the cost within limits and clearances, as for any other motion.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from ...arrays import FloatArray
from ...exceptions import MissingDependencyError, require
from ..context import Budget, Context
from ..options import FREE, SolverOptions
from ..program.compile import (
    MIN_NATURALNESS,
    SCALING_MARGIN,
    Setting,
    basis_along,
    first_setting,
    rates_along,
)
from ..program.constraints import least_distances
from ..request import Request, timing_for
from ..time_scaling import kinematic_stretch, slowdown
from .candidate import Candidate, attempt, checked, least_violation, sampled

# OMPL has one seed and one log level per process: one thread at a time makes sources of random
# numbers. The log level stays.
_LOCK = threading.Lock()
_BEYOND = np.pi  # Range beyond the ends of joints without limits [rad].
# Longest distance by which a tree grows at once [rad or m], and shortcuts that are tried at most.
_RANGE, _N_SHORTCUTS = 0.5, 50

PATH_REACH = 1.0
"""Distance beyond the ends, joint by joint, within which the first search stays [rad or m].

Those after the first three reach as much further, and so on. Most paths are near the ends: another
seed finds them sooner than a search farther away.
"""

# Searches for paths at most, with different seeds; the first of them are compared, and the shortest
# path is tried first. Searches of the same reach, and the configurations that the first of them
# check; those that reach farther check as many more.
_N_PATHS, _N_COMPARED, _N_OF_REACH, _N_CHECKS = 60, 4, 3, 6_000
# Share of the remaining time at which the search for a path is cut off.
_SHARE_OF_SEARCH = 0.75
# Configurations that are checked before the clock is read again: it takes a tenth of a check.
_CHECKS_PER_STOP = 8
# Length of a path, relative to the straight line, up to which it is not compared.
_MAX_DETOUR = 1.5
# Distance between the configurations of a line that are checked [rad or m], and the same where the
# motion rests at the corners of a path.
_STEP, _FINE_STEP = 0.07, 0.03
# Tolerance of the solver: most of the cost depends on the path. Sum of constraint violations that
# counts as rounding: less than the margins of constraints. Clearances are curved, so its first
# radius is small.
_TOLERANCE, _FEASIBLE, _FIRST_RADIUS = 3e-3, 1e-4, 1.5


def missing_planner() -> str:
    """What is missing for the search; empty if OMPL is installed. It is not imported for this."""
    is_known = "ompl" in sys.modules
    if find_spec("ompl") if is_known else _is_on_disk():
        return ""
    return str(MissingDependencyError("ompl", "", "the search for detours"))


@cache
def _is_on_disk() -> bool:
    """Whether OMPL can be found in the folders of Python, which takes 0.1 ms."""
    return find_spec("ompl") is not None


def along_path(context: Context, request: Request, budget: Budget) -> Candidate | None:
    """The best motion of one segment along a collision-free path; None if there is no path.

    If it is not valid, it has the corners of the path, at which a slow motion may rest.
    """
    found, path = list[Candidate](), None
    score = request.segments[0].expected.in_span_score
    request = replace(request, timing=timing_for(context.options, score, is_detour=True))
    for points in paths(context, (request.start.positions, request.goal.positions), budget):
        path = points if path is None else path
        found.append(_near_path(context, request, points, budget))
        if found[-1].is_valid:
            return found[-1]
        if budget.is_late():
            break
    if path is None:
        return None
    return replace(least_violation(found), corners=corners_of(context, path, budget))


def _near_path(context: Context, request: Request, path: FloatArray, budget: Budget) -> Candidate:
    """The motion of least cost near a path, or else the one along it."""
    segment, options = request.segments[0], context.options
    basis = basis_along(segment, path, request.naturalness)
    duration = request.duration
    if request.duration_is_free:
        least = SCALING_MARGIN * kinematic_stretch(context.limits, rates_along(segment, basis))
        at_least = 0.0 if request.timing == FREE else duration
        duration = min(max(at_least, least), context.longest)
        _, check = sampled(context, [basis.motion(request.start, request.goal, duration)])
        duration = min(duration * slowdown(check.violations), context.longest)
    motion = basis.motion(request.start, request.goal, duration)
    found = list[Candidate]()
    if not budget.is_late():
        solver = SolverOptions(_TOLERANCE, _FEASIBLE, first_radius=_FIRST_RADIUS, goes_back=True)
        if request.is_shortest:
            setting = replace(first_setting(context, request, basis), solver=solver)
        else:
            naturalness = max(request.naturalness, MIN_NATURALNESS)
            is_timed = request.duration_is_free and request.timing == FREE
            setting = Setting(
                (basis,), (motion,), naturalness, options.objectives, solver, is_timed
            )
        found.append(attempt(context, request, setting, budget))
        if found[0].is_valid:
            return found[0]
    found.append(checked(context, request, (basis,), (motion,)))
    return least_violation(found)


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
    collision, limits = context.collision, context.limits
    assert collision is not None
    bounds = np.minimum(limits.lower, ends[0]), np.maximum(limits.upper, ends[0])
    least = least_distances(np.array(ends), collision)
    if np.any(least < 0.0):  # an end is in collision
        return
    if _is_free(collision.collides, *ends, _STEP):
        yield np.array(ends)
    checks = (collision.body_pairs.check(least, hulls=hulls) for hulls in (True, False))
    collides = next((one for one in checks if not any(map(one, ends))), None)
    if collides is None or missing_planner():  # OMPL would wait for other ends
        return
    longest = _MAX_DETOUR * _length(np.array(ends))
    found: list[FloatArray] = []
    for seed in range(1, _N_PATHS + 1):
        search = budget.part(_SHARE_OF_SEARCH)
        # Few searches take far longer than most: another seed is often faster.
        times = 1 + (seed - 1) // _N_OF_REACH
        low, high = np.min(ends, axis=0), np.max(ends, axis=0)
        near = (
            np.maximum(low - PATH_REACH * times, bounds[0]),
            np.minimum(high + PATH_REACH * times, bounds[1]),
        )
        path = sampled_path(
            collides,
            near,
            ends,
            search.is_late,
            seed=seed,
            step=_STEP,
            max_checks=_N_CHECKS * times,
        )
        if path is not None:
            found.append(path)
        is_last = seed >= _N_COMPARED or search.is_late()
        if found and (is_last or _length(found[-1]) <= longest):
            yield from sorted(found, key=_length)
            found = []
        if search.is_late():
            return


def corners_of(context: Context, path: FloatArray, budget: Budget) -> FloatArray:
    """The points of a path between which straight lines are free; all once time has run out."""
    assert context.collision is not None
    collides, step = context.collision.collides, _FINE_STEP
    kept = [0]
    while kept[-1] < len(path) - 1:
        here, k = path[kept[-1]], len(path) - 1
        while k > kept[-1] + 1 and (
            budget.is_late() or not _is_free(collides, here, path[k], step)
        ):
            k -= 1
        kept.append(k)
    return path[kept]


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
        require(f"ompl.{name}", "", "the search for detours")
        for name in ("base", "geometric", "util")
    )
    n_joints, n_checks, is_over = ends[0].size, 0, False

    def is_free(state: Any) -> bool:
        nonlocal n_checks, is_over
        n_checks += 1
        if n_checks % _CHECKS_PER_STOP == 0:
            is_over = is_over or should_stop()
        # Once time has run out, the simplifier finds no shortcut and ends.
        return not (is_over or collides(np.array(state[0:n_joints])))

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
