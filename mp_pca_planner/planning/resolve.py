# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Resolution of goals: open quantities are filled in, unusable goals are rejected.

A primitive is selected without solving for all. The in-span score is a first filter: only
primitives about as near to the request as the nearest one remain. These are ranked by the cost of
their expected motion, compiled but not optimised. The reduction by optimisation differs by a few
percent between primitives, so the planner solves for all whose costs are that close to the least.

For each pose of a sequence, the initial configuration is the one that makes the sequence most
similar to the demonstrations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from operator import itemgetter

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, quote_names, unknown_name
from ..motion.goal import Goal, JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ..motion.validation import nearest_start
from ..primitives.in_span import UNUSUAL_IN_SPAN_SCORE
from ..primitives.library import PrimitiveLibrary
from ..primitives.prediction import ConditionalDistribution
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .configurations import configurations_at, starts_near
from .context import Budget, Context
from .motion import Motion, cost_of, rank_of
from .options import SHORTEST
from .program.compile import expected_cost, tables_of
from .request import Request, RequestSegment, naturalness_for, timing_for

# Largest in-span score of a primitive that is considered, as a multiple of the least one, and the
# score below which all are: the request is like their demonstrations.
_RELATIVE_SCORE, _NEAR_SCORE = 1.25, 1.0
# Primitives that are considered at most. Among many alike, the least expected cost of the 12
# nearest is 0.6 % above that of the 32 nearest, in the mean.
_MAX_CONSIDERED = 12
# Usual relative error of expected costs: three standard deviations of optimised to expected costs
# among the primitives of a request (1.6 % for the human-like arm).
_USUAL_ERROR = 0.05
# Primitives with which motions are planned at most.
_MAX_CONTENDERS = 5


Contender = tuple[MovementPrimitive, ConditionalDistribution]
"""A primitive and its prediction for a request."""


def in_span_scores(
    robot: Robot,
    primitives: Iterable[MovementPrimitive],
    start: FloatArray,
    goal: FloatArray,
    duration: float | None = None,
) -> FloatArray:
    """In-span scores of end points [rad or m] and a time [s] for primitives, (n_primitives,)."""
    found = list[float]()
    for model in (primitive.model for primitive in primitives):
        found.append(model.in_span_score(*model.turned(start, goal, robot.continuous), duration))
    return np.array(found)


def choose(
    context: Context,
    primitives: PrimitiveLibrary,
    start: FloatArray,
    goal: FloatArray,
    duration: float | None = None,
) -> list[Contender]:
    """The best primitives for a motion from rest to rest.

    Parameters
    ----------
    context : Context
        Robot and options. Primitives above `max_in_span_score` are only chosen if all are.
    primitives : PrimitiveLibrary
        The primitives.
    start, goal : array, shape (n_joints,)
        End points [rad or m].
    duration : float, optional
        Duration [s]; the one that each primitive predicts unless given.

    Returns
    -------
    contenders : list of Contender
        The one with the least expected cost, then those whose costs are too close to it to be
        ranked.
    """
    robot, chosen = context.robot, np.zeros(1, dtype=np.intp)
    if len(primitives) > 1:
        scores = in_span_scores(robot, primitives, start, goal, duration)
        nearest = np.argsort(scores, kind="stable")[:_MAX_CONSIDERED]
        scores = scores[nearest]
        most = max(context.options.max_in_span_score or np.inf, float(scores.min()))
        near_score = max(_RELATIVE_SCORE * float(scores.min()), _NEAR_SCORE)
        chosen = nearest[(scores <= near_score) & (scores <= most)]
    found, costs = list[Contender](), list[float]()
    here, there = (JointState(robot.joint_names, q) for q in (start, goal))
    for primitive in (primitives[i] for i in chosen):
        turned = primitive.model.turned(start, goal, robot.continuous)
        expected = primitive.model.predict(*turned, duration)
        found.append((primitive, expected))
        if len(chosen) == 1:
            return found
        # Without time scaling: tables for each request would dominate the computing time.
        tables = tables_of(primitive)
        motion = Motion(here, there, expected.duration, tables.basis, expected.weights)
        costs.append(rank_of(cost_of(robot, motion, tables, context.options.objectives)))
    cheapest = np.argsort(costs, kind="stable")[:_MAX_CONTENDERS]
    near = (1.0 + _USUAL_ERROR) * min(costs)
    return [found[i] for i in cheapest if costs[i] <= near]


