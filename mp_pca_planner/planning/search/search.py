# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The search for a motion: what is tried for a goal, read from top to bottom.

`ORDER` lists the stages for one request; the first valid candidate ends them.
A stage is a function of a case and a budget, whose result is None if it does not apply.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..context import Budget, Context
from ..motion import cost_of, rank_of
from ..objectives import effort
from ..options import DEMONSTRATED, REAL_TIME
from ..program.compile import (
    MAX_STRETCH,
    N_WIDTHS,
    NEAR_EXPECTED,
    MotionBasis,
    Setting,
    first_setting,
    joined_motion,
    segment_basis,
    stretched,
)
from ..request import Request
from .candidate import (
    JOINED,
    OPTIMISED,
    SLOW,
    Candidate,
    attempt,
    checked,
    depth_of,
    least_violation,
    met_at,
)
from .detours import along_path, missing_planner
from .stop_and_go import slow_motion

# Shares to which passing velocities are reduced in turn if joined segments exceed a position limit,
# and times that their durations are stretched at most, for each share.
_PASSING_SHARES, _MAX_STRETCHES = (1.0, 0.5, 0.25, 0.0), 12


@dataclass(frozen=True, eq=False)
class Case:
    """A request, and what is known of its motions.

    Attributes
    ----------
    context : Context
        Of the planner.
    request : Request
        The request.
    first : Setting
        The first setting.
    joined : Candidate or None
        The expected motion of several segments, within the limits if possible.
    may_detour : bool
        Whether paths around bodies may help: those of single segments.
    starts_at_path : bool
        Whether a path comes before descent: the expected motion collides at a quadrature node.
        Descent from there takes longer. It stays nearer to the demonstrations, so it comes first
        where their timing or naturalness is asked for.
    found : list of Candidate
        The candidates of the stages so far.
    """

    context: Context
    request: Request
    first: Setting
    joined: Candidate | None
    may_detour: bool
    starts_at_path: bool
    found: list[Candidate]


def first_case(context: Context, request: Request, budget: Budget) -> Case:
    """A request before anything was tried, its segments joined within the budget."""
    options, collision = context.options, context.collision
    bases = tuple(segment_basis(options, request, segment) for segment in request.segments)
    if request.mode:
        joined = _joined(context, request, bases, budget)
        first = Setting(bases, joined.motions, request.naturalness, options.objectives)
        return Case(context, request, first, joined, False, False, [])
    first = first_setting(context, request, bases[0])
    if collision is None or not collision.pairs:
        return Case(context, request, first, None, False, False, [])
    is_natural = request.naturalness >= NEAR_EXPECTED or request.timing == DEMONSTRATED
    at_path = request.duration_is_free and not is_natural
    if at_path:
        motion = replace(first.initial[0], duration=request.duration)
        times = request.duration * bases[0].tables.phases
        at_path = collision.collide_anywhere(motion.evaluate(times)[0])
    return Case(context, request, first, None, True, at_path, [])


def _joined(
    context: Context, request: Request, bases: tuple[MotionBasis, ...], budget: Budget
) -> Candidate:
    """Lengthen free durations, and lower passing velocities, until the limits are kept."""
    durations = [one.duration for one in request.segments]
    found = list[Candidate]()
    for share in _PASSING_SHARES:
        for _ in range(_MAX_STRETCHES):
            motions = joined_motion(request, bases, durations, share)
            found.append(replace(checked(context, request, bases, motions), how=JOINED))
            if not found[-1].check.violations or budget.is_late():
                return least_violation(found)
            longer = stretched(request, found[-1].check, durations, MAX_STRETCH)
            if longer == durations or sum(longer) > context.longest:
                break
            durations = longer
    return least_violation(found)


def blocked(case: Case, budget: Budget) -> Candidate | None:
    """The expected motion, if an end or a target in collision is fixed: nothing else is tried."""
    context, request, model = case.context, case.request, case.context.collision
    if model is None:
        return None
    fixed = [request.start, *(one.goal for one in request.segments if one.pose is None)]
    if not model.collide_anywhere(np.array([state.positions for state in fixed])):
        return None
    targets = zip(request.target_names, request.segments, strict=True)
    names = ["the start", *(name for name, one in targets if one.pose is None)]
    for name, state in zip(names, fixed, strict=True):
        if met := met_at(model, state):
            advice = ": move the robot or the obstacle first" if state is request.start else ""
            if met[0].links[1] not in model.world.names:
                advice = "; if they may touch, name the two links in an SRDF file (srdf)"
            unchecked = replace(context, collision=None)
            found = checked(unchecked, request, case.first.bases, case.first.initial)
            excess, _, strayed, missed = found.violation
            return replace(
                found,
                violation=(excess, depth_of(met), strayed, missed),
                is_valid=False,
                blocked=f"{name} is in collision: {met[0].at_rest}{advice}",
            )
    return None


