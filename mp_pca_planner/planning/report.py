# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Step 5: the best candidate of a search becomes a plan: a status, one reason and remarks."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from operator import attrgetter

import numpy as np

from ..motion.collision import CollisionModel
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck
from ..primitives.in_span import UNUSUAL_IN_SPAN_SCORE
from .configurations import POSE_TOLERANCE
from .context import Budget, Context
from .options import DEMONSTRATED, REAL_TIME
from .plan import ALREADY_THERE, INFEASIBLE, SOLVED, STOPPED_EARLY, Plan
from .resolve import in_order
from .search.candidate import JOINED, OPTIMISED, SLOW, Candidate, met_at
from .search.detours import missing_planner
from .search.stop_and_go import brakes
from .time_scaling import shortest_durations

# Distance from a demonstrated range, in standard deviations of its values, that is reported, that
# of requests unlike the demonstrations, and the least of these deviations [rad or m].
_FAR_OUTSIDE, _OUTSIDE, _LEAST_SPREAD = 2.0, 0.5, 0.1
# Ends outside their range that are named at most.
_N_NAMED = 3
# In-span score up to which a request is like the demonstrations; about 1 is usual.
_LIKE_SCORE = 1.5
# Clearance up to which it is measured [m].
_CLEARANCE_REACH = 0.2


def report(context: Context, best: Candidate, budget: Budget, began: float) -> Plan:
    """The plan of a candidate.

    Parameters
    ----------
    context : Context
        Robot, limits and options of the planner.
    best : Candidate
        The best candidate of the search.
    budget : Budget
        The time that there was.
    began : float
        When planning began, by the clock of `time.perf_counter` [s].
    """
    solve_time, request, trajectory = time.perf_counter() - began, best.request, best.trajectory
    correction = _correction(best)
    score, outside, error = _of_predictions(context, best)
    model, nearest = context.collision, None
    if model is not None and len(model.world):
        nearest = model.clearance(trajectory, _CLEARANCE_REACH)
    status, message = _verdict(context, best, budget, score)
    if status != INFEASIBLE:
        is_shaped = context.options.basis == "pca" and correction > 0.0
        parts = [_headline(context, best, score, nearest, is_shaped=is_shaped), message]
        unit = context.robot.position_unit
        parts += _concessions(best, correction if is_shaped else 0.0, unit)
        message = "; ".join(filter(None, parts))
    remarks = motion_remarks(score, best.check, outside)
    collision = _collision_words(model, best)
    limits = best.refusal if best.check.violations else "kept, on a grid of 1 ms"
    if unlimited := context.limits.unlimited:
        limits += f"; {unlimited}"
    start_error = np.abs(trajectory.positions[0] - request.start.positions).max()
    facts: dict[str, str | float | int] = {
        "naturalness": best.naturalness,
        "expected_error": error,
        "correction": correction,
        "start_error": float(start_error),
        "via_error": max(best.target_errors[:-1], default=0.0),
        "effort_parts": context.robot.effort_parts,
        "limits": limits,
        "collision": collision,
    }
    if nearest is not None:
        facts |= {"clearance": nearest[0], "nearest_obstacle": nearest[1]}
    return Plan(
        status,
        message,
        trajectory,
        best.motions,
        tuple(map(attrgetter("primitive.name"), request.segments)),
        best.solution,
        replace(best.check, efforts=None),
        tuple(remarks),
        score,
        best.target_errors[-1],
        solve_time,
        REAL_TIME if request.mode and best.how != OPTIMISED else request.mode,
        facts,
    )


def already_there(context: Context, start: JointState, began: float) -> Plan:
    """The plan for a goal at which the robot rests: no motion; see :func:`report`."""
    here = in_order(start, context.robot.joint_names)
    still = Trajectory.at_rest(here.joint_names, here.positions)
    message = "already there: the robot rests at the goal, so no motion is needed"
    took, zero_errors = time.perf_counter() - began, {"start_error": 0.0, "via_error": 0.0}
    return Plan(ALREADY_THERE, message, still, solve_time=took, facts=zero_errors)


