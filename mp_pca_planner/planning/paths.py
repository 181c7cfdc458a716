# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Collision-free paths between two configurations.

A path is a straight line in joint space, or else one of RRT-Connect; without the extra ``ompl``,
two lines that meet at a random via.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..exceptions import MissingDependencyError
from .budget import Budget
from .clearance import least_distances
from .sampling import SamplingOptions, sampled_path
from .setup import Setup


@dataclass(frozen=True)
class PathOptions:
    """Options of the search for paths.

    Attributes
    ----------
    n_vias : int
        Number of random vias that are tried where there is no sampling planner.
    via_spread : float
        Standard deviation of vias from the middle of the motion [rad or m].
    n_paths : int
        Largest number of searches for paths, with different seeds; mostly their time ends earlier.
    reach : float
        Distance beyond the ends, joint by joint, within which the first search stays [rad or m];
        each further one reaches as much further. Most paths are near the ends.
    n_checks : int
        Number of configurations that the first search checks; each further one checks as many more.
    share_of_search : float
        Share of the remaining time for a path, 0 to 1.
    share_of_comparison : float
        Share of the remaining time for comparing paths, 0 to 1; the shortest is tried first.
    max_detour : float
        Length of a path, relative to the straight line, up to which it is not compared.
    step : float
        Distance between the configurations of a line that are checked [rad or m].
    fine_step : float
        The same where the motion rests at the corners of a path.
    """

    n_vias: int = 40
    via_spread: float = 0.6
    n_paths: int = 60
    reach: float = 1.0
    n_checks: int = 5_000
    share_of_search: float = 0.75
    share_of_comparison: float = 0.2
    max_detour: float = 1.5
    step: float = 0.07
    fine_step: float = 0.03


_OPTIONS = PathOptions()


class PathFinder:
    """Finds collision-free paths for one planner.

    Parameters
    ----------
    setup : Setup
        Robot, limits and options of the planner, with a collision model.

    Attributes
    ----------
    hint : str
        Which extra would help if no path was found; empty if none.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup, self.hint = setup, ""

    def paths(self, ends: tuple[FloatArray, FloatArray], budget: Budget) -> Iterator[FloatArray]:
        """Different paths between two configurations, the cheapest to find first.

        Parameters
        ----------
        ends : tuple of (array, shape (n_joints,))
            Start and goal.
        budget : Budget
            The time for all of it.

        Yields
        ------
        path : array, shape (n_points, n_joints)
            Points with straight lines between them.
        """
        collision, limits = self._setup.collision, self._setup.limits
        assert collision is not None
        bounds = np.minimum(limits.lower, ends[0]), np.maximum(limits.upper, ends[0])
        least = least_distances(np.array(ends), collision)
        if np.any(least < 0.0):  # an end is in collision
            return
        if _is_free(collision.collides, *ends, _OPTIONS.step):
            yield np.array(ends)
        checks = (collision.check(least, hulls=hulls) for hulls in (True, False))
        collides = next((one for one in checks if not any(map(one, ends))), None)
        if collides is None:  # OMPL would wait for other ends
            return
        longest = _OPTIONS.max_detour * _length(np.array(ends))
        found: list[FloatArray] = []
        early = budget.share(_OPTIONS.share_of_comparison)
        for seed in range(1, _OPTIONS.n_paths + 1):
            search = budget.share(_OPTIONS.share_of_search)
            # Few searches take far longer than most: another seed is often faster.
            n_checks = _OPTIONS.n_checks * seed
            options = SamplingOptions(seed, _OPTIONS.step, max_checks=n_checks)
            near = _around(ends, _OPTIONS.reach * seed, bounds)
            try:
                path = sampled_path(collides, near, ends, options, search.is_over)
            except MissingDependencyError as error:
                self.hint = str(error)
                yield from paths_by_vias(collides, bounds, ends, budget.is_over)
                return
            if path is not None:
                found.append(path)
            is_last = seed == _OPTIONS.n_paths or early.is_over() or search.is_over()
            if found and (is_last or _length(found[-1]) <= longest):
                yield from sorted(found, key=_length)
                found = []
            if search.is_over():
                return

    def corners(self, path: FloatArray) -> FloatArray:
        """The points of a path between which straight lines are free of collisions."""
        assert self._setup.collision is not None
        kept = [0]
        while kept[-1] < len(path) - 1:
            here, k = path[kept[-1]], len(path) - 1
            while k > kept[-1] + 1 and not _is_free(
                self._setup.collision.collides, here, path[k], _OPTIONS.fine_step
            ):
                k -= 1
            kept.append(k)
        return path[kept]

    def corners_between(
        self, ends: tuple[FloatArray, FloatArray], budget: Budget
    ) -> FloatArray | None:
        """The corners of the first path, shape (n_corners, n_joints); None if there is none."""
        path = next(self.paths(ends, budget), None)
        return None if path is None else self.corners(path)


def _around(
    ends: tuple[FloatArray, FloatArray], reach: float, bounds: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Least and largest positions within a reach of the ends, and within bounds."""
    low, high = np.min(ends, axis=0) - reach, np.max(ends, axis=0) + reach
    return np.maximum(low, bounds[0]), np.minimum(high, bounds[1])


def _length(path: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def paths_by_vias(
    collides: Callable[[FloatArray], bool],
    bounds: tuple[FloatArray, FloatArray],
    ends: tuple[FloatArray, FloatArray],
    should_stop: Callable[[], bool] = lambda: False,
) -> Iterator[FloatArray]:
    """Collision-free paths of two straight lines in joint space that meet at a random via.

    The same vias are drawn in every call.

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

    Yields
    ------
    path : array, shape (3, n_joints)
        Start, via and goal.
    """
    rng, middle = np.random.default_rng(0), 0.5 * (ends[0] + ends[1])
    for _ in range(_OPTIONS.n_vias):
        if should_stop():
            return
        off = _OPTIONS.via_spread * rng.standard_normal(middle.size)
        via = np.clip(middle + off, *bounds)
        if all(_is_free(collides, end, via, _OPTIONS.step) for end in ends):
            yield np.array([ends[0], via, ends[1]])


def _is_free(
    collides: Callable[[FloatArray], bool], start: FloatArray, goal: FloatArray, step: float
) -> bool:
    """Whether a straight line is free of collisions, coarsely first."""
    n = 1 + int(np.ceil(np.linalg.norm(goal - start) / step))
    shares = np.linspace(0.0, 1.0, n + 1)
    order = np.concatenate([shares[first::8] for first in (4, 0, 2, 6, 1, 3, 5, 7)])
    return not any(collides(start + share * (goal - start)) for share in order)
