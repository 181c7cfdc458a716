# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options of the parts of the planner, each number with its range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

from ..arrays import check_number
from ..exceptions import GoalError


def within(default: Any, low: float, high: float, *, is_whole: bool = False) -> Any:
    """A number, or a tuple of numbers, with its range."""
    return field(default=default, metadata={"range": (low, high), "is_whole": is_whole})


class Checked:
    """Options whose numbers are compared with their ranges.

    Raises
    ------
    GoalError
        If an option is out of its range.
    """

    def __post_init__(self) -> None:
        for one in fields(self):  # type: ignore[arg-type]
            value, limits = getattr(self, one.name), one.metadata.get("range")
            if limits is None:
                continue
            for number in value if isinstance(value, tuple) else (value,):
                is_whole = one.metadata["is_whole"]
                check_number(number, one.name, GoalError, *limits, is_whole=is_whole)


@dataclass(frozen=True)
class SolverOptions(Checked):
    """Stopping criteria and step limits of the solver.

    Attributes
    ----------
    tolerance : float
        Stop when a step is predicted to lower the objective by less than this share of it.
    max_iterations : int
        Largest number of evaluations of the program.
    should_stop : callable
        Called after each step; True ends the search, because time ran out or it was cancelled.
    first_radius : float
        First radius of the trust region, in scaled unknowns (about 1). Without naturalness, optima
        are tens of standard deviations of the weights away, and the quadratic model of efforts is
        accurate over that distance.
    first_radius_to_equalities : float
        The same with equalities, which may be far more curved.
    expected_share : float
        Share of the predicted change of the gradient in the scale of the curvature's update, 0 to
        1: it steadies the update as Powell's damping does. The default took the fewest passes on
        four arms.
    min_cosine : float
        Below this cosine of the angle between a step and the change of the gradient, the curvature
        is not updated: the update would be out of proportion.
    min_radius : float
        Radius of the trust region at which the search ends.
    """

    tolerance: float = within(3e-5, 0.0, 1.0)
    max_iterations: int = within(60, 1, 1_000_000, is_whole=True)
    should_stop: Callable[[], bool] = bool  # never
    first_radius: float = within(30.0, 1e-6, 1e6)
    first_radius_to_equalities: float = within(10.0, 1e-6, 1e6)
    expected_share: float = within(0.3, 0.0, 1.0)
    min_cosine: float = within(0.05, 0.0, 1.0)
    min_radius: float = within(1e-9, 0.0, 1.0)


@dataclass(frozen=True)
class SelectionOptions(Checked):
    """Options of the selection among primitives.

    Attributes
    ----------
    relative_score : float
        Largest in-span score of a primitive that is considered, as a multiple of the least one.
    near_score : float
        All primitives below this score are considered: the request is like their demonstrations.
    max_considered : int
        Largest number of primitives that are considered. Among many alike, the least expected
        cost of the 12 nearest is 0.6 % above that of the 32 nearest, in the mean.
    usual_error : float
        Usual relative error of expected costs: three standard deviations of optimised to expected
        costs among the primitives of a request (1.6 % for the human-like arm).
    max_contenders : int
        Largest number of primitives with which motions are planned.
    max_named : int
        Largest number of primitives that a message names.
    n_kept_tables : int
        Number of primitives whose precomputed tables stay in memory, those used last.
    """

    relative_score: float = within(1.25, 1.0, 1e6)
    near_score: float = within(1.0, 0.0, 1e6)
    max_considered: int = within(12, 1, 1000, is_whole=True)
    usual_error: float = within(0.05, 0.0, 10.0)
    max_contenders: int = within(5, 1, 1000, is_whole=True)
    max_named: int = within(8, 1, 1000, is_whole=True)
    n_kept_tables: int = within(1000, 1, 1_000_000, is_whole=True)


@dataclass(frozen=True)
class PoseSearchOptions(Checked):
    """Options of the search for configurations that reach a pose.

    Attributes
    ----------
    max_steps : int
        Largest number of steps from a start.
    reached : float
        Largest error at which the steps end [m or rad].
    first_damping, max_damping : float
        Levenberg–Marquardt damping of the first step, and at which the search ends.
    n_known : int
        Number of known configurations to search from.
    n_random : int
        Number of further starts, spread over the limits, if the known ones lead to no solution.
    distinct : float
        Configurations nearer to each other than this count as one [rad or m].
    """

    max_steps: int = within(30, 1, 10_000, is_whole=True)
    reached: float = within(1e-8, 1e-12, 1e-6)
    first_damping: float = within(1e-3, 1e-12, 1e6)
    max_damping: float = within(1e8, 1.0, 1e12)
    n_known: int = within(4, 0, 1000, is_whole=True)
    n_random: int = within(40, 0, 10_000, is_whole=True)
    distinct: float = within(0.05, 0.0, 10.0)


