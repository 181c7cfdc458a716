# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Resolution of single goals: open quantities are filled in, unusable goals are rejected."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..exceptions import GoalError
from ..motion.goal import JointGoal, JointState, Pose, PoseGoal, Via
from ..primitives.boundary import hermite_functions
from ..primitives.conditional_model import ConditionalDistribution
from ..primitives.primitive import MovementPrimitive
from ..primitives.primitive_library import PrimitiveLibrary
from .conditions import Condition, JointTarget, PoseTarget, Target
from .plan import SHORTEST
from .pose_search import configurations_at, starts_near
from .selection import Selection, Selector
from .setup import Setup
from .states import check_start, check_within_limits, completed, in_order, unwrapped


@dataclass(frozen=True, eq=False)
class Request:
    """A resolved goal: the complete input of the compiler.

    Attributes
    ----------
    selection : Selection
        Reason for the choice of the primitive.
    primitive : MovementPrimitive
        The primitive of the motion.
    start, goal : JointState
        States of all joints; of a pose, one that reaches it.
    pose : Pose or None
        The goal pose, if the goal is a pose; then the goal state is an initial value.
    conditions : tuple of Condition
        The vias, then a pose.
    duration_is_free : bool
        Whether the duration is not specified.
    expected : ConditionalDistribution
        Prediction from the demonstrations.
    """

    selection: Selection
    primitive: MovementPrimitive
    start: JointState
    goal: JointState
    pose: Pose | None
    conditions: tuple[Condition, ...]
    duration_is_free: bool
    expected: ConditionalDistribution

    @property
    def usual_duration(self) -> float:
        """The requested duration, or the predicted one [s]."""
        return self.expected.duration

    @property
    def primitives(self) -> tuple[MovementPrimitive, ...]:
        """The primitive."""
        return (self.primitive,)

    @property
    def selections(self) -> tuple[Selection, ...]:
        """The reason for the choice of the primitive."""
        return (self.selection,)

    @property
    def n_vias(self) -> int:
        """Number of vias."""
        return len(self.conditions) - (self.pose is not None)


