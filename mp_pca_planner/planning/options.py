# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The options of the planner and of its solver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..arrays import check_choice, check_number, check_type
from ..exceptions import GoalError, shown
from .objectives import Objective, effort
from .path_constraints import PathConstraint

BASES = ("pca", "bspline")
AUTO, DEMONSTRATED, SHORTEST, FREE = "auto", "demonstrated", "shortest", "free"
TIMINGS = (AUTO, DEMONSTRATED, SHORTEST, FREE)
REAL_TIME, OPTIMAL = "real_time", "optimal"
MODES = (REAL_TIME, OPTIMAL)
MAX_NATURALNESS = 1.0
"""Largest naturalness ρ: motions like the demonstrations."""
MOST_STARTS = 5
"""Largest number of starts: expected weights, mean shape, and those of three similar motions."""


@dataclass(frozen=True)
class SolverOptions:
    """When the solver stops, and its first step.

    Attributes
    ----------
    tolerance : float
        Stop when a step is predicted to lower the objective by less than this share of it.
    feasible : float
        Sum of constraint violations that counts as rounding, in shares of the limits and SI units.
    max_iterations : int
        Largest number of evaluations of the program.
    first_radius : float
        First radius of the trust region, in scaled unknowns (about 1). Without naturalness, optima
        are tens of standard deviations of the weights away, and the quadratic model of efforts is
        accurate over that distance.
    goes_back : bool
        Whether it goes back by one step, for a shorter one, where the linearised constraints
        contradict each other. Otherwise the search ends there.
    """

    tolerance: float = 3e-5
    feasible: float = 1e-6
    max_iterations: int = 60
    first_radius: float = 30.0
    goes_back: bool = False


@dataclass(frozen=True)
class PlannerOptions:
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
        ρ, 0 to 1: cost of a motion one standard deviation away from the expected one, as a share of
        the cost of the expected motion, or more. 0: least effort alone, whose motions may be far
        from the demonstrations. None: 1 for requests like the demonstrations, (3 / score)³ where
        the in-span score is above 3, see :func:`.naturalness_for`.
    max_in_span_score : float
        In-span score above which no motion is executable: the request is too far from the
        demonstrations. 0: none is too far.
    demonstrated_margin : float
        Motions from rest to rest take at most this multiple of the largest demonstrated velocity
        and acceleration of each joint. With timing 'shortest' or 'free', this holds for
        accelerations without a limit only; with a requested duration or passing time, not at all.
        0: no such limits.
    sample_period : float
        Time between the points of a trajectory [s].
    max_solve_time : float
        Longest time for planning [s], unless `Planner.plan` is given another budget; some of it is
        kept for the last checks.
    n_starts : int
        Number of starts of the solver, at most 5, for a small naturalness (ρ < 0.1), where there
        may be several optima. The best solution found in the available time is used. Five starts
        instead of one find a motion better by over 0.5 % for 3 % of the problems of four robots, at
        most 12 % better, in about four times the time.
    allow_nonzero_end_velocity : bool
        Whether the controller accepts motions that don't end at rest.

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
    naturalness: float | None = None
    max_in_span_score: float = 0.0
    demonstrated_margin: float = 1.2
    sample_period: float = 0.01
    max_solve_time: float = 1.0
    n_starts: int = 1
    allow_nonzero_end_velocity: bool = False

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
        if self.naturalness is not None:
            check_number(self.naturalness, "naturalness", GoalError, 0.0, MAX_NATURALNESS)
        check_number(self.max_in_span_score, "max_in_span_score", GoalError, 0.0, 1e6)
        check_number(self.demonstrated_margin, "demonstrated_margin", GoalError, 0.0, 1e6)
        check_number(self.n_starts, "n_starts", GoalError, 1, MOST_STARTS, is_whole=True)