@dataclass(frozen=True)
class ClearanceOptions(Checked):
    """Options of clearance constraints.

    Attributes
    ----------
    distance : float
        Least clearance [m], with a margin for the motion between the phases.
    share_of_ends : float
        Largest share of the distance at the fixed ends of the motion, 0 to 1.
    reach : float
        Distance [m] from which on the change of a distance is not predicted.
    n_phases : int
        Number of phases at which pairs are constrained at first.
    n_more : int
        Number of phases that are added during each further collision.
    """

    distance: float = within(3e-3, 0.0, 1.0)
    share_of_ends: float = within(0.5, 0.0, 1.0)
    reach: float = within(0.03, 0.0, 10.0)
    n_phases: int = within(40, 1, 1000, is_whole=True)
    n_more: int = within(5, 1, 100, is_whole=True)


@dataclass(frozen=True)
class PathOptions(Checked):
    """Options of the search for collision-free paths.

    Attributes
    ----------
    n_paths : int
        Largest number of searches for paths, with different seeds; their time usually ends earlier.
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

    n_paths: int = within(60, 1, 10_000, is_whole=True)
    reach: float = within(1.0, 0.0, 100.0)
    n_checks: int = within(5_000, 1, 10_000_000, is_whole=True)
    share_of_search: float = within(0.75, 0.0, 1.0)
    share_of_comparison: float = within(0.2, 0.0, 1.0)
    max_detour: float = within(1.5, 1.0, 100.0)
    step: float = within(0.07, 1e-4, 1.0)
    fine_step: float = within(0.03, 1e-4, 1.0)


@dataclass(frozen=True)
class DetourOptions(Checked):
    """Options of motions near collision-free paths.

    Attributes
    ----------
    n_control_points : int
        Control points of the B-splines of each joint.
    spread : float
        Deviation of these from the path with the cost of naturalness [rad or m].
    n_phases : int
        Number of points of the path that the B-splines follow.
    min_naturalness : float
        Least weight ρ of deviations from the path. Without it, the program takes too many passes.
    shares_of_solving : tuple of float
        Shares of the remaining time for a motion near a path, 0 to 1, in turn until it may be
        executed. The rest is for checks and for other paths.
    tolerance : float
        Tolerance of the solver: most of the cost depends on the path that was found.
    radius : float
        First radius of the trust region: clearances are curved.
    """

    n_control_points: int = within(6, 1, 100, is_whole=True)
    spread: float = within(0.3, 1e-6, 100.0)
    n_phases: int = within(80, 10, 10_000, is_whole=True)
    min_naturalness: float = within(0.005, 1e-12, 1e6)
    shares_of_solving: tuple[float, ...] = within((0.2, 0.8), 0.0, 1.0)
    tolerance: float = within(1e-3, 0.0, 1.0)
    radius: float = within(1.0, 1e-6, 1e6)


@dataclass(frozen=True)
class BrakingOptions(Checked):
    """Options of braking and of the timing of slow motions.

    Attributes
    ----------
    shares : tuple of float
        Shares of the limits of acceleration and jerk for braking, tried in turn. Hard braking needs
        least distance to position limits, soft braking least effort.
    jerk_shares : tuple of float
        Shares of the jerk, tried in turn until braking in whole steps stays within the jerk limit.
    stopping_time, ramp_time : float
        Times in which braking ends velocities and accelerations that have no limits [s].
    clearance : float
        Factor on least durations: motions with a distance to limits are checked several times
        faster.
    max_stretches : int
        Largest number of times that a motion is slowed because its points exceed a limit.
    """

    shares: tuple[float, ...] = within((0.999, 0.8, 0.6, 0.4, 0.2, 0.1, 0.05), 0.0, 1.0)
    jerk_shares: tuple[float, ...] = within((1.0, 0.8, 0.6, 0.4, 0.2), 0.0, 1.0)
    stopping_time: float = within(0.1, 1e-3, 100.0)
    ramp_time: float = within(0.05, 1e-3, 100.0)
    clearance: float = within(1.001, 1.0, 10.0)
    max_stretches: int = within(10, 1, 1000, is_whole=True)
