# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The planner (block 4 of [P] Fig. 1): goal → primitive → program → weights → trajectory."""

from __future__ import annotations

import time
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from importlib import import_module
from types import NoneType

import numpy as np

from ..arrays import check_choice, check_type
from ..exceptions import (
    GoalError,
    LimitsError,
    PrimitiveError,
    RobotError,
    WorldError,
    quote_names,
)
from ..input_limits import INPUT_LIMITS
from ..motion.collision import CollisionModel
from ..motion.goal import (
    GoalLike,
    JointGoal,
    JointState,
    SequenceGoal,
    StateLike,
    as_goal,
    as_state,
)
from ..motion.validation import require_effort_limits
from ..primitives.library import PrimitiveLibrary
from ..primitives.primitive import MovementPrimitive
from ..robot.limits import JointLimits
from ..robot.meshes import package_folders
from ..robot.model import Robot
from ..robot.world import World
from .context import Budget, Context, one_blas_thread
from .demonstrated import NO_SHAPES, demonstrated_limits, robot_collision
from .objectives import uses_efforts
from .options import FREE, MODES, OPTIMAL, SHORTEST, PlannerOptions
from .plan import Plan
from .report import already_there, report
from .resolve import in_order, in_span_scores, resolve, target
from .search.search import search

# Time that is kept for the last checks and for a slow motion where no other was found, for each
# segment; at most 0.4 of all [s].
_TIME_FOR_CHECKS = 0.025


