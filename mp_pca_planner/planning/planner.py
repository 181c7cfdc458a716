# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner (block 4 of [P] Fig. 1): goal → primitive → program → weights → trajectory."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, PrimitiveError, TrajectoryError, quote_names
from ..goal import JointGoal, JointState, Pose, PoseGoal, Via
from ..limits import JointLimits
from ..primitives.basis import Basis, BSplineBasis
from ..primitives.boundary import hermite_functions
from ..primitives.primitive import MovementPrimitive
from ..primitives.statistics import Conditional
from ..robot import Robot
from ..trajectory import Trajectory
from ..validation import LimitCheck, check_executable, check_limits
from .clearance import ClearProgram, Watch, watches_of
from .collision import NOT_CHECKED, Collision, CollisionModel
from .compiler import DEFAULT_NODES, MotionProgram, QuadratureTables
from .conditions import Condition, JointTarget, PoseTarget, Target
from .constraints import LimitedProgram, LimitTables
from .families import Family, component_family, corrected_family, spline_family
from .motion import Motion
from .objectives import Effort, Objective
from .pose_search import POSE_TOLERANCE, configurations_at, nearest_configuration, starts_near
from .program import Program
from .selection import Selection, Selector
from .solver import FEASIBLE, Solution, SolverMemory, SolverOptions, solve
from .starts import MOST_STARTS, Practice, Start
from .states import check_within_limits, completed, in_order, unwrapped

BASES = ("pca", "bspline")
DEMONSTRATED, SHORTEST, FREE = "demonstrated", "shortest", "free"
TIMINGS = (DEMONSTRATED, SHORTEST, FREE)
SOLVED = "solved"
STOPPED_EARLY = "stopped_early"
INFEASIBLE = "infeasible"

LONGEST_DURATION = 600.0
"""Longer motions [s] are taken for mistakes."""

# So are motions of more points, which would exhaust the memory.
_MOST_POINTS = 100_000

# Configurations that reach a pose to which motions are planned, the most natural first.
_N_CONFIGURATIONS = 3
# Share of the time that goes to the duration that was asked for.
_SHARE_OF_FIXED = 0.6
# The search for the shortest duration: first step, precision, and passes over the nodes of
# each attempt.
_FIRST_STEP, _DURATION_PRECISION = 2.0, 1.002
_SEARCH_ITERATIONS = 30
# In it, likeness to the demonstrations mustn't stand against the limits.
_SEARCH_NATURALNESS = 1e-2
# From this naturalness on, motions stay near the expected one.
_NEAR_EXPECTED = 0.1
# The shortest duration is stated this much longer, for a motion to fit into it again.
_SHORTEST_MARGIN = 1.002
# How much worse a motion in which links meet is than one in which they don't.
_TOUCH = 1e-3
# Demonstrations of a primitive whose own ends are planned between beforehand. From them one starts
# up to that in-span score: requests like the demonstrations have at most 2, those from anywhere
# to anywhere 6 and more, and may end in dear optima.
_N_PRACTISED, _PRACTISED_SCORE = 20, 3.0
# Times that limits which are broken between the points of the solver's grid are drawn in.
_MOST_REFINEMENTS = 8
# Where that doesn't meet the limits, a duration that nobody fixed is lengthened up to this
# factor, …
_LONGEST_STRETCH = 10.0
# … and motions are pulled towards the expected one, ten times as hard each time, up to a
# naturalness at which effort hardly counts any more.
_PULLS = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)


