# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The search for a motion: what is tried for a goal, read from top to bottom.

`ORDER` lists the stages for one request; the first valid candidate ends them. If no request has a
valid one, a slow motion is searched; if the requested duration has none, the shortest duration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

from ..context import Context
from ..options import DEMONSTRATED, OPTIMAL, REAL_TIME, SHORTEST
from ..plan import MotionSolution
from ..program.bases import MotionBasis
from ..program.joining import expected_motion, stretched
from ..program.setting import Setting
from ..request import Request
from ..requests.resolve import predict
from .budget import Budget
from .candidate import Candidate, attempt, checked
from .detours import along_path
from .recoveries import failure_of, recovered
from .sampling import has_planner
from .settings import first_setting, sequence_setting
from .slow import Slow, slow_motion


@dataclass(frozen=True, eq=False)
class Case:
    """A request, and what is known of its motions.

    Attributes
    ----------
    context : Context
        Of the planner.
    request : Request
        The request.
    optimises : bool
        Whether motions are optimised; otherwise segments are only joined.
    first : Setting
        The first setting.
    joined : Candidate or None
        The expected motion of several segments, within the limits if possible.
    tried : tuple of str
        Names of the stages that were tried.
    found : tuple of Candidate
        Their candidates.
    """

    context: Context
    request: Request
    optimises: bool
    first: Setting
    joined: Candidate | None
    tried: tuple[str, ...] = ()
    found: tuple[Candidate, ...] = ()

    @property
    def best(self) -> Candidate:
        """The candidate with the least violations."""
        return min(self.found, key=lambda one: one.violation)


