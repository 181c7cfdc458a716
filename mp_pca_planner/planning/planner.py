# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner (block 4 of [P] Fig. 1): goal → primitive → program → weights → trajectory."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, PrimitiveError, quote_names
from ..motion.collision import CollisionModel
from ..motion.goal import JointGoal, JointState, PoseGoal
from ..motion.validation import check_limits, require_effort_limits
from ..primitives.basis import Basis, BSplineBasis
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .attempt import NEAR_EXPECTED, Attempt, MotionSolver, condition_errors, largest
from .compiler import QuadratureTables
from .conditions import PoseTarget
from .constraints import LimitTables
from .fallback import Fallback, FallbackPlanner
from .families import Family, component_family, corrected_family, spline_family
from .objectives import uses_efforts
from .plan import FREE, SHORTEST, Plan, PlannerOptions
from .request import Request, RequestMaker
from .selection import Selector
from .starts import Practice
from .stop_and_go import slowdown
from .verdict import Judge, Outcome, StatedDuration, correction

# Share of the time that goes to the duration that was asked for.
_SHARE_OF_FIXED = 0.6
# The search for the shortest duration: first step and precision.
_FIRST_STEP, _DURATION_PRECISION = 2.0, 1.002
# In it, likeness to the demonstrations mustn't stand against the limits.
_SEARCH_NATURALNESS = 1e-2
# The shortest duration is stated this much longer, for a motion to fit into it again.
_SHORTEST_MARGIN = 1.002
# Demonstrations of a primitive whose own ends are planned between beforehand. From them one starts
# up to that in-span score: requests like the demonstrations have at most 2, those from anywhere
# to anywhere 6 and more, and may end in dear optima.
_N_PRACTISED, _PRACTISED_SCORE = 20, 3.0
# Where an attempt doesn't meet the limits, a duration that nobody fixed is lengthened up to this
# factor, …
_LONGEST_STRETCH = 10.0
# … and motions are pulled towards the expected one, ten times as hard each time, up to a
# naturalness at which effort hardly counts any more.
_PULLS = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)


