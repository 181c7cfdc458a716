# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""One attempt at a request: compile and solve it, sample the motion, and check that.

Where the check on its dense grid finds a limit broken between the points of the solver's grid, or
links that meet, the solver goes on from where it was with limits drawn in or the links kept apart.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..motion.collision import Collision, CollisionModel
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import LimitCheck, check_limits
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .clearance import ClearProgram, Watch, watches_of
from .compiler import MotionProgram
from .conditions import Condition
from .constraints import LimitedProgram
from .families import Family
from .motion import Motion
from .plan import MotionSolution, PlannerOptions
from .pose_search import POSE_TOLERANCE, nearest_configuration
from .program import Program
from .request import Request
from .solver import FEASIBLE, Solution, SolverMemory, SolverOptions, solve
from .starts import Start

NEAR_EXPECTED = 0.1
"""From this naturalness on, motions stay near the expected one."""

# Passes over the nodes of an attempt in the search for a duration.
_SEARCH_ITERATIONS = 30
# How much worse a motion in which links meet is than one in which they don't.
_TOUCH = 1e-3
# Times that limits which are broken between the points of the solver's grid are drawn in.
_MOST_REFINEMENTS = 8


@dataclass(frozen=True, eq=False)
class Attempt:
    """One solved program and what the validator says of its motion.

    Attributes
    ----------
    request : Request
        What was attempted.
    family : Family
        The motions it was sought among.
    motion : Motion
        The motion found.
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
        Links that meet; not looked for where limits are broken.
    kept_apart : bool
        Whether links were kept apart by constraints.
    memory : SolverMemory
        What the solver has learned.
    solved_at : float
        When the solver was done, by the clock of `time.perf_counter` [s].
    """

    request: Request
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
        missed = largest(self.condition_errors)
        broken = self.check.worst_excess if self.check.violations else 0.0
        met = sum(_TOUCH + one.penetration for one in self.collisions)
        return broken + met + (missed if not missed <= POSE_TOLERANCE else 0.0)

    @property
    def is_hopeless(self) -> bool:
        """Whether links meet at an end that no other motion would change."""
        return _meet_at_ends(self.collisions, self.request, self.motion)


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
        self._robot, self._limits, self._options, self._collision = (
            robot,
            limits,
            options,
            collision,
        )

    def attempt(
        self,
        request: Request,
        family: Family,
        duration: float,
        naturalness: float,
        deadline: float,
        *,
        duration_is_free: bool = False,
        searching: bool = False,
    ) -> Attempt:
        """Compile and solve with this duration and naturalness, and check the limits.

        In the search for a duration it is not worth more than a start and a few iterations.
        """
        expected = family.expected
        motion = Motion(request.start, request.goal, duration, family.basis, expected)
        program = MotionProgram(
            self._robot,
            family.tables,
            motion.boundary,
            duration,
            expected,
            objectives=self._options.objectives,
            goal_is_free=request.pose is not None,
            duration_is_free=duration_is_free,
            conditions=request.conditions,
        )
        first = _starts(family, program, naturalness)[: 1 if searching else self._options.n_starts]
        most = _SEARCH_ITERATIONS if searching else SolverOptions.max_iterations

        def limited_by(limits: JointLimits | None) -> LimitedProgram:
            return LimitedProgram(program, family.limit_tables, limits, self._end_states(request))

        # Limits hardly ever matter near the expected motion; that they don't is checked.
        unbounded = naturalness >= NEAR_EXPECTED and family.precision is not None
        limited = limited_by(None if unbounded else self._limits)
        starts, passes, touched = first, 0, False
        watches: tuple[Watch, ...] = ()
        for _ in range(_MOST_REFINEMENTS):
            whole: Program = limited
            if self._collision is not None and watches:
                whole = ClearProgram(limited, family.basis, self._collision, watches)
            solutions = _solutions(whole, starts, most, deadline)
            solved_at = time.perf_counter()
            passes += sum(one.iterations for one in solutions)
            found = min(solutions, key=lambda one: (one.infeasibility > FEASIBLE, one.cost))
            x = found.unknowns
            starts = [Start(x, found.memory)]
            motion = self._motion(request, family, program, x)
            trajectory = self.sample(motion)
            check = check_limits(trajectory, self._robot, self._limits)
            # Where limits are broken, there will be another motion to look at.
            collisions = () if check.violations else self.collisions(trajectory)
            if check.violations and solved_at > deadline:
                break
            if check.violations and unbounded:
                unbounded, limited = False, limited_by(self._limits)
                starts = first
                continue
            # What is only touched may be broken between the points of the check's grid: once is
            # enough, for an end of the motion may be there.
            again = check.violations or (check.touched and not touched and not unbounded)
            more = self._watches(collisions, watches, motion, request)
            if not (again or more) or not found.converged:
                break
            if again:
                limited = limited.tightened(check.touched)
                touched = not check.violations
            if more:
                watches += more
                # The way round from there may be blocked.
                starts = [*starts, first[0]]
        effort_cost, start_cost = program.effort_costs(np.array([x, program.expected])).tolist()
        natural = program.naturalness(x)
        solution = MotionSolution(
            weights=motion.weights,
            objective_cost=found.cost - natural,
            effort_cost=effort_cost,
            naturalness_cost=natural,
            start_cost=start_cost,
            converged=found.converged,
            iterations=passes,
            kkt_residual=found.kkt_residual,
        )
        phases = tuple(program.phases(x))
        return Attempt(
            request,
            family,
            motion,
            solution,
            naturalness,
            condition_errors(motion, request.conditions, phases),
            phases,
            trajectory,
            check,
            collisions,
            bool(watches),
            found.memory,
            solved_at,
        )

    def collisions(self, trajectory: Trajectory) -> tuple[Collision, ...]:
        """Links that meet in a trajectory, if that matters to the planner."""
        return () if self._collision is None else self._collision.collisions(trajectory)

    def sample(self, motion: Motion) -> Trajectory:
        """The points of a motion's trajectory, with their efforts if they are known."""
        times = motion.sample_times(self._options.sample_period)
        q, v, a = motion.evaluate(times)
        tau = self._robot.known_efforts(q, v, a)
        return Trajectory(self._robot.joint_names, times, q, v, a, tau)

    def _watches(
        self,
        collisions: tuple[Collision, ...],
        known: tuple[Watch, ...],
        motion: Motion,
        request: Request,
    ) -> tuple[Watch, ...]:
        """What to keep apart in addition, for a motion in which links meet."""
        if self._collision is None or _meet_at_ends(collisions, request, motion):
            return ()
        ends = [motion.start.positions]
        if request.pose is None:
            ends.append(motion.goal.positions)
        return watches_of(collisions, known, self._collision, ends, motion.duration)

    def _motion(
        self, request: Request, family: Family, program: MotionProgram, x: FloatArray
    ) -> Motion:
        """The motion of some unknowns, its end moved on to the goal pose to the last digits."""
        goal, unknowns = request.goal, program.unknowns
        if request.pose is not None:
            q = unknowns.boundary_at(x)[0][3]
            q, _ = nearest_configuration(self._robot, self._limits, request.pose, q)
            goal = JointState(goal.joint_names, q)
        weights, duration = unknowns.weights(x), unknowns.duration_at(x)
        return Motion(request.start, goal, duration, family.basis, weights)

    def _end_states(self, request: Request) -> FloatArray:
        """Positions, velocities, accelerations, efforts at both ends, shape (2, 4, n_joints)."""
        # An end that is free leaves itself as much room as it needs.
        ends = (request.start, request.goal if request.pose is None else request.start)
        q, v, a = (
            np.array([getattr(state, kind) for state in ends])
            for kind in ("positions", "velocities", "accelerations")
        )
        return np.stack([q, v, a, self._robot.inverse_dynamics(q, v, a)], axis=1)


