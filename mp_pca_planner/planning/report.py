# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Step 5: the outcome of a search becomes a plan, with its status, message and figures.

All sentences about plans are in this module.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..exceptions import TrajectoryError
from ..motion.collision import NOT_CHECKED
from ..motion.goal import Goal, JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_executable
from .configurations import POSE_TOLERANCE
from .context import Context
from .figures import (
    correction,
    deviation_score,
    expected_error,
    is_corrected,
    novelty,
    selection_reason,
)
from .objectives import Effort
from .options import DEMONSTRATED, REAL_TIME
from .plan import INFEASIBLE, SOLVED, STOPPED_EARLY, Plan
from .request import Request
from .requests.resolve import shifted
from .search.candidate import Candidate, with_costs
from .search.sampling import missing_planner
from .search.search import Outcome
from .search.stop_and_go import brakes

if TYPE_CHECKING:
    from .planner import Planner

# Points of a detour at which clearances are computed, and the largest that is reported [m].
_N_CHECKED, _NEAR = 50, 0.05
# Time before and after a collision in which it may begin or end, where it is known roughly [s].
_AROUND = 0.05
# Share of the planning time up to which there is time for the precise search.
_SHARE_OF_SOLVING = 0.5
# Distance from a demonstrated range, in standard deviations of its values, that is reported, and
# the least of these deviations [rad or m].
_FAR_OUTSIDE, _LEAST_SPREAD = 2.0, 0.1
# Naturalness from which on effort hardly moves the motion away from the prediction.
_CLOSE = 0.1

UNUSUAL_IN_SPAN_SCORE = 3.0
"""In-span score above which a motion is reported as unlike the demonstrations."""

SENTENCES = {
    "least": "motion of least {what} found{effort}",
    "close": "motion close to the prediction found (naturalness {rho:g}){effort}",
    "between": (
        "motion between the prediction and least {what} found (naturalness {rho:g}){effort}"
    ),
    "effort": ": effort {effort:.4g} N²m²s, {share:.2g} % {side} that of the predicted motion",
    "shortest": "shortest motion within the limits found",
    "early": "time or iterations ran out before the least was found",
    "joined": "motion concatenated in real time",
    "joined_collision": "motion concatenated in real time, because in the optimal one {met}",
    "joined_converged": (
        "motion concatenated in real time, because no cheaper one within the limits was found"
    ),
    "joined_early": (
        "motion concatenated in real time, because time or iterations ran out before a cheaper one "
        "within the limits was found"
    ),
    "slow": (
        "{searched}; this one {follows} a minimum-jerk path{rests}, keeps the limits and may be "
        "executed"
    ),
    "slow_sequence": (
        "{searched}; this one rests at each target{rests}, keeps the limits and may be executed"
    ),
    "around": " around obstacles with {n} stops",
    "none": "no motion {kind} was found",
    "ran_out": "time ran out (max_solve_time = {most:g} s) before a motion {kind} was found",
    "refused": "{searched}: {why}",
    "too_fast": (
        "no motion within the limits takes {asked:.4g} s: at its limit of velocity, {limit:.4g}, "
        "joint '{joint}' alone needs {least:.4g} s"
    ),
    "feasible": "{message}; a feasible duration is {seconds:.4g} s",
    "least_duration": ("{message}; the shortest duration that the limits allow is {seconds:.4g} s"),
    "no_slow": "{message}; nor was a slow one found: {reason}",
    "no_planner": "{message}; {missing}",
    "end": "{end} is in collision: {bodies} {place}",
    "beyond": "the goal is passed at a velocity, and in the stop after it {met}",
    "missed": "the nearest one is {missed:.3g} rad or m off",
    "keeping": "that keeps {what}",
    "strays": "the nearest one leaves it",
    "lengthened": "the duration was lengthened from {usual:.3g} to {duration:.3g} s",
    "raised": "the naturalness was raised from {asked:g} to {used:g}",
    "given_up": "; {why}, {what}",
    "detour": "; near a collision-free path, because the predicted motion collides",
    "far": "; bodies stay {near:g} mm apart",
    "near": "; the least clearance is {near:.1f} mm, of '{one}' and '{other}'",
    "cleared": "; bodies that would collide otherwise are kept apart",
    "corrected": (
        "; beyond the components of the primitive it took B-splines, {added:.2g} rad or m in the "
        "mean"
    ),
    "unusual": (
        "the request is unlike the demonstrations (in-span score {score:.1f}, about 1 is usual), "
        "so the motion may look unlike them, too"
    ),
    "outside": (
        "the {end} of '{joint}', {value:.3g} rad or m, is outside the demonstrated {low:.3g} to "
        "{high:.3g}"
    ),
}
"""Every sentence, and part of one, about a plan."""


