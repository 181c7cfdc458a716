# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One attempt at a request: compile and solve it, sample the motion, and check that."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..motion.collision import Collision, CollisionModel
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_limits
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .bases import MotionBasis
from .budget import Budget
from .chain import junctions_of
from .compiler import MotionProgram
from .conditions import Condition
from .motion import Motion
from .naturalness import segment_precision
from .plan import MotionSolution, PlannerOptions
from .pose_search import POSE_TOLERANCE, nearest_configuration
from .problem import Part, Problem
from .request import Request
from .selection import effort_of
from .sequence_request import SequenceRequest
from .solver import FEASIBLE, Solution, SolverMemory, solve
from .starts import StartPoint
from .unknowns import GOAL_POSITION

Violation = tuple[float, float, float]
"""Relative excess over a limit, penetration [m] and missed distance [rad or m], largest ones."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """One solved program and the validator's verdict on its motion.

    Attributes
    ----------
    request : Request or SequenceRequest
        What was attempted.
    bases : tuple of MotionBasis
        The bases of the segments.
    motions : tuple of Motion
        The motion found, segment by segment.
    solution : MotionSolution
        What the solver says of it.
    naturalness : float
        The ρ used.
    condition_errors : array, shape (n_errors,)
        What it misses conditions by [rad or m].
    phases : tuple of float
        Phases of the conditions.
    trajectory : Trajectory
        Its points.
    check : LimitCheck
        Comparison with the limits.
    collisions : tuple of Collision
        Self-collisions; not searched for where limits are violated.
    has_clearances : bool
        Whether there were clearance constraints.
    memory : SolverMemory or None
        State of the solver at the end.
    solved_at : float
        When the solver was done, by the clock of `time.perf_counter` [s].
    """

    request: Request | SequenceRequest
    bases: tuple[MotionBasis, ...]
    motions: tuple[Motion, ...]
    solution: MotionSolution
    naturalness: float
    condition_errors: FloatArray
    phases: tuple[float, ...]
    trajectory: Trajectory
    check: LimitCheck
    collisions: tuple[Collision, ...]
    has_clearances: bool = False
    memory: SolverMemory | None = None
    solved_at: float = 0.0

    @property
    def duration(self) -> float:
        """Duration of all segments [s]."""
        return sum(motion.duration for motion in self.motions)

    @property
    def violation(self) -> Violation:
        """Violations of limits, of clearance and of conditions; the smaller, the better."""
        missed = largest(self.condition_errors)
        return (
            self.check.worst_excess if self.check.violations else 0.0,
            sum(POSE_TOLERANCE + one.penetration for one in self.collisions),
            0.0 if missed <= POSE_TOLERANCE else missed,
        )

    @property
    def is_valid(self) -> bool:
        """Whether it may be executed and meets the conditions."""
        return not any(self.violation)

    @property
    def is_hopeless(self) -> bool:
        """Whether links collide at an end that no other motion would change."""
        return meets_at_ends(self.collisions, self.request, self.duration)


class MotionSolver:
    """Compiles and solves requests for a planner.

    Parameters
    ----------
    robot, limits, options, collision
        The planner's.
    """

    def __init__(
        self,
        robot: Robot,
        limits: JointLimits,
        options: PlannerOptions,
        collision: CollisionModel | None,
    ) -> None:
        self._robot, self._limits, self._options = robot, limits, options
        self._collision = collision

    def attempt(
        self,
        request: Request,
        basis: MotionBasis,
        duration: float,
        naturalness: float,
        budget: Budget,
        *,
        duration_is_free: bool = False,
        searching: bool = False,
    ) -> Attempt:
        """Compile and solve with this duration and naturalness, and check the limits.

        In the search for a duration it is not worth more than a start and a few iterations.
        """
        initial = Motion(request.start, request.goal, duration, basis.basis, basis.expected)
        program = MotionProgram(
            self._robot,
            basis.tables,
            initial.boundary,
            duration,
            basis.expected,
            objectives=self._options.objectives,
            free_rows=[] if request.pose is None else [GOAL_POSITION],
            duration_is_free=duration_is_free,
            conditions=request.conditions,
        )
        starts = _starts(basis, program, naturalness, self._options.search.near_expected)
        starts = starts[: 1 if searching else self._options.n_starts]
        ends = request.start, request.goal if request.pose is None else None
        problem = Problem([Part(program, basis, ends)], self._robot, self._limits, self._collision)

        def motions(x: FloatArray) -> tuple[Motion, ...]:
            return (self._motion(request, basis, program, x),)

        n_most = self._options.search.max_search_iterations if searching else None
        found = self._refined(problem, request, motions, starts, naturalness, budget, n_most)
        x = found.solution.unknowns
        effort, start_effort = program.effort_costs(np.array([x, program.expected])).tolist()
        phases = tuple(program.phases(x))
        return found.attempt(request, (basis,), naturalness, phases, effort, start_effort)

    def improve(
        self,
        request: SequenceRequest,
        bases: tuple[MotionBasis, ...],
        joined: tuple[Motion, ...],
        budget: Budget,
    ) -> Attempt:
        """The best motion through several targets near a joined one."""
        problem = self.chain_problem(request, bases, joined)
        chain, naturalness = problem.chain(), self._options.naturalness
        start = StartPoint(chain.start)
        found = self._refined(problem, request, chain.motions, [start], naturalness, budget, None)
        ends = np.cumsum([motion.duration for motion in found.motions])
        phases = tuple(map(float, ends / ends[-1]))[: len(request.conditions)]
        effort, joined_effort = (
            sum(effort_of(self._robot, motion) for motion in motions)
            for motions in (found.motions, joined)
        )
        return found.attempt(request, bases, naturalness, phases, effort, joined_effort)

    def chain_problem(
        self,
        request: SequenceRequest,
        bases: tuple[MotionBasis, ...],
        joined: tuple[Motion, ...],
    ) -> Problem:
        """The problem of a motion through several targets near a joined one.

        The naturalness of each segment counts by the effort of its joined motion.
        """
        junctions, parts = junctions_of(request, joined), []
        for i, (motion, basis) in enumerate(zip(joined, bases, strict=True)):
            here, there = junctions[i : i + 2]
            program = MotionProgram(
                self._robot,
                basis.tables,
                motion.boundary,
                motion.duration,
                motion.weights,
                objectives=self._options.objectives,
                free_rows=[*here.rows, *(3 + row for row in there.rows)],
                duration_is_free=here.time_is_free or there.time_is_free,
            )
            price = self._options.naturalness * effort_of(self._robot, motion)
            program.precision = price * segment_precision(program, basis, request.expected[i])
            parts.append(Part(program, basis, (here.fixed_state, there.fixed_state)))
        return Problem(parts, self._robot, self._limits, self._collision, junctions)

    def check(
        self,
        request: Request | SequenceRequest,
        bases: tuple[MotionBasis, ...],
        motions: tuple[Motion, ...],
        solution: MotionSolution,
        phases: tuple[float, ...],
    ) -> Attempt:
        """An attempt of motions that were found in another way."""
        trajectory = self.sample(motions)
        check = check_limits(trajectory, self._robot, self._limits)
        return Attempt(
            request,
            bases,
            motions,
            solution,
            self._options.naturalness,
            condition_errors(motions, request.conditions, phases),
            phases,
            trajectory,
            check,
            () if check.violations else self.collisions(trajectory),
            solved_at=time.perf_counter(),
        )

    def collisions(self, trajectory: Trajectory) -> tuple[Collision, ...]:
        """Self-collisions of a trajectory, if the planner checks them."""
        return () if self._collision is None else self._collision.collisions(trajectory)

    def sample(self, motions: Sequence[Motion]) -> Trajectory:
        """The points of a trajectory through some segments, with their efforts if known."""
        times, states, began = [], [], 0.0
        for i, motion in enumerate(motions):
            own = motion.sample_times(self._options.sample_period)[min(i, 1) :]
            times.append(began + own)
            states.append(np.stack(motion.evaluate(own)))
            began += motion.duration
        q, v, a = np.concatenate(states, axis=1)
        tau = self._robot.known_efforts(q, v, a)
        return Trajectory(self._robot.joint_names, np.concatenate(times), q, v, a, tau)

    def _refined(
        self,
        problem: Problem,
        request: Request | SequenceRequest,
        motions_of: Callable[[FloatArray], tuple[Motion, ...]],
        first: Sequence[StartPoint],
        naturalness: float,
        budget: Budget,
        max_iterations: int | None,
    ) -> _Refined:
        """Solve, and refine the constraints until the validator finds no violation."""
        search, certain = (
            self._options.search,
            all(part.basis.precision is not None for part in problem.parts),
        )
        # Limits hardly ever matter near the expected motion; that they don't is checked.
        problem.bound(with_limits=not (naturalness >= search.near_expected and certain))
        found = _Refined(problem)
        starts, touched = list(first), False
        for _ in range(search.max_refinements):
            solutions = self._solutions(problem, starts, max_iterations, budget)
            found.solved_at = time.perf_counter()
            found.passes += sum(one.iterations for one in solutions)
            best = min(solutions, key=lambda one: (one.infeasibility > FEASIBLE, one.cost))
            found.solution, found.motions = best, motions_of(best.unknowns)
            found.trajectory = self.sample(found.motions)
            check = found.check = check_limits(found.trajectory, self._robot, self._limits)
            # Where limits are violated, there will be another motion to check.
            found.collisions = () if check.violations else self.collisions(found.trajectory)
            if check.violations and budget.is_over():
                break
            if check.violations and not problem.is_bounded:
                problem.bound(with_limits=True)
                starts = list(first)
                continue
            # A limit that is only touched may be exceeded between the points of the grid: tighten
            # once, for an end of the motion may be at the limit.
            tight = check.violations or (check.touched and not touched and problem.is_bounded)
            apart = self._separated(problem, request, found)
            if not (tight or apart) or not best.converged:
                break
            if tight:
                problem.tighten(check.touched, found.motions)
                touched = not check.violations
            starts = [StartPoint(best.unknowns, best.memory)]
            if apart:
                # The detour on this side may be blocked: search from the first start, too. The
                # inequalities of a chain are numbered anew.
                if problem.junctions:
                    starts = [StartPoint(best.unknowns, best.memory.curvature_alone())]
                starts.append(first[0])
        return found

    def _separated(
        self, problem: Problem, request: Request | SequenceRequest, found: _Refined
    ) -> bool:
        """Constrain the clearance of links that collide, where another motion can help."""
        duration = sum(motion.duration for motion in found.motions)
        if meets_at_ends(found.collisions, request, duration):
            return False
        return problem.separate(found.collisions, found.motions)

    def _solutions(
        self,
        problem: Problem,
        starts: Sequence[StartPoint],
        max_iterations: int | None,
        budget: Budget,
    ) -> list[Solution]:
        """Solutions from one start after the other while there is time."""
        program, found = problem.program(), list[Solution]()
        options = replace(self._options.solver, should_stop=budget.is_over)
        if max_iterations is not None:
            options = replace(options, max_iterations=max_iterations)
        for start in starts:
            if found and budget.is_over():
                break
            found.append(solve(program, start.unknowns, options, start.memory))
        return found

    def _motion(
        self, request: Request, basis: MotionBasis, program: MotionProgram, x: FloatArray
    ) -> Motion:
        """The motion of some unknowns, its end moved on to the goal pose to the last digits."""
        goal, unknowns = request.goal, program.unknowns
        if request.pose is not None:
            q = unknowns.boundary_at(x)[0][GOAL_POSITION]
            q, _ = nearest_configuration(self._robot, self._limits, request.pose, q)
            goal = JointState(goal.joint_names, q)
        weights, duration = unknowns.weights(x), unknowns.duration_at(x)
        return Motion(request.start, goal, duration, basis.basis, weights)


class _Refined:
    """What a refinement has found so far."""

    solution: Solution
    motions: tuple[Motion, ...]
    trajectory: Trajectory
    check: LimitCheck
    collisions: tuple[Collision, ...]
    solved_at: float

    def __init__(self, problem: Problem) -> None:
        self._problem, self.passes = problem, 0

    def attempt(
        self,
        request: Request | SequenceRequest,
        bases: tuple[MotionBasis, ...],
        naturalness: float,
        phases: tuple[float, ...],
        effort: float,
        start_effort: float,
    ) -> Attempt:
        """The attempt that it makes."""
        natural = self._problem.naturalness(self.solution.unknowns)
        solution = MotionSolution(
            weights=np.concatenate([motion.weights for motion in self.motions]),
            objective_cost=self.solution.cost - natural,
            effort_cost=effort,
            naturalness_cost=natural,
            start_cost=start_effort,
            converged=self.solution.converged,
            iterations=self.passes,
            kkt_residual=self.solution.kkt_residual,
        )
        return Attempt(
            request,
            bases,
            self.motions,
            solution,
            naturalness,
            condition_errors(self.motions, request.conditions, phases),
            phases,
            self.trajectory,
            self.check,
            self.collisions,
            any(part.clearances for part in self._problem.parts),
            self.solution.memory,
            self.solved_at,
        )


def meets_at_ends(
    collisions: Sequence[Collision], request: Request | SequenceRequest, duration: float
) -> bool:
    """Whether links collide at an end that is fixed."""
    goal_is_fixed = request.pose is None
    return any(
        one.first_time == 0.0 or (goal_is_fixed and one.last_time >= duration) for one in collisions
    )


def _starts(
    basis: MotionBasis, program: MotionProgram, naturalness: float, near_expected: float
) -> list[StartPoint]:
    """Set the program's naturalness; return the unknowns to start from, the cheapest first."""
    candidates = np.array([program.unknowns.from_weights(s.unknowns) for s in basis.starts])
    order: Sequence[int] = range(len(candidates))
    if basis.precision is not None and naturalness > 0.0:
        n = program.unknowns.n_weights
        scales = program.scales[:n]
        price = naturalness * program.costs(candidates[:1])[0]
        program.precision[:n, :n] = price * basis.precision * np.outer(scales, scales)
        if naturalness >= near_expected:
            order = order[:1]
    if len(order) > 1:
        order = np.argsort(program.costs(candidates), kind="stable").tolist()
    # The state of a solver of weights alone does not fit other unknowns.
    fits = program.scales.size == program.unknowns.n_weights
    return [StartPoint(candidates[i], basis.starts[i].memory if fits else None) for i in order]


def condition_errors(
    motions: Sequence[Motion], conditions: Sequence[Condition], phases: Sequence[float]
) -> FloatArray:
    """What a motion misses conditions by [rad or m]; of several segments, at their ends."""
    if not conditions:
        return np.zeros(0)
    places = [motion.goal.positions for motion in motions]
    if len(motions) == 1:
        places = list(motions[0].evaluate(motions[0].duration * np.array(phases))[0])
    return np.concatenate(
        [condition.target.error(q)[0] for condition, q in zip(conditions, places, strict=False)]
    )


def largest(errors: FloatArray) -> float:
    """The largest magnitude, 0 of none."""
    return float(np.abs(errors).max(initial=0.0))
