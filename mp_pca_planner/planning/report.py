# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Step 5: the outcome of a search becomes a plan, with its status, message and figures."""

from __future__ import annotations

import time
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import text_table
from ..motion.collision import CollisionModel
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck
from ..primitives.in_span import UNUSUAL_IN_SPAN_SCORE
from .configurations import POSE_TOLERANCE
from .context import Context
from .options import DEMONSTRATED, REAL_TIME
from .plan import ALREADY_THERE, INFEASIBLE, NOT_SOLVED, SOLVED, STOPPED_EARLY, Plan
from .request import Request
from .resolve import in_order
from .search.candidate import Candidate
from .search.detours import missing_planner
from .search.search import Outcome
from .search.stop_and_go import brakes

if TYPE_CHECKING:
    from .planner import Planner

# Distance from a demonstrated range, in standard deviations of its values, that is reported, that
# of requests unlike the demonstrations, and the least of these deviations [rad or m].
_FAR_OUTSIDE, _OUTSIDE, _LEAST_SPREAD = 2.0, 0.5, 0.1
# Ends outside their range that are named at most.
_N_NAMED = 3


def report(context: Context, outcome: Outcome, began: float, planner: Planner) -> Plan:
    """The plan of an outcome.

    Parameters
    ----------
    context : Context
        Robot, limits and options of the planner.
    outcome : Outcome
        The outcome.
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
    status, message = _status(context, outcome, score, correction)
    ends = np.cumsum(list(map(attrgetter("duration"), motions)))
    start_error = np.abs(trajectory.positions[0] - request.start.positions).max()
    return Plan(
        status=status,
        message=message,
        trajectory=trajectory,
        motions=motions,
        primitives=tuple(map(attrgetter("primitive.name"), request.segments)),
        solution=best.solution,
        considered=max(map(attrgetter("considered"), request.segments)),
        in_span_score=score,
        outside=outside,
        expected_error=error,
        limit_check=best.check,
        start_error=float(start_error),
        goal_error=best.target_errors[-1],
        via_error=max(best.target_errors[:-1], default=0.0),
        via_phases=tuple((ends[:-1] / ends[-1]).tolist()),
        n_components_used=n_components,
        correction=correction,
        deviation_score=deviation,
        naturalness=best.naturalness,
        solve_time=solve_time,
        mode=outcome.mode,
        planner=planner,
    )


def already_there(context: Context, start: JointState, began: float, planner: Planner) -> Plan:
    """The plan for a goal at which the robot rests: no motion; see :func:`report`."""
    here = in_order(start, context.robot.joint_names)
    zero = np.zeros((1, len(here.joint_names)))
    still = Trajectory(here.joint_names, [0.0], [here.positions], zero, zero)
    nan = float("nan")
    return Plan(
        status=ALREADY_THERE,
        message="already there: the robot rests at the goal, so no motion is needed",
        trajectory=still,
        motions=(),
        primitives=(),
        solution=NOT_SOLVED,
        considered=0,
        in_span_score=nan,
        outside="",
        expected_error=nan,
        limit_check=LimitCheck(),
        start_error=0.0,
        goal_error=0.0,
        via_error=0.0,
        via_phases=(),
        n_components_used=0,
        correction=0.0,
        deviation_score=nan,
        naturalness=nan,
        solve_time=time.perf_counter() - began,
        planner=planner,
    )


def _status(context: Context, outcome: Outcome, score: float, correction: float) -> tuple[str, str]:
    """Status and message of a plan, see :func:`_of_predictions` and :func:`_of_weights`."""
    best, cost = outcome.best, outcome.best.solution.effort_cost
    if why := _refusal(context, outcome, score):
        return INFEASIBLE, why
    status, message = SOLVED, "motion found"
    if outcome.is_slow:
        status, message = STOPPED_EARLY, _slow(context, outcome)
    elif outcome.mode == REAL_TIME:
        message = "segments joined without optimisation"
        tried = outcome.optimised
        if tried is not None:
            message += ", because no better motion within the limits was found"
            if not (tried.collisions or tried.solution.converged):
                status = STOPPED_EARLY
    elif not best.solution.converged:
        status = STOPPED_EARLY
        message += ", but not yet the best one: its share of the time, or its iterations, ran out"
    elif outcome.is_shortest:
        message = "shortest motion within the limits found"
    elif np.isfinite(cost):
        message = f"motion found: effort {cost:.4g} N²m²s"
    if status == SOLVED and outcome.ran_out:
        status = STOPPED_EARLY
        most = context.options.max_solve_time
        message += f", but time ran out (max_solve_time = {most:g} s) before the search ended"
    return status, "; ".join([message, *_concessions(context, best, correction)])


def _refusal(context: Context, outcome: Outcome, score: float) -> str:
    """Why a motion must not be executed; empty if it may."""
    best, most = outcome.best, context.options.max_in_span_score
    if most and score > most:
        return (
            "the request is too far from the demonstrations: its in-span score is "
            f"{score:.2f}, and at most {most:g} is accepted (max_in_span_score)"
        )
    why, kind = best.refusal, "within the limits"
    if not why and (why := _met(context, best)):
        has_world = context.collision is not None and len(context.collision.world)
        kind = f"without {'collision' if has_world else 'self-collision'}"
    if not why and best.strayed:
        kind = f"that keeps {' and '.join(best.strayed)}"
        why = "the nearest motion violates this constraint"
    missed = max(best.target_errors)
    if not why and missed > POSE_TOLERANCE:
        kind = "that reaches its targets"
        why = f"the nearest motion misses a target by {missed:.3g} rad or m"
    if not why:
        return ""
    if cause := _end_in_collision(context, best.request):
        return cause
    message = f"{_searched(context, outcome, kind)}: {why}"
    if not (best.request.mode or best.request.duration_is_free):
        message += "; without a duration, timing 'shortest' finds the shortest one"
    if best.meets_bodies and not best.is_hopeless and (missing := missing_planner()):
        message += f"; {missing}"
    return message


def _searched(context: Context, outcome: Outcome, kind: str) -> str:
    """Text on the end of the search for a kind of motion."""
    if outcome.ran_out:
        most = context.options.max_solve_time
        return f"time ran out (max_solve_time = {most:g} s) before a motion {kind} was found"
    return f"no motion {kind} was found"


def _slow(context: Context, outcome: Outcome) -> str:
    """The message of a slow motion."""
    kind = "without stops within the limits" if outcome.mode else "optimised within the limits"
    path = "rests at each target" if outcome.mode else "follows a minimum-jerk path"
    n_stops = outcome.best.n_stops
    around = f" around obstacles with {n_stops} stops" if n_stops else ""
    return f"{_searched(context, outcome, kind)}; this motion {path}{around} and keeps the limits"


def _met(context: Context, best: Candidate) -> str:
    """Text on the collision of a motion, or of all stops beyond a goal in motion; or empty."""
    if best.collisions:
        return str(best.collisions[0])
    end = JointState(best.trajectory.joint_names, *(x[-1] for x in best.trajectory.states))
    if context.collision is None or not np.any(end.velocities):
        return ""
    met, options = "", context.options
    for stop, check in brakes(context.robot, context.limits, end, options.sample_period):
        if check.violations:
            continue
        found = context.collision.collisions(stop, precisely=False)
        if not found:
            return ""
        met = met or f"the motion ends at a velocity, and in the stop after it {found[0]}"
    return met


def _end_in_collision(context: Context, request: Request) -> str:
    """Text on the first configuration of a request that is in collision; empty if none is."""
    model = context.collision
    if model is None:
        return ""
    names, fixed = context.robot.joint_names, [("the start", request.start)]
    if request.pose is None:
        fixed.append(("the goal", request.goal))
    for number, segment in enumerate(request.segments[:-1], start=1):
        if segment.pose is None:
            fixed.append((f"target {number}", segment.goal))
    zero = np.zeros((1, len(names)))
    for name, state in fixed:
        still = Trajectory(names, [0.0], [state.positions], zero, zero)
        if found := model.collisions(still, precisely=False):
            leave = ": move the robot or the obstacle first" if state is request.start else ""
            return f"{name} is in collision: {found[0].at_rest}{leave}"
    return ""


def _concessions(context: Context, best: Candidate, correction: float) -> list[str]:
    """What was done for the goal beyond a usual motion."""
    request, notes = best.request, []
    is_detour = best.bases[0].is_detour
    usual, asked = request.duration, request.naturalness
    if n_passed := request.n_passed:
        which = "target 1 is" if n_passed == 1 else f"targets 1 to {n_passed} are"
        notes.append(f"{which} left out, because the robot is there")
    if best.duration > usual * (1.0 + 1e-9) and request.timing == DEMONSTRATED:
        notes.append(f"the duration was lengthened from {usual:.4g} to {best.duration:.4g} s")
    if best.naturalness > asked and not is_detour:
        notes.append(f"the naturalness was raised from {asked:.3g} to {best.naturalness:.3g}")
    if is_detour:
        notes.append("near a collision-free path, because the predicted motion collides")
    elif best.has_clearances:
        notes.append("bodies that would collide otherwise are kept apart")
    if context.options.basis == "pca" and correction > 0.0:
        notes.append(f"B-splines were added to the components (RMS {correction:.2g} rad or m)")
    return notes


def collision_words(collision: CollisionModel | None, trajectory: Trajectory) -> str:
    """Text on the collisions of a motion.

    Parameters
    ----------
    collision : CollisionModel or None
        The model that was used; None if collisions were not checked.
    trajectory : Trajectory
        The motion.
    """
    if collision is None:
        return "self-collision is not checked"
    if found := collision.collisions(trajectory, precisely=False):
        return str(found[0])
    kind = "bodies" if len(collision.world) else "links"
    text = f"none; {len(collision.pairs)} pairs of {kind} were checked"
    return text if collision.checks_links else f"{text}; self-collision is not checked"


def _of_predictions(context: Context, best: Candidate) -> tuple[float, str, float]:
    """What the primitives say of the request and of the motion that was found.

    Returns
    -------
    score : float
        The in-span score of the request, the largest of its segments; for poses, of the
        configurations that were found.
    outside : str
        Text on the ends that are far outside their demonstrated ranges; empty if none is.
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
            text = (
                f"the {('start', 'goal')[end]} of '{joint}', {numbers[0]:.3g}, is outside the "
                f"demonstrated {numbers[1]:.3g} to {numbers[2]:.3g}"
            )
            found.append((float(beyond[end, j]), text))
    least = _OUTSIDE if score > UNUSUAL_IN_SPAN_SCORE else _FAR_OUTSIDE
    named = [text for distance, text in sorted(found, reverse=True) if distance >= least]
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
    if not plan.motions:
        return repr(plan)
    names = ", ".join(f"'{name}'" for name in dict.fromkeys(plan.primitives))
    head = f"Plan: {plan.status}, {plan.duration:.2f} s by {names}"
    lines = [head, f"  {plan.message}"]
    lines += [f"  remark: {remark}" for remark in plan.remarks if remark != plan.message]
    lines.append(
        f"  in-span score: {plan.in_span_score:.2f} (about 1 is like the demonstrations, above 3 "
        "is unlike)"
    )
    if np.isfinite(plan.expected_error):
        error = f"{plan.expected_error:.2g} rad or m RMS"
        lines.append(f"  expected error of the predicted motion: {error}")
    violations = plan.limit_check.violations
    kept = str(violations[0]) if violations else "kept, on a grid of 1 ms"
    if planner is not None and (unlimited := planner.limits.unlimited):
        kept += f"; some joints have no limit of {', '.join(unlimited)}"
    lines.append(f"  limits: {kept}")
    if planner is not None:
        lines.append(f"  collisions: {collision_words(planner.collision, trajectory)}")
    if planner is not None:
        lines.append(f"  efforts: of {planner.robot.effort_parts}")
    fastest = np.abs(trajectory.velocities).max(axis=0)
    # A number that is rounded to zero has no sign.
    columns = np.round([*trajectory.positions[[0, -1]], fastest], 3) + 0.0
    numbers = [[f"{x:.3f}" for x in row] for row in columns.T]
    rows = [[name, *row] for name, row in zip(trajectory.joint_names, numbers, strict=True)]
    head, *others = text_table(rows, header=["joint", "start", "goal", "fastest"]).splitlines()
    lines += [f"  {head}  [rad or m, /s]", *(f"  {line}" for line in others)]
    return "\n".join(lines)


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
    unusual = (
        f"the request is unlike the demonstrations (in-span score {score:.1f}, about 1 is usual), "
        "so the motion may look unlike them"
    )
    found = unusual if score > UNUSUAL_IN_SPAN_SCORE else ""
    beyond = "" if check is None else check.remark
    return [sentence for sentence in (found, outside, beyond) if sentence]