class GoalResolver:
    """Resolves single goals for a planner.

    Parameters
    ----------
    setup : Setup
        Robot, limits and options of the planner.
    selector : Selector
        Chooses among its primitives.
    """

    def __init__(self, setup: Setup, selector: Selector) -> None:
        self._setup, self._selector = setup, selector
        robot, limits = setup.robot, setup.limits
        zero = np.zeros(robot.n_joints)
        self._anywhere = JointState(robot.joint_names, np.clip(zero, limits.lower, limits.upper))

    def check(self, goal: JointGoal) -> None:
        """Reject a goal that can't be served from any start, see :meth:`.Planner.check`."""
        if goal.duration is not None:
            self._setup.check_duration("the duration is", goal.duration)
        self._selector.check_name(goal.primitive)
        here = self._anywhere
        there = completed(goal.state, here, self._setup.robot, "goal")
        # The number of turns of a continuous joint depends on the start.
        q = np.where(self._setup.robot.continuous, here.positions, there.positions)
        self._check_end(JointState(here.joint_names, q, there.velocities, there.accelerations))

    def resolve(self, goal: JointGoal | PoseGoal, start: JointState) -> Iterator[Request]:
        """Fill in the open quantities of a goal; reject a goal that can't be served.

        A pose can be reached in several configurations: several requests, the most natural first.
        A configuration can be reached with several primitives, the one expected to be cheapest
        first. They are made when they are needed: mostly the first is enough.

        Parameters
        ----------
        goal : JointGoal or PoseGoal
            The goal.
        start : JointState
            Present state.

        Raises
        ------
        GoalError, RobotError
            See :meth:`.Planner.plan`.
        """
        here = in_order(start, self._setup.robot.joint_names)
        check_start(here, self._setup.limits)
        if goal.duration is not None:
            self._setup.check_duration("the duration is", goal.duration)
        selector = self._selector.among(goal.primitive)
        if isinstance(goal, JointGoal):
            goals, pose = [self.target(goal, here)], None
        else:
            goals, pose = self._pose_goals(goal.pose, here, selector.primitives), goal.pose

        def score(there: JointState) -> float:
            return selector.least_score(here.positions, there.positions, goal.duration)

        # Several primitives are tried for one configuration, but not in the search for the shortest
        # duration, nor for each of several configurations.
        searches = goal.duration is None and self._setup.options.timing == SHORTEST
        if len(goals) > 1:
            goals = sorted(goals, key=score)[: self._setup.options.search.n_configurations]
        for there in goals:
            selection = selector.choose(here.positions, there.positions, goal.duration)
            several = pose is None and not searches
            for one in selection.contenders if several else [selection.first]:
                request = Request(
                    selection,
                    one.primitive,
                    here,
                    there,
                    pose,
                    (),
                    goal.duration is None,
                    one.expected,
                )
                if pose is not None or goal.vias:
                    request = replace(request, conditions=self._conditions(request, goal.vias))
                yield request

    def target(self, goal: JointGoal, here: JointState) -> JointState:
        """The configuration of all joints that a goal specifies; see :meth:`resolve`."""
        there = completed(goal.state, here, self._setup.robot, "goal")
        self._check_end(there)
        return there

    def _check_end(self, there: JointState) -> None:
        check_within_limits("goal", there, self._setup.limits)
        if not self._setup.options.allow_nonzero_end_velocity and np.any(there.velocities != 0.0):
            moving = there.joint_names[int(np.abs(there.velocities).argmax())]
            raise GoalError(
                f"the goal velocity of joint '{moving}' is not 0, which the controller rejects "
                "unless it and this planner are set to allow a nonzero velocity at the end"
            )

    def _pose_goals(
        self, pose: Pose, here: JointState, candidates: PrimitiveLibrary
    ) -> list[JointState]:
        """Configurations that reach the pose, from ends of demonstrations and the start."""
        known = candidates.ends[:, 1]
        starts = [*starts_near(self._setup.robot, pose, known), here.positions]
        found = configurations_at(self._setup.robot, self._setup.limits, pose, starts)
        return [JointState(here.joint_names, unwrapped(q, here, self._setup.robot)) for q in found]

    def _conditions(self, request: Request, vias: Sequence[Via]) -> tuple[Condition, ...]:
        """The vias, and the pose to reach at the end."""
        conditions = self._via_conditions(request, vias) if vias else []
        if request.pose is not None:
            conditions.append(Condition(PoseTarget(self._setup.robot, request.pose), 1.0))
        return tuple(conditions)

    def _via_conditions(self, request: Request, vias: Sequence[Via]) -> list[Condition]:
        targets = [self._target(via, request.start) for via in vias]
        phases = np.linspace(0.0, 1.0, 201)
        ends = np.zeros((6, self._setup.robot.n_joints))
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
        names, target = self._setup.robot.joint_names, via.target
        if isinstance(target, Pose):
            self._setup.robot.frame_positions(here.positions[None], [target.frame])
            return PoseTarget(self._setup.robot, target)
        state = completed(target, here, self._setup.robot, "via")
        check_within_limits("via", JointState(names, state.positions), self._setup.limits)
        index = np.array([names.index(name) for name in target.joint_names])
        return JointTarget(index, state.positions[index], len(names))

    def expect(
        self,
        primitive: MovementPrimitive,
        start: JointState,
        goal: JointState,
        duration: float | None,
    ) -> ConditionalDistribution:
        """The prediction for a motion, with continuous joints shifted by full turns."""
        return primitive.model.predict(*self._shifted(primitive, start, goal), duration)

    def in_span_score(
        self,
        primitive: MovementPrimitive,
        start: JointState,
        goal: JointState,
        duration: float | None,
    ) -> float:
        """The in-span score of that prediction."""
        return primitive.model.in_span_score(*self._shifted(primitive, start, goal), duration)

    def _shifted(
        self, primitive: MovementPrimitive, start: JointState, goal: JointState
    ) -> tuple[FloatArray, FloatArray]:
        # The demonstrations of a continuous joint may be full turns away.
        mean = primitive.model.mean[: primitive.n_joints]
        turns = np.round((mean - start.positions) / (2.0 * np.pi))
        shift = np.where(self._setup.robot.continuous, 2.0 * np.pi * turns, 0.0)
        return start.positions + shift, goal.positions + shift


def _windows(
    targets: Sequence[Target], vias: Sequence[Via], phases: FloatArray, usual: FloatArray
) -> list[tuple[float, float]]:
    """Windows of the free phases of vias, around the phase at which the expected motion is nearest.

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
            # Phases are reserved for the free vias after it.
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
