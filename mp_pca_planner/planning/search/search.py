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
from operator import attrgetter

from ..context import Context
from ..options import DEMONSTRATED, OPTIMAL, REAL_TIME
from ..plan import MotionSolution
from ..program.costs import rank_of
from ..program.joining import expected_motion
from ..request import Request
from ..requests.resolve import predict
from .budget import Budget
from .candidate import Candidate, attempt, with_costs
from .cases import Case, first_case
from .detours import along_path
from .examine import collides, searches_paths
from .recoveries import failure_of, recovered
from .sampling import missing_planner
from .settings import first_setting
from .slow import Slow, slow_motion


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
    applies: Callable[[Case], object]
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


def expected_collides(case: Case) -> bool:
    """Whether paths are tried before descent from the expected motion.

    They are if that is in collision at a quadrature node: descent from there takes longer than a
    path. It stays nearer to the demonstrations, so it comes first where their timing or
    naturalness is asked for.
    """
    context, request, options = case.context, case.request, case.context.options
    if not (request.is_single and searches_paths(context) and request.duration_is_free):
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
    if not case.found or not case.request.is_single or not searches_paths(case.context):
        return False
    last = case.found[-1]
    if "path" in case.tried or last.is_hopeless:
        return False
    # Collisions of a motion outside the limits are not known yet.
    return last.meets_bodies or collides(case.context, last.trajectory)


def path(case: Case, budget: Budget) -> Candidate | None:
    """The best motion along a collision-free path."""
    return along_path(case.context, case.request, budget)


def descent(case: Case, budget: Budget) -> Candidate:
    """The best motion by descent from the expected one, with recoveries of single segments.

    If paths may help, it ends when bodies collide.
    """
    context, request, setting = case.context, case.request, case.first
    leads = request.is_single and searches_paths(context) and not missing_planner()
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
            if candidate.meets_bodies or collides(context, candidate.trajectory):
                break
        if budget.is_over():
            break
        following = recovered(failure_of(context, request, case.first, setting, same))
        if following is None:
            break
        if following.width != setting.width or (setting.is_timed and not candidate.has_clearances):
            same = []
        setting = following
    return min(found, key=attrgetter("violation"))


def joined(case: Case, budget: Budget) -> Candidate:
    """The expected motion of several segments, joined within the limits if possible."""
    assert case.joined is not None
    passes = sum(one.solution.iterations for one in case.found)
    return replace(case.joined, solution=MotionSolution.unknown(passes))


ORDER = (
    Stage("path", expected_collides, path),
    Stage("descent", attrgetter("optimises"), descent),
    Stage("path", bodies_meet, path),
    Stage("joined", attrgetter("joined"), joined),
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
    every, found, tried, slow, ran_out = list[Candidate](), list[Candidate](), [], Slow(), False
    for request in requests:
        tried.append(request)
        first = budget
        if request.is_single and not request.duration_is_free:
            # Part of the time is kept for finding a feasible duration.
            share = context.options.search.share_of_fixed
            first = replace(budget, deadline=began + share * (budget.deadline - began))
        case = first_case(context, request, mode, first)
        for stage in ORDER:
            if stage.applies(case):
                candidate = stage.search(case, first)
                case = replace(case, tried=(*case.tried, stage.name))
                if candidate is not None:
                    case = replace(case, found=(*case.found, candidate))
                    if candidate.is_valid:
                        break
        found.append(min(case.found, key=attrgetter("violation")))
        every += case.found
        # Further configurations of a pose are for where the most natural one has no motion.
        if first.is_over() or (request.pose is not None and found[-1].is_valid):
            break
    best = found[0]
    if len(found) > 1:  # slow motions and detours have no costs yet
        found = [with_costs(context, one) for one in found]
        best = min(found, key=lambda one: (one.violation, rank_of(one.solution.cost)))
    if not (best.is_valid or best.is_hopeless or budget.is_cancelled()):
        ran_out = first.is_over()
        slow = slow_motion(context, chain(tried, requests), best, every, budget)
        best = slow.candidate or best
    stated, is_shortest, optimised, joins = float("nan"), True, None, ""
    if not best.is_valid:
        stated, is_shortest = feasible_duration(context, best, slow, budget)
    elif case.first.is_shortest:
        stated = best.duration
    if not request.is_single:
        is_joined = best is slow.candidate or case.tried[-1] == "joined"
        joins = REAL_TIME if is_joined else OPTIMAL
        optimised = case.found[0] if is_joined and mode == OPTIMAL else None
    return Outcome(best, tuple(found), optimised, slow, ran_out, stated, is_shortest, joins)


def feasible_duration(
    context: Context, best: Candidate, slow: Slow, budget: Budget
) -> tuple[float, bool]:
    """A feasible duration to report [s], NaN if none is known, and whether it is the shortest."""
    request, search = best.request, context.options.search
    if request.duration_is_free or best.is_hopeless or budget.is_over() or not request.is_single:
        return slow.duration, False
    segment, groups = request.segments[0], (((0,), False),)
    expected = predict(context, segment, request.goal, None)
    segment = replace(segment, expected=expected, duration=expected.duration)
    free = Request.of([segment], groups, is_single=True)
    for width in range(context.bases.n_widths):
        if budget.is_over():
            break
        setting = first_setting(context, free, width, shortest=True)
        found = attempt(context, free, setting, budget)
        if found.is_valid:
            seconds, is_shortest = found.duration, found.solution.converged
            seconds *= search.duration_margin
            return (slow.duration, False) if slow.duration < seconds else (seconds, is_shortest)
    return slow.duration, False