@dataclass(frozen=True)
class PlannerOptions:
    """How motions are planned.

    Attributes
    ----------
    basis : {'pca', 'bspline'}
        Components of the primitive, or B-splines with 6 control points per joint ([P]). Where
        components can't do it, B-splines are added to them, and the plan says so.
    objectives : tuple of (float, Objective)
        What to minimise: running costs and their weights, see :mod:`.objectives`. Effort alone
        unless given.
    timing : {'demonstrated', 'shortest', 'free'}
        Of goals that don't say their duration: like the demonstrations; the shortest that all
        limits allow; or the one with the least of the objectives.
    naturalness : float
        ρ: how much a motion one standard deviation away from the expected one costs, as a
        share of what the expected motion costs. 0: least effort alone, which may leave the
        demonstrations far behind. It is raised when a motion breaks limits otherwise.
    sample_period : float
        Time between the points of a trajectory [s].
    max_solve_time : float
        Longest time for the solver [s].
    n_starts : int
        Where likeness to the demonstrations counts for little (ρ < 0.1), there may be several
        optima: from how many weights, at most 5, the least is searched for while there is time.
        Five starts instead of one find a motion better by over 0.5 % for 3 % of the problems of
        four robots, at most 24 % better, in about four times the time (benchmarks/starts.py).
    n_nodes : int
        Quadrature nodes.
    allow_nonzero_end_velocity : bool
        Whether the controller accepts motions that don't end at rest.

    Raises
    ------
    GoalError
        If an option is out of its range.
    """

    basis: str = "pca"
    objectives: tuple[tuple[float, Objective], ...] = ((1.0, Effort()),)
    timing: str = DEMONSTRATED
    naturalness: float = 1.0
    sample_period: float = 0.01
    max_solve_time: float = 1.0
    n_starts: int = 1
    n_nodes: int = DEFAULT_NODES
    allow_nonzero_end_velocity: bool = False

    def __post_init__(self) -> None:
        if self.basis not in BASES:
            raise GoalError(f"basis must be one of {BASES}, got {self.basis!r}")
        if self.timing not in TIMINGS:
            raise GoalError(f"timing must be one of {TIMINGS}, got {self.timing!r}")
        weights = [weight for weight, _ in self.objectives]
        if not (weights and np.all(np.isfinite(weights)) and min(weights) > 0.0):
            raise GoalError(
                f"at least one objective with a weight > 0 is needed, got the weights {weights}"
            )
        if not (np.isfinite(self.naturalness) and self.naturalness >= 0.0):
            raise GoalError(f"naturalness must be a number ≥ 0, got {self.naturalness}")
        if not 1e-4 <= self.sample_period <= 1.0:
            raise GoalError(f"sample_period must be 0.0001 to 1 s, got {self.sample_period}")
        if not self.max_solve_time > 0.0:
            raise GoalError(f"max_solve_time must be positive, got {self.max_solve_time}")
        if not 1 <= self.n_starts <= MOST_STARTS:
            raise GoalError(f"n_starts must be 1 to {MOST_STARTS}, got {self.n_starts}")
        if not 4 <= self.n_nodes <= 1000:
            raise GoalError(f"n_nodes must be 4 to 1000, got {self.n_nodes}")


@dataclass(frozen=True, eq=False)
class MotionSolution:
    """What the solver found for a motion.

    Attributes
    ----------
    weights : array, shape (n_weights,)
        The best weights w found.
    objective_cost : float
        Their weighted sum of the objectives.
    effort_cost : float
        Their J = ½∫‖τ‖²dt [N²·m²·s], whether that is an objective or not.
    naturalness_cost : float
        Their ½ρ(w−ŵ)ᵀΛ⁻¹(w−ŵ), in units of the objectives.
    start_cost : float
        J of the expected motion.
    converged : bool
        Whether it is optimal within the limits, to the solver's tolerance.
    iterations : int
        Passes over the quadrature nodes.
    kkt_residual : float
        Norm of the Lagrangian's gradient by scaled weights, as a share of the objective.
    """

    weights: FloatArray
    objective_cost: float
    effort_cost: float
    naturalness_cost: float
    start_cost: float
    converged: bool
    iterations: int
    kkt_residual: float

    @property
    def cost(self) -> float:
        """The whole objective."""
        return self.objective_cost + self.naturalness_cost


@dataclass(frozen=True, eq=False)
class Plan:
    """What came of a request.

    Attributes
    ----------
    status : str
        'solved': converged, and executable. 'stopped_early': executable, but time ran out
        before the least effort was found. 'infeasible': must not be executed.
    message : str
        One sentence for a person.
    trajectory : Trajectory
        The sampled motion with its efforts; also of an infeasible plan, to look at.
    motion : Motion
        The continuous motion.
    solution : MotionSolution
        What the solver says.
    primitive : str
        Name of the primitive used.
    considered : int
        Number of primitives near the request, at most 32, that it was chosen among.
    selection : str
        Why the primitive was used, in a sentence.
    in_span_score : float
        How far outside the demonstrations the request lies (about 1: like them).
    limit_check : LimitCheck
        Comparison with the limits on a grid of at most 1 ms.
    start_error, goal_error : float
        Largest distance of the ends from the present and the goal position, or from the goal
        pose [rad or m].
    via_error : float
        Largest distance from what to pass on the way [rad or m].
    via_phases : tuple of float
        When that is passed, as shares of the duration.
    shortest_duration : float
        Shortest duration [s] for which a motion within the limits was found; NaN unless it was
        asked for, or the duration asked for was too short.
    n_components_used : int
        Number of principal components of the motion.
    correction : float
        Root of the mean square of what B-splines add to the components [rad or m].
    deviation_score : float
        How far the motion is from the one that the demonstrations let expect: root of the mean
        square of its components' weights, less their expected ones, in standard deviations;
        NaN without components.
    naturalness : float
        The ρ used: that of the options, or a larger one that was needed to meet the limits.
    solve_time : float
        Time taken to find the weights, [s]; attempts that failed the limits are included, the
        check of the motion that is returned is not.
    """

    status: str
    message: str
    trajectory: Trajectory
    motion: Motion
    solution: MotionSolution
    primitive: str
    considered: int
    selection: str
    in_span_score: float
    limit_check: LimitCheck
    start_error: float
    goal_error: float
    via_error: float
    via_phases: tuple[float, ...]
    shortest_duration: float
    n_components_used: int
    correction: float
    deviation_score: float
    naturalness: float
    solve_time: float

    @property
    def is_executable(self) -> bool:
        """Whether the trajectory may be sent to a robot."""
        return self.status != INFEASIBLE

    def summary(self) -> dict[str, str | float | int]:
        """Scalar facts, by the names of the package's public interface."""
        return {
            "status": self.status,
            "message": self.message,
            "primitive": self.primitive,
            "considered": self.considered,
            "selection": self.selection,
            "duration": self.motion.duration,
            "shortest_duration": self.shortest_duration,
            "objective_cost": self.solution.objective_cost,
            "effort_cost": self.solution.effort_cost,
            "naturalness": self.naturalness,
            "naturalness_cost": self.solution.naturalness_cost,
            "start_cost": self.solution.start_cost,
            "solve_time_s": self.solve_time,
            "iterations": self.solution.iterations,
            "kkt_residual": self.solution.kkt_residual,
            "in_span_score": self.in_span_score,
            "deviation_score": self.deviation_score,
            "n_components_used": self.n_components_used,
            "correction_used": int(self.correction > 0.0),
            "correction": self.correction,
            "limit_violation": self.limit_check.worst_excess,
            "start_error": self.start_error,
            "goal_error": self.goal_error,
            "via_error": self.via_error,
        }