def _headline(
    context: Context,
    best: Candidate,
    score: float,
    nearest: tuple[float, str] | None,
    *,
    is_shaped: bool,
) -> str:
    """What a user wants to know of a motion: duration, likeness, clearance, share of efforts."""
    duration = best.duration
    parts = [f"{duration:.1f} s" if duration >= 1.0 else f"{duration:.2f} s"]
    like = "at the edge of" if score <= UNUSUAL_IN_SPAN_SCORE else "unlike"
    like = "like" if score <= _LIKE_SCORE else like
    if is_shaped or best.bases[0].is_detour or best.how == SLOW:  # then only the request is
        like = f"a goal {like}"
    parts.append(f"{like} your demonstrations (score {score:.1f})")
    if nearest is not None:
        parts.append(f"{math.floor(1e3 * nearest[0])} mm clear of '{nearest[1]}'")
    efforts, bounds = best.check.efforts, context.limits.effort
    if efforts is not None and np.isfinite(bounds).any():
        share = float(np.max(np.abs(efforts) / bounds))
        name = "effort" if context.robot.prismatic_joints else "torque"
        parts.append(f"{100.0 * share:.0f} % of the {name} limit")
    return ", ".join(parts)


def _verdict(context: Context, best: Candidate, budget: Budget, score: float) -> tuple[str, str]:
    """Status of a motion, and why it must not be executed or is not the best one; or how it is."""
    request, most = best.request, context.options.max_in_span_score
    if most and score > most:
        return INFEASIBLE, (
            "the request is too far from the demonstrations: its in-span score is "
            f"{score:.2f}, and at most {most:g} is accepted (max_in_span_score)"
        )
    if best.blocked:
        return INFEASIBLE, best.blocked
    ran_out = f"time ran out (max_solve_time = {budget.seconds:g} s)"
    searched = "no motion {} was found"
    if budget.is_cut:
        searched = f"{ran_out} before a motion {{}} was found"
    why, kind = best.refusal, "within the limits"
    if not why and best.collisions:
        why = str(best.collisions[0])
        has_world = context.collision is not None and len(context.collision.world)
        kind = f"without {'collision' if has_world else 'self-collision'}"
    if not why and best.strayed:
        kind = f"that keeps {' and '.join(best.strayed)}"
        why = "the nearest motion violates this constraint"
    missed = max(best.target_errors)
    if not why and missed > POSE_TOLERANCE:
        kind = "that reaches its targets"
        why = f"the nearest motion misses a target by {missed:.3g} rad or m"
    cause = _cause(context, best, is_refused=bool(why))
    if cause:
        return INFEASIBLE, cause
    if why:
        message = f"{searched.format(kind)}: {why}"
        if not (request.mode or request.duration_is_free):
            message += "; without a duration, timing 'shortest' finds the shortest one"
        if best.meets_bodies and (missing := missing_planner()):
            message += f"; {missing}"
        return INFEASIBLE, message
    if best.how == SLOW:
        kind = "without stops within the limits" if request.mode else "optimised within the limits"
        path = "rests at each target" if request.mode else "follows a minimum-jerk path"
        around = f" around obstacles with {best.n_stops} stops" if best.n_stops else ""
        searched = searched.format(kind)
        return STOPPED_EARLY, f"{searched}; this motion {path}{around} and keeps the limits"
    if best.how == JOINED:
        text = "segments joined without optimisation"
        if request.mode == REAL_TIME:
            return SOLVED, text
        why = "because no better motion within the limits was found"
        return STOPPED_EARLY, f"{text}, {why}"
    if budget.is_cut:
        return STOPPED_EARLY, f"{ran_out} before the search ended"
    if not best.solution.converged:
        return STOPPED_EARLY, "not the best motion yet: the solver's iterations ran out"
    return SOLVED, ""


def _cause(context: Context, best: Candidate, *, is_refused: bool) -> str:
    """Text on what the request itself makes impossible, whatever the time; empty if nothing.

    A duration that the limits exclude, the configuration of a pose in collision, or the collision
    of all stops beyond a goal in motion.
    """
    request, limits, model = best.request, context.limits, context.collision
    is_fixed = not (request.mode or request.duration_is_free) and request.pose is None
    if is_refused and is_fixed:
        least = shortest_durations(limits, request.start, request.goal)
        if least.max() > request.duration:
            return (
                f"the duration of {request.duration:.4g} s is too short: within its limits, joint "
                f"'{limits.joint_names[least.argmax()]}' takes at least {least.max():.4g} s; "
                "without a duration, timing 'shortest' finds the shortest one"
            )
    if model is None:
        return ""
    if is_refused:
        targets = zip(request.target_names, request.segments, best.motions, strict=True)
        for name, segment, motion in targets:
            if segment.pose is not None and (found := met_at(model, motion.goal)):
                return (
                    f"{name} is in collision: {found[0].at_rest}; no configuration that reaches "
                    "its pose without a collision was found"
                )
    end = best.motions[-1].goal
    if not np.any(end.velocities):
        return ""
    met, options = "", context.options
    for stop, check in brakes(context.robot, context.limits, end, options.sample_period):
        if check.violations:
            continue
        found = model.collisions(stop, precisely=False)
        if not found:
            return ""
        met = met or f"the motion ends at a velocity, and in the stop after it {found[0]}"
    return met


