# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The search for a motion: what is tried for a goal, read from top to bottom.

`ORDER` lists the stages for one request; the first valid candidate ends them.
A stage is a function of a case and a budget, whose result is None if it does not apply.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...motion.trajectory import Trajectory
from ...motion.validation import LimitCheck
from ..context import Budget, Context
from ..motion import cost_of, rank_of
from ..objectives import effort
from ..options import DEMONSTRATED, REAL_TIME
from ..program.bases import NEAR_EXPECTED, MotionBasis
from ..program.compile import (
    MAX_STRETCH,
    Setting,
    expected_setting,
    first_setting,
    joined_motion,
    lasting,
    stretched,
)
from ..request import Request
from ..time_scaling import slowdown
from .candidate import (
    JOINED,
    OPTIMISED,
    SLOW,
    Candidate,
    Violation,
    attempt,
    checked,
    collides,
    depth_of,
    least_violation,
    sampled,
)
from .detours import along_path, missing_planner
from .stop_and_go import slow_motion

# Attempts with one basis, after the least violation, that end the recovery by longer durations.
_MAX_WORSE = 3
# Values to which naturalness is raised if the reduction of effort caused a limit violation. At the
# last value, effort hardly counts.
_NATURALNESS_STEPS = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)
# Shares to which passing velocities are reduced in turn if joined segments exceed a position limit,
# and times that their durations are stretched at most, for each share.
_PASSING_SHARES, _MAX_STRETCHES = (1.0, 0.5, 0.25, 0.0), 12
# Evaluations of descent from the expected motion among obstacles, before detours are tried.
_EVALUATIONS_OF_DESCENT = 60


@dataclass(frozen=True, eq=False)
class Failure:
    """A failed attempt at one segment, and the expected motion for comparison.

    Attributes
    ----------
    context : Context
        Of the planner.
    request : Request
        The request.
    first, setting : Setting
        The first setting of the request, and the one that failed.
    candidate : Candidate
        The motion that was found.
    violations : list of Violation
        Violations of the attempts with this basis, the last one included.
    expected_check : LimitCheck
        Comparison with the limits of the expected motion of the same ends and duration.
    is_recoverable : bool
        Whether another duration or naturalness may help.
    """

    context: Context
    request: Request
    first: Setting
    setting: Setting
    candidate: Candidate
    violations: list[Violation]
    expected_check: LimitCheck
    is_recoverable: bool


Recovery = Callable[[Failure], Setting | None]


def given_duration(failure: Failure) -> Setting | None:
    """The duration that was found as a given one, unless bodies collide."""
    setting, found = failure.setting, failure.candidate
    if not setting.is_timed or setting.is_shortest or found.has_clearances:
        return None
    return lasting(setting, found.duration)


def slower(failure: Failure) -> Setting | None:
    """A longer duration, if the expected motion violates limits, too.

    From a moving start, a longer duration may violate them more; then this recovery ends.
    """
    duration = failure.candidate.duration
    longest = failure.request.duration
    if failure.request.duration_is_free:
        longest = min(longest * MAX_STRETCH, failure.context.longest)
    violations = failure.violations
    n_worse = len(violations) - 1 - violations.index(min(violations))
    if n_worse >= _MAX_WORSE or not failure.is_recoverable:
        return None
    longer = min(duration * slowdown(failure.expected_check.violations), longest)
    return lasting(failure.setting, longer) if longer > duration else None


def more_natural(failure: Failure) -> Setting | None:
    """A larger naturalness, if the expected motion keeps the limits.

    In that case, the reduction of the cost caused the violation of a limit or a collision.
    """
    setting = failure.setting
    if not failure.is_recoverable or failure.expected_check.violations:
        return None
    larger = [step for step in _NATURALNESS_STEPS if step > setting.naturalness]
    if setting.bases[0].precision is None or setting.width or not larger:
        return None
    return replace(lasting(setting, failure.candidate.duration), naturalness=larger[0])


def wider_basis(failure: Failure) -> Setting | None:
    """The next wider basis, otherwise with the first setting."""
    context, request, first = failure.context, failure.request, failure.first
    width = failure.setting.width + 1
    if width >= context.bases.n_widths:
        return None
    basis = context.bases.basis(
        request.segments[0], request.naturalness, width, shortest=first.is_shortest
    )
    if first.is_shortest:
        return first_setting(context, request, basis, width, shortest=True)
    wider = replace(first, bases=(basis,), width=width)
    return replace(lasting(wider, first.duration), is_timed=first.is_timed)