def path_first(case: Case, budget: Budget) -> Candidate | None:
    """The best motion along a collision-free path, if the expected motion collides."""
    return along_path(case.context, case.request, budget) if case.starts_at_path else None


def descent(case: Case, budget: Budget) -> Candidate | None:
    """The best motion by descent from the expected one; of single segments, with wider bases, too.

    If paths may help, it ends when bodies collide. Segments that are only joined have none.
    """
    context, request, setting = case.context, case.request, case.first
    if request.mode == REAL_TIME:
        return None
    found = list[Candidate]()
    has_one_basis = request.mode or context.options.basis == "bspline"
    for width in range(1 if has_one_basis else N_WIDTHS):
        if width:
            basis = segment_basis(context.options, request, request.segments[0], width)
            setting = first_setting(context, request, basis)
        found.append(attempt(context, request, setting, budget))
        if found[-1].is_valid or budget.is_late():
            break
        if found[-1].meets_bodies and case.may_detour and not missing_planner():
            break
    return least_violation(found)


def path_after(case: Case, budget: Budget) -> Candidate | None:
    """The best motion along a collision-free path, if descent failed by collisions between ends."""
    model = case.context.collision
    if model is None or case.starts_at_path or not (case.may_detour and case.found):
        return None
    last = case.found[-1]
    # Collisions of a motion outside the limits are not known yet.
    if not last.meets_bodies and not model.collisions(last.trajectory, precisely=False):
        return None
    return along_path(case.context, case.request, budget)


def joined(case: Case, budget: Budget) -> Candidate | None:
    """The expected motion of several segments, joined within the limits if possible."""
    return case.joined


def slow(case: Case, budget: Budget) -> Candidate | None:
    """A motion with rests, within the limits."""
    paths = (one.corners for one in case.found if one.corners is not None)
    return slow_motion(case.context, case.request, next(paths, None), budget)


ORDER: tuple[Callable[[Case, Budget], Candidate | None], ...] = (
    blocked,
    path_first,
    descent,
    path_after,
    joined,
    slow,
)
"""What is tried for one request, in this order; the first valid candidate ends it."""


def search(context: Context, requests: Iterable[Request], budget: Budget) -> Candidate:
    """The best motion for one of several alternative requests.

    Parameters
    ----------
    context : Context
        Robot, limits and options of the planner.
    requests : iterable of Request
        Requests for one goal, at least one.
    budget : Budget
        The time for all of it.
    """
    best: Candidate | None = None
    for request in requests:
        case, passes = first_case(context, request, budget), 0
        for stage in ORDER:
            # The last two stages go on when time has run out: they take little time. A slow
            # motion is for goals without any other.
            if stage is slow:
                is_needed = not (budget.is_cancelled() or (best is not None and best.is_valid))
            else:
                is_needed = stage is joined or not ((best or case.found) and budget.is_late())
            candidate = stage(case, budget) if is_needed else None
            if candidate is None:
                continue
            passes += candidate.solution.iterations
            if candidate.how != OPTIMISED:  # it knows the evaluations of the stages before
                solution = replace(candidate.solution, iterations=passes)
                candidate = replace(candidate, solution=solution)
            case.found.append(candidate)
            if candidate.is_valid or candidate.blocked:
                break
        rivals = [] if best is None else [best]
        if case.found:
            rivals.append(least_violation(case.found))
        if len(rivals) > 1:  # slow motions and detours have no costs yet
            rivals = [with_costs(context, one) for one in rivals]
            rivals.sort(
                key=lambda one: (one.violation, one.how == SLOW, rank_of(one.solution.cost))
            )
        best = rivals[0]
        # Further configurations of a pose are for where the most natural one has no motion.
        is_enough = best.is_valid and (request.pose is not None and best.how != SLOW)
        if is_enough or budget.is_cancelled() or (budget.is_late() and best.is_valid):
            break
    assert best is not None, "a goal has a request"
    return with_costs(context, best)


def with_costs(context: Context, found: Candidate) -> Candidate:
    """A candidate whose costs are known, also if its motion was not optimised."""
    if np.isfinite(found.solution.objective_cost):
        return found
    objective = effort_cost = 0.0
    for motion, basis in zip(found.motions, found.bases, strict=True):
        objectives = context.options.objectives
        objective += cost_of(context.robot, motion, basis.tables, objectives)
        effort_cost += cost_of(context.robot, motion, basis.tables, [(1.0, effort)])
    solution = replace(found.solution, objective_cost=objective, effort_cost=effort_cost)
    return replace(found, solution=solution)
