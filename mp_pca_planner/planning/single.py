# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Planning of motions to single goals: alternative requests, their bases, recoveries, durations."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import islice

import numpy as np

from ..exceptions import GoalError
from ..motion.goal import JointGoal, JointState
from ..primitives.basis import Basis, BSplineBasis
from ..primitives.primitive import MovementPrimitive
from .attempt import Attempt, attempt, with_costs
from .bases import MotionBasis, component_basis, corrected_basis, spline_basis
from .budget import Budget
from .constraints import LimitTables
from .detours import DetourPlanner
from .fallback import Fallback, FallbackPlanner, Paths
from .motion import Motion
from .objectives import Time
from .plan import FREE, SHORTEST
from .problem import SingleProblem
from .recoveries import Failure, MoreNatural, Recovery, Setting, Slower, WiderBasis
from .request import GoalResolver, Request
from .selection import cost_of, node_states
from .setup import Setup
from .starts import WarmStarts
from .subproblem import TINY
from .time_scaling import least_stretch
from .unknowns import QuadratureTables
from .verdict import Planned, StatedDuration


class BasisChooser:
    """The bases of requests, from the narrowest to the widest, with their precomputed tables.

    Parameters
    ----------
    setup : Setup
        Robot and options of the planner.

    Attributes
    ----------
    warm_starts : dict
        Precomputed motions by the name of their primitive.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.warm_starts: dict[str, WarmStarts] = {}
        self._tables = lru_cache(setup.options.search.n_kept_tables)(self._tables_of)

    def _tables_of(self, primitive: MovementPrimitive) -> tuple[QuadratureTables, LimitTables]:
        splines = self._setup.options.basis == "bspline"
        n_joints = self._setup.robot.n_joints
        return self._made(BSplineBasis(n_joints) if splines else primitive.basis)

    def _made(self, basis: Basis) -> tuple[QuadratureTables, LimitTables]:
        tables = QuadratureTables(basis, self._setup.options.n_nodes)
        return tables, LimitTables(tables)

    def bases(self, request: Request) -> Iterator[MotionBasis]:
        """The bases to try for a request."""
        narrowest = self.narrowest(request)
        if self._setup.options.basis == "bspline":
            yield narrowest
            return
        q = request.start.positions
        n_equations = sum(c.target.error(q)[0].size for c in request.conditions)
        n_goal = 0 if request.pose is None else self._setup.robot.n_joints
        if n_equations <= narrowest.n_components + n_goal:
            yield narrowest
        yield corrected_basis(narrowest, request.primitive, self._setup.options.n_nodes)
        yield spline_basis(*self._made(BSplineBasis(self._setup.robot.n_joints)))

    def narrowest(self, request: Request, *, is_paced: bool = True) -> MotionBasis:
        """The components of the primitive, or B-splines alone if the options say so.

        With the time scaling of the request, unless `is_paced` is false.
        """
        primitive, ends = request.primitive, (request.start.positions, request.goal.positions)
        expected = request.expected
        if self._setup.options.basis == "bspline":
            return spline_basis(*self._tables(primitive))
        if is_paced and np.any(expected.pace):
            # The basis of a motion with its own time scaling is not known in advance.
            tables = self._made(primitive.paced_basis(*ends, expected.pace))
        else:
            tables = self._tables(primitive)
        known = expected.in_span_score <= self._setup.options.search.warm_start_score
        starts = self.warm_starts.get(primitive.name) if known else None
        return component_basis(*tables, primitive, expected, np.concatenate(ends), starts)


class SinglePlanner:
    """Plans motions to single goals.

    Parameters
    ----------
    setup, resolver, fallback, chooser
        Components of the planner.
    """

    def __init__(
        self,
        setup: Setup,
        resolver: GoalResolver,
        fallback: FallbackPlanner,
        chooser: BasisChooser,
    ) -> None:
        self._setup, self._resolver = setup, resolver
        self._fallback, self._chooser = fallback, chooser
        self._detours = DetourPlanner(setup, self._attempt)

    def serve(
        self, requests: Iterator[Request], began: float, budget: Budget
    ) -> tuple[Planned, list[Attempt]]:
        """The best motion for one of several alternative requests, and all attempts.

        Parameters
        ----------
        requests : iterator of Request
            Requests for one goal, at least one.
        began : float
            When planning began, by the clock of the budget [s].
        budget : Budget
            The time for all of it.
        """
        # Part of the time is reserved for finding a feasible duration if the requested one is too
        # short.
        tried = [next(requests)]
        share = 1.0 if tried[0].duration_is_free else self._setup.options.search.share_of_fixed
        first = replace(budget, deadline=began + share * (budget.deadline - began))
        attempts: list[Attempt] = []
        paths: Paths = {}
        for request in tried:
            attempts.append(self._attempts(request, first, paths))
            # Further configurations of a pose are for where the most natural one has no motion.
            if first.is_over() or (request.pose is not None and attempts[-1].is_valid):
                break
            tried += islice(requests, 1)
        if len(attempts) > 1:  # slow motions and detours have no costs yet
            attempts = [with_costs(one, self._setup) for one in attempts]
        best = min(attempts, key=lambda one: one.rank)
        failed = not (best.is_valid or best.is_hopeless or budget.is_cancelled())
        ran_out, fallback = failed and first.is_over(), Fallback()
        if failed:
            fallback = self._fallback.serve([*tried, *requests], best, paths, budget)
            best = fallback.attempt or best
        stated = self._stated_duration(best, fallback, budget)
        hint = self._detours.hint or self._fallback.hint if failed else ""
        return Planned(best, fallback, ran_out, stated, hint=hint), attempts

    def precompute(self, primitive: MovementPrimitive, deadline: float) -> WarmStarts:
        """Motions between the ends of demonstrations, as warm starts for similar ones."""
        names, states = primitive.joint_names, primitive.boundary_states
        n_chosen = min(len(states), self._setup.options.search.n_warm_starts)
        ends, weights, memories = [], [], []
        for i in np.linspace(0, len(states) - 1, n_chosen).astype(int):
            if Budget(deadline).is_over():
                break
            here, there = (JointState(names, states[i, k]) for k in (0, 3))
            duration = float(primitive.durations[i])
            goal = JointGoal(there, duration, primitive=primitive.name)
            try:
                request = next(self._resolver.resolve(goal, here))
            except GoalError:  # demonstrations may lie outside the limits
                continue
            basis = self._chooser.narrowest(request)
            budget = Budget(time.perf_counter() + self._setup.options.max_solve_time)
            naturalness = self._setup.options.naturalness
            problem = SingleProblem(self._setup, request, basis, duration, naturalness)
            found = attempt(problem, budget, n_starts=self._setup.options.n_starts)
            if found.is_valid and found.solution.converged and found.memory is not None:
                ends.append(states[i, [0, 3]].ravel())
                weights.append(found.solution.weights)
                memories.append(found.memory.curvature_alone())
        return WarmStarts(np.array(ends), np.array(weights), memories)

    def _attempts(self, request: Request, budget: Budget, paths: Paths) -> Attempt:
        """The best motion for a request; adds a collision-free path to `paths`."""
        tried: list[Attempt] = []
        for one in self._in_turn(request, budget, paths):
            tried.append(one)
            if one.is_valid or one.is_hopeless:
                break
        return min(tried, key=lambda one: one.violation)

    def _in_turn(self, request: Request, budget: Budget, paths: Paths) -> Iterator[Attempt]:
        """Attempts by descent and, once bodies collide, along a detour; then recoveries."""
        bases, searches = self._chooser.bases(request), self._searches(request)
        setting, recoveries = _settings(self._setup, request, bases, searches=searches)
        following: Setting | None = setting
        descent, detour = budget, self._detours.attempts(request, budget, paths)
        if self._detours.lead_first(request, setting.basis):
            for found in detour:
                yield found
                if budget.is_over():
                    return
        elif self._detours.may_serve(request):
            descent = budget.share(self._setup.options.search.share_of_descent)
        while following is not None:
            tried, setting = self._attempt(request, following, descent)
            yield tried
            if descent.is_over() or tried.meets_bodies:
                descent = budget
                if self._detours.may_help(request, tried):
                    yield from detour
                    if not self._detours.hint:  # then more descent is of no use
                        return
            if budget.is_over():
                return
            failure = Failure(tried, setting, self._setup)
            proposals = (recovery.propose(failure) for recovery in recoveries)
            following = next((one for one in proposals if one is not None), None)

    def _searches(self, request: Request) -> bool:
        return request.duration_is_free and self._setup.options.timing == SHORTEST

    def _attempt(
        self, request: Request, setting: Setting, budget: Budget
    ) -> tuple[Attempt, Setting]:
        """The attempt with a setting, and the setting with the duration that was found."""
        if self._searches(request):
            return self._shortest(request, setting.basis, budget), setting
        options = self._setup.options
        if request.duration_is_free and options.timing == FREE and setting.is_first:
            timed = self._attempt_in(request, setting, budget, duration_is_free=True)
            setting = replace(setting, duration=timed.duration)
            if timed.is_valid or timed.has_clearances or budget.is_over():
                return timed, setting
        return self._attempt_in(request, setting, budget), setting

    def _attempt_in(
        self, request: Request, setting: Setting, budget: Budget, *, duration_is_free: bool = False
    ) -> Attempt:
        problem = SingleProblem(
            self._setup,
            request,
            setting.basis,
            setting.duration,
            setting.naturalness,
            duration_is_free=duration_is_free,
        )
        may_meet = self._detours.may_serve(request) and not problem.has_clearances
        if may_meet and problem.starts_in_collision:
            problem.keep_clear()
        return attempt(problem, budget, n_starts=self._setup.options.n_starts)

    def _shortest(self, request: Request, basis: MotionBasis, budget: Budget) -> Attempt:
        """The attempt of the least duration, from the expected motion within the limits.

        The planner's objectives count little: they choose among motions of one duration.
        """
        options = self._setup.options
        duration = _scaled(self._setup, request, basis, is_unknown=True)
        initial = Motion(request.start, request.goal, duration, basis.basis, basis.expected)
        cost = cost_of(self._setup.robot, initial, basis.tables, options.objectives)
        share = options.search.share_in_shortest * duration / max(cost, TINY)
        others = [(share * weight, objective) for weight, objective in options.objectives]
        timed = replace(options, objectives=((1.0, Time()), *others))
        setup = replace(self._setup, options=timed)
        problem = SingleProblem(setup, request, basis, duration, 0.0, duration_is_free=True)
        found = attempt(problem, budget)
        # The cost is computed in the assembly of the plan, by the objectives of the planner.
        unknown = float("nan")
        solution = replace(found.solution, objective_cost=unknown, naturalness_cost=0.0)
        return replace(found, solution=solution)

    def _stated_duration(self, best: Attempt, fallback: Fallback, budget: Budget) -> StatedDuration:
        """The shortest known feasible duration, if it is to be reported."""
        request, search = best.request, self._setup.options.search
        assert isinstance(request, Request)
        if best.is_valid:
            searched = self._searches(request)
            return StatedDuration(best.duration) if searched else StatedDuration()
        stated = StatedDuration(fallback.duration, is_shortest=False)
        if request.duration_is_free or best.is_hopeless or budget.is_over():
            return stated
        expected = self._resolver.expect(request.primitive, request.start, request.goal, None)
        free = replace(request, duration_is_free=True, expected=expected)
        for basis in self._chooser.bases(free):
            if budget.is_over():
                break
            found = self._shortest(free, basis, budget)
            if found.is_valid:
                seconds, is_shortest = found.duration, found.solution.converged
                seconds *= search.duration_margin
                return stated if stated.seconds < seconds else StatedDuration(seconds, is_shortest)
        return stated


def _settings(
    setup: Setup, request: Request, bases: Iterator[MotionBasis], *, searches: bool
) -> tuple[Setting, list[Recovery]]:
    """The first setting and its recoveries in order, with or without a search for the shortest."""
    options, basis = setup.options, next(bases)
    duration = longest = request.expected.duration
    if request.duration_is_free and not searches:
        longest = min(longest * options.search.max_stretch, setup.longest)
        duration = _scaled(setup, request, basis, is_unknown=options.timing == FREE)
    setting = Setting(basis, duration, options.naturalness, is_first=True)
    wider, natural = WiderBasis(bases, setting), MoreNatural(options.search.naturalness_steps)
    return setting, [wider] if searches else [Slower(longest), natural, wider]


def _scaled(setup: Setup, request: Request, basis: MotionBasis, *, is_unknown: bool) -> float:
    """The expected duration, longer if the expected motion exceeds limits otherwise [s].

    With a margin, unless it is an unknown of the program, which keeps the limits itself.
    """
    usual, search = request.expected.duration, setup.options.search
    motion = Motion(request.start, request.goal, usual, basis.basis, basis.expected)
    states = node_states(motion, basis.tables)
    margin = 1.0 if is_unknown else search.scaling_margin
    stretch = margin * least_stretch(setup.robot, setup.limits, states)
    most = min(search.max_stretch, setup.longest / usual)
    return usual * stretch if 1.0 < stretch <= most else usual
