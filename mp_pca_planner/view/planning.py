# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Plans to a goal that is dragged: the request, its answer in figures and words, the planner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError, WorldError
from ..motion.goal import JointGoal, JointState, Pose
from ..planning.configurations import POSE_TOLERANCE, nearest_configuration
from ..planning.context import Budget
from ..planning.options import PlannerOptions
from ..planning.plan import ALREADY_THERE, STOPPED_EARLY, Plan
from ..planning.planner import Planner
from ..primitives.in_span import UNUSUAL_IN_SPAN_SCORE
from ..robot.world import World
from .content import PageContent
from .stage import BAD, GOOD, WARNING, part

_TIME_OUTDATED = 1.0  # s


@dataclass(frozen=True, eq=False)
class ViewRequest:
    """A goal, and how to reach it.

    Attributes
    ----------
    start : array, shape (n_joints,)
        Start configuration, at rest [rad or m].
    goal : array, shape (n_joints,)
        The goal; if there is a pose, the configuration from which it is searched.
    pose : Pose or None
        The pose to reach.
    naturalness : float, optional
        See :class:`.PlannerOptions`.
    world : World
        The obstacles.
    is_final : bool
        Whether the handle was released there.
    """

    start: FloatArray
    goal: FloatArray
    pose: Pose | None = None
    naturalness: float | None = None
    world: World = field(default_factory=World)
    is_final: bool = False


@dataclass(frozen=True, eq=False)
class PlanAnswer:
    """The result of a request.

    Attributes
    ----------
    request : ViewRequest
        The request.
    goal : array, shape (n_joints,)
        The goal configuration; of a goal that can't be reached, the nearest one found.
    plan : Plan or None
        The plan; None if the goal is rejected.
    problem : str
        Why there is no motion to execute; empty if there is one.
    distance : float
        Distance of the goal from the place to reach, if that is out of reach [m]; else 0.
    """

    request: ViewRequest
    goal: FloatArray
    plan: Plan | None
    problem: str
    distance: float = 0.0


class InteractivePlanner:
    """Answers requests one after the other, the next one from the answer before it.

    Parameters
    ----------
    content : PageContent
        Robot, primitives, limits and collision model; robot and model are not shared between
        threads.
    max_solve_time : float
        Longest time for a plan [s], as that of the command `plan`.
    """

    def __init__(self, content: PageContent, max_solve_time: float = 5.0) -> None:
        self._content, self._max_solve_time = content, max_solve_time
        self._planner = lru_cache(maxsize=20)(self._new_planner)

    def answer(
        self, request: ViewRequest, is_outdated: Callable[[], bool] = lambda: False
    ) -> PlanAnswer:
        """Plan the motion of a request; a goal that can't be served is an answer, too.

        Once the request is outdated, the plan has a second: a drag shows plans on its way.
        """
        names = self._content.robot.joint_names
        start = JointState(names, request.start)
        reached, distance = request.goal, 0.0
        plan, problem = None, ""
        try:
            self._use_world(request.world)
            if request.pose is not None:
                reached, distance = self._nearest(request.pose, request.goal)
            goal = JointGoal(JointState(names, reached))
            quick = Budget(min(_TIME_OUTDATED, self._max_solve_time))
            budget = Budget(self._max_solve_time, lambda: quick.is_late() and is_outdated())
            plan = self._planner(request.naturalness).plan(goal, start, budget=budget)
            reached = plan.trajectory.positions[-1]
            is_served = plan.is_executable or plan.status == ALREADY_THERE
            problem = "" if is_served else plan.message
        except PlannerError as error:
            problem = str(error)
        return PlanAnswer(request, reached, plan, problem, distance)

    def _nearest(self, pose: Pose, start: FloatArray) -> tuple[FloatArray, float]:
        """The configuration nearest to a pose, and how far from it that is [m]; 0 if it is reached.

        The search begins where the last one ended, so that the configuration follows a drag without
        jumps.
        """
        reached, error = nearest_configuration(
            self._content.robot, self._content.limits, pose, start
        )
        if np.abs(error).max() <= POSE_TOLERANCE:
            return reached, 0.0
        return reached, float(np.linalg.norm(error[:3]))

    def _use_world(self, world: World) -> None:
        """Avoid obstacles; those that were used before are kept as they are."""
        collision = self._content.collision
        if collision is None:
            if len(world):
                raise WorldError(
                    "obstacles can't be avoided: the robot's collision geometry can't be read"
                )
        elif collision.world is not world:
            collision.set_world(world)

    def _new_planner(self, naturalness: float | None) -> Planner:
        options = PlannerOptions(naturalness=naturalness)
        shown = self._content
        return Planner(shown.robot, shown.primitives, shown.limits, options, shown.collision)


def answer_html(answer: PlanAnswer) -> str:
    """The verdict on an answer, and what is unusual about it."""
    plan = answer.plan
    if plan is None or answer.problem:
        return part("verdict", "No motion", answer.problem, BAD)
    if plan.status == ALREADY_THERE:
        return part("verdict", "Already there", "the goal is the start", GOOD)
    if answer.distance > 0.0:
        is_away = answer.distance > 5e-4
        away = f"{1e3 * answer.distance:.0f} mm from the handle" if is_away else "turned otherwise"
        text = f"the motion goes to the nearest pose, {away}"
        head = part("verdict", "Out of reach", text, WARNING)
    else:
        unlike = plan.in_span_score > UNUSUAL_IN_SPAN_SCORE
        is_fine = plan.status != STOPPED_EARLY
        title = "Motion found" if is_fine else "Motion found, not optimal"
        colour = WARNING if unlike or not is_fine else GOOD
        head = part("verdict", title, plan.message, colour)
    found = f"planned in {1e3 * plan.solve_time:.0f} ms with the primitive '{plan.primitive}'"
    return head + part("lines", [*plan.remarks, found])