# Largest positions, velocities and accelerations where there is no limit [SI].
_NO_ROBOT = 1e6
_QUANTITIES = ("position", "velocity", "acceleration")
_METRES = ("metres", "m/s", "m/s²")
_RADIANS = ("radians", "rad/s", "rad/s²")
_DEGREES = ("degrees", "deg/s", "deg/s²")
# Targets within this distance of each other count as the same [rad or m].
_SAME = 1e-6

# Known configurations to search from for a single pose, whose expected motions' costs are compared,
# and for each pose of a sequence.
_N_COMPARED, _N_KNOWN = 12, 4
# Configurations that reach a pose to which motions are planned, until one is found, and those of a
# pose of a sequence that are compared.
_N_CONFIGURATIONS, _N_ROUTE_CONFIGURATIONS = 3, 6
# Initial targets within this distance of the robot count as passed [rad or m].
_HERE = 0.01
# The robot is at a goal if it rests there within this distance [rad or m], at velocities of at most
# the same number [/s]. Drives repeat positions to about this.
_THERE = 1e-4


def resolve(
    context: Context,
    primitives: PrimitiveLibrary,
    goal: Goal,
    start: JointState,
    mode: str,
    budget: Budget,
) -> Iterable[Request]:
    """Fill in the open quantities of a goal; reject a goal that can't be served.

    A pose can be reached in several configurations: several requests, the one expected to be
    cheapest first.
    A configuration can be reached with several primitives, the one expected to be cheapest
    first.

    Parameters
    ----------
    context : Context
        Robot, limits and options.
    primitives : PrimitiveLibrary
        The primitives of the planner.
    goal : Goal
        The goal.
    start : JointState
        Present state.
    mode : {'optimal', 'real_time'}
        Whether to optimise a sequence, or only to join its segments.
    budget : Budget
        The time for planning.

    Returns
    -------
    requests : iterable of Request
        The requests; an empty tuple if the robot already is at the goal.

    Raises
    ------
    GoalError, RobotError
        See :meth:`.Planner.plan`.
    """
    here = in_order(start, context.robot.joint_names)
    # A start may be a little outside the limits of position.
    inside = nearest_start(here.positions, context.limits)
    _check_within_limits(context.robot, context.limits, "start", here, inside)
    _check_path(context, "start", here)
    if not isinstance(goal, SequenceGoal) and goal.duration is not None:
        context.check_duration("the duration is", goal.duration)
    if goal.primitive is not None:
        primitives = PrimitiveLibrary.of(primitives.named(goal.primitive))
    if isinstance(goal, SequenceGoal):
        n_passed = _n_passed(context, goal, here)
        if n_passed == len(goal.targets) - 1 and _is_there(
            context, goal.targets[-1], here, f"target {n_passed + 1}"
        ):
            return ()
        return (_sequence(context, primitives, goal, here, mode, n_passed),)
    if isinstance(goal, JointGoal):
        there = target(context, goal, here)
        if _is_there(context, there, here):
            return ()
        return _requests(context, primitives, goal, here, there)
    if _is_there(context, goal.pose, here):
        return ()
    return _cheapest_first(context, primitives, goal, here, budget)


def _is_there(
    context: Context, aim: JointState | Pose, here: JointState, what: str = "goal"
) -> bool:
    """Whether the robot rests, within its limits, at a target at which it is to rest."""
    limits = context.limits
    inside = np.array_equal(here.positions, np.clip(here.positions, limits.lower, limits.upper))
    return inside and max(_offsets(context, aim, here, what)) <= _THERE


def _offsets(
    context: Context, aim: JointState | Pose, here: JointState, what: str
) -> tuple[float, float]:
    """The largest distance from a target [rad or m], and the largest rate here or there."""
    rates = [here.velocities]
    if isinstance(aim, JointState):
        aim = completed(aim, here, context.robot, what)
        missed, rates = aim.positions - here.positions, [*rates, *aim.values[1:]]
    else:
        place = aim.position, aim.orientation
        missed, _ = context.robot.pose_error(aim.frame, here.positions, *place)
    return float(np.abs(missed).max()), float(np.abs(rates).max())