@dataclass(frozen=True, eq=False)
class _Request:
    """A goal made complete: everything the compiler needs to know."""

    selection: Selection
    primitive: MovementPrimitive
    start: JointState
    goal: JointState
    pose: Pose | None
    conditions: tuple[Condition, ...]
    duration_is_free: bool
    expected: Conditional

    @property
    def n_vias(self) -> int:
        """Number of conditions on the way."""
        return len(self.conditions) - (self.pose is not None)


@dataclass(frozen=True, eq=False)
class _Attempt:
    """One solved program and what the validator says of its motion."""

    request: _Request
    family: Family
    motion: Motion
    solution: MotionSolution
    naturalness: float
    condition_errors: FloatArray
    phases: tuple[float, ...]
    trajectory: Trajectory
    check: LimitCheck
    collisions: tuple[Collision, ...]
    kept_apart: bool
    memory: SolverMemory
    solved_at: float

    @property
    def fault(self) -> float:
        """0 if it may be executed and meets the conditions, otherwise by how much it mustn't."""
        missed = _largest(self.condition_errors)
        broken = self.check.worst_excess if self.check.violations else 0.0
        met = sum(_TOUCH + one.penetration for one in self.collisions)
        return broken + met + (missed if not missed <= POSE_TOLERANCE else 0.0)

    @property
    def is_hopeless(self) -> bool:
        """Whether links meet at an end that no other motion would change."""
        goal_is_fixed, last = self.request.pose is None, self.motion.duration
        return any(
            one.first_time == 0.0 or (goal_is_fixed and one.last_time >= last)
            for one in self.collisions
        )


