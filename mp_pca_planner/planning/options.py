# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""All options of the planner, in one tree with :class:`PlannerOptions` at its root.

Each number has a range, which is checked when an object is made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any

from ..arrays import check_choice, check_number, check_type
from ..exceptions import GoalError, shown
from .objectives import Objective, effort
from .path_constraints import PathConstraint

BASES = ("pca", "bspline")
AUTO, DEMONSTRATED, SHORTEST, FREE = "auto", "demonstrated", "shortest", "free"
TIMINGS = (AUTO, DEMONSTRATED, SHORTEST, FREE)
REAL_TIME, OPTIMAL = "real_time", "optimal"
MODES = (REAL_TIME, OPTIMAL)
MOST_STARTS = 5
"""Largest number of starts: expected weights, mean shape, and those of three similar motions."""


def within(default: Any, low: float, high: float, *, is_whole: bool = False) -> Any:
    """A number, or a tuple of numbers, with its range."""
    return field(default=default, metadata={"range": (low, high), "is_whole": is_whole})


class Checked:
    """Options whose numbers are compared with their ranges.

    Raises
    ------
    GoalError
        If an option is unknown or out of its range.
    """

    def __post_init__(self) -> None:
        for one in fields(self):  # type: ignore[arg-type]
            value, limits = getattr(self, one.name), one.metadata.get("range")
            if limits is None or (value is None and one.default is None):
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
    feasible : float
        Sum of constraint violations that counts as rounding, in shares of the limits and SI units.
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
    feasible: float = within(1e-6, 0.0, 1.0)
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
    n_kept_tables : int
        Number of primitives whose precomputed tables stay in memory, those used last.
    """

    relative_score: float = within(1.25, 1.0, 1e6)
    near_score: float = within(1.0, 0.0, 1e6)
    max_considered: int = within(12, 1, 1000, is_whole=True)
    usual_error: float = within(0.05, 0.0, 10.0)
    max_contenders: int = within(5, 1, 1000, is_whole=True)
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
    n_compared : int
        Number of known configurations to search from for a single pose. The costs of their expected
        motions are compared.
    n_known : int
        Number of known configurations to search from for each pose of a sequence.
    n_random : int
        Number of further starts, spread over the limits, if the known ones lead to no solution.
    distinct : float
        Configurations nearer to each other than this count as one [rad or m].
    """

    max_steps: int = within(30, 1, 10_000, is_whole=True)
    reached: float = within(1e-8, 1e-12, 1e-6)
    first_damping: float = within(1e-3, 1e-12, 1e6)
    max_damping: float = within(1e8, 1.0, 1e12)
    n_compared: int = within(12, 0, 1000, is_whole=True)
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
    feasible : float
        Sum of constraint violations that counts as rounding: less than the margins of constraints.
    radius : float
        First radius of the trust region: clearances are curved.
    """

    n_control_points: int = within(6, 1, 100, is_whole=True)
    spread: float = within(0.3, 1e-6, 100.0)
    n_phases: int = within(80, 10, 10_000, is_whole=True)
    min_naturalness: float = within(0.005, 1e-12, 1e6)
    shares_of_solving: tuple[float, ...] = within((0.2, 0.8), 0.0, 1.0)
    tolerance: float = within(1e-3, 0.0, 1.0)
    feasible: float = within(1e-4, 0.0, 1.0)
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


@dataclass(frozen=True)
class SearchOptions(Checked):
    """Options of the planner's search; the defaults suit arms of 4 to 14 joints.

    Attributes
    ----------
    near_expected : float
        From this naturalness on, motions stay near the expected one: one start is enough, and
        the first attempt has only those limits in the program that the expected motion comes near,
        none if it keeps them.
    near_limit : float
        Share of a limit from which on the expected motion is near it.
    effort_weight : float
        The unit of naturalness is the cost of the expected motion, or this multiple of the decrease
        of the objective along one standard deviation of the weights, if that is larger. At ρ = 1
        and to first order, motions are displaced by at most 1 / effort_weight standard deviations
        (benchmarks/naturalness.py).
    max_refinements : int
        Largest number of times that constraints are refined after a check on the dense grid.
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
    max_stretch : float
        Largest factor of a free duration where an attempt does not meet the limits.
    max_worse : int
        Number of attempts with one basis, after the least violation, that end the recovery by
        longer durations.
    naturalness_steps : tuple of float
        Values to which naturalness is raised if the reduction of effort caused a limit violation.
        At the last value, effort hardly counts.
    n_configurations : int
        Number of configurations that reach a pose to which motions are planned, until one is found.
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
    n_path_phases : int
        Number of phases of a segment at which path constraints are kept at first.
    bend_spread : float
        Passing a target at speed bends segments more than in demonstrations from rest to rest.
        Therefore this number of their standard deviations counts as one (benchmarks/sequences.py).
    min_spread : float
        Least standard deviation of a joint in that cost [rad or m].
    usual_correction : float
        Usual magnitude of the correction by B-splines [rad or m]; larger if the primitive fits
        worse.
    n_kept_tables : int
        Number of primitives whose precomputed tables stay in memory, those used last.
    """

    near_expected: float = within(0.1, 0.0, 1e12)
    near_limit: float = within(0.7, 0.0, 100.0)
    effort_weight: float = within(8.0, 0.0, 1e6)
    max_refinements: int = within(8, 1, 1000, is_whole=True)
    time_for_checks: float = within(0.025, 0.0, 1e6)
    share_in_shortest: float = within(1e-3, 0.0, 1.0)
    scaling_margin: float = within(1.02, 1.0, 10.0)
    share_of_descent: float = within(0.15, 0.0, 1.0)
    max_stretch: float = within(10.0, 1.0, 1e6)
    max_worse: int = within(3, 1, 1000, is_whole=True)
    naturalness_steps: tuple[float, ...] = within((1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0), 0.0, 1e12)
    n_configurations: int = within(3, 1, 100, is_whole=True)
    n_route_configurations: int = within(6, 1, 100, is_whole=True)
    here: float = within(0.01, 0.0, 1.0)
    max_stretches: int = within(12, 1, 1000, is_whole=True)
    passing_shares: tuple[float, ...] = within((1.0, 0.5, 0.25, 0.0), 0.0, 1.0)
    duration_spread: float = within(0.3, 1e-6, 100.0)
    n_path_phases: int = within(40, 2, 10_000, is_whole=True)
    bend_spread: float = within(18.0, 1e-6, 1e6)
    min_spread: float = within(0.01, 1e-9, 10.0)
    usual_correction: float = within(0.02, 1e-6, 10.0)
    n_kept_tables: int = within(500, 1, 1_000_000, is_whole=True)


@dataclass(frozen=True)
class PlannerOptions(Checked):
    """Options of planning.

    Attributes
    ----------
    basis : {'pca', 'bspline'}
        Components of the primitive, or B-splines with 6 control points per joint ([P]). If
        components have no motion within the limits, B-splines are added, and the plan reports it.
    objectives : tuple of (float, Objective)
        Objectives: running costs and their weights, see :mod:`.objectives`. Effort alone unless
        given.
    constraints : tuple of PathConstraint
        Constraints on every configuration of a motion, see :mod:`.path_constraints`.
    timing : {'auto', 'demonstrated', 'shortest', 'free'}
        Duration of goals that don't specify one: as predicted from the demonstrations; the shortest
        within all limits; or the one with the least objective. 'auto': as predicted for requests
        like the demonstrations. Elsewhere (in-span score above 3, or a detour) it is free, but not
        longer than predicted unless the limits require it.
    naturalness : float, optional
        ρ: cost of a motion one standard deviation away from the expected one, as a share of the
        cost of the expected motion (or more, see `SearchOptions.effort_weight`). 0: least effort
        alone, whose motions may be far from the demonstrations. It is raised if a motion violates
        limits otherwise. None: 1 for requests like the demonstrations, (3 / score)³ where the
        in-span score is above 3, see :func:`.naturalness_for`.
    max_in_span_score : float
        In-span score above which no motion is executable: the request is too far from the
        demonstrations. 0: none is too far.
    sample_period : float
        Time between the points of a trajectory [s].
    max_solve_time : float
        Longest time for planning [s]; some of it is kept for the last checks.
    n_starts : int
        Number of starts of the solver, at most 5, for a small naturalness (ρ < 0.1), where there
        may be several optima. The best solution found in the available time is used. Five starts
        instead of one find a motion better by over 0.5 % for 3 % of the problems of four robots, at
        most 12 % better, in about four times the time.
    n_nodes : int
        Quadrature nodes.
    allow_nonzero_end_velocity : bool
        Whether the controller accepts motions that don't end at rest.
    solver : SolverOptions
        Stopping criteria of the solver. Its `should_stop` cancels planning: the best motion found
        until then is returned.
    search, selection, poses, clearance, paths, detours, braking
        Options of the parts of the planner.

    Raises
    ------
    GoalError
        If an option is unknown or out of its range.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> options = mp.PlannerOptions(naturalness=0.1, timing="shortest")
    >>> options.basis
    'pca'
    """

    basis: str = "pca"
    objectives: tuple[tuple[float, Objective], ...] = ((1.0, effort),)
    constraints: tuple[PathConstraint, ...] = ()
    timing: str = AUTO
    naturalness: float | None = within(None, 0.0, 1e12)
    max_in_span_score: float = within(0.0, 0.0, 1e6)
    sample_period: float = 0.01
    max_solve_time: float = 1.0
    n_starts: int = within(1, 1, MOST_STARTS, is_whole=True)
    n_nodes: int = within(28, 4, 1000, is_whole=True)
    allow_nonzero_end_velocity: bool = False
    solver: SolverOptions = field(default_factory=SolverOptions)
    search: SearchOptions = field(default_factory=SearchOptions)
    selection: SelectionOptions = field(default_factory=SelectionOptions)
    poses: PoseSearchOptions = field(default_factory=PoseSearchOptions)
    clearance: ClearanceOptions = field(default_factory=ClearanceOptions)
    paths: PathOptions = field(default_factory=PathOptions)
    detours: DetourOptions = field(default_factory=DetourOptions)
    braking: BrakingOptions = field(default_factory=BrakingOptions)

    def __post_init__(self) -> None:
        check_choice(self.basis, "basis", GoalError, BASES)
        check_choice(self.timing, "timing", GoalError, TIMINGS)
        moving = self.allow_nonzero_end_velocity
        check_type(moving, "allow_nonzero_end_velocity", GoalError, bool)
        check_type(self.objectives, "objectives", GoalError, Sequence)
        if not len(self.objectives):
            raise GoalError("at least one objective with a weight is needed, got none")
        for pair in self.objectives:
            is_pair = isinstance(pair, Sequence) and len(pair) == 2
            if not (is_pair and callable(pair[1])):
                raise GoalError(
                    "objectives must be pairs of a weight and an objective, such as "
                    f"(1.0, effort), got {shown(pair)}"
                )
            check_number(pair[0], "the weight of an objective", GoalError, 1e-12, 1e12)
        check_type(self.constraints, "constraints", GoalError, Sequence)
        for one in self.constraints:
            if not hasattr(one, "values"):
                raise GoalError(
                    "constraints must be path constraints, such as Upright('gripper', 0.3), "
                    f"got {shown(one)}"
                )
        check_number(self.sample_period, "sample_period [s]", GoalError, 1e-4, 1.0)
        check_number(self.max_solve_time, "max_solve_time [s]", GoalError, 1e-9)
        for part in fields(self):
            if part.default_factory is not MISSING:
                made = type(part.default_factory())
                check_type(getattr(self, part.name), part.name, GoalError, made)
        super().__post_init__()