def _cheapest_first(
    context: Context, primitives: PrimitiveLibrary, goal: PoseGoal, here: JointState, budget: Budget
) -> Iterator[Request]:
    """Requests for the configurations that reach a pose, the least expected cost first.

    Only configurations like the demonstrations are compared, while there is time: a motion to
    another may cost less, but none like it was shown. The others follow, the most natural first.
    When time runs out, the search for configurations ends with the first that is found.
    """
    robot, known = context.robot, primitives.ends[:, 1]
    starts = [*starts_near(robot, goal.pose, known, _N_COMPARED), here.positions]
    found = configurations_at(robot, context.limits, goal.pose, starts, budget.is_late)
    goals, scores = [JointState(here.joint_names, unwrapped(q, here, robot)) for q in found], [0.0]
    if len(goals) > 1:
        ends = [(here.positions, there.positions) for there in goals]
        scores = [
            float(in_span_scores(robot, primitives, *pair, goal.duration).min()) for pair in ends
        ]
        goals = [goals[i] for i in np.argsort(scores, kind="stable")]
    n_natural = int(np.sum(np.array(scores) <= max(min(scores), UNUSUAL_IN_SPAN_SCORE)))
    natural: list[tuple[float, Request]] = []
    for there in goals[:n_natural]:
        (request,) = _requests(context, primitives, goal, here, there)
        natural.append((expected_cost(context, request) if n_natural > 1 else 0.0, request))
        if budget.is_late():
            break
    natural.sort(key=itemgetter(0))
    for _, request in natural[:_N_CONFIGURATIONS]:
        yield request
    # The others are usually not needed, so their requests are made when they are.
    for there in goals[len(natural) : _N_CONFIGURATIONS]:
        yield from _requests(context, primitives, goal, here, there)


def _requests(
    context: Context,
    primitives: PrimitiveLibrary,
    goal: JointGoal | PoseGoal,
    here: JointState,
    there: JointState,
) -> tuple[Request, ...]:
    """Requests for one configuration, which differ in their primitives."""
    pose = goal.pose if isinstance(goal, PoseGoal) else None
    contenders = choose(context, primitives, here.positions, there.positions, goal.duration)
    # Several primitives are tried for one configuration, but not in the search for the shortest
    # duration, nor for each of several configurations.
    one_each = pose is not None or (goal.duration is None and context.options.timing == SHORTEST)
    groups, found = (((0,), goal.duration is not None),), []
    # The same for all primitives, so that the costs of their motions can be compared.
    score = min(expected.in_span_score for _, expected in contenders)
    naturalness = naturalness_for(context.options, score)
    timing = timing_for(context.options, score)
    for primitive, expected in contenders[: 1 if one_each else None]:
        duration = expected.duration
        segment = RequestSegment(here, there, pose, True, primitive, expected, duration)
        found.append(Request((segment,), groups, "", naturalness, timing))
    return tuple(found)


def check_goal(robot: Robot, limits: JointLimits, goal: JointGoal) -> None:
    """Reject a configuration that no motion can end at, wherever it starts.

    Raises
    ------
    GoalError
        If it names unknown joints, or is outside the limits.
    """
    zero = np.zeros(robot.n_joints)
    here = JointState(robot.joint_names, np.clip(zero, limits.lower, limits.upper))
    there = completed(goal.state, here, robot, "goal")
    # The number of turns of a continuous joint depends on the start.
    q = np.where(robot.continuous, here.positions, there.positions)
    _check_within_limits(robot, limits, "goal", there, q)


def target(context: Context, goal: JointGoal, here: JointState) -> JointState:
    """The configuration of all joints that a goal specifies; see :func:`resolve`."""
    there = completed(goal.state, here, context.robot, "goal")
    _check_within_limits(context.robot, context.limits, "goal", there, there.positions)
    if not context.options.allow_nonzero_end_velocity and np.any(there.velocities != 0.0):
        moving = there.joint_names[int(np.abs(there.velocities).argmax())]
        raise GoalError(
            f"the goal velocity of joint '{moving}' is not 0, which the controller rejects "
            "unless it and this planner are set to allow a nonzero velocity at the end"
        )
    _check_path(context, "goal", there)
    return there


def _check_path(context: Context, what: str, state: JointState) -> None:
    """Reject a fixed end that violates a path constraint."""
    for constraint in context.options.constraints:
        values, _ = constraint.values(context.robot, state.positions[None])
        if values.min() < 0.0:
            raise GoalError(f"the {what} does not keep {constraint}, as is asked of the motion")