class _StatedDuration(NamedTuple):
    """A feasible duration [s] that is told, NaN if none is; the shortest if there was time."""

    seconds: float = float("nan")
    is_shortest: bool = True


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
        bases: list[Basis] = [p.basis for p in self.primitives]
        if self.options.basis == "bspline":
            bases = [BSplineBasis(self.robot.n_joints)] * len(names)
        tables = [QuadratureTables(basis, self.options.n_nodes) for basis in bases]
        self._tables = {
            name: (nodes, LimitTables(nodes)) for name, nodes in zip(names, tables, strict=True)
        }
        self._selector = Selector(self.robot, self.primitives, self.options.objectives)
        self._practice: dict[str, Practice] = {}

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
        attempts: list[_Attempt] = []
        for request in self._complete(goal, start):
            attempts.append(self._serve(request, enough))
            if _is_over(enough):
                break
        best = min(attempts, key=lambda one: (one.fault, one.solution.cost))
        shortest = self._stated_duration(goal, best, deadline)
        reason = _reason(goal, best, attempts)
        return self._judge(best, reason, attempts[-1].solved_at - began, shortest)

    def practise(self, max_time: float = float("inf")) -> None:
        """Plan between the ends of demonstrations, to find similar motions faster from there.

        That takes as long as twenty goals for each primitive, and goals later take about two
        thirds of the time (benchmarks/starts.py). Where motions stay near the expected ones
        anyway (naturalness of 0.1 and more), and for B-splines alone, it does nothing.

        Parameters
        ----------
        max_time : float
            Time [s] after which no further primitive is begun.
        """
        if self.options.basis != "pca" or self.options.naturalness >= _NEAR_EXPECTED:
            return
        deadline = time.perf_counter() + max_time
        for primitive in self.primitives:
            if _is_over(deadline):
                return
            found = self._practised(primitive)
            if found.starts:
                self._practice[primitive.name] = found

    def _practised(self, primitive: MovementPrimitive) -> Practice:
        names, states = primitive.joint_names, primitive.boundary_states
        chosen = np.linspace(0, len(states) - 1, min(len(states), _N_PRACTISED)).astype(int)
        ends, starts = [np.zeros((0, 2 * len(names)))], []
        for i in chosen:
            here, there = (JointState(names, states[i, k]) for k in (0, 3))
            duration = float(primitive.durations[i])
            goal = JointGoal(there, duration, primitive=primitive.name)
            try:
                request = self._complete(goal, here)[0]
            except GoalError:  # demonstrations may lie outside the limits
                continue
            family = next(self._families(request))
            deadline = time.perf_counter() + self.options.max_solve_time
            found = self._attempt(request, family, duration, self.options.naturalness, deadline)
            if found.fault == 0.0 and found.solution.converged:
                ends.append(states[i : i + 1, [0, 3]].reshape(1, -1))
                starts.append(Start(found.solution.weights, found.memory.curvature_alone()))
        return Practice(np.concatenate(ends), starts)

    def _serve(self, request: _Request, deadline: float) -> _Attempt:
        """The best motion of the narrowest family in which there is one."""
        best: _Attempt | None = None
        for family in self._families(request):
            attempt = self._within_limits(request, family, deadline)
            if best is None or attempt.fault < best.fault:
                best = attempt
            if best.fault == 0.0 or best.is_hopeless or _is_over(deadline):
                break
        assert best is not None
        return best

    def _families(self, request: _Request) -> Iterator[Family]:
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

    def _within_limits(self, request: _Request, family: Family, deadline: float) -> _Attempt:
        """The best motion of a family, slower or more natural if it must be to keep the limits."""
        duration, naturalness = request.expected.duration, self.options.naturalness
        if request.duration_is_free and self.options.timing == SHORTEST:
            found, is_shortest = self._shortest(request, family, deadline)
            converged = found.solution.converged and is_shortest
            return replace(found, solution=replace(found.solution, converged=converged))
        if request.duration_is_free and self.options.timing == FREE:
            timed = self._attempt(
                request, family, duration, naturalness, deadline, duration_is_free=True
            )
            if timed.fault == 0.0:
                return timed
            duration = timed.motion.duration
        best: _Attempt | None = None
        while True:
            attempt = self._attempt(request, family, duration, naturalness, deadline)
            if best is None or attempt.fault < best.fault:
                best = attempt
            remedy = self._remedy(attempt)
            if remedy is None or _is_over(deadline):
                return best
            duration, naturalness = remedy

    def _shortest(
        self, request: _Request, family: Family, deadline: float
    ) -> tuple[_Attempt, bool]:
        """The attempt of the shortest duration that keeps the limits, by bisection.

        Which durations are long enough is known only from trying; each attempt optimises the
        weights (and a free goal) again. Whether there was time to find the shortest is returned,
        too.
        """
        naturalness = min(self.options.naturalness, _SEARCH_NATURALNESS)

        def attempt(duration: float) -> _Attempt:
            return self._attempt(request, family, duration, naturalness, deadline, searching=True)

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
        self, goal: JointGoal | PoseGoal, best: _Attempt, deadline: float
    ) -> _StatedDuration:
        """The shortest feasible duration where it is of interest."""
        if best.fault == 0.0:
            asked = best.request.duration_is_free and self.options.timing == SHORTEST
            return _StatedDuration(best.motion.duration) if asked else _StatedDuration()
        if goal.duration is None or best.is_hopeless:
            return _StatedDuration()
        request = best.request
        expected = self._expect(request.primitive, request.start, request.goal, None)
        free = replace(request, duration_is_free=True, expected=expected)
        for family in self._families(free):
            found, is_shortest = self._shortest(free, family, deadline)
            if found.fault == 0.0:
                return _StatedDuration(_SHORTEST_MARGIN * found.motion.duration, is_shortest)
        return _StatedDuration()

    def _complete(self, goal: JointGoal | PoseGoal, start: JointState) -> list[_Request]:
        """Fill in what the goal leaves open; refuse what can't be served.

        A pose can be reached in several configurations: several requests, the most natural first.
        A configuration can be reached with several primitives, the one expected to be cheapest
        first.
        """
        here = in_order(start, self.robot.joint_names)
        check_within_limits("present", here, self.limits)
        self._check_size(goal.duration)
        selector = self._selector.among(goal.primitive)
        if isinstance(goal, JointGoal):
            goals, pose = [self._joint_goal(goal, here)], None
        else:
            goals, pose = self._pose_goals(goal.pose, here, selector.primitives), goal.pose

        def score(there: JointState) -> float:
            return float(selector.scores(here.positions, there.positions, goal.duration).min())

        # Of several motions to one place the cheapest is wanted, but not of several searches for
        # the shortest duration, nor of several configurations.
        searches = goal.duration is None and self.options.timing == SHORTEST
        chosen: list[_Request] = []
        if len(goals) > 1:
            goals = sorted(goals, key=score)[:_N_CONFIGURATIONS]
        for there in goals:
            selection = selector.choose(here.positions, there.positions, goal.duration)
            several = pose is None and not searches
            for one in selection.contenders if several else [selection.first]:
                request = _Request(
                    selection,
                    one.primitive,
                    here,
                    there,
                    pose,
                    (),
                    goal.duration is None,
                    one.expected,
                )
                conditions = self._conditions(request, goal.vias)
                chosen.append(replace(request, conditions=conditions))
        return chosen

    def _joint_goal(self, goal: JointGoal, here: JointState) -> JointState:
        there = completed(goal.state, here, self.robot, "goal")
        check_within_limits("goal", there, self.limits)
        if not self.options.allow_nonzero_end_velocity and np.any(there.velocities != 0.0):
            moving = there.joint_names[int(np.abs(there.velocities).argmax())]
            raise GoalError(
                f"the goal velocity of joint '{moving}' is not 0, which the controller refuses "
                "unless it and this planner are set to allow a nonzero velocity at the end"
            )
        return there

    def _pose_goals(
        self, pose: Pose, here: JointState, candidates: Sequence[MovementPrimitive]
    ) -> list[JointState]:
        """Configurations that reach the pose, from where the demonstrations end and from here."""
        ends = np.concatenate([p.boundary_states[:, 3] for p in candidates])
        starts = [*starts_near(self.robot, pose, ends), here.positions]
        found = configurations_at(self.robot, self.limits, pose, starts)
        return [JointState(here.joint_names, unwrapped(q, here, self.robot)) for q in found]

    def _conditions(self, request: _Request, vias: Sequence[Via]) -> tuple[Condition, ...]:
        """What to meet on the way, and the pose to reach at the end."""
        conditions = self._via_conditions(request, vias) if vias else []
        if request.pose is not None:
            conditions.append(Condition(PoseTarget(self.robot, request.pose), 1.0))
        return tuple(conditions)

    def _via_conditions(self, request: _Request, vias: Sequence[Via]) -> list[Condition]:
        targets = [self._target(via, request.start) for via in vias]
        phases = np.linspace(0.0, 1.0, 201)
        ends = np.zeros((6, self.robot.n_joints))
        ends[0], ends[3] = request.start.positions, request.goal.positions
        usual = hermite_functions(phases) @ ends + request.primitive.basis.shape(
            request.expected.weights, phases
        )
        return [
            Condition(target, via.phase, window)
            for target, via, window in zip(
                targets, vias, _windows(targets, vias, phases, usual), strict=True
            )
        ]

    def _target(self, via: Via, here: JointState) -> Target:
        names, target = self.robot.joint_names, via.target
        if isinstance(target, Pose):
            self.robot.frame_positions(here.positions[None], [target.frame])
            return PoseTarget(self.robot, target)
        state = completed(target, here, self.robot, "via")
        check_within_limits("via", JointState(names, state.positions), self.limits)
        index = np.array([names.index(name) for name in target.joint_names])
        return JointTarget(index, state.positions[index], len(names))

    def _check_size(self, duration: float | None) -> None:
        if duration is None:
            return
        longest = min(LONGEST_DURATION, _MOST_POINTS * self.options.sample_period)
        if duration > longest:
            raise GoalError(
                f"the duration {duration:g} s is too long: with a sample period of "
                f"{self.options.sample_period:g} s at most {longest:g} s are accepted"
            )

    def _expect(
        self,
        primitive: MovementPrimitive,
        start: JointState,
        goal: JointState,
        duration: float | None,
    ) -> Conditional:
        # The demonstrations of a joint that turns without end may lie whole turns away.
        mean = primitive.statistics.mean[: primitive.n_joints]
        turns = np.round((mean - start.positions) / (2.0 * np.pi))
        shift = np.where(self.robot.continuous, 2.0 * np.pi * turns, 0.0)
        return primitive.statistics.condition(
            start.positions + shift, goal.positions + shift, duration
        )

    def _attempt(
        self,
        request: _Request,
        family: Family,
        duration: float,
        naturalness: float,
        deadline: float,
        *,
        duration_is_free: bool = False,
        searching: bool = False,
    ) -> _Attempt:
        """Compile and solve with this duration and naturalness, and check the limits.

        In the search for a duration it is not worth more than a start and a few iterations.
        """
        expected = family.expected
        motion = Motion(request.start, request.goal, duration, family.basis, expected)
        program = MotionProgram(
            self.robot,
            family.tables,
            motion.boundary,
            duration,
            expected,
            objectives=self.options.objectives,
            goal_is_free=request.pose is not None,
            duration_is_free=duration_is_free,
            conditions=request.conditions,
        )
        first = _starts(family, program, naturalness)[: 1 if searching else self.options.n_starts]
        most = _SEARCH_ITERATIONS if searching else SolverOptions.max_iterations

        def limited_by(limits: JointLimits | None) -> LimitedProgram:
            return LimitedProgram(program, family.limit_tables, limits, self._end_states(request))

        # Limits hardly ever matter near the expected motion; that they don't is checked.
        unbounded = naturalness >= _NEAR_EXPECTED and family.precision is not None
        limited = limited_by(None if unbounded else self.limits)
        starts, passes, touched = first, 0, False
        watches: tuple[Watch, ...] = ()
        for _ in range(_MOST_REFINEMENTS):
            whole: Program = limited
            if self.collision is not None and watches:
                whole = ClearProgram(limited, family.basis, self.collision, watches)
            solutions = _solutions(whole, starts, most, deadline)
            solved_at = time.perf_counter()
            passes += sum(one.iterations for one in solutions)
            found = min(solutions, key=lambda one: (one.infeasibility > FEASIBLE, one.cost))
            x = found.unknowns
            starts = [Start(x, found.memory)]
            motion = self._motion(request, family, program, x)
            trajectory = self._sample(motion)
            check = check_limits(trajectory, self.robot, self.limits)
            # Where limits are broken, there will be another motion to look at.
            collisions = () if check.violations else self._collisions(trajectory)
            if check.violations and unbounded:
                unbounded, limited = False, limited_by(self.limits)
                starts = first
                continue
            # What is only touched may be broken between the points of the check's grid: once is
            # enough, for an end of the motion may be there.
            again = check.violations or (check.touched and not touched and not unbounded)
            if not (again or collisions) or not found.converged:
                break
            if again:
                limited = limited.tightened(check.touched)
                touched = not check.violations
            if collisions:
                watches += self._watches(collisions, watches, motion, request)
                # The way round from there may be blocked.
                starts = [*starts, first[0]]
        natural = program.naturalness(x)
        solution = MotionSolution(
            weights=motion.weights,
            objective_cost=found.cost - natural,
            effort_cost=float(program.effort_costs(x[None])[0]),
            naturalness_cost=natural,
            start_cost=float(program.effort_costs(program.expected[None])[0]),
            converged=found.converged,
            iterations=passes,
            kkt_residual=found.kkt_residual,
        )
        phases = tuple(program.phases(x))
        return _Attempt(
            request,
            family,
            motion,
            solution,
            naturalness,
            _condition_errors(motion, request.conditions, phases),
            phases,
            trajectory,
            check,
            collisions,
            bool(watches),
            found.memory,
            solved_at,
        )

    def _collisions(self, trajectory: Trajectory) -> tuple[Collision, ...]:
        return () if self.collision is None else self.collision.collisions(trajectory)

    def _watches(
        self,
        collisions: tuple[Collision, ...],
        known: tuple[Watch, ...],
        motion: Motion,
        request: _Request,
    ) -> tuple[Watch, ...]:
        """What to keep apart in addition, for a motion in which links meet."""
        assert self.collision is not None
        ends = [motion.start.positions]
        if request.pose is None:
            ends.append(motion.goal.positions)
        return watches_of(collisions, known, self.collision, ends, motion.duration)

    def _motion(
        self, request: _Request, family: Family, program: MotionProgram, x: FloatArray
    ) -> Motion:
        """The motion of some unknowns, its end moved on to the goal pose to the last digits."""
        goal, unknowns = request.goal, program.unknowns
        if request.pose is not None:
            q = unknowns.boundary_at(x)[0][3]
            q, _ = nearest_configuration(self.robot, self.limits, request.pose, q)
            goal = JointState(goal.joint_names, q)
        weights, duration = unknowns.weights(x), unknowns.duration_at(x)
        return Motion(request.start, goal, duration, family.basis, weights)

    def _end_states(self, request: _Request) -> FloatArray:
        """Positions, velocities, accelerations, efforts at both ends, shape (2, 4, n_joints)."""
        # An end that is free leaves itself as much room as it needs.
        ends = (request.start, request.goal if request.pose is None else request.start)
        q, v, a = (
            np.array([getattr(state, kind) for state in ends])
            for kind in ("positions", "velocities", "accelerations")
        )
        return np.stack([q, v, a, self.robot.inverse_dynamics(q, v, a)], axis=1)

    def _remedy(self, attempt: _Attempt) -> tuple[float, float] | None:
        """The duration and naturalness to try next if limits are broken, None if none is left.

        What the expected motion breaks, too, takes more time. If it breaks nothing, less effort was
        what broke a limit, or made links meet, and more naturalness mends it.
        """
        if not (attempt.check.violations or attempt.collisions) or attempt.is_hopeless:
            return None
        request, family = attempt.request, attempt.family
        duration, naturalness = attempt.motion.duration, attempt.naturalness
        expected = self._sample(replace(attempt.motion, weights=family.expected))
        if attempt.collisions and self._collisions(expected):
            return None
        check = check_limits(expected, self.robot, self.limits)
        longest = request.expected.duration * (_LONGEST_STRETCH if request.duration_is_free else 1)
        slower = min(duration * _stretch(check), longest)
        if slower > duration:
            return slower, naturalness
        if check.violations or family.precision is None or family.is_corrected:
            return None
        stronger = next((pull for pull in _PULLS if pull > naturalness), None)
        return None if stronger is None else (duration, stronger)

    def _sample(self, motion: Motion) -> Trajectory:
        times = motion.sample_times(self.options.sample_period)
        q, v, a = motion.evaluate(times)
        tau = self.robot.inverse_dynamics(q, v, a)
        return Trajectory(self.robot.joint_names, times, q, v, a, tau)

    def _judge(
        self, attempt: _Attempt, reason: str, solve_time: float, shortest: _StatedDuration
    ) -> Plan:
        request, family = attempt.request, attempt.family
        trajectory = attempt.trajectory
        n_vias = request.n_vias
        via_error = _largest(
            _condition_errors(attempt.motion, request.conditions[:n_vias], attempt.phases[:n_vias])
        )
        if request.pose is None:
            goal_error = _distance(trajectory.positions[-1], request.goal)
            in_span_score = request.expected.in_span_score
        else:
            goal_error = _largest(
                PoseTarget(self.robot, request.pose).error(trajectory.positions[-1])[0]
            )
            in_span_score = self._expect(
                request.primitive,
                request.start,
                attempt.motion.goal,
                None if request.duration_is_free else attempt.motion.duration,
            ).in_span_score
        status, message = self._verdict(attempt, max(via_error, goal_error), shortest)
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
            shortest_duration=shortest.seconds,
            n_components_used=family.n_components,
            correction=_correction(attempt),
            deviation_score=_deviation(attempt),
            naturalness=attempt.naturalness,
            solve_time=solve_time,
        )

    def _verdict(
        self, attempt: _Attempt, missed: float, shortest: _StatedDuration
    ) -> tuple[str, str]:
        """Status and message."""
        try:
            check_executable(
                attempt.trajectory,
                attempt.check,
                attempt.request.start,
                allow_nonzero_end_velocity=self.options.allow_nonzero_end_velocity,
            )
        except TrajectoryError as error:
            message = f"no motion within the limits was found: {error}"
            return INFEASIBLE, message + self._other_duration(attempt, shortest)
        if attempt.collisions:
            message = f"no motion without self-collision was found: {attempt.collisions[0]}"
            return INFEASIBLE, message + self._other_duration(attempt, shortest)
        if missed > POSE_TOLERANCE:
            return INFEASIBLE, (
                "no motion that passes where it was asked to was found: the nearest one is "
                f"{missed:.3g} rad or m off"
            )
        concessions = self._concessions(attempt)
        if not attempt.solution.converged:
            found = "time or iterations ran out before the least was found"
            return STOPPED_EARLY, found + concessions
        if np.isfinite(shortest.seconds):
            return SOLVED, "shortest motion within the limits found" + concessions
        effort_alone = [type(objective) for _, objective in self.options.objectives] == [Effort]
        least = "effort" if effort_alone else "cost"
        return SOLVED, f"motion of least {least} found{concessions}"

    def _other_duration(self, attempt: _Attempt, shortest: _StatedDuration) -> str:
        """What is known of motions in another duration than that asked for."""
        if np.isfinite(shortest.seconds):
            known = "a feasible duration"
            if shortest.is_shortest:
                known = "the shortest duration that the limits allow"
            return f"; {known} is {shortest.seconds:.4g} s"
        if attempt.request.duration_is_free or attempt.is_hopeless:
            return ""
        return (
            "; nor was one found in another duration, within max_solve_time = "
            f"{self.options.max_solve_time:g} s"
        )

    def _concessions(self, attempt: _Attempt) -> str:
        """What had to be given up to do what was asked, as the end of a sentence."""
        usual, duration = attempt.request.expected.duration, attempt.motion.duration
        given_up = []
        if duration > usual and self.options.timing == DEMONSTRATED:
            given_up.append(f"the duration was lengthened from {usual:.3g} to {duration:.3g} s")
        if attempt.naturalness > self.options.naturalness:
            given_up.append(
                f"the naturalness was raised from {self.options.naturalness:g} "
                f"to {attempt.naturalness:g}"
            )
        why = "to keep the limits"
        if self.collision is not None and self.collision.has_geometry:
            why += " without self-collision"
        kept = f"; {why}, {' and '.join(given_up)}" if given_up else ""
        if attempt.kept_apart:
            kept += "; links that would meet otherwise are kept apart"
        if self.collision is not None and not self.collision.has_geometry:
            kept += NOT_CHECKED
        if self.options.basis == "pca" and attempt.family.is_corrected:
            kept += (
                f"; beyond the components of the primitive it took B-splines, "
                f"{_correction(attempt):.2g} rad or m in the mean"
            )
        return kept


