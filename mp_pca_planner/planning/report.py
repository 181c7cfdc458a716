# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Step 5: the outcome of a search becomes a plan, with its status, message and figures.

All sentences about plans are in this module.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import text_table
from ..exceptions import quote_names
from ..motion.collision import NOT_CHECKED, CollisionModel
from ..motion.goal import Goal, JointState
from ..motion.interpolation import interpolate
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck
from ..primitives.in_span import UNUSUAL_IN_SPAN_SCORE
from .configurations import POSE_TOLERANCE
from .context import Context
from .objectives import effort
from .options import AUTO, DEMONSTRATED, FREE, REAL_TIME
from .plan import INFEASIBLE, SOLVED, STOPPED_EARLY, Plan
from .request import NATURAL, Request
from .search.candidate import Candidate
from .search.detours import missing_planner
from .search.search import Outcome
from .search.stop_and_go import brakes
from .selection import Considered

if TYPE_CHECKING:
    from .planner import Planner

# Moments at which clearances are computed at most, the time between them [s], and the largest
# clearance that is reported [m]: those below the first one are searched first.
_N_CHECKED, _PERIOD, _NEAREST, _NEAR = 1000, 4e-3, 0.01, 0.05
# Time before and after a collision in which it may begin or end, where it is known roughly [s].
_AROUND = 0.05
# Share of the planning time up to which there is time for the precise search.
_SHARE_OF_SOLVING = 0.5

# Distance from a demonstrated range, in standard deviations of its values, that is reported, that
# of requests unlike the demonstrations, and the least of these deviations [rad or m].
_FAR_OUTSIDE, _OUTSIDE, _LEAST_SPREAD = 2.0, 0.5, 0.1
# Ends outside their range that are named at most.
_N_NAMED = 3
# Share of the predicted effort that is no difference.
_SAME_EFFORT = 1e-6
# Naturalness from which on effort hardly moves the motion away from the prediction.
_CLOSE = 0.1