def report(context: Context, outcome: Outcome, goal: Goal, began: float, planner: Planner) -> Plan:
    """The plan of an outcome.

    Parameters
    ----------
    context : Context
        Robot, limits and options of the planner.
    outcome : Outcome
        The outcome.
    goal : Goal
        The goal.
    began : float
        When planning began, by the clock of `time.perf_counter` [s].
    planner : Planner
        The planner.
    """
    best, request = with_costs(context, outcome.best), outcome.best.request
    trajectory, motions = best.trajectory.with_efforts(best.check.efforts), best.motions
    solve_time = max([best.solved_at, *[one.solved_at for one in outcome.found]]) - began
    status, message = _status(context, outcome, solve_time)
    ends = np.cumsum([motion.duration for motion in motions])
    start_error = np.abs(trajectory.positions[0] - request.start.positions).max()
    score = novelty(context, best)
    return Plan(
        status=status,
        message=message,
        trajectory=trajectory,
        motions=motions,
        primitives=tuple([segment.primitive.name for segment in request.segments]),
        solution=best.solution,
        considered=max([len(segment.selection.considered) for segment in request.segments]),
        selection=selection_reason(goal, outcome),
        in_span_score=score,
        outside=_outside(context, best, score),
        expected_error=expected_error(context, best),
        limit_check=best.check,
        start_error=float(start_error),
        goal_error=best.target_errors[-1],
        via_error=max(best.target_errors[:-1], default=0.0),
        via_phases=tuple((ends[:-1] / ends[-1]).tolist()),
        shortest_duration=outcome.stated,
        n_components_used=max([basis.n_components for basis in best.bases]),
        correction=max(map(correction, best.bases, motions)),
        deviation_score=deviation_score(best),
        naturalness=best.naturalness,
        solve_time=solve_time,
        mode=outcome.mode,
        planner=planner,
    )


def _status(context: Context, outcome: Outcome, solve_time: float) -> tuple[str, str]:
    """Status and message of a plan."""
    best = outcome.best
    if why := _refusal(context, outcome, solve_time):
        return INFEASIBLE, why
    concessions = _concessions(context, best)
    if best is outcome.slow.candidate:
        return STOPPED_EARLY, _slow(context, outcome) + concessions
    if outcome.mode == REAL_TIME:
        status, name, met = _joined(outcome)
        return status, SENTENCES[name].format(met=met) + concessions
    if not best.solution.converged:
        return STOPPED_EARLY, SENTENCES["early"] + concessions
    if np.isfinite(outcome.stated):
        return SOLVED, SENTENCES["shortest"] + concessions
    return SOLVED, _optimal(context, best) + concessions


def _optimal(context: Context, best: Candidate) -> str:
    """What an optimal motion is: near the prediction, or of least effort, by its naturalness."""
    objectives, rho = context.options.objectives, best.naturalness
    is_effort = [type(objective) for _, objective in objectives] == [Effort]
    name = "least"
    if rho > 0.0 and any(basis.n_components for basis in best.bases):
        name = "close" if rho >= _CLOSE else "between"
    effort, predicted = best.solution.effort_cost, best.solution.start_cost
    beside = ""
    if predicted > 0.0 and np.isfinite(effort):
        share = effort / predicted - 1.0
        side = "above" if share > 0.0 else "below"
        beside = SENTENCES["effort"].format(effort=effort, share=100.0 * abs(share), side=side)
    what = "effort" if is_effort else "cost"
    return SENTENCES[name].format(what=what, rho=rho, effort=beside)


def _outside(context: Context, best: Candidate, score: float) -> str:
    """Text on the end that is furthest outside its demonstrated range; empty if none is far."""
    least = 0.0 if score > UNUSUAL_IN_SPAN_SCORE else _FAR_OUTSIDE
    found = (least, "")
    for segment, motion in zip(best.request.segments, best.motions, strict=True):
        demonstrated = segment.primitive.boundary_states[:, [0, 3]]
        low, high = demonstrated.min(axis=0), demonstrated.max(axis=0)
        ends = np.array(shifted(context, replace(segment, start=motion.start), motion.goal))
        beyond = np.maximum(low - ends, ends - high)
        beyond /= np.maximum(demonstrated.std(axis=0), _LEAST_SPREAD)
        end, j = np.unravel_index(int(beyond.argmax()), beyond.shape)
        text = SENTENCES["outside"].format(
            end=("start", "goal")[end],
            joint=segment.primitive.joint_names[j],
            value=ends[end, j],
            low=low[end, j],
            high=high[end, j],
        )
        found = max(found, (float(beyond[end, j]), text))
    return found[1]