def _concessions(best: Candidate, correction: float, unit: str) -> list[str]:
    """What was done for the goal beyond a usual motion."""
    request, notes = best.request, []
    is_detour = best.bases[0].is_detour
    usual = request.duration
    if n_passed := request.n_passed:
        which = "target 1 is" if n_passed == 1 else f"targets 1 to {n_passed} are"
        notes.append(f"{which} left out, because the robot is there")
    if best.duration > usual * (1.0 + 1e-9) and request.timing == DEMONSTRATED:
        notes.append(f"the duration was lengthened from {usual:.4g} to {best.duration:.4g} s")
    if is_detour:
        notes.append("a detour, because the predicted motion collides")
    elif best.has_clearances:
        notes.append("shaped to avoid a collision")
    if correction > 0.0:
        advice = "" if is_detour else ": record some near this goal"
        notes.append(f"shaped beyond the demonstrations (RMS {correction:.2g} {unit}){advice}")
    return notes


def _collision_words(model: CollisionModel | None, best: Candidate) -> str:
    """Text on what was checked for collisions, and what was found."""
    if model is None:
        return "self-collision is not checked"
    if best.check.violations:
        return "not checked, because limits are violated"
    if best.blocked or best.collisions:
        return best.blocked or str(best.collisions[0])
    kind = "bodies" if len(model.world) else "links"
    text = f"none; {len(model.pairs)} pairs of {kind} were checked"
    return text if model.checks_links else f"{text}; self-collision is not checked"


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
        expected = segment.expected
        own = expected.in_span_score
        if not is_resolved:
            own = model.in_span_score(ends[0], ends[1], motion.duration if is_fixed else None)
        score = max(score, own)
        if not (is_resolved and motion.duration == expected.duration):
            expected = model.predict(ends[0], ends[1], motion.duration)
        error = np.maximum(error, primitive.prediction_error(expected))
        demonstrated = primitive.boundary_states[:, [0, 3]]
        low, high = demonstrated.min(axis=0), demonstrated.max(axis=0)
        beyond = np.maximum(low - ends, ends - high)
        for end, j in np.argwhere(beyond > 0.0):
            joint, numbers = primitive.joint_names[j], [x[end, j] for x in (ends, low, high)]
            text = (
                f"the {('start', 'goal')[end]} of '{joint}', {numbers[0]:.3g}, is outside the "
                f"demonstrated {numbers[1]:.3g} to {numbers[2]:.3g}"
            )
            spread = max(float(demonstrated[:, end, j].std()), _LEAST_SPREAD)
            found.append((float(beyond[end, j]) / spread, text))
    least = _OUTSIDE if score > UNUSUAL_IN_SPAN_SCORE else _FAR_OUTSIDE
    named = [text for distance, text in sorted(found, reverse=True) if distance >= least]
    return score, "; ".join(named[:_N_NAMED]), float(error)


def _correction(best: Candidate) -> float:
    """RMS of what B-splines add to components [rad or m], the largest of the segments."""
    found = 0.0
    for basis, motion in zip(best.bases, best.motions, strict=True):
        if basis.n_components < motion.weights.size:
            phases = np.linspace(0.0, 1.0, 101)
            only, shape = motion.weights.copy(), basis.tables.basis.shape
            only[: basis.n_components] = 0.0
            added = shape(only, phases) - shape(0.0 * only, phases)
            found = max(found, float(np.sqrt(np.mean(added**2))))
    return found


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
        f"in-span score {score:.1f}, where 1 is usual: look at the motion before a robot moves"
    )
    found = unusual if score > UNUSUAL_IN_SPAN_SCORE else ""
    beyond = "" if check is None else check.remark
    return [sentence for sentence in (found, outside, beyond) if sentence]