def _is_over(deadline: float) -> bool:
    return time.perf_counter() > deadline


def _reason(goal: JointGoal | PoseGoal, best: _Attempt, attempts: Sequence[_Attempt]) -> str:
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


def _starts(family: Family, program: MotionProgram, naturalness: float) -> list[Start]:
    """Set the program's naturalness; return the unknowns to start from, the cheapest first."""
    candidates = np.array([program.unknowns.from_weights(s.unknowns) for s in family.starts])
    order: Sequence[int] = range(len(candidates))
    if family.precision is not None and naturalness > 0.0:
        n = program.unknowns.n_weights
        scales = program.scales[:n]
        price = naturalness * program.costs(candidates[:1])[0]
        program.precision[:n, :n] = price * family.precision * np.outer(scales, scales)
        if naturalness >= _NEAR_EXPECTED:
            order = order[:1]
    if len(order) > 1:
        order = np.argsort(program.costs(candidates), kind="stable").tolist()
    # What was learned of weights says nothing of other unknowns.
    knows = program.scales.size == program.unknowns.n_weights
    return [Start(candidates[i], family.starts[i].memory if knows else None) for i in order]


def _solutions(
    program: Program, starts: Sequence[Start], most_iterations: int, deadline: float
) -> list[Solution]:
    """Solutions from one start after the other while there is time."""
    found: list[Solution] = []
    for start in starts:
        left = max(deadline - time.perf_counter(), 0.0)
        if found and left == 0.0:
            break
        stop = SolverOptions(max_iterations=most_iterations, max_time=left)
        found.append(solve(program, start.unknowns, stop, start.memory))
    return found