@dataclass(frozen=True)
class Stage:
    """What is tried, and when.

    Attributes
    ----------
    name : str
        Its name.
    applies : callable
        Whether it is tried for a case.
    search : callable
        Its candidate; None if there is none.
    """

    name: str
    applies: Callable[[Case], bool]
    search: Callable[[Case, Budget], Candidate | None]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the report is made of.

    Attributes
    ----------
    best : Candidate
        The motion.
    found : tuple of Candidate
        The best candidate of each request that was tried.
    optimised : Candidate or None
        The motion of several segments that was optimised in vain.
    slow : Slow
        Result of the search for a slow motion, if there was one.
    ran_out : bool
        Whether time ran out before a motion within the limits was found by optimisation.
    stated : float
        A feasible duration to report [s], or NaN.
    is_shortest : bool
        Whether it is the shortest.
    mode : str
        Mode of joining segments, see :class:`.Plan`.
    """

    best: Candidate
    found: tuple[Candidate, ...]
    optimised: Candidate | None
    slow: Slow
    ran_out: bool
    stated: float
    is_shortest: bool
    mode: str


def searches_shortest(context: Context, request: Request) -> bool:
    """Whether the shortest duration of a single segment is searched."""
    is_free = request.is_single and request.duration_is_free
    return is_free and context.options.timing == SHORTEST


def expected_collides(case: Case) -> bool:
    """Whether paths are tried before descent from the expected motion.

    They are if that is in collision at a quadrature node: descent from there takes longer than a
    path. It stays nearer to the demonstrations, so it comes first where their timing or
    naturalness is asked for.
    """
    context, request, options = case.context, case.request, case.context.options
    if not (request.is_single and context.searches_paths and request.duration_is_free):
        return False
    is_natural = options.naturalness >= options.search.near_expected
    if is_natural or options.timing == DEMONSTRATED:
        return False
    assert context.collision is not None
    basis = case.first.bases[0]
    (motion,) = expected_motion(request, case.first.bases, [request.duration])
    positions = motion.evaluate(request.duration * basis.tables.phases)[0]
    return context.collision.collide_anywhere(positions)


def bodies_meet(case: Case) -> bool:
    """Whether descent failed by collisions between the ends of a single segment."""
    if not case.found or not case.request.is_single or not case.context.searches_paths:
        return False
    last = case.found[-1]
    if "path" in case.tried or last.is_hopeless:
        return False
    # Collisions of a motion outside the limits are not known yet.
    return last.meets_bodies or bool(case.context.collisions(last.trajectory))


def path(case: Case, budget: Budget) -> Candidate | None:
    """The best motion along a collision-free path."""
    return along_path(case.context, case.request, budget)


def descent(case: Case, budget: Budget) -> Candidate:
    """The best motion by descent from the expected one, with recoveries of single segments.

    If paths may help, it ends when bodies collide.
    """
    context, request, setting = case.context, case.request, case.first
    leads = request.is_single and context.searches_paths and has_planner()
    within, found, same = budget, list[Candidate](), list[Candidate]()
    if leads and not case.tried:
        within = budget.share(context.options.search.share_of_descent)
    while True:
        candidate = attempt(context, request, setting, within)
        found.append(candidate)
        same.append(candidate)
        if candidate.is_valid or candidate.is_hopeless or not request.is_single:
            break
        if leads and (within.is_over() or candidate.meets_bodies):
            within = budget
            if candidate.meets_bodies or context.collisions(candidate.trajectory):
                break
        if budget.is_over():
            break
        following = recovered(failure_of(context, request, case.first, setting, same))
        if following is None:
            break
        if following.width != setting.width or (setting.is_timed and not candidate.has_clearances):
            same = []
        setting = following
    return min(found, key=lambda one: one.violation)


def joined(case: Case, budget: Budget) -> Candidate:
    """The expected motion of several segments, joined within the limits if possible."""
    assert case.joined is not None
    passes = sum(one.solution.iterations for one in case.found)
    return replace(case.joined, solution=MotionSolution.unknown(passes))


ORDER = (
    Stage("path", expected_collides, path),
    Stage("descent", lambda case: case.optimises, descent),
    Stage("path", bodies_meet, path),
    Stage("joined", lambda case: case.joined is not None, joined),
)
"""What is tried for one request, in this order; the first valid candidate ends it."""


def search(
    context: Context, requests: Iterator[Request], mode: str, began: float, budget: Budget
) -> Outcome:
    """The best motion for one of several alternative requests.

    Parameters
    ----------
    context : Context
        Robot, limits and options of the planner.
    requests : iterator of Request
        Requests for one goal, at least one.
    mode : {'real_time', 'optimal'}
        Whether a motion through several targets is optimised.
    began : float
        When planning began, by the clock of the budget [s].
    budget : Budget
        The time for all of it.
    """
    cases = list[Case]()
    for request in requests:
        first = _budget_of_optimisation(context, request, began, budget)
        cases.append(_tried(_case(context, request, mode, first), first))
        # Further configurations of a pose are for where the most natural one has no motion.
        if first.is_over() or (request.pose is not None and cases[-1].best.is_valid):
            break
    found = tuple(case.best for case in cases)
    best = min(found, key=lambda one: (one.violation, one.solution.cost))
    slow, ran_out = Slow(), False
    if not (best.is_valid or best.is_hopeless or budget.is_cancelled()):
        ran_out = first.is_over()
        others = chain([case.request for case in cases], requests)
        every = [one for case in cases for one in case.found]
        slow = slow_motion(context, others, best, every, budget)
        best = slow.candidate or best
    stated, is_shortest = _stated_duration(context, best, slow, budget)
    last = cases[-1]
    mode = _mode(last, best, slow)
    optimised = last.found[0] if mode == REAL_TIME and last.optimises else None
    return Outcome(best, found, optimised, slow, ran_out, stated, is_shortest, mode)


def _budget_of_optimisation(
    context: Context, request: Request, began: float, budget: Budget
) -> Budget:
    """The time for optimised motions.

    Part of the time is kept for finding a feasible duration if the requested one is too short.
    """
    if request.duration_is_free or not request.is_single:
        return budget
    share = context.options.search.share_of_fixed
    return replace(budget, deadline=began + share * (budget.deadline - began))


def _case(context: Context, request: Request, mode: str, budget: Budget) -> Case:
    """A request before anything was tried."""
    if request.is_single:
        shortest = searches_shortest(context, request)
        first = first_setting(context, request, shortest=shortest)
        return Case(context, request, True, first, None)
    bases = tuple(context.bases.basis(segment, is_paced=False) for segment in request.segments)
    expected = _joined(context, request, bases, budget)
    first = sequence_setting(context, bases, expected.motions)
    return Case(context, request, mode == OPTIMAL, first, expected)


def _joined(
    context: Context, request: Request, bases: tuple[MotionBasis, ...], budget: Budget
) -> Candidate:
    """Lengthen free durations, and lower passing velocities, until the limits are kept."""
    search, durations = context.options.search, [one.duration for one in request.segments]
    found = list[Candidate]()
    for share in search.passing_shares:
        for _ in range(search.max_stretches):
            motions = expected_motion(request, bases, durations, share)
            found.append(checked(context, request, bases, motions))
            if not found[-1].check.violations or budget.is_over():
                return min(found, key=lambda one: one.violation)
            longer = stretched(request, found[-1].check, durations, search.max_stretch)
            if longer == durations or sum(longer) > context.longest:
                break
            durations = longer
    return min(found, key=lambda one: one.violation)


def _tried(case: Case, budget: Budget) -> Case:
    """The case after the stages of `ORDER`."""
    for stage in ORDER:
        if stage.applies(case):
            candidate = stage.search(case, budget)
            found = case.found if candidate is None else (*case.found, candidate)
            case = replace(case, tried=(*case.tried, stage.name), found=found)
            if candidate is not None and candidate.is_valid:
                break
    return case


def _mode(case: Case, best: Candidate, slow: Slow) -> str:
    """How the segments of several targets were joined; empty for a single one."""
    if case.request.is_single:
        return ""
    is_joined = best is slow.candidate or case.tried[-1] == "joined"
    return REAL_TIME if is_joined else OPTIMAL


def _stated_duration(
    context: Context, best: Candidate, slow: Slow, budget: Budget
) -> tuple[float, bool]:
    """A feasible duration to report [s], NaN if none is known, and whether it is the shortest."""
    request, search = best.request, context.options.search
    if best.is_valid:
        is_asked = searches_shortest(context, request) and best is not slow.candidate
        return (best.duration if is_asked else float("nan")), True
    if request.duration_is_free or best.is_hopeless or budget.is_over() or not request.is_single:
        return slow.duration, False
    segment, groups = request.segments[0], (((0,), False),)
    expected = predict(context, segment, request.goal, None)
    segment = replace(segment, expected=expected, duration=expected.duration)
    free = Request((segment,), groups, is_single=True)
    for width in range(context.bases.n_widths):
        setting = first_setting(context, free, width, shortest=True)
        found = attempt(context, free, setting, budget)
        if found.is_valid:
            seconds, is_shortest = found.duration, found.solution.converged
            seconds *= search.duration_margin
            return (slow.duration, False) if slow.duration < seconds else (seconds, is_shortest)
    return slow.duration, False
