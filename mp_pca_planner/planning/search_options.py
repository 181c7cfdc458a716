# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the search for motions."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchOptions:
    """Options of the planner's search; the defaults suit arms of 4 to 14 joints.

    Attributes
    ----------
    near_expected : float
        From this naturalness on, motions stay near the expected one: one start is enough, warm
        starts do not help, and the first attempt has only those limits in the program that the
        expected motion comes near, none if it keeps them.
    near_limit : float
        Share of a limit from which on the expected motion is near it.
    effort_weight : float
        The unit of naturalness is the cost of the expected motion, or this multiple of the decrease
        of the objective along one standard deviation of the weights, if that is larger. At ρ = 1
        and to first order, motions are displaced by at most 1 / effort_weight standard deviations
        (benchmarks/naturalness.py).
    max_refinements : int
        Largest number of times that constraints are refined after a check on the dense grid.
    share_of_fixed : float
        Share of the time for planning with a requested duration, 0 to 1. The rest is for finding a
        feasible duration.
    time_for_checks : float
        Time that is kept for the last checks and for a slow motion where no other was found, for
        each segment; at most 0.4 of all [s].
    share_in_shortest : float
        Cost of the planner's objectives as a share of that of time, in the search for the shortest
        duration.
    scaling_margin : float
        Factor on the duration at which the expected motion just keeps the limits at the nodes, for
        the peaks between them.
    share_of_descent : float
        Share of the time for descent from the expected motion among obstacles, 0 to 1, before
        detours are tried.
    detour_tolerance : float
        Tolerance of the solver on detours: most of the cost depends on the path that was found.
    detour_radius : float
        First radius of the trust region on detours, where clearances are curved.
    duration_margin : float
        Factor on the reported shortest duration, so that a motion with that duration is found
        again.
    max_stretch : float
        Largest factor of a free duration where an attempt does not meet the limits.
    naturalness_steps : tuple of float
        Values to which naturalness is raised if the reduction of effort caused a limit violation.
        At the last value, effort hardly counts.
    n_warm_starts : int
        Number of demonstrations of a primitive between whose ends motions are precomputed.
    n_configurations : int
        Number of configurations that reach a pose to which motions are planned, the most natural
        first.
    n_route_configurations : int
        Number of configurations that reach a pose of a sequence that are compared.
    here : float
        Initial targets within this distance of the robot count as passed [rad or m].
    max_stretches : int
        Largest number of times that durations of joined segments are stretched, for each share.
    passing_shares : tuple of float
        Shares to which passing velocities are reduced in turn if joined segments exceed a position
        limit.
    duration_spread : float
        Change of the logarithm of a segment's duration with the same cost as one standard deviation
        of the weights.
    bend_spread : float
        Passing a target at speed bends segments more than in demonstrations from rest to rest.
        Therefore this number of their standard deviations counts as one (benchmarks/sequences.py).
    min_spread : float
        Least standard deviation of a joint in that cost [rad or m].
    n_kept_tables : int
        Number of primitives whose precomputed tables stay in memory, those used last.
    warm_start_score : float
        Largest in-span score of a request that uses warm starts. Requests like the demonstrations
        have at most 2. Those between arbitrary configurations have 6 and more, and may end in poor
        optima.
    """

    near_expected: float = 0.1
    near_limit: float = 0.7
    effort_weight: float = 8.0
    max_refinements: int = 8
    share_of_fixed: float = 0.6
    time_for_checks: float = 0.015
    share_in_shortest: float = 1e-3
    scaling_margin: float = 1.02
    share_of_descent: float = 0.15
    detour_tolerance: float = 1e-3
    detour_radius: float = 1.0
    duration_margin: float = 1.002
    max_stretch: float = 10.0
    naturalness_steps: tuple[float, ...] = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)
    n_configurations: int = 3
    n_route_configurations: int = 6
    here: float = 0.01
    max_stretches: int = 12
    passing_shares: tuple[float, ...] = (1.0, 0.5, 0.25, 0.0)
    duration_spread: float = 0.3
    bend_spread: float = 18.0
    min_spread: float = 0.01
    n_warm_starts: int = 20
    n_kept_tables: int = 500
    warm_start_score: float = 3.0
