# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner (block 4 of [P] Fig. 1): goal → primitive → program → weights → trajectory."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError, PrimitiveError, quote_names
from ..motion.collision import CollisionModel
from ..motion.goal import Goal, JointGoal, JointState, SequenceGoal
from ..motion.validation import require_effort_limits
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.model import Robot
from .attempt import Attempt, largest
from .bases import MotionBasis
from .budget import Budget
from .conditions import PoseTarget
from .fallback import FallbackPlanner
from .motion import Motion
from .objectives import Effort, uses_efforts
from .plan import MODES, OPTIMAL, MotionSolution, Plan, PlannerOptions
from .request import GoalResolver, Request
from .route import SequenceResolver
from .selection import Selector, cost_of
from .setup import Setup
from .several import SeveralPlanner
from .single import BasisChooser, SinglePlanner
from .verdict import Judge, Planned, correction


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
        self._selector = Selector(self.robot, self.primitives, self.options.objectives)
        self._setup = setup = Setup(self.robot, self.limits, self.options, self.collision)
        self._resolver = GoalResolver(setup, self._selector)
        self._sequences = SequenceResolver(setup, self._selector)
        fallback = FallbackPlanner(setup)
        self._chooser = BasisChooser(setup, self.primitives)
        self._single = SinglePlanner(setup, self._resolver, fallback, self._chooser)
        self._several = SeveralPlanner(setup, fallback, self._chooser)
        self._judge = Judge(setup)

    def check(self, goal: JointGoal) -> None:
        """Reject a goal that can't be served wherever the robot is.

        This takes far less time than planning, and may be done while another thread plans.

        Raises
        ------
        GoalError
            If it names unknown joints or no primitive of the planner, is outside the limits, or
            its duration is too long.
        """
        self._resolver.check(goal)

    def target(self, goal: JointGoal, start: JointState) -> JointState:
        """The configuration of all joints that a goal asks for.

        Raises
        ------
        GoalError
            See :meth:`plan`.
        """
        return self._resolver.target(goal, start)

    def plan(self, goal: Goal, start: JointState, mode: str = OPTIMAL) -> Plan:
        """Plan the motion with the least of the objectives to a goal, or through several targets.

        Parameters
        ----------
        goal : JointGoal, PoseGoal or SequenceGoal
            What to reach. Joints that a joint goal doesn't name keep their position. Initial
            targets of a sequence where the robot is already are passed.
        start : JointState
            Present state; further joints are ignored.
        mode : {'optimal', 'real_time'}
            Whether to optimise a sequence, or only to join its segments. Free durations of a
            sequence are lengthened where the limits can't be kept otherwise.

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
        budget = Budget(began + self.options.max_solve_time, self.options.solver.should_stop)
        if isinstance(goal, SequenceGoal):
            if mode not in MODES:
                raise GoalError(f"the mode of a sequence must be one of {MODES}, got {mode!r}")
            planned = self._several.serve(self._sequences.resolve(goal, start), mode, budget)
            attempts = [planned.attempt]
        else:
            requests = self._resolver.resolve(goal, start)
            planned, attempts = self._single.serve(requests, began, budget)
        solved_at = max(attempts[-1].solved_at, planned.attempt.solved_at)
        return self._plan(planned, _reason(goal, planned.attempt, attempts), solved_at - began)

    def practise(self, max_time: float = float("inf")) -> None:
        """Precompute motions between the ends of demonstrations, as warm starts of similar ones.

        That takes as long as twenty goals for each primitive, and goals later take about two
        thirds of the time (benchmarks/starts.py). Where motions stay near the expected ones
        anyway (naturalness of 0.1 and more), and for B-splines alone, it does nothing.

        Parameters
        ----------
        max_time : float
            Time [s] after which no further motion is begun.
        """
        near = self.options.naturalness >= self.options.search.near_expected
        if self.options.basis != "pca" or near:
            return
        deadline = time.perf_counter() + max_time
        for primitive in self.primitives:
            found = self._single.precompute(primitive, deadline)
            if found.memories:
                self._chooser.warm_starts[primitive.name] = found

    def _plan(self, planned: Planned, reason: str, solve_time: float) -> Plan:
        attempt = planned.attempt
        request, trajectory = attempt.request, attempt.trajectory
        via_error, goal_error = _errors(attempt, self.robot)
        status, message = self._judge.verdict(planned, max(via_error, goal_error))
        motions = attempt.motions
        return Plan(
            status=status,
            message=message,
            trajectory=trajectory,
            motions=motions,
            primitives=tuple(primitive.name for primitive in request.primitives),
            solution=self._solution(attempt),
            considered=max(len(one.considered) for one in request.selections),
            selection=reason,
            in_span_score=self._in_span_score(attempt),
            limit_check=attempt.check,
            start_error=_distance(trajectory.positions[0], request.start),
            goal_error=goal_error,
            via_error=via_error,
            via_phases=attempt.phases[: request.n_vias],
            shortest_duration=planned.stated.seconds,
            n_components_used=max(basis.n_components for basis in attempt.bases),
            correction=max(map(correction, attempt.bases, motions)),
            deviation_score=_deviation(attempt),
            naturalness=attempt.naturalness,
            solve_time=solve_time,
            mode=planned.mode,
        )

    def _solution(self, attempt: Attempt) -> MotionSolution:
        """What the solver says; costs of a motion that was not optimised are computed here."""
        solution = attempt.solution
        if np.isfinite(solution.objective_cost):
            return solution
        objective, effort = (
            sum(
                cost_of(self.robot, motion, basis.tables, objectives)
                for motion, basis in zip(attempt.motions, attempt.bases, strict=True)
            )
            for objectives in (self.options.objectives, [(1.0, Effort())])
        )
        return replace(solution, objective_cost=objective, effort_cost=effort)

    def _in_span_score(self, attempt: Attempt) -> float:
        """That of the request; of a pose, with the configuration that was chosen for it."""
        request = attempt.request
        if isinstance(request, Request) and request.pose is None:
            return request.expected.in_span_score
        free = request.duration_is_free
        return max(
            self._resolver.expect(
                primitive, motion.start, motion.goal, None if free else motion.duration
            ).in_span_score
            for primitive, motion in zip(request.primitives, attempt.motions, strict=True)
        )


def _errors(attempt: Attempt, robot: Robot) -> tuple[float, float]:
    """Largest distances from the vias and from the goal [rad or m]."""
    request = attempt.request
    n_via_errors = sum(
        condition.target.error(request.start.positions)[0].size
        for condition in request.conditions[: request.n_vias]
    )
    last = attempt.trajectory.positions[-1]
    via_error = largest(attempt.condition_errors[:n_via_errors])
    if request.pose is None:
        return via_error, _distance(last, request.goal)
    return via_error, largest(PoseTarget(robot, request.pose).error(last)[0])


def _reason(goal: Goal, best: Attempt, attempts: Sequence[Attempt]) -> str:
    """Why the primitives of the best attempt were used."""
    request, names = best.request, [primitive.name for primitive in best.request.primitives]
    if goal.primitive is not None:
        return f"the goal names '{goal.primitive}'"
    if not isinstance(request, Request):
        found = zip(request.selections, names, strict=True)
        return "; ".join(dict.fromkeys(one.reason(name, {name: None}) for one, name in found))
    solved = {
        one.request.primitives[0].name: one.solution.cost if one.is_valid else None
        for one in attempts
        if one.request.goal is request.goal
    }
    return request.selection.reason(names[0], solved)


def _deviation(attempt: Attempt) -> float:
    """How far the components' weights are from the expected ones, in standard deviations."""
    found = [
        _deviation_of(basis, motion)
        for basis, motion in zip(attempt.bases, attempt.motions, strict=True)
        if basis.n_components
    ]
    return max(found, default=float("nan"))


def _deviation_of(basis: MotionBasis, motion: Motion) -> float:
    n = basis.n_components
    assert basis.precision is not None
    off = motion.weights[:n] - basis.expected[:n]
    return float(np.sqrt(off @ basis.precision[:n, :n] @ off / n))


def _distance(position: FloatArray, state: JointState) -> float:
    return float(np.abs(position - state.positions).max())