def _joined(outcome: Outcome) -> tuple[str, str, str]:
    """Status, sentence, and collision of a motion that was joined without optimisation."""
    optimised = outcome.optimised
    if optimised is None:
        return SOLVED, "joined", ""
    if optimised.collisions:
        return SOLVED, "joined_collision", str(optimised.collisions[0])
    if optimised.solution.converged:
        return SOLVED, "joined_converged", ""
    return STOPPED_EARLY, "joined_early", ""


def _refusal(context: Context, outcome: Outcome, solve_time: float) -> str:
    """Why a motion must not be executed; empty if it may."""
    best, trajectory = outcome.best, outcome.best.trajectory
    try:
        check_executable(
            trajectory,
            best.check,
            best.request.start,
            allow_nonzero_end_velocity=context.options.allow_nonzero_end_velocity,
        )
    except TrajectoryError as error:
        return _refused(context, outcome, "within the limits", str(error))
    met = ""
    if best.collisions:
        is_early = solve_time < _SHARE_OF_SOLVING * context.options.max_solve_time
        met = _met(context, best) if is_early else str(best.collisions[0])
    if context.collision is not None and np.any(trajectory.velocities[-1]):
        met = met or _met_beyond(context, trajectory)
    if met:
        return _refused(context, outcome, f"without {_collision_kind(context)}", met)
    if best.strayed:
        kind = SENTENCES["keeping"].format(what=" and ".join(best.strayed))
        return _refused(context, outcome, kind, SENTENCES["strays"])
    missed = max(best.target_errors)
    if missed > POSE_TOLERANCE:
        why = SENTENCES["missed"].format(missed=missed)
        return _refused(context, outcome, "that passes where it was asked to", why)
    return ""


def _refused(context: Context, outcome: Outcome, kind: str, why: str) -> str:
    """The message of a motion that must not be executed."""
    best = outcome.best
    if cause := _end_in_collision(context, best.request):
        return cause
    message = SENTENCES["refused"].format(searched=_searched(context, outcome, kind), why=why)
    if best.request.is_single and not best.request.duration_is_free:
        message = _too_fast(context, best) or message
    if np.isfinite(outcome.stated):
        name = "least_duration" if outcome.is_shortest else "feasible"
        return SENTENCES[name].format(message=message, seconds=outcome.stated)
    if outcome.slow.reason:
        message = SENTENCES["no_slow"].format(message=message, reason=outcome.slow.reason)
    is_blocked = bool(best.collisions) or "collide" in outcome.slow.reason
    if is_blocked and not best.is_hopeless and (missing := missing_planner()):
        message = SENTENCES["no_planner"].format(message=message, missing=missing)
    return message


def _searched(context: Context, outcome: Outcome, kind: str) -> str:
    """Text on the end of the search for a kind of motion."""
    name = "ran_out" if outcome.ran_out else "none"
    return SENTENCES[name].format(kind=kind, most=context.options.max_solve_time)


def _collision_kind(context: Context) -> str:
    collision = context.collision
    return "collision" if collision is not None and len(collision.world) else "self-collision"


def _end_in_collision(context: Context, request: Request) -> str:
    """Text on the first configuration of a request that is in collision; empty if none is."""
    names, model = context.robot.joint_names, context.collision
    fixed = [("the start", request.start)]
    if request.pose is None:
        fixed.append(("the goal", request.goal))
    for number, segment in enumerate(request.segments[:-1], start=1):
        if segment.pose is None:
            fixed.append((f"target {number}", segment.goal))
    zero = np.zeros((1, len(names)))
    for name, state in fixed if model is not None else ():
        assert model is not None
        still = Trajectory(names, [0.0], [state.positions], zero, zero)
        if found := model.collisions(still, precisely=False):
            return SENTENCES["end"].format(end=name, bodies=found[0].bodies, place=found[0].place)
    return ""


def _met(context: Context, best: Candidate) -> str:
    """Text on the deepest collision of a motion, about the time that is known roughly.

    Only this part of the motion is searched again, because that takes longer than planning.
    """
    rough, points = best.collisions[0], best.trajectory
    first = int(np.searchsorted(points.times, rough.first_time - _AROUND))
    last = int(np.searchsorted(points.times, rough.last_time + _AROUND))
    began, part = points.times[first], slice(first, last + 1)
    states = [x[part] for x in points.states]
    section = Trajectory(points.joint_names, points.times[part] - began, *states)
    assert context.collision is not None
    found = context.collision.collisions(section, precisely=True)
    return str(found[0].within(-began, np.inf) or rough) if found else str(rough)


