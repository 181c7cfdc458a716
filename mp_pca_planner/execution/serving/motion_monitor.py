# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Publishing, monitoring and stopping motions."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from ...exceptions import GoalError
from ...motion.trajectory import Trajectory
from ...robot.world import World
from ..options import Serving
from ..threads import SAFETY_WAIT
from ..tracking.following import MotionFollower
from ..tracking.measured import Clock
from ..tracking.published_motion import PublishedMotion
from .assembly import Model
from .execution import Execution, ExecutionReport, MotionOutcome, Served
from .stopping import StopPlanner
from .surroundings import Surroundings


class MotionMonitor:
    """Publishes motions, monitors how the robot follows them, and stops it.

    Parameters
    ----------
    follower :
        Tracks the robot on its motion.
    send :
        Sends the trajectory of a motion to the controller.
    clock :
        The clock of planning times [s]: never set back.
    report :
        Called with the outcome of each published motion.

    Attributes
    ----------
    follower, clock
        As given.
    surroundings : Surroundings
        The obstacles around the robot.
    """

    def __init__(
        self,
        follower: MotionFollower,
        send: Callable[[PublishedMotion], None],
        clock: Clock,
        report: Callable[[ExecutionReport], None],
    ) -> None:
        self.follower, self.clock = follower, clock
        self._send, self._report = send, report
        self.surroundings = Surroundings(follower)
        self._stops = StopPlanner(follower, self.surroundings, clock)

    def watch(self, model: Model) -> None:
        """Check how the robot follows its motion; call this at 10 Hz or more.

        The robot is stopped if it would hit an obstacle soon, whatever is being planned.

        Raises
        ------
        BusyError
            If another thread publishes a motion at this moment; call it again.
        """
        with self.follower.lock.within(SAFETY_WAIT):
            try:
                following = self.follower.follow(model.settings)
            except GoalError:
                following = None
            execution, now = self.follower.execution, self.follower.motion_time
            if execution is not None and self.follower.commanded is None:
                self._end(execution.given_up("time was set back"))
            elif execution is not None:
                report = execution.update(following, now)
                self._end(report)
                is_lost = report is not None and not report.outcome.is_good
                if following is not None and following.motion is not execution.motion:
                    is_lost |= now <= execution.published + Serving.start_delay
                if execution.is_stop and is_lost and following and not following.at_rest:
                    self.stop(model, execution.reason, execution.published)
            threat = self.surroundings.threat
            if threat is not None and now > threat.last_time:
                self.stop(model, threat.reason)

    def expect(self, joint_names: tuple[str, ...], model: Model | None = None) -> bool:
        """Use the states of these joints; returns whether they are others.

        A running motion is stopped then, with the model before.
        """
        reason = "the joints of the primitives have changed"
        with self.follower.lock:
            if joint_names == self.follower.measured.joint_names:
                return False
            if model is not None:
                with suppress(GoalError):
                    self.release(model, reason)
            execution = self.follower.execution
            self.follower.expect(joint_names)
            if execution is not None:
                self._end(execution.given_up(reason))
        return True

    def release(self, model: Model, reason: str) -> None:
        """Stop the robot if it executes the motion of a goal, like :meth:`stop`."""
        with self.follower.lock:
            execution = self.follower.execution
            if execution is None:
                return
            if not (execution.is_stop or execution.is_reported):
                self.stop(model, reason)

    @property
    def served(self) -> Served | None:
        """The goal that was served last; None if the robot was stopped since."""
        execution = self.follower.execution
        return None if execution is None else execution.served

    def stop(
        self,
        model: Model,
        reason: str = "",
        began: float | None = None,
    ) -> str:
        """Publish a trajectory that brings the robot to rest.

        Parameters
        ----------
        model :
            The planner and its settings.
        reason :
            Why, for the report of the execution.
        began :
            For a stop that is repeated, when the first one was published [s].

        Returns
        -------
        :
            Description of the stop, one sentence.

        Raises
        ------
        PlannerError
            If the robot's state is unknown; nothing was published then.
        """
        with self.follower.lock:
            stopped = self.follower.execution
            late = 0.0 if began is None else self.follower.motion_time - began
            said, motion, collision = self._stops.find(model, late)
            why = "; ".join(filter(None, [reason, collision]))
            stop = Execution.of_stop(stopped, motion, why)
            stop.published = stop.published if began is None else began
            self.publish(stop)
        return "; ".join(filter(None, [said, collision]))

    def publish(self, execution: Execution, world: World | None = None) -> None:
        """Publish a motion, the only place where that is done; it replaces the one before.

        It was checked for collisions with the obstacles of the world, if that is given.
        """
        old, motion = self.follower.execution, execution.motion
        execution.checked = None if world is None else (motion, world)
        self._send(motion)
        self.follower.command(motion, execution)
        if old is not None and not execution.is_stop:
            self._end(old.replaced(execution))

    def hear(self, sent: Trajectory, text: str, failure: MotionOutcome | None) -> bool:
        """Record what the controller answered to a trajectory that was sent as a goal.

        Parameters
        ----------
        sent :
            The trajectory.
        text :
            The answer, after "the controller".
        failure :
            `NEVER_STARTED` if the goal is rejected, `NOT_FOLLOWED` if it ended badly; None if all
            is well so far.

        Returns
        -------
        :
            Whether it is the stop of the robot, and was not replaced since.
        """
        with self.follower.lock:
            published, execution = self.follower.published, self.follower.execution
            if published is None or execution is None or execution.motion.sent is not sent:
                return False  # it has been replaced, and was reported as such
            if failure is MotionOutcome.NEVER_STARTED:
                published.give_up()
            self._end(execution.answer(text, failure))
            return execution.is_stop

    def _end(self, report: ExecutionReport | None) -> None:
        if report is not None:
            self._report(report)