def _windows(
    targets: Sequence[Target], vias: Sequence[Via], phases: FloatArray, usual: FloatArray
) -> list[tuple[float, float]]:
    """Where to look for the free phases of vias: around where the usual motion comes nearest.

    Parameters
    ----------
    phases, usual
        Phases and the positions of the usual motion there, shape (n_phases, n_joints).
    """
    windows: list[tuple[float, float]] = []
    last = 0.0
    for i, (target, via) in enumerate(zip(targets, vias, strict=True)):
        later = [v.phase for v in vias[i:] if v.phase is not None]
        until = via.phase or (later[0] if later else 1.0)
        n_left = 1 + next((j for j, v in enumerate(vias[i + 1 :]) if v.phase), len(vias) - i - 1)
        if via.phase is None:
            # Room is left for the free ones after it.
            low, high = last, last + (until - last) * (1.0 if n_left == 1 else 1.5 / n_left)
            inside = np.flatnonzero((phases > low) & (phases < high))
            misses = [float(np.sum(target.error(q)[0] ** 2)) for q in usual[inside]]
            nearest = float(phases[inside[int(np.argmin(misses))]])
            reach = min(nearest - low, high - nearest)
            reach = max(reach, 0.25 * (high - low))
            nearest = float(np.clip(nearest, low + reach, high - reach))
            windows.append((nearest - reach, nearest + reach))
            last = nearest + reach
        else:
            windows.append((0.0, 1.0))
            last = via.phase
    return windows


