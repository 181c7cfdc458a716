# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Plans to a goal that is dragged: the request, its answer, and the planner between them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PlannerError, WorldError
from ..motion.collision import CollisionModel
from ..motion.goal import Goal, JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ..planning.configurations import POSE_TOLERANCE, nearest_configuration
from ..planning.objectives import objective_by_name
from ..planning.plan import DEMONSTRATED, TIMINGS, Plan, PlannerOptions
from ..planning.planner import Planner
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.model import Robot
from ..robot.world import World

FIXED = "fixed"
"""Timing of a request with a duration of its own."""


@dataclass(frozen=True)
class PlanSettings:
    """Options of a plan that the page offers.

    Attributes
    ----------
    naturalness : float
        See :class:`.PlannerOptions`.
    objective : str
        One of :data:`.OBJECTIVES`.
    timing : str
        One of :data:`.TIMINGS`, or 'fixed'.
    duration : float
        Duration of a fixed timing [s].
    compares : bool
        Whether the same goal is planned with B-splines, too.
    """

    naturalness: float = 1.0
    objective: str = "effort"
    timing: str = DEMONSTRATED
    duration: float = 1.0
    compares: bool = False


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
    vias : tuple of Pose
        Positions to pass.
    settings : PlanSettings
        Options.
    world : World
        The obstacles.
    is_final : bool
        Whether the handle was released there.
    """

    start: FloatArray
    goal: FloatArray
    pose: Pose | None = None
    vias: tuple[Pose, ...] = ()
    settings: PlanSettings = field(default_factory=PlanSettings)
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
    comparison : Plan or None
        The plan with B-splines, if it was requested and there is one.
    seconds : float
        Time that the answer took [s].
    """

    request: ViewRequest
    goal: FloatArray
    plan: Plan | None
    problem: str
    comparison: Plan | None
    seconds: float


class InteractivePlanner:
    """Answers requests one after the other, the next one from the answer before it.

    Parameters
    ----------
    robot : Robot
        The robot; not shared between threads.
    primitives : sequence of MovementPrimitive
        At least one.
    limits : JointLimits
        Limits of the joints.
    collision : CollisionModel, optional
        Collision model of the same robot; not shared between threads.
    max_solve_time : float
        Longest time for a plan [s].
    """

    def __init__(
        self,
        robot: Robot,
        primitives: Sequence[MovementPrimitive],
        limits: JointLimits,
        collision: CollisionModel | None = None,
        max_solve_time: float = 1.0,
    ) -> None:
        self.robot, self.primitives, self.limits = robot, primitives, limits
        self.collision, self._max_solve_time = collision, max_solve_time
        self._planner = lru_cache(maxsize=20)(self._new_planner)

    def answer(self, request: ViewRequest) -> PlanAnswer:
        """Plan the motion of a request; a goal that can't be served is an answer, too."""
        began = time.perf_counter()
        settings, start = request.settings, JointState(self.robot.joint_names, request.start)
        reached, goal = request.goal, self._goal(request, request.goal)
        plan = comparison = None
        problem = ""
        try:
            self._use_world(request.world)
            if request.pose is not None:
                reached, error = nearest_configuration(
                    self.robot, self.limits, request.pose, request.goal
                )
                if np.abs(error).max() <= POSE_TOLERANCE:
                    goal = self._goal(replace(request, pose=None), reached)
            plan = self._planner("pca", settings).plan(goal, start)
            reached = plan.trajectory.positions[-1]
            problem = "" if plan.is_executable else plan.message
            if settings.compares:
                comparison = self._planner("bspline", settings).plan(goal, start)
        except PlannerError as error:
            problem = str(error)
        return PlanAnswer(request, reached, plan, problem, comparison, time.perf_counter() - began)

    def _use_world(self, world: World) -> None:
        """Avoid obstacles; those that were used before are kept as they are."""
        if self.collision is None:
            if len(world):
                raise WorldError(
                    "obstacles can't be avoided: the robot's collision geometry can't be read"
                )
        elif self.collision.world is not world:
            self.collision.set_world(world)

    def _goal(self, request: ViewRequest, configuration: FloatArray) -> Goal:
        settings = request.settings
        duration = settings.duration if settings.timing == FIXED else None
        state = JointState(self.robot.joint_names, configuration)
        end = state if request.pose is None else request.pose
        if request.vias:
            times = (*(None for _ in request.vias), duration)
            return SequenceGoal((*request.vias, end), times)
        return PoseGoal(end, duration) if isinstance(end, Pose) else JointGoal(end, duration)

    def _new_planner(self, basis: str, settings: PlanSettings) -> Planner:
        timing = settings.timing if settings.timing in TIMINGS else DEMONSTRATED
        options = PlannerOptions(
            basis=basis,
            objectives=((1.0, objective_by_name(settings.objective, self.robot)),),
            timing=timing,
            naturalness=settings.naturalness,
            max_solve_time=self._max_solve_time,
        )
        return Planner(self.robot, self.primitives, self.limits, options, self.collision)