def _met_beyond(context: Context, trajectory: Trajectory) -> str:
    """Text on the collision of all stops beyond a goal in motion; empty if one is clear."""
    met, options = "", context.options
    end = JointState(trajectory.joint_names, *[values[-1] for values in trajectory.states])
    assert context.collision is not None
    for stop, check in brakes(
        context.robot, context.limits, end, options.sample_period, options.braking
    ):
        if check.violations:
            continue
        found = context.collision.collisions(stop, precisely=False)
        if not found:
            return ""
        met = met or SENTENCES["beyond"].format(met=found[0])
    return met


def _too_fast(context: Context, best: Candidate) -> str:
    """The reason why the requested duration has no motion; empty if unknown."""
    request, limits = best.request, context.limits
    least = np.abs(request.goal.positions - request.start.positions) / limits.velocity
    j = int(least.argmax())
    if request.pose is not None or not least[j] > request.duration:
        return ""
    return SENTENCES["too_fast"].format(
        asked=request.duration,
        limit=limits.velocity[j],
        joint=limits.joint_names[j],
        least=least[j],
    )


def _slow(context: Context, outcome: Outcome) -> str:
    """The message of a slow motion."""
    best = outcome.best
    rests = SENTENCES["around"].format(n=best.n_stops) if best.n_stops else ""
    if outcome.mode:
        searched = _searched(context, outcome, "without stops within the limits")
        return SENTENCES["slow_sequence"].format(searched=searched, rests=rests)
    searched = _searched(context, outcome, "optimised within the limits")
    follows = "brakes, then follows" if np.any(best.request.start.values[1:]) else "follows"
    return SENTENCES["slow"].format(searched=searched, follows=follows, rests=rests)


def _concessions(context: Context, best: Candidate) -> str:
    """The concessions that were made for the goal, as the end of a sentence."""
    options, collision = context.options, context.collision
    usual, duration = best.request.duration, best.duration
    given_up, kept = [], ""
    if duration > usual * (1.0 + 1e-9) and options.timing == DEMONSTRATED:
        given_up.append(SENTENCES["lengthened"].format(usual=usual, duration=duration))
    is_detour = best.bases[0].is_detour
    if best.naturalness > options.naturalness and not is_detour:
        given_up.append(
            SENTENCES["raised"].format(asked=options.naturalness, used=best.naturalness)
        )
    if given_up:
        why = "to keep the limits"
        if collision is not None and collision.has_geometry:
            why += f" without {_collision_kind(context)}"
        kept = SENTENCES["given_up"].format(why=why, what=" and ".join(given_up))
    if is_detour:
        kept += SENTENCES["detour"] + _clearance(context, best.trajectory)
    elif best.has_clearances:
        kept += SENTENCES["cleared"]
    if collision is not None and not collision.has_geometry:
        kept += NOT_CHECKED
    if options.basis == "pca" and any(map(is_corrected, best.bases)):
        added = max(map(correction, best.bases, best.motions))
        kept += SENTENCES["corrected"].format(added=added)
    return kept


def _clearance(context: Context, trajectory: Trajectory) -> str:
    """Text on the bodies that come nearest to each other on a detour."""
    if context.collision is None:
        return ""
    positions = trajectory.positions
    chosen = np.linspace(0, len(positions) - 1, min(_N_CHECKED, len(positions))).astype(int)
    near = context.collision.near(positions[chosen], _NEAR)
    if not near.distances.size:
        return SENTENCES["far"].format(near=1e3 * _NEAR)
    k = int(near.distances.argmin())
    one, other = context.collision.pairs[near.pairs[k]]
    return SENTENCES["near"].format(near=1e3 * near.distances[k], one=one, other=other)


class AnyPlan(Protocol):
    """Common interface of all kinds of plans."""

    @property
    def status(self) -> str:
        """Status of the plan."""

    @property
    def message(self) -> str:
        """One sentence."""

    @property
    def in_span_score(self) -> float:
        """How far outside the demonstrations the request lies."""

    @property
    def limit_check(self) -> LimitCheck | None:
        """Its comparison with the limits."""


def remarks(plan: AnyPlan) -> list[str]:
    """Sentences on unusual properties of a plan; none for a usual one."""
    found = [plan.message] if plan.status == STOPPED_EARLY else []
    if plan.in_span_score > UNUSUAL_IN_SPAN_SCORE:
        found.append(SENTENCES["unusual"].format(score=plan.in_span_score))
    if isinstance(plan, Plan) and plan.outside:
        found.append(plan.outside)
    if plan.limit_check is not None and plan.limit_check.remark:
        found.append(plan.limit_check.remark)
    return found