def _meet_at_ends(collisions: Sequence[Collision], request: Request, motion: Motion) -> bool:
    goal_is_fixed, last = request.pose is None, motion.duration
    return any(
        one.first_time == 0.0 or (goal_is_fixed and one.last_time >= last) for one in collisions
    )


def _starts(family: Family, program: MotionProgram, naturalness: float) -> list[Start]:
    """Set the program's naturalness; return the unknowns to start from, the cheapest first."""
    candidates = np.array([program.unknowns.from_weights(s.unknowns) for s in family.starts])
    order: Sequence[int] = range(len(candidates))
    if family.precision is not None and naturalness > 0.0:
        n = program.unknowns.n_weights
        scales = program.scales[:n]
        price = naturalness * program.costs(candidates[:1])[0]
        program.precision[:n, :n] = price * family.precision * np.outer(scales, scales)
        if naturalness >= NEAR_EXPECTED:
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


def condition_errors(
    motion: Motion, conditions: Sequence[Condition], phases: Sequence[float]
) -> FloatArray:
    """What a motion misses conditions by [rad or m]."""
    if not conditions:
        return np.zeros(0)
    q, _, _ = motion.evaluate(motion.duration * np.array(phases))
    return np.concatenate(
        [condition.target.error(x)[0] for condition, x in zip(conditions, q, strict=True)]
    )


def largest(errors: FloatArray) -> float:
    """The largest magnitude, 0 of none."""
    return float(np.abs(errors).max(initial=0.0))
