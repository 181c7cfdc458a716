# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Assembly of a plan from the selected attempt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..motion.goal import Goal, JointState
from ..robot.model import Robot
from .attempt import Attempt, largest
from .bases import MotionBasis
from .conditions import PoseTarget
from .motion import Motion
from .objectives import Effort
from .plan import MotionSolution, Plan
from .request import GoalResolver, Request
from .selection import cost_of
from .setup import Setup
from .verdict import Judge, Planned, correction

if TYPE_CHECKING:
    from .planner import Planner


class PlanAssembly:
    """Makes plans of attempts.

    Parameters
    ----------
    setup, resolver
        Components of the planner.
    """

    def __init__(self, setup: Setup, resolver: GoalResolver) -> None:
        self._setup, self._resolver, self._judge = setup, resolver, Judge(setup)

    def plan(self, planned: Planned, reason: str, solve_time: float, planner: Planner) -> Plan:
        """The plan of a planner, with its status, message and values."""
        attempt = planned.attempt
        request = attempt.request
        trajectory = attempt.trajectory.with_efforts(attempt.check.efforts)
        via_error, goal_error = _errors(attempt, self._setup.robot)
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
            expected_error=self._expected_error(attempt),
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
            planner=planner,
        )

    def _solution(self, attempt: Attempt) -> MotionSolution:
        """The result of the solver; costs of a motion that was not optimised are computed here."""
        solution = attempt.solution
        if np.isfinite(solution.objective_cost):
            return solution
        objective, effort = (
            sum(
                cost_of(self._setup.robot, motion, basis.tables, objectives)
                for motion, basis in zip(attempt.motions, attempt.bases, strict=True)
            )
            for objectives in (self._setup.options.objectives, [(1.0, Effort())])
        )
        return replace(solution, objective_cost=objective, effort_cost=effort)

    def _in_span_score(self, attempt: Attempt) -> float:
        """The goal state of the request; for a pose, the configuration that was found for it."""
        request = attempt.request
        if isinstance(request, Request) and request.pose is None:
            return request.expected.in_span_score
        free = request.duration_is_free
        return max(
            self._resolver.in_span_score(
                primitive, motion.start, motion.goal, None if free else motion.duration
            )
            for primitive, motion in zip(request.primitives, attempt.motions, strict=True)
        )

    def _expected_error(self, attempt: Attempt) -> float:
        return max(
            primitive.expected_error(
                self._resolver.expect(primitive, motion.start, motion.goal, motion.duration)
            )
            for primitive, motion in zip(attempt.request.primitives, attempt.motions, strict=True)
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


def selection_reason(goal: Goal, best: Attempt, attempts: Sequence[Attempt]) -> str:
    """The reason for the choice of the primitives of the best attempt."""
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
    """RMS deviation of the components' weights from the expected ones, in standard deviations."""
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