def _sequence(
    context: Context,
    primitives: PrimitiveLibrary,
    goal: SequenceGoal,
    here: JointState,
    mode: str,
    n_passed: int,
) -> Request:
    """Choose configurations, primitives and usual durations of a sequence."""
    last = max((when for when in goal.times if when is not None), default=1.0)
    context.check_duration("the sequence asks for a time of", last)
    targets, times = goal.targets[n_passed:], goal.times[n_passed:]
    stops = (*goal.stops[n_passed:-1], True)
    states = _route(context, primitives, targets, here, n_passed + 1)
    firsts = [choose(context, primitives, a.positions, b.positions)[0] for a, b in pairwise(states)]
    usual = [expected.duration for _, expected in firsts]
    # Predicted durations between two fixed times are scaled to the interval.
    scaled, groups = np.array(usual), list[tuple[tuple[int, ...], bool]]()
    began, first = 0.0, 0
    for i, fixed in enumerate(times, start=1):
        if fixed is not None:
            scaled[first:i] *= (fixed - began) / scaled[first:i].sum()
            groups.append((tuple(range(first, i)), True))
            began, first = fixed, i
    if first < len(times):
        groups.append((tuple(range(first, len(times))), False))
    durations = scaled.tolist()
    context.check_duration("the sequence would take", sum(durations))
    context.check_duration("a segment of the sequence would take", min(durations))
    segments = []
    for i, ((primitive, expected), aim) in enumerate(zip(firsts, targets, strict=True)):
        before, after, pose = states[i], states[i + 1], aim if isinstance(aim, Pose) else None
        segments.append(
            RequestSegment(before, after, pose, stops[i], primitive, expected, durations[i])
        )
    # Sequences are planned like the demonstrations unless the options say otherwise.
    naturalness = naturalness_for(context.options, 0.0)
    return Request(tuple(segments), tuple(groups), mode, naturalness, n_passed=n_passed)


def _n_passed(context: Context, goal: SequenceGoal, here: JointState) -> int:
    """The number of initial targets at the robot's position."""
    for n_passed, (aim, when) in enumerate(zip(goal.targets[:-1], goal.times[:-1], strict=True)):
        missed, _ = _offsets(context, aim, here, f"target {n_passed + 1}")
        if missed > _HERE:
            return n_passed
        if when is not None:
            raise GoalError(
                f"target {n_passed + 1} of the sequence is where the robot is, and is to be "
                f"passed at {when:g} s: to wait there, send the sequence later"
            )
    return len(goal.targets) - 1


def _route(
    context: Context,
    primitives: PrimitiveLibrary,
    targets: Sequence[JointState | Pose],
    here: JointState,
    first_number: int,
) -> tuple[JointState, ...]:
    """The states at the start and the targets that are most similar to the demonstrations.

    For poses, the configurations with the least sum of squared in-span scores are chosen, by
    dynamic programming.
    """
    robot, known = context.robot, primitives.ends.reshape(-1, here.positions.size)
    routes: list[tuple[float, tuple[JointState, ...]]] = [(0.0, (here,))]
    for number, aim in enumerate(targets, first_number):
        what, befores = f"target {number}", [states[-1] for _, states in routes]
        if isinstance(aim, Pose):
            starts = [one.positions for one in befores]
            starts += starts_near(robot, aim, known, _N_KNOWN)
            try:
                found = configurations_at(robot, context.limits, aim, starts)
            except GoalError as error:
                raise GoalError(f"{what}: {error}") from None
            found = found[:_N_ROUTE_CONFIGURATIONS]
            ends = [[unwrapped(q, one, robot) for one in befores] for q in found]
        else:
            ends = [[completed(aim, one, robot, what).positions for one in befores]]
        longer = []
        for positions in ends:
            longer.append(list[tuple[float, tuple[JointState, ...]]]())
            for (cost, states), q in zip(routes, positions, strict=True):
                there = JointState(here.joint_names, q)
                if isinstance(aim, JointState):
                    _check_within_limits(robot, context.limits, what, there, q)
                    _check_path(context, what, there)
                score = float(in_span_scores(robot, primitives, states[-1].positions, q).min())
                longer[-1].append((cost + score**2, (*states, there)))
        if isinstance(aim, JointState) and len(aim.joint_names) < robot.n_joints:
            (routes,) = longer
        else:
            routes = [min(part, key=itemgetter(0)) for part in longer]
    _, states = min(routes, key=itemgetter(0))
    for number, (a, b) in enumerate(pairwise(states[1:]), first_number):
        if np.abs(a.positions - b.positions).max() <= _SAME:
            # A segment without displacement would get an arbitrary swing from the optimiser.
            raise GoalError(
                f"targets {number} and {number + 1} of the sequence are the same: give it once"
            )
    return states