SENTENCES = {
    # What was found.
    "least": "motion of least {what} found{effort}",
    "close": "motion close to the prediction found (naturalness {rho:.3g}){effort}",
    "between": (
        "motion between the prediction and least {what} found (naturalness {rho:.3g}){effort}"
    ),
    "found": "motion found",
    "its_effort": ": effort {effort:.4g} N²m²s",
    "effort": ": effort {effort:.4g} N²m²s, {share:.2g} % {side} that of the predicted motion",
    "same_effort": ": effort {effort:.4g} N²m²s, that of the predicted motion",
    "shortest": "shortest motion within the limits found",
    "early": (
        "motion found, but not yet the best one: its share of the time, or its iterations, ran out"
    ),
    "joined": "segments joined without optimisation",
    "joined_collision": (
        "segments joined without optimisation, because in the optimised motion {met}"
    ),
    "joined_converged": (
        "segments joined without optimisation, because no cheaper motion within the limits was "
        "found"
    ),
    "joined_early": (
        "segments joined without optimisation, because time or iterations ran out before a cheaper "
        "motion within the limits was found"
    ),
    "slow": (
        "{searched}; this motion {follows} a minimum-jerk path{rests}, keeps the limits and may be "
        "executed"
    ),
    "slow_sequence": (
        "{searched}; this motion rests at each target{rests}, keeps the limits and may be executed"
    ),
    "follows": "follows",
    "brakes": "brakes, then follows",
    "around": " around obstacles with {n} stops",
    # What was not found, and why.
    "none": "no motion {kind} was found",
    "ran_out": "time ran out (max_solve_time = {most:g} s) before a motion {kind} was found",
    "within": "within the limits",
    "optimised": "optimised within the limits",
    "nonstop": "without stops within the limits",
    "clear": "without {collision}",
    "keeping": "that keeps {what}",
    "reaching": "that reaches its targets",
    "refused": "{searched}: {why}",
    "too_far": (
        "the request is too far from the demonstrations: its in-span score is {score:.2f}, and at "
        "most {most:g} is accepted (max_in_span_score)"
    ),
    "too_fast": (
        "no motion within the limits takes {asked:.4g} s: at its limit of velocity, {limit:.4g}, "
        "joint '{joint}' alone needs {least:.4g} s"
    ),
    "feasible": "{message}; a feasible duration is {seconds:.4g} s",
    "least_duration": "{message}; the shortest duration that the limits allow is {seconds:.4g} s",
    "no_slow": "{message}; no slow motion was found: {reason}",
    "no_planner": "{message}; {missing}",
    "end": "{end} is in collision: {collision}",
    "leave": "; no motion is planned out of a collision: move the robot or the obstacle first",
    "beyond": "the motion ends at a velocity, and in the stop after it {met}",
    "missed": "the nearest motion misses a target by {missed:.3g} rad or m",
    "strays": "the nearest motion violates this constraint",
    # Concessions, as the end of a sentence.
    "lengthened": "the duration was lengthened from {usual:.4g} to {duration:.4g} s",
    "raised": "the naturalness was raised from {asked:.3g} to {used:.3g}",
    "given_up": "; to keep the limits{clear}, {what}",
    "detour": "; near a collision-free path, because the predicted motion collides",
    "no_geometry": "not checked: the robot description has no collision geometry",
    "links_unchecked": "self-collision is not checked",
    "no_collision": "none; {n} pairs of {kind} were checked",
    "more_collide": ", and {n} more pairs collide",
    "far": "; the clearance is at least {near:g} mm",
    "near": "; the least clearance is {near:.1f} mm{margin}, of '{one}' and '{other}'",
    "margin": " (margin {margin:.3g} mm)",
    "unlike": "; nothing like this motion was demonstrated, so {what}",
    "around_unlike": "; the way around was not demonstrated, so {what}",
    "cost_counts": "its naturalness is only {rho:.3g}",
    "free": "its duration is free",
    "cleared": "; bodies that would collide otherwise are kept apart",
    "corrected": (
        "; B-splines were added to the components of the primitive (RMS {added:.2g} rad or m)"
    ),
    # Reasons for the choice of primitives.
    "named": "the goal names '{name}'",
    "only_primitive": "'{winner}' is the only primitive",
    "only_near": (
        "of {n} primitives, only '{winner}' has demonstrations near the request (in-span score "
        "{score:.2f})"
    ),
    "were_near": "of {n} primitives, {near} are near the request: {names}; {reason}",
    "more_names": " and {n} more",
    "least_expected": (
        "'{winner}' has the least expected cost, {cost:.4g}; '{second}' has {other:.4g}"
    ),
    "least_cost": "'{winner}' has the least cost of the {n} planned: {costs}",
    "outside": "'{name}' not within the limits",
    "cost": "'{name}' {cost:.4g}",
    # Lines of the table.
    "score": "  in-span score: {score:.2f} (about 1 is like the demonstrations, above 3 is unlike)",
    "expected_error": "  expected error of the predicted motion: {error:.2g} rad or m RMS",
    "kept": "kept, on a grid of 1 ms",
    "unlimited": "; some joints have no limit of {kinds}",
    # Remarks.
    "unusual": (
        "the request is unlike the demonstrations (in-span score {score:.1f}, about 1 is usual), "
        "so the motion may look unlike them"
    ),
    "outside_range": (
        "the {end} of '{joint}', {value:.3g} m, is outside the demonstrated {low:.3g} to {high:.3g}"
    ),
    "outside_angles": (
        "the {end} of '{joint}', {value:.3g} rad ({degrees[0]:.3g}°), is outside the demonstrated "
        "{low:.3g} to {high:.3g} ({degrees[1]:.3g}° to {degrees[2]:.3g}°)"
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
    best, request, motions = outcome.best, outcome.best.request, outcome.best.motions
    trajectory = best.trajectory
    solve_time = max(map(attrgetter("solved_at"), (best, *outcome.found))) - began
    correction, deviation, n_components = _of_weights(best)
    score, outside, error = _of_predictions(context, best)
    status, message = _status(context, outcome, solve_time, score, correction, n_components)
    ends = np.cumsum(list(map(attrgetter("duration"), motions)))
    start_error = np.abs(trajectory.positions[0] - request.start.positions).max()
    return Plan(
        status=status,
        message=message,
        trajectory=trajectory,
        motions=motions,
        primitives=tuple(map(attrgetter("primitive.name"), request.segments)),
        solution=best.solution,
        considered=max(map(len, map(attrgetter("considered"), request.segments))),
        selection=_selection(context, goal, outcome, len(planner.primitives)),
        in_span_score=score,
        outside=outside,
        expected_error=error,
        limit_check=best.check,
        start_error=float(start_error),
        goal_error=best.target_errors[-1],
        via_error=max(best.target_errors[:-1], default=0.0),
        via_phases=tuple((ends[:-1] / ends[-1]).tolist()),
        shortest_duration=outcome.stated,
        n_components_used=n_components,
        correction=correction,
        deviation_score=deviation,
        naturalness=best.naturalness,
        solve_time=solve_time,
        mode=outcome.mode,
        planner=planner,
    )


def _status(
    context: Context,
    outcome: Outcome,
    solve_time: float,
    score: float,
    correction: float,
    n_components: int,
) -> tuple[str, str]:
    """Status and message of a plan, see :func:`_of_predictions` and :func:`_of_weights`."""
    best = outcome.best
    if why := _refusal(context, outcome, solve_time, score):
        return INFEASIBLE, why
    concessions = _concessions(context, best, correction)
    if outcome.is_slow:
        return STOPPED_EARLY, _slow(context, outcome) + concessions
    if outcome.mode == REAL_TIME:
        status, name, met = _joined(outcome)
        return status, SENTENCES[name].format(met=met) + concessions
    concessions += _preferences(context, best)
    if not best.solution.converged:
        return STOPPED_EARLY, SENTENCES["early"] + concessions
    if np.isfinite(outcome.stated):
        return SOLVED, SENTENCES["shortest"] + concessions
    return SOLVED, _optimal(context, best, n_components) + concessions


def _optimal(context: Context, best: Candidate, n_components: int) -> str:
    """What an optimal motion is: near the prediction, or of least effort, by its naturalness."""
    objectives, rho = context.options.objectives, best.naturalness
    is_effort = len(objectives) == 1 and objectives[0][1] is effort
    cost, predicted = best.solution.effort_cost, best.solution.start_cost
    if best.bases[0].is_detour:
        its_effort = SENTENCES["its_effort"].format(effort=cost)
        return SENTENCES["found"] + (its_effort if np.isfinite(cost) else "")
    name = "least"
    if rho > 0.0 and n_components:
        name = "close" if rho >= _CLOSE and not _preferences(context, best) else "between"
    beside = ""
    if predicted > 0.0 and np.isfinite(cost):
        share = cost / predicted - 1.0
        side = "above" if share > 0.0 else "below"
        name_of_share = "effort" if abs(share) > _SAME_EFFORT else "same_effort"
        beside = SENTENCES[name_of_share].format(effort=cost, share=100.0 * abs(share), side=side)
    what = "effort" if is_effort else "cost"
    return SENTENCES[name].format(what=what, rho=rho, effort=beside)


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


def _refusal(context: Context, outcome: Outcome, solve_time: float, score: float) -> str:
    """Why a motion must not be executed; empty if it may."""
    best, trajectory = outcome.best, outcome.best.trajectory
    most = context.options.max_in_span_score
    if most and score > most:
        return SENTENCES["too_far"].format(score=score, most=most)
    if best.refusal:
        return _refused(context, outcome, SENTENCES["within"], best.refusal)
    met = ""
    if best.collisions:
        is_early = solve_time < _SHARE_OF_SOLVING * context.options.max_solve_time
        met = _met(context, best) if is_early else str(best.collisions[0])
    if context.collision is not None and np.any(trajectory.velocities[-1]):
        met = met or _met_beyond(context, trajectory)
    if met:
        return _refused(context, outcome, _clear_kind(context), met)
    if best.strayed:
        kind = SENTENCES["keeping"].format(what=" and ".join(best.strayed))
        return _refused(context, outcome, kind, SENTENCES["strays"])
    missed = max(best.target_errors)
    if missed > POSE_TOLERANCE:
        why = SENTENCES["missed"].format(missed=missed)
        return _refused(context, outcome, SENTENCES["reaching"], why)
    return ""


def _refused(context: Context, outcome: Outcome, kind: str, why: str) -> str:
    """The message of a motion that must not be executed."""
    best = outcome.best
    if cause := _end_in_collision(context, best.request):
        return cause
    message = SENTENCES["refused"].format(searched=_searched(context, outcome, kind), why=why)
    if not (best.request.mode or best.request.duration_is_free):
        message = _too_fast(context, best) or message
    if np.isfinite(outcome.stated):
        name = "least_duration" if outcome.is_shortest else "feasible"
        return SENTENCES[name].format(message=message, seconds=outcome.stated)
    if outcome.no_slow:
        message = SENTENCES["no_slow"].format(message=message, reason=outcome.no_slow)
    if outcome.is_blocked and not best.is_hopeless and (missing := missing_planner()):
        message = SENTENCES["no_planner"].format(message=message, missing=missing)
    return message


def _searched(context: Context, outcome: Outcome, kind: str) -> str:
    """Text on the end of the search for a kind of motion."""
    name = "ran_out" if outcome.ran_out else "none"
    return SENTENCES[name].format(kind=kind, most=context.options.max_solve_time)


def _clear_kind(context: Context) -> str:
    collision = context.collision
    has_world = collision is not None and len(collision.world)
    return SENTENCES["clear"].format(collision="collision" if has_world else "self-collision")


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
            leave = SENTENCES["leave"] if state is request.start else ""
            return SENTENCES["end"].format(end=name, collision=found[0].at_rest) + leave
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
        searched = _searched(context, outcome, SENTENCES["nonstop"])
        return SENTENCES["slow_sequence"].format(searched=searched, rests=rests)
    searched = _searched(context, outcome, SENTENCES["optimised"])
    follows = "brakes" if np.any(best.request.start.values[1:]) else "follows"
    return SENTENCES["slow"].format(searched=searched, follows=SENTENCES[follows], rests=rests)


def _concessions(context: Context, best: Candidate, correction: float) -> str:
    """The concessions that were made for the goal, as the end of a sentence."""
    options, collision = context.options, context.collision
    usual, duration = best.request.duration, best.duration
    given_up, kept = [], ""
    if duration > usual * (1.0 + 1e-9) and best.request.timing == DEMONSTRATED:
        given_up.append(SENTENCES["lengthened"].format(usual=usual, duration=duration))
    is_detour = best.bases[0].is_detour
    asked = best.request.naturalness
    if best.naturalness > asked and not is_detour:
        given_up.append(SENTENCES["raised"].format(asked=asked, used=best.naturalness))
    if given_up:
        clear = ""
        if collision is not None and collision.has_geometry:
            clear = f" {_clear_kind(context)}"
        kept = SENTENCES["given_up"].format(clear=clear, what=" and ".join(given_up))
    if is_detour:
        kept += SENTENCES["detour"]
        if collision is not None:
            kept += _clearance(collision, best.trajectory)
    elif best.has_clearances:
        kept += SENTENCES["cleared"]
    if collision is not None and not collision.has_geometry:
        kept += NOT_CHECKED
    if options.basis == "pca" and correction > 0.0:
        kept += SENTENCES["corrected"].format(added=correction)
    return kept


def _preferences(context: Context, best: Candidate) -> str:
    """What the planner chose because nothing like the motion was demonstrated."""
    options, request, chosen = context.options, best.request, []
    if options.naturalness is None and request.naturalness < NATURAL:
        chosen.append(SENTENCES["cost_counts"].format(rho=request.naturalness))
    if options.timing == AUTO and request.timing == FREE and request.duration_is_free:
        chosen.append(SENTENCES["free"])
    sentence = SENTENCES["around_unlike" if best.bases[0].is_detour else "unlike"]
    return sentence.format(what=" and ".join(chosen)) if chosen else ""


def _clearance(collision: CollisionModel, trajectory: Trajectory) -> str:
    """Text on the bodies that come nearest to each other in a motion."""
    q, margins = interpolate(trajectory, _PERIOD).q, collision.margins
    q = q[:: -(-len(q) // _N_CHECKED)]
    for reach in (_NEAREST, _NEAR):
        near = collision.near(q, reach)
        if near.distances.size:
            break
    else:
        return SENTENCES["far"].format(near=1e3 * _NEAR)
    # Distances count from the margins, and pairs without one may be nearer than all others.
    if np.ptp(margins):
        near = collision.near(q, float((near.distances + margins[near.pairs]).min()))
    distances = near.distances + margins[near.pairs]
    k = int(distances.argmin())
    pair = near.pairs[k]
    one, other = collision.pairs[pair]
    kept = SENTENCES["margin"].format(margin=1e3 * margins[pair]) if margins[pair] else ""
    nearest = np.floor(1e4 * distances[k]) / 10.0
    return SENTENCES["near"].format(near=nearest, margin=kept, one=one, other=other)


def collision_words(collision: CollisionModel | None, trajectory: Trajectory) -> str:
    """Text on the collisions of a motion: the deepest, or the least clearance.

    Parameters
    ----------
    collision : CollisionModel or None
        The model that was used; None if collisions were not checked.
    trajectory : Trajectory
        The motion.
    """
    if collision is None:
        return SENTENCES["links_unchecked"]
    if not collision.has_geometry:
        return SENTENCES["no_geometry"]
    found = collision.collisions(trajectory)
    if found:
        more = SENTENCES["more_collide"].format(n=len(found) - 1) if len(found) > 1 else ""
        return f"{found[0]}{more}"
    kind = "bodies" if len(collision.world) else "links"
    text = SENTENCES["no_collision"].format(n=len(collision.pairs), kind=kind)
    text += _clearance(collision, trajectory) if collision.pairs else ""
    return text if collision.checks_links else f"{text}; {SENTENCES['links_unchecked']}"


def _selection(context: Context, goal: Goal, outcome: Outcome, n_primitives: int) -> str:
    """The reason for the choice of the primitives."""
    request, n_named = outcome.best.request, context.options.selection.max_named
    if goal.primitive is not None:
        return SENTENCES["named"].format(name=goal.primitive)
    if request.mode:
        reasons = [
            selection_reason(one.considered, n_primitives, name, {name: None}, n_named)
            for one in request.segments
            for name in [one.primitive.name]
        ]
        return "; ".join(dict.fromkeys(reasons))
    segment = request.segments[0]
    winner = segment.primitive.name
    solved: dict[str, float | None] = {winner: None}
    if len(outcome.found) > 1:
        solved = {
            one.request.segments[0].primitive.name: one.solution.cost if one.is_valid else None
            for one in outcome.found
            if one.request.goal is request.goal
        }
    return selection_reason(segment.considered, n_primitives, winner, solved, n_named)


def selection_reason(
    considered: Sequence[Considered],
    n_primitives: int,
    winner: str,
    solved: Mapping[str, float | None],
    n_named: int,
) -> str:
    """The reason for the choice of a primitive, one sentence.

    Parameters
    ----------
    considered : sequence of Considered
        The primitives that were compiled, the one with the least expected cost first.
    n_primitives : int
        Number of available primitives.
    winner : str
        Name of the chosen one.
    solved : mapping of str to float or None
        Costs of the motions that were planned, by primitive; None: not within the limits.
    n_named : int
        Number of primitives that are named at most.
    """
    if n_primitives == 1:
        return SENTENCES["only_primitive"].format(winner=winner)
    first = considered[0]
    if len(considered) == 1:
        return SENTENCES["only_near"].format(
            n=n_primitives, winner=winner, score=first.expected.in_span_score
        )
    names = quote_names([one.name for one in considered[:n_named]])
    if len(considered) > n_named:
        names += SENTENCES["more_names"].format(n=len(considered) - n_named)
    if len(solved) == 1:
        reason = SENTENCES["least_expected"].format(
            winner=winner, cost=first.cost, second=considered[1].name, other=considered[1].cost
        )
    else:
        costs = [
            SENTENCES["outside" if cost is None else "cost"].format(name=name, cost=cost)
            for name, cost in solved.items()
        ]
        reason = SENTENCES["least_cost"].format(
            winner=winner, n=len(solved), costs=", ".join(costs)
        )
    return SENTENCES["were_near"].format(
        n=n_primitives, near=len(considered), names=names, reason=reason
    )


def _of_predictions(context: Context, best: Candidate) -> tuple[float, str, float]:
    """What the primitives say of the request and of the motion that was found.

    Returns
    -------
    score : float
        The in-span score of the request, the largest of its segments; for poses, of the
        configurations that were found.
    outside : str
        Text on the ends that are far outside their demonstrated ranges; empty if none is. Requests
        unlike the demonstrations are outside with one end at least, if only slightly.
    error : float
        The largest error to expect of a prediction [rad or m].
    """
    request = best.request
    is_resolved = not request.mode and request.pose is None
    is_fixed = not (request.mode or request.duration_is_free)
    score, error, found = -np.inf, -np.inf, list[tuple[float, str]]()
    for segment, motion in zip(request.segments, best.motions, strict=True):
        primitive, model = segment.primitive, segment.primitive.model
        start, goal = motion.start.positions, motion.goal.positions
        ends = np.array(model.turned(start, goal, context.robot.continuous))
        own = segment.expected.in_span_score
        if not is_resolved:
            own = model.in_span_score(ends[0], ends[1], motion.duration if is_fixed else None)
        score = max(score, own)
        expected = model.predict(ends[0], ends[1], motion.duration)
        error = np.maximum(error, primitive.prediction_error(expected))
        demonstrated = primitive.boundary_states[:, [0, 3]]
        low, high = demonstrated.min(axis=0), demonstrated.max(axis=0)
        beyond = np.maximum(low - ends, ends - high)
        beyond /= np.maximum(demonstrated.std(axis=0), _LEAST_SPREAD)
        for end, j in np.argwhere(beyond > 0.0):
            joint, numbers = primitive.joint_names[j], [x[end, j] for x in (ends, low, high)]
            is_angle = joint not in context.robot.prismatic_joints
            text = SENTENCES["outside_angles" if is_angle else "outside_range"].format(
                end=("start", "goal")[end],
                joint=joint,
                value=numbers[0],
                low=numbers[1],
                high=numbers[2],
                degrees=np.degrees(numbers),
            )
            found.append((float(beyond[end, j]), text))
    if not found:
        return score, "", float(error)
    found.sort(reverse=True)
    is_unusual = score > UNUSUAL_IN_SPAN_SCORE
    least = min(found[0][0], _OUTSIDE) if is_unusual else _FAR_OUTSIDE
    named = [text for distance, text in found if distance >= least]
    return score, "; ".join(named[:_N_NAMED]), float(error)


def _of_weights(best: Candidate) -> tuple[float, float, int]:
    """What the weights of a motion say, the largest of its segments.

    Returns
    -------
    correction : float
        RMS of what B-splines add to components [rad or m]; 0 without B-splines.
    deviation : float
        RMS deviation of the components' weights from the expected ones, in standard deviations; NaN
        without components.
    n_components : int
        Number of principal components.
    """
    correction, deviation, n_components = 0.0, float("nan"), 0
    for basis, motion in zip(best.bases, best.motions, strict=True):
        n, n_weights = basis.n_components, basis.expected.size
        n_components = max(n, n_components)
        if n:
            assert basis.precision is not None
            off = motion.weights[:n] - basis.expected[:n]
            own = float(np.sqrt(off @ basis.precision[:n, :n] @ off / n))
            deviation = own if np.isnan(deviation) else max(deviation, own)
        if n < n_weights:
            shape, phases = basis.tables.basis.shape, np.linspace(0.0, 1.0, 101)
            only = np.where(np.arange(n_weights) < n, 0.0, 1.0)
            added = shape(only * motion.weights, phases) - shape(0.0 * only, phases)
            correction = max(correction, float(np.sqrt(np.mean(added**2))))
    return correction, deviation, n_components


def table(plan: Plan) -> str:
    """A plan as some lines of text: what was found, how good it is, and where each joint goes."""
    trajectory, planner = plan.trajectory, plan.planner
    names = ", ".join(f"'{name}'" for name in dict.fromkeys(plan.primitives))
    head = f"Plan: {plan.status}, {plan.duration:.2f} s{plan.could_take} by {names}"
    lines = [head, f"  {plan.message}"]
    lines += [f"  remark: {remark}" for remark in remarks(plan) if remark != plan.message]
    lines.append(SENTENCES["score"].format(score=plan.in_span_score))
    if np.isfinite(plan.expected_error):
        lines.append(SENTENCES["expected_error"].format(error=plan.expected_error))
    violations = plan.limit_check.violations
    kept = str(violations[0]) if violations else SENTENCES["kept"]
    if planner is not None and (unlimited := planner.limits.unlimited):
        kept += SENTENCES["unlimited"].format(kinds=", ".join(unlimited))
    lines.append(f"  limits: {kept}")
    if planner is not None:
        lines.append(f"  collisions: {collision_words(planner.collision, trajectory)}")
    fastest = np.abs(trajectory.velocities).max(axis=0)
    # A number that is rounded to zero has no sign.
    columns = np.round([*trajectory.positions[[0, -1]], fastest], 3) + 0.0
    numbers = [[f"{x:.3f}" for x in row] for row in columns.T]
    rows = [[name, *row] for name, row in zip(trajectory.joint_names, numbers, strict=True)]
    head, *others = text_table(rows, header=["joint", "start", "goal", "fastest"]).splitlines()
    lines += [f"  {head}  [rad or m, /s]", *(f"  {line}" for line in others)]
    return "\n".join(lines)


def remarks(plan: Plan) -> list[str]:
    """Sentences on unusual properties of a plan; none for a usual one."""
    found = [plan.message] if plan.status == STOPPED_EARLY else []
    return found + motion_remarks(plan.in_span_score, plan.limit_check, plan.outside)


def motion_remarks(score: float, check: LimitCheck | None, outside: str = "") -> list[str]:
    """Sentences on an unusual request and on limits that a motion does not keep.

    Parameters
    ----------
    score : float
        In-span score of the request.
    check : LimitCheck or None
        Comparison of the motion with the limits.
    outside : str
        Joints whose start or goal is far outside the demonstrations, see :class:`.Plan`.
    """
    unusual = SENTENCES["unusual"].format(score=score) if score > UNUSUAL_IN_SPAN_SCORE else ""
    beyond = "" if check is None else check.remark
    return [sentence for sentence in (unusual, outside, beyond) if sentence]