class Planner:
    """Plans motions of one robot from movement primitives.

    Parameters
    ----------
    robot : Robot
        The model, with the joints of the primitives in their order. Not shared between threads.
    primitives : MovementPrimitive, sequence of them, or PrimitiveLibrary
        At least one; names must differ.
    limits : JointLimits, optional
        Limits of the joints; those of the robot description unless given.
    options : PlannerOptions, optional
        Options of planning.
    collision : bool or CollisionModel
        Whether self-collision is avoided, or the collision model of the same robot, not shared
        between threads. By default, links are checked where the robot has collision shapes, except
        pairs that are neighbours, or collide in the neutral configuration or in a demonstration.
    world : World, optional
        Obstacles to avoid. They replace those of the collision model.

    Attributes
    ----------
    remarks : tuple of str
        What is not checked for collisions, against expectation.

    Raises
    ------
    GoalError
        If an argument is unknown.
    PrimitiveError
        If there is no primitive, two have the same name, or one is of other joints.
    RobotError
        If a moving link has no valid inertia, and efforts are limited or part of the objective; if
        there are obstacles, and the robot's collision shapes can't be used.
    WorldError
        If an obstacle is attached to an unknown link or has the name of a link.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> urdf = mp.config_file("human_arm.urdf")
    >>> motions = mp.load_demonstrations(mp.write_example_recording("motions.mcap", 6), robot=urdf)
    >>> reach = mp.MovementPrimitive.fit(motions, name="reach")
    >>> planner = mp.Planner(mp.Robot.from_file(urdf, reach.joint_names), [reach])
    >>> start, goal = motions[0].positions[[0, -1]]
    >>> planner.plan(start=start, goal=goal).status
    'solved'
    """

    def __init__(
        self,
        robot: Robot,
        primitives: MovementPrimitive | Sequence[MovementPrimitive],
        limits: JointLimits | None = None,
        options: PlannerOptions | None = None,
        collision: CollisionModel | bool | None = True,
        world: World | None = None,
    ) -> None:
        check_type(robot, "the robot", RobotError, Robot)
        self.robot, self.primitives = robot, PrimitiveLibrary.of(primitives)
        self.limits = robot.limits() if limits is None else limits
        self.options = PlannerOptions() if options is None else options
        check_type(self.limits, "limits", LimitsError, JointLimits)
        check_type(self.options, "options", GoalError, PlannerOptions)
        check_type(collision, "collision", RobotError, CollisionModel, bool, NoneType)
        check_type(world, "world", WorldError, World, NoneType)
        if self.primitives.joint_names != self.robot.joint_names:
            raise PrimitiveError(
                f"primitive '{next(iter(self.primitives.names))}' moves "
                f"{quote_names(self.primitives.joint_names)}, but the planner was set up for "
                f"{quote_names(self.robot.joint_names)}; 'rename' and --rename give demonstrations "
                "the names of a robot"
            )
        self.remarks: tuple[str, ...] = ()
        if isinstance(collision, CollisionModel):
            if world is not None:
                collision.set_world(world)
            self.remarks = () if collision.has_geometry else (NO_SHAPES,)
        else:
            collision, self.remarks = robot_collision(
                robot,
                self.primitives,
                self_collision=bool(collision),
                package_dirs=package_folders((), robot.path),
                world=world,
            )
        # Imported by then, so that the first plan does not wait for it.
        import_module("scipy.interpolate")
        import_module("scipy.optimize")
        require_effort_limits(self.robot, self.limits)
        if any(uses_efforts(objective, self.robot) for _, objective in self.options.objectives):
            others = "choose an objective without efforts, such as jerk"
            self.robot.require_inertias("objectives with efforts", others)
        longest = INPUT_LIMITS.longest_motion(self.options.sample_period)
        self._context = Context(self.robot, self.limits, self.options, collision, longest)

    def __repr__(self) -> str:
        names = quote_names(self.primitives.names)
        return f"Planner of {self.robot!r}, primitives {names}"

    @property
    def collision(self) -> CollisionModel | None:
        """The collision model, if collisions are avoided."""
        return self._context.collision

    def use_collision(self, collision: CollisionModel) -> None:
        """Avoid collisions by another model of the same robot from now on."""
        self._context = replace(self._context, collision=collision)

    def target(self, goal: JointGoal, start: StateLike) -> JointState:
        """The configuration of all joints that a goal specifies.

        Raises
        ------
        GoalError
            See :meth:`plan`.
        """
        check_type(goal, "the goal", GoalError, JointGoal)
        here = as_state(start, self.robot.joint_names, "the start")
        return target(self._context, goal, in_order(here, self.robot.joint_names))

    def is_too_far(self, goal: JointGoal, start: JointState, end: JointState) -> bool:
        """Whether a request is too far from the demonstrations, see `max_in_span_score`.

        Parameters
        ----------
        goal : JointGoal
            Its duration and its primitive count.
        start, end : JointState
            States of all joints, in the robot's order.
        """
        most = self.options.max_in_span_score
        if not most:
            return False
        named = goal.primitive
        primitives = self.primitives if named is None else [self.primitives.named(named)]
        ends = start.positions, end.positions
        return bool(in_span_scores(self.robot, primitives, *ends, goal.duration).min() > most)

    @one_blas_thread()
    def plan(
        self,
        goal: GoalLike,
        start: StateLike,
        mode: str = OPTIMAL,
        *,
        duration: float | None = None,
        budget: Budget | None = None,
    ) -> Plan:
        """Plan the motion with the least objective to a goal, or through several targets.

        Parameters
        ----------
        goal : Goal, Pose, JointState, mapping, array, shape (n_joints,), or sequence of these
            The goal. Joints that are not named keep their position. Initial targets of a sequence
            at the robot's position count as passed. At a goal where the robot rests already, no
            motion is planned.
        start : JointState, mapping or array, shape (n_joints,)
            Present state; further joints are ignored.
        mode : {'optimal', 'real_time'}
            Whether to optimise a sequence, or only to join its segments. Free durations of a
            sequence are lengthened where the limits can't be kept otherwise.
        duration : float, optional
            Duration of the motion [s], for goals other than a `Goal`, which has its own.
        budget : Budget, optional
            Time for planning and a way to cancel it; `max_solve_time` of the options unless given.

        Returns
        -------
        plan : Plan
            The plan; its status states whether the motion may be executed.

        Raises
        ------
        GoalError
            If the goal or the state can't be used: unknown or missing joints, positions
            outside the limits, a pose out of reach, no such primitive, an unknown argument.
        RobotError
            If there is no such frame.
        """
        began = time.perf_counter()
        goal = as_goal(goal, self.robot.joint_names, duration)
        start = as_state(start, self.robot.joint_names, "the start")
        check_choice(mode, "the mode", GoalError, MODES)
        states, times = [start, getattr(goal, "state", start)], [getattr(goal, "duration", None)]
        if isinstance(goal, SequenceGoal):
            states += [one for one in goal.targets if isinstance(one, JointState)]
            times += goal.times
        limits, is_asked, moves = self.limits, bool(set(times) - {None}), False
        for one in states:
            moves |= bool(one.velocities.any() or one.accelerations.any())
        # Limits of the demonstrations are for motions from rest to rest in times of our own.
        if self.options.demonstrated_margin and not (is_asked or moves):
            careful, usual = self._demonstrated
            limits = usual if self.options.timing in (SHORTEST, FREE) else careful
        context = replace(self._context, limits=limits)
        n_segments = len(goal.targets) if isinstance(goal, SequenceGoal) else 1
        budget = copy(Budget(self.options.max_solve_time) if budget is None else budget)
        budget.whole = budget
        budget.deadline -= min(n_segments * _TIME_FOR_CHECKS, 0.4 * budget.seconds)
        requests = resolve(context, self.primitives, goal, start, mode, budget)
        if isinstance(requests, tuple) and not requests:
            return already_there(context, start, began)
        return report(context, search(context, requests, budget), budget, began)

    @cached_property
    def _demonstrated(self) -> tuple[JointLimits, JointLimits]:
        margin = self.options.demonstrated_margin
        return demonstrated_limits(self.robot, self.primitives, self.limits, margin)

    @property
    def default_accelerations(self) -> dict[str, float]:
        """Limits of acceleration [/s²] of joints without one, from the demonstrations."""
        if not self.options.demonstrated_margin:
            return {}
        _, usual = self._demonstrated
        pairs = zip(self.limits.joint_names, usual.acceleration.tolist(), strict=True)
        free = np.isinf(self.limits.acceleration)
        return {name: value for (name, value), has in zip(pairs, free, strict=True) if has}