def _condition_errors(
    motion: Motion, conditions: Sequence[Condition], phases: Sequence[float]
) -> FloatArray:
    """What a motion misses conditions by [rad or m]."""
    if not conditions:
        return np.zeros(0)
    q, _, _ = motion.evaluate(motion.duration * np.array(phases))
    return np.concatenate(
        [condition.target.error(x)[0] for condition, x in zip(conditions, q, strict=True)]
    )


def _correction(attempt: _Attempt) -> float:
    """Root of the mean square of what B-splines add to components [rad or m]."""
    family = attempt.family
    if not family.is_corrected:
        return 0.0
    only = np.where(np.arange(family.expected.size) < family.n_components, 0.0, 1.0)
    phases = np.linspace(0.0, 1.0, 101)
    added = family.basis.shape(only * attempt.motion.weights, phases)
    return float(np.sqrt(np.mean((added - family.basis.shape(0.0 * only, phases)) ** 2)))


def _deviation(attempt: _Attempt) -> float:
    """How far the components' weights are from the expected ones, in standard deviations."""
    n = attempt.family.n_components
    if n == 0:
        return float("nan")
    off = attempt.motion.weights[:n] - attempt.family.expected[:n]
    return float(np.sqrt(off @ attempt.request.expected.precision @ off / n))


def _largest(errors: FloatArray) -> float:
    return float(np.abs(errors).max(initial=0.0))


def _stretch(check: LimitCheck) -> float:
    """By how much a longer duration may mend what is broken, 1 if it can't."""
    # More time doesn't change the path, and with it the positions.
    powers = {"velocity": 1.0, "acceleration": 1.0 / 2.0, "jerk": 1.0 / 3.0, "effort": 1.0 / 2.0}
    factors = [
        (1.0 + v.excess) ** powers[v.quantity] for v in check.violations if v.quantity in powers
    ]
    # A little more than the law of scaling says, for the motion is optimised again.
    return float(np.clip(1.02 * max(factors), 1.05, 2.0)) if factors else 1.0


def _distance(position: FloatArray, state: JointState) -> float:
    return float(np.abs(position - state.positions).max())