@dataclass(eq=False)
class Planner:
    """Plans motions of one robot from movement primitives.

    Parameters
    ----------
    robot : Robot
        The model, with the joints of the primitives in their order. Not shared between threads.
    primitives : sequence of MovementPrimitive
        At least one; names must differ.
    limits : JointLimits
        Limits of the joints.
    options : PlannerOptions
        How to plan.
    collision : CollisionModel, optional
        Of the same robot, not shared between threads: keeps the robot from hitting itself, where it
        has collision geometry at all.

    Raises
    ------
    PrimitiveError
        If there is no primitive, two have the same name, or one is of other joints.
    RobotError
        If a moving link has no valid inertia, and efforts are limited or part of the objective.
    """

    robot: Robot
    primitives: Sequence[MovementPrimitive]
    limits: JointLimits
    options: PlannerOptions = field(default_factory=PlannerOptions)
    collision: CollisionModel | None = None

    def __post_init__(self) -> None:
        names = [p.name for p in self.primitives]
        if not names:
            raise PrimitiveError("the planner needs at least one primitive, got none")
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise PrimitiveError(f"several primitives are called {quote_names(twice)}")
        for primitive in self.primitives:
            if primitive.joint_names != self.robot.joint_names:
                raise PrimitiveError(
                    f"primitive '{primitive.name}' moves {quote_names(primitive.joint_names)}, but "
                    f"the planner was set up for {quote_names(self.robot.joint_names)}"
                )
        require_effort_limits(self.robot, self.limits)
        if any(uses_efforts(objective, self.robot) for _, objective in self.options.objectives):
            others = "choose an objective without efforts, such as jerk"
            self.robot.require_inertias("objectives with efforts", others)
        bases: list[Basis] = [p.basis for p in self.primitives]
        if self.options.basis == "bspline":
            bases = [BSplineBasis(self.robot.n_joints)] * len(names)
        tables = [QuadratureTables(basis, self.options.n_nodes) for basis in bases]
        self._tables = {
            name: (nodes, LimitTables(nodes)) for name, nodes in zip(names, tables, strict=True)
        }
        selector = Selector(self.robot, self.primitives, self.options.objectives)
        self._requests = RequestMaker(self.robot, self.limits, self.options, selector)
        self._solver = MotionSolver(self.robot, self.limits, self.options, self.collision)
        self._fallback = FallbackPlanner(self.robot, self.limits, self.options, self._solver)
        self._judge = Judge(self.limits, self.options, self.collision)
        self._practice: dict[str, Practice] = {}

    def check(self, goal: JointGoal) -> None:
        """Refuse a goal that can't be served wherever the robot is.

        This takes far less time than planning, and may be done while another thread plans.

        Raises
        ------
        GoalError
            If it names unknown joints or no primitive of the planner, is outside the limits, or
            its duration is out of the question.
        """
        self._requests.check(goal)

    def target(self, goal: JointGoal, start: JointState) -> JointState:
        """The whole configuration that a goal asks for, of all joints of the robot.

        Raises
        ------
        GoalError
            See :meth:`plan`.
        """
        return self._requests.target(goal, start)

    def plan(self, goal: JointGoal | PoseGoal, start: JointState) -> Plan:
        """Plan the motion with the least of the objectives to a goal.

        Parameters
        ----------
        goal : JointGoal or PoseGoal
            What to reach. Joints that a joint goal doesn't name keep their position.
        start : JointState
            Present state; further joints are ignored.

        Returns
        -------
        plan : Plan
            The motion; look at its status.

        Raises
        ------
        GoalError
            If the goal or the state can't be used: unknown or missing joints, positions
            outside the limits, a pose out of reach, no such primitive.
        RobotError
            If there is no such frame.
        """
        began = time.perf_counter()
        deadline = began + self.options.max_solve_time
        # What a duration that is too short leaves goes to finding one that isn't.
        share = 1.0 if goal.duration is None else _SHARE_OF_FIXED
        enough = began + share * self.options.max_solve_time
        attempts: list[Attempt] = []
        requests = self._requests.complete(goal, start)
        for request in requests:
            attempts.append(self._serve(request, enough))
            if _is_over(enough):
                break
        best = min(attempts, key=lambda one: (one.fault, one.solution.cost))
        failed = best.fault > 0.0 and not best.is_hopeless
        ran_out, fallback = failed and _is_over(enough), Fallback()
        if failed:
            fallback = self._fallback.serve(requests, best)
            best = fallback.attempt or best
        stated = self._stated_duration(best, fallback, deadline)
        reason = _reason(goal, best, attempts)
        solve_time = max(attempts[-1].solved_at, best.solved_at) - began
        return self._plan(Outcome(best, fallback, stated, ran_out), reason, solve_time)

    def practise(self, max_time: float = float("inf")) -> None:
        """Plan between the ends of demonstrations, to find similar motions faster from there.

        That takes as long as twenty goals for each primitive, and goals later take about two
        thirds of the time (benchmarks/starts.py). Where motions stay near the expected ones
        anyway (naturalness of 0.1 and more), and for B-splines alone, it does nothing.

        Parameters
        ----------
        max_time : float
            Time [s] after which no further motion is begun.
        """
        if self.options.basis != "pca" or self.options.naturalness >= NEAR_EXPECTED:
            return
        deadline = time.perf_counter() + max_time
        for primitive in self.primitives:
            found = self._practised(primitive, deadline)
            if found.memories:
                self._practice[primitive.name] = found

    def _practised(self, primitive: MovementPrimitive, deadline: float) -> Practice:
        names, states = primitive.joint_names, primitive.boundary_states
        chosen = np.linspace(0, len(states) - 1, min(len(states), _N_PRACTISED)).astype(int)
        ends, weights, memories = [], [], []
        for i in chosen:
            if _is_over(deadline):
                break
            here, there = (JointState(names, states[i, k]) for k in (0, 3))
            duration = float(primitive.durations[i])
            goal = JointGoal(there, duration, primitive=primitive.name)
            try:
                request = self._requests.complete(goal, here)[0]
            except GoalError:  # demonstrations may lie outside the limits
                continue
            family = next(self._families(request))
            enough = time.perf_counter() + self.options.max_solve_time
            found = self._solver.attempt(
                request, family, duration, self.options.naturalness, enough
            )
            if found.fault == 0.0 and found.solution.converged:
                ends.append(states[i, [0, 3]].ravel())
                weights.append(found.solution.weights)
                memories.append(found.memory.curvature_alone())
        return Practice(np.array(ends), np.array(weights), memories)

    def _serve(self, request: Request, deadline: float) -> Attempt:
        """The best motion of the narrowest family in which there is one."""
        best: Attempt | None = None
        for family in self._families(request):
            attempt = self._within_limits(request, family, deadline)
            if best is None or attempt.fault < best.fault:
                best = attempt
            if best.fault == 0.0 or best.is_hopeless or _is_over(deadline):
                break
        assert best is not None
        return best

    def _families(self, request: Request) -> Iterator[Family]:
        """The families to try, from the narrowest to the widest."""
        nodes, grid = self._tables[request.primitive.name]
        if self.options.basis == "bspline":
            yield spline_family(nodes, grid)
            return
        primitive, ends = request.primitive, (request.start.positions, request.goal.positions)
        like_demonstrations = request.expected.in_span_score <= _PRACTISED_SCORE
        if np.any(request.expected.pace):
            # That of a motion with a pace of its own is not known before.
            basis = primitive.paced_basis(*ends, request.expected.pace)
            nodes = QuadratureTables(basis, self.options.n_nodes)
            grid = LimitTables(nodes)
        components = component_family(
            nodes,
            grid,
            primitive,
            request.expected,
            np.concatenate(ends),
            self._practice.get(primitive.name) if like_demonstrations else None,
        )
        n_equations = sum(c.target.error(ends[0])[0].size for c in request.conditions)
        n_goal = 0 if request.pose is None else self.robot.n_joints
        if n_equations <= components.n_components + n_goal:
            yield components
        yield corrected_family(components, primitive, self.options.n_nodes)
        nodes = QuadratureTables(BSplineBasis(self.robot.n_joints), self.options.n_nodes)
        yield spline_family(nodes, LimitTables(nodes))

    def _within_limits(self, request: Request, family: Family, deadline: float) -> Attempt:
        """The best motion of a family, slower or more natural if it must be to keep the limits."""
        duration, naturalness = request.expected.duration, self.options.naturalness
        if request.duration_is_free and self.options.timing == SHORTEST:
            found, is_shortest = self._shortest(request, family, deadline)
            converged = found.solution.converged and is_shortest
            return replace(found, solution=replace(found.solution, converged=converged))
        if request.duration_is_free and self.options.timing == FREE:
            timed = self._solver.attempt(
                request, family, duration, naturalness, deadline, duration_is_free=True
            )
            if timed.fault == 0.0:
                return timed
            duration = timed.motion.duration
        best: Attempt | None = None
        while True:
            attempt = self._solver.attempt(request, family, duration, naturalness, deadline)
            if best is None or attempt.fault < best.fault:
                best = attempt
            remedy = None if _is_over(deadline) else self._remedy(attempt)
            if remedy is None:
                return best
            duration, naturalness = remedy

    def _shortest(self, request: Request, family: Family, deadline: float) -> tuple[Attempt, bool]:
        """The attempt of the shortest duration that keeps the limits, by bisection.

        Which durations are long enough is known only from trying; each attempt optimises the
        weights (and a free goal) again. Whether there was time to find the shortest is returned,
        too.
        """
        naturalness = min(self.options.naturalness, _SEARCH_NATURALNESS)

        def attempt(duration: float) -> Attempt:
            return self._solver.attempt(
                request, family, duration, naturalness, deadline, searching=True
            )

        best = attempt(request.expected.duration)
        too_short, factor = 0.0, 1.0 / _FIRST_STEP if best.fault == 0.0 else _FIRST_STEP
        longest = _LONGEST_STRETCH * request.expected.duration
        while best.fault > 0.0 or too_short == 0.0:
            duration = factor * best.motion.duration
            if not longest / _LONGEST_STRETCH**3 < duration <= longest or _is_over(deadline):
                return best, not _is_over(deadline)
            tried = attempt(duration)
            if tried.fault > 0.0 and best.fault == 0.0:
                too_short = duration
            else:
                if tried.fault == 0.0 and best.fault > 0.0:
                    too_short = best.motion.duration
                best = tried
        while best.motion.duration > _DURATION_PRECISION * too_short and not _is_over(deadline):
            tried = attempt(float(np.sqrt(too_short * best.motion.duration)))
            if tried.fault == 0.0:
                best = tried
            elif not _is_over(deadline):
                too_short = tried.motion.duration
        return best, best.motion.duration <= _DURATION_PRECISION * too_short

    def _stated_duration(
        self, best: Attempt, fallback: Fallback, deadline: float
    ) -> StatedDuration:
        """The shortest feasible duration known, where it is of interest."""
        request = best.request
        if best.fault == 0.0:
            asked = request.duration_is_free and self.options.timing == SHORTEST
            return StatedDuration(best.motion.duration) if asked else StatedDuration()
        stated = StatedDuration(fallback.duration, is_shortest=False)
        if request.duration_is_free or best.is_hopeless or _is_over(deadline):
            return stated
        expected = self._requests.expect(request.primitive, request.start, request.goal, None)
        free = replace(request, duration_is_free=True, expected=expected)
        for family in self._families(free):
            found, is_shortest = self._shortest(free, family, deadline)
            if found.fault == 0.0:
                seconds = _SHORTEST_MARGIN * found.motion.duration
                return stated if stated.seconds < seconds else StatedDuration(seconds, is_shortest)
        return stated

    def _remedy(self, attempt: Attempt) -> tuple[float, float] | None:
        """The duration and naturalness to try next if limits are broken, None if none is left.

        What the expected motion breaks, too, takes more time. If it breaks nothing, less effort was
        what broke a limit, or made links meet, and more naturalness mends it.
        """
        if not (attempt.check.violations or attempt.collisions) or attempt.is_hopeless:
            return None
        request, family = attempt.request, attempt.family
        duration, naturalness = attempt.motion.duration, attempt.naturalness
        expected = self._solver.sample(replace(attempt.motion, weights=family.expected))
        if attempt.collisions and self._solver.collisions(expected):
            return None
        check = check_limits(expected, self.robot, self.limits)
        longest = request.expected.duration * (_LONGEST_STRETCH if request.duration_is_free else 1)
        slower = min(duration * slowdown(check), longest)
        if slower > duration:
            return slower, naturalness
        if check.violations or family.precision is None or family.is_corrected:
            return None
        stronger = next((pull for pull in _PULLS if pull > naturalness), None)
        return None if stronger is None else (duration, stronger)

    def _plan(self, outcome: Outcome, reason: str, solve_time: float) -> Plan:
        attempt = outcome.attempt
        request, family = attempt.request, attempt.family
        trajectory = attempt.trajectory
        n_vias = request.n_vias
        via_error = largest(
            condition_errors(attempt.motion, request.conditions[:n_vias], attempt.phases[:n_vias])
        )
        if request.pose is None:
            goal_error = _distance(trajectory.positions[-1], request.goal)
            in_span_score = request.expected.in_span_score
        else:
            goal_error = largest(
                PoseTarget(self.robot, request.pose).error(trajectory.positions[-1])[0]
            )
            in_span_score = self._requests.expect(
                request.primitive,
                request.start,
                attempt.motion.goal,
                None if request.duration_is_free else attempt.motion.duration,
            ).in_span_score
        status, message = self._judge.verdict(outcome, max(via_error, goal_error))
        return Plan(
            status=status,
            message=message,
            trajectory=trajectory,
            motion=attempt.motion,
            solution=attempt.solution,
            primitive=request.primitive.name,
            considered=len(request.selection.considered),
            selection=reason,
            in_span_score=in_span_score,
            limit_check=attempt.check,
            start_error=_distance(trajectory.positions[0], request.start),
            goal_error=goal_error,
            via_error=via_error,
            via_phases=attempt.phases[:n_vias],
            shortest_duration=outcome.stated.seconds,
            n_components_used=family.n_components,
            correction=correction(attempt),
            deviation_score=_deviation(attempt),
            naturalness=attempt.naturalness,
            solve_time=solve_time,
        )


def _is_over(deadline: float) -> bool:
    return time.perf_counter() > deadline


def _reason(goal: JointGoal | PoseGoal, best: Attempt, attempts: Sequence[Attempt]) -> str:
    """Why the primitive of the best attempt was used."""
    winner = best.request.primitive.name
    if goal.primitive is not None:
        return f"the goal names '{winner}'"
    solved = {
        one.request.primitive.name: one.solution.cost if one.fault == 0.0 else None
        for one in attempts
        if one.request.goal is best.request.goal
    }
    return best.request.selection.reason(winner, solved)


def _deviation(attempt: Attempt) -> float:
    """How far the components' weights are from the expected ones, in standard deviations."""
    n = attempt.family.n_components
    if n == 0:
        return float("nan")
    off = attempt.motion.weights[:n] - attempt.family.expected[:n]
    return float(np.sqrt(off @ attempt.request.expected.precision @ off / n))


def _distance(position: FloatArray, state: JointState) -> float:
    return float(np.abs(position - state.positions).max())
