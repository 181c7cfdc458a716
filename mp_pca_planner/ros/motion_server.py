# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals → motions that a controller may follow, from wherever the robot is and however it moves.

This is what the node does, but for messages: it knows nothing of ROS.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..exceptions import TrajectoryError
from ..goal import Goal, JointGoal, JointState, SequenceGoal
from ..planning.plan import Plan
from ..planning.sequence import SequencePlan
from ..trajectory import Trajectory
from ..validation import check_executable, check_limits
from .assembly import Model
from .commanded import stopping_motion
from .goal_statistics import GoalStatistics
from .newest_goal import CancelledError, IsCancelled
from .start_state import REST_VELOCITY, Clock, Start, StartStates, TooLateError

if TYPE_CHECKING:
    from .trial_book import ServedTrial, TrialBook

MakeGoal = Callable[[JointState], Goal]
"""Says what is to be reached, for a motion that starts at a state."""

# Times that a motion is planned again because the robot had gone on, each time with twice the
# time that it took before.
_MOST_ATTEMPTS = 3


class UnexecutablePlanError(TrajectoryError):
    """A plan that must not be published."""

    def __init__(self, plan: Plan | SequencePlan) -> None:
        super().__init__(plan.message)
        self.plan = plan


@dataclass(frozen=True, eq=False)
class Served:
    """A goal whose motion was published.

    Attributes
    ----------
    plan : Plan or SequencePlan
        The plan.
    model : Model
        What it was made with.
    trial : ServedTrial or None
        The trial that it is, if the goal is learned by trials.
    """

    plan: Plan | SequencePlan
    model: Model
    trial: ServedTrial | None = None


class MotionServer:
    """Plans motions, publishes them, and stops them.

    Parameters
    ----------
    states :
        Where motions start.
    statistics :
        Counts goals, and knows how long they take.
    publish :
        Sends a trajectory to the controller, which starts it at once; only its last point if
        the second argument says so.
    clock :
        Tells how long planning takes [s]: never set back.
    """

    def __init__(
        self,
        states: StartStates,
        statistics: GoalStatistics,
        publish: Callable[[Trajectory, bool], None],
        clock: Clock,
    ) -> None:
        self._states = states
        self._statistics = statistics
        self._send = publish
        self._clock = clock
        self._trials: TrialBook | None = None
        # Goals are served in a thread of their own, stops in that of the callbacks.
        self._publishing = threading.Lock()

    def serve(
        self, kind: type[Goal], make_goal: MakeGoal, model: Model, is_cancelled: IsCancelled
    ) -> Served:
        """Plan and publish a motion.

        Parameters
        ----------
        kind :
            The kind of the goal: some take longer than others.
        make_goal :
            The goal, for a motion that starts at this state.
        model :
            What to plan with.
        is_cancelled :
            Whether nobody wants the motion any more.

        Raises
        ------
        PlannerError
            If the goal can't be served; nothing was published then.
        CancelledError
            If it is cancelled before it is published.
        """
        latency = self._statistics.expected_latency(kind)
        for attempt in range(1, _MOST_ATTEMPTS + 1):
            began = self._states.motion_time
            try:
                return self._serve_once(kind, make_goal, model, is_cancelled, latency)
            except TooLateError:
                if attempt == _MOST_ATTEMPTS:
                    raise
                latency = 2.0 * max(self._states.motion_time - began, latency)
        raise AssertionError("the last attempt returns or raises")

    def stop(self, model: Model) -> str:
        """Publish a trajectory of one point that brings the robot to rest.

        Returns
        -------
        :
            How it stops, one sentence.

        Raises
        ------
        PlannerError
            If it isn't known where the robot is; nothing was published then.
        """
        with self._publishing:
            settings = model.settings
            here = self._states.present(settings.state_timeout, settings.commanded_tolerance)
            motion = stopping_motion(here, model.robot, model.limits)
            if motion is not None:
                said = f"comes to rest within {motion.duration:.3g} s"
            else:
                # What the controller does when it is told to cancel.
                motion = _hold(here)
                said = "holds where it is: no stop within the limits was found"
            self._send(motion, True)
            self._states.command(motion)
        return said

    def _serve_once(
        self,
        kind: type[Goal],
        make_goal: MakeGoal,
        model: Model,
        is_cancelled: IsCancelled,
        latency: float,
    ) -> Served:
        settings = model.settings
        began = self._clock()
        start = self._states.choose(
            settings.start_from, settings.state_timeout, latency, settings.commanded_tolerance
        )
        model.planning_robot.is_cancelled = is_cancelled
        goal = make_goal(start.state)
        plan = (
            model.sequence_planner.plan(goal, start.state, settings.sequence_mode)
            if isinstance(goal, SequenceGoal)
            else model.planner.plan(goal, start.state)
        )
        if not plan.is_executable:
            raise UnexecutablePlanError(plan)
        trial = None
        may_learn = settings.learn_trials and _is_at_rest(start)
        if may_learn and isinstance(goal, JointGoal) and isinstance(plan, Plan):
            plan, trial = self._trial_book().vary(goal, plan, model)
        self._publish(plan, start, model, is_cancelled)
        self._statistics.served(kind, plan.solve_time, self._clock() - began)
        return Served(plan, model, trial)

    def _trial_book(self) -> TrialBook:
        # Takes long to import, and hardly any node learns.
        from .trial_book import TrialBook

        if self._trials is None:
            self._trials = TrialBook()
        return self._trials

    def _publish(
        self, plan: Plan | SequencePlan, start: Start, model: Model, is_cancelled: IsCancelled
    ) -> None:
        """Publish a plan from where the robot is: the only place where motions are published."""
        timeout = model.settings.state_timeout
        check = plan.limit_check
        if start.commanded is not None:
            # What is published a moment later is the end of the same trajectory.
            joined = self._states.join(plan.trajectory, start, timeout)
            check = check_limits(joined, model.planning_robot, model.limits)
        with self._publishing:
            if is_cancelled():
                raise CancelledError
            trajectory = self._states.join(plan.trajectory, start, timeout)
            check_executable(
                trajectory,
                check,
                _first_state(trajectory) if start.commanded else start.state,
                allow_nonzero_end_velocity=model.settings.allow_nonzero_end_velocity,
            )
            self._send(trajectory, False)
            self._states.command(trajectory)


def _is_at_rest(start: Start) -> bool:
    return start.commanded is None and bool(np.abs(start.state.velocities).max() <= REST_VELOCITY)


def _first_state(trajectory: Trajectory) -> JointState:
    return JointState(trajectory.joint_names, trajectory.positions[0])


def _hold(here: JointState) -> Trajectory:
    zero = [[0.0] * len(here.joint_names)]
    return Trajectory(here.joint_names, [0.0], [here.positions], zero, zero)