def in_order(state: JointState, names: Sequence[str]) -> JointState:
    """The start of the named joints alone, in their order.

    Raises
    ------
    GoalError
        If the state lacks a joint.
    """
    if state.joint_names == names:
        return state
    missing = [name for name in names if name not in state.joint_names]
    if missing:
        raise GoalError(
            f"the start lacks {quote_names(missing)}; it has {quote_names(state.joint_names)}"
        )
    index = [state.joint_names.index(name) for name in names]
    return JointState(
        names, state.positions[index], state.velocities[index], state.accelerations[index]
    )


def completed(state: JointState, before: JointState, robot: Robot, what: str) -> JointState:
    """The goal state of all joints; joints that are not named stay at rest.

    Parameters
    ----------
    state : JointState
        The requested state.
    before : JointState
        The state before, of all joints in the robot's order.
    robot : Robot
        The model; its continuous joints turn by less than half a turn.
    what : str
        Name of the state in messages.

    Raises
    ------
    GoalError
        If it names an unknown joint.
    """
    names = robot.joint_names
    if state.joint_names == names and not robot.continuous.any():
        return state
    for name in state.joint_names:
        if name not in names:
            raise GoalError(f"the {what} can't be used: {unknown_name('joint', name, names)}")
    q, v, a = before.positions.copy(), np.zeros(len(names)), np.zeros(len(names))
    index = [names.index(name) for name in state.joint_names]
    q[index], v[index], a[index] = state.positions, state.velocities, state.accelerations
    return JointState(names, unwrapped(q, before, robot), v, a)


def unwrapped(q: FloatArray, before: JointState, robot: Robot) -> FloatArray:
    """Positions to which continuous joints turn by less than half a turn."""
    turns = np.round((before.positions - q) / (2.0 * np.pi))
    return np.asarray(q + np.where(robot.continuous, 2.0 * np.pi * turns, 0.0))


def _check_within_limits(
    robot: Robot, limits: JointLimits, what: str, state: JointState, positions: FloatArray
) -> None:
    """Reject an end of a motion, with the positions that count, that violates a limit."""
    values = np.array([positions, state.velocities, state.accelerations])
    low, high = _bounds(limits)
    inside = (low <= values) & (values <= high)
    if inside.all():
        return
    k, j = np.argwhere(~inside)[0].tolist()
    name, value, bounds = state.joint_names[j], values[k, j], (low[k, j], high[k, j])
    text = (
        f"the {what} {_QUANTITIES[k]} of joint '{name}' is {value:.9g}, outside its limits "
        f"[{bounds[0]:.9g}, {bounds[1]:.9g}] in "
    )
    way_out = "; move it inwards, or widen its limits (limits file, robot.limits in Python)"
    way_out = way_out if k == 0 and what == "start" else ""
    if name in robot.prismatic_joints:
        raise GoalError(f"{text}{_METRES[k]}{way_out}")
    # The values may have been given in degrees, so the message states both.
    given, least, most = (f"{math.degrees(x):.5g}" for x in (value, *bounds))
    text += f"{_RADIANS[k]}; in {_DEGREES[k]}, {given}, outside [{least}, {most}]"
    if k == 0 and abs(value) > 2.0 * math.pi:
        text += "; commands read degrees with --degrees"
    raise GoalError(text + way_out)


@lru_cache(maxsize=8)
def _bounds(limits: JointLimits) -> tuple[FloatArray, FloatArray]:
    """Least and largest positions, velocities and accelerations, shape (3, n_joints)."""
    rates = limits.velocity, limits.acceleration
    low = np.maximum([limits.lower, *(-bound for bound in rates)], -_NO_ROBOT)
    return low, np.minimum([limits.upper, *rates], _NO_ROBOT)