RECOVERIES: tuple[Recovery, ...] = (given_duration, slower, more_natural, wider_basis)
"""The recoveries, in the order in which they are tried."""


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
    earlier : Candidate or None
        The best candidate of earlier requests.
    found : list of Candidate
        The candidates of the stages so far.
    """

    context: Context
    request: Request
    first: Setting
    joined: Candidate | None
    earlier: Candidate | None
    found: list[Candidate]

    @property
    def may_detour(self) -> bool:
        """Whether paths around bodies may help: those of single segments."""
        collision = self.context.collision
        return not self.request.mode and collision is not None and bool(collision.pairs)

    @cached_property
    def starts_at_path(self) -> bool:
        """Whether a path comes before descent: the expected motion collides at a quadrature node.

        Descent from there takes longer. It stays nearer to the demonstrations, so it comes first
        where their timing or naturalness is asked for.
        """
        request, collision = self.request, self.context.collision
        is_natural = request.naturalness >= NEAR_EXPECTED or request.timing == DEMONSTRATED
        if collision is None or not self.may_detour or is_natural or not request.duration_is_free:
            return False
        motion = replace(self.first.initial[0], duration=request.duration)
        times = request.duration * self.first.bases[0].tables.phases
        return collision.collide_anywhere(motion.evaluate(times)[0])


def first_case(
    context: Context, request: Request, earlier: Candidate | None, budget: Budget
) -> Case:
    """A request before anything was tried, its segments joined within the budget."""
    if not request.mode:
        return Case(context, request, expected_setting(context, request), None, earlier, [])
    naturalness = request.naturalness
    bases = tuple(
        context.bases.basis(one, naturalness, is_time_scaled=False) for one in request.segments
    )
    joined = _joined(context, request, bases, budget)
    first = Setting(bases, joined.motions, naturalness, context.options.objectives)
    return Case(context, request, first, joined, earlier, [])


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
            if not found[-1].check.violations or budget.is_over():
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
    fixed = [("the start", request.start)]
    for number, segment in enumerate(request.segments, start=1):
        if segment.pose is None:
            is_last = number == len(request.segments)
            fixed.append(("the goal" if is_last else f"target {number}", segment.goal))
    if not model.collide_anywhere(np.array([state.positions for _, state in fixed])):
        return None
    zero = np.zeros((1, context.robot.n_joints))
    for name, state in fixed:
        still = Trajectory(state.joint_names, [0.0], [state.positions], zero, zero)
        if met := model.collisions(still, precisely=False):
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
    """The best motion by descent from the expected one, with recoveries of single segments.

    If paths may help, it ends when bodies collide. Segments that are only joined have none.
    """
    context, request, setting = case.context, case.request, case.first
    if request.mode == REAL_TIME:
        return None
    leads = case.may_detour and not missing_planner()
    among = context.collision is not None and len(context.collision.world)
    within, found, violations = budget, list[Candidate](), list[Violation]()
    if leads and among and not case.starts_at_path:
        within = budget.part(_EVALUATIONS_OF_DESCENT)
    while True:
        candidate = attempt(context, request, setting, within)
        found.append(candidate)
        violations.append(candidate.violation)
        if candidate.is_valid or request.mode:
            break
        if leads and (within.is_over() or candidate.meets_bodies):
            within = budget
            if candidate.meets_bodies or collides(context, candidate.trajectory):
                break
        if budget.is_over():
            break
        expected = replace(candidate.motions[0], weights=setting.bases[0].expected)
        trajectory, check = sampled(context, [expected])
        wrong = candidate.collisions or candidate.check.violations
        may_recover = bool(wrong) and not setting.is_shortest
        may_recover &= not (candidate.collisions and collides(context, trajectory))
        failure = Failure(
            context, request, case.first, setting, candidate, violations, check, may_recover
        )
        settings = (recovery(failure) for recovery in RECOVERIES)
        following = next((one for one in settings if one is not None), None)
        if following is None:
            break
        if following.width != setting.width or (setting.is_timed and not candidate.has_clearances):
            violations = []
        setting = following
    return least_violation(found)


def path_after(case: Case, budget: Budget) -> Candidate | None:
    """The best motion along a collision-free path, if descent failed by collisions between ends."""
    if case.starts_at_path or not (case.may_detour and case.found):
        return None
    last = case.found[-1]
    # Collisions of a motion outside the limits are not known yet.
    if not (last.meets_bodies or collides(case.context, last.trajectory)):
        return None
    return along_path(case.context, case.request, budget)


def joined(case: Case, budget: Budget) -> Candidate | None:
    """The expected motion of several segments, joined within the limits if possible."""
    return case.joined


def slow(case: Case, budget: Budget) -> Candidate | None:
    """A motion with rests, within the limits, where there is no other for any request so far."""
    has_fallback = case.earlier is not None and case.earlier.is_valid
    if has_fallback or budget.is_cancelled():
        return None
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

# Stages that go on when time has run out: they take hardly any.
_WITHOUT_TIME = (joined, slow)


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
        case, passes = first_case(context, request, best, budget), 0
        for stage in ORDER:
            if (best or case.found) and budget.is_over() and stage not in _WITHOUT_TIME:
                continue
            candidate = stage(case, budget)
            if candidate is None:
                continue
            passes += candidate.solution.iterations
            if candidate.how != OPTIMISED:  # it knows the evaluations of the stages before
                solution = replace(candidate.solution, iterations=passes)
                candidate = replace(candidate, solution=solution)
            case.found.append(candidate)
            if candidate.is_valid or candidate.blocked:
                break
        rivals = [least_violation(case.found)] if case.found else []
        if best is not None:  # slow motions and detours have no costs yet
            rivals = [with_costs(context, one) for one in [best, *rivals]]
        best = rivals[0]
        if len(rivals) > 1:
            best = min(rivals, key=_rank)
        # Further configurations of a pose are for where the most natural one has no motion.
        is_enough = best.is_valid and (request.pose is not None and best.how != SLOW)
        if is_enough or budget.is_cancelled() or (budget.is_over() and best.is_valid):
            break
    assert best is not None, "a goal has a request"
    return with_costs(context, best)


def _rank(found: Candidate) -> tuple[Violation, bool, float]:
    return found.violation, found.how == SLOW, rank_of(found.solution.cost)


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
