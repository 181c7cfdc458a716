# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The server of goals: one object, called by one thread, that never waits.

It has the planner plan for the newest goal, joins the motion to where the robot is, checks it and
publishes it, watches how the robot follows it, and stops the robot. What takes long is done by
workers, whose answers come as messages.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from ..exceptions import GoalError, PlannerError, TrajectoryError
from ..motion.goal import Goal, JointGoal, JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import check_executable, check_limits
from ..planning.plan import ALREADY_THERE
from ..planning.resolve import check_goal
from ..robot.model import Robot
from .link import (
    Link,
    ModelFacts,
    Place,
    Planned,
    PlanRequest,
    Rejected,
    RunningMotion,
    Verdict,
    Watch,
    WorkerDied,
)
from .motions import PublishedMotion
from .outcomes import Execution, ExecutionReport, GoalOutcome, MotionOutcome
from .parameters import Settings
from .states import UnconfirmedError
from .stopping import find_stop
from .tracking import (
    MotionStart,
    TooLateError,
    Tracker,
    Where,
    choose_start,
    join,
)

# Times that a motion is planned if the robot has moved past its start. Each time, the start is
# twice as far ahead as the last planning took.
_MAX_ATTEMPTS = 3
# Expected time from choosing a start to publishing: before the first one, and the longest for a
# joint goal [s]; a multiple of the 90th percentile of the latest ones.
_INITIAL_LATENCY, _MAX_LOOKAHEAD, _LATENCY_MARGIN = 0.1, 0.25, 1.5
# Longest time to wait for states that show where the robot is [s].
_CONFIRMATION = 1.5
# Least time that a motion around an obstacle is planned ahead, and time before a collision at which
# the robot is stopped if there is none [s].
_LOOKAHEAD, _RESERVE = 0.15, 0.6
# Distance between the first command and the motion under way that is rounding [rad or m]: of times
# in seconds since 1970, and of those in messages.
_ROUNDING = 1e-6
# Change of a joint that carries the arm, while a motion is planned, up to which it is the same.
_CARRIER_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class NodeModel:
    """The robot that motions are joined, checked and stopped with.

    Attributes
    ----------
    robot : Robot
        The robot.
    facts : ModelFacts
        What the planner says of its model.
    settings : Settings
        The parameters.
    """

    robot: Robot
    facts: ModelFacts
    settings: Settings


@dataclass(frozen=True, eq=False)
class GoalRequest:
    """A goal that was received.

    Attributes
    ----------
    goal : Goal
        The goal as stated.
    name : object
        Identifies it in reports.
    make_goal : callable, optional
        Returns the goal for a motion from a start state, if that depends on the start.
    ignored_joints : tuple of str
        Joints of the goal that the primitives don't move.
    """

    goal: Goal
    name: Any = None
    make_goal: Callable[[JointState], Goal] | None = None
    ignored_joints: tuple[str, ...] = ()


class Outputs(Protocol):
    """What a server does to the world."""

    def send(self, motion: PublishedMotion, planned: Planned | None) -> None:
        """Send a motion to the controller."""

    def report_goal(
        self,
        outcome: GoalOutcome,
        name: Any,
        reason: str = "",
        planned: Planned | Rejected | None = None,
        ignored_joints: Sequence[str] = (),
    ) -> None:
        """Report what became of the goal with a name."""

    def report_motion(self, report: ExecutionReport) -> None:
        """Report what became of a motion."""

    def log(self, text: str) -> None:
        """Tell a user what was done without a goal."""


class GoalStatistics:
    """Counts of goals and their latest times."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(GoalOutcome, 0)
        # Enough times for a 99th percentile; older ones may be outdated.
        self._solve_times: deque[float] = deque(maxlen=1000)
        # By kind: sequences take longer than single goals.
        self._latencies: dict[type[Goal], deque[float]] = defaultdict(lambda: deque(maxlen=100))

    def served(self, kind: type[Goal], solve_time: float, latency: float) -> None:
        """Count the times of a goal whose motion was published [s]."""
        self._solve_times.append(solve_time)
        self._latencies[kind].append(latency)

    def expected_latency(self, kind: type[Goal]) -> float:
        """Time from choosing a start to publishing that few goals of a kind exceed [s]."""
        recent = self._latencies[kind]
        if not recent:
            return _INITIAL_LATENCY
        return _LATENCY_MARGIN * float(np.percentile(recent, 90))

    def solve_time_percentiles(self) -> dict[str, float]:
        """Percentiles of the latest solve times by name [s]; none before the first goal."""
        if not self._solve_times:
            return {}
        ranks = (50, 90, 99)
        found = np.percentile(list(self._solve_times), ranks).tolist()
        return {f"solve_time_p{rank}_s": x for rank, x in zip(ranks, found, strict=True)}


@dataclass(eq=False)
class _Attempt:
    """A goal that is being served."""

    request: GoalRequest
    lookahead: float
    is_detour: bool = False
    number: int = 1
    key: int = 0
    start: MotionStart | None = None
    began: float = 0.0
    deadline: float = math.inf
    is_dropped: bool = False
    carriers: dict[str, float] = field(default_factory=dict)


class MotionServer:
    """Serves goals: see the module.

    Parameters
    ----------
    tracker : Tracker
        Where the robot is.
    planner : Link
        The way to the planner.
    outputs : Outputs
        Sends motions and reports.

    Attributes
    ----------
    tracker : Tracker
        As given.
    model : NodeModel or None
        The robot; None while there is none, and goals are rejected.
    hold : str
        Why goals are rejected although there is a model; empty if they are accepted.
    watcher : Link or None
        The way to the watcher, once there are obstacles.
    execution : Execution or None
        The motion that was published last.
    statistics : GoalStatistics
        Counts of goals.
    """

    def __init__(self, tracker: Tracker, planner: Link, outputs: Outputs) -> None:
        self.tracker, self._planner, self._outputs = tracker, planner, outputs
        self.model: NodeModel | None = None
        self._last_model: NodeModel | None = None
        self.hold = ""
        self.watcher: Link | None = None
        self.execution: Execution | None = None
        self.statistics = GoalStatistics()
        self._waiting: GoalRequest | None = None
        self._active: _Attempt | None = None
        self._retry: _Attempt | None = None
        self._may_cancel = True
        self._key = 0
        self._verdict = Verdict(0)
        # The motion that the watcher checks, and its number.
        self._watching: PublishedMotion | None = None
        self._watched = 0
        self._is_given_up = False

    # Set-up.

    def use(self, model: NodeModel | None, joint_names: tuple[str, ...]) -> None:
        """Use another model of some joints, or none; a running motion of others is stopped."""
        changed = "the parameters, the primitives or the robot description changed"
        self.cancel(f"{changed} during planning")
        if joint_names != self.tracker.measured.joint_names:
            reason = "the joints of the primitives have changed"
            self.release(reason)
            if self.execution is not None:
                self._report(self.execution.given_up(reason))
            self.execution = self._last_model = None
            self.tracker.expect(joint_names)
        self.model = model
        self._last_model = model or self._last_model

    def learn(self, facts: ModelFacts) -> None:
        """Use other facts of the same model: joints that do not move are elsewhere."""
        model = self.model
        if model is not None:
            robot = model.robot
            if dict(facts.locked) != dict(robot.locked_positions):
                robot = robot.locked_at(facts.locked)
            self.model = self._last_model = replace(model, robot=robot, facts=facts)

    # Goals.

    def goal(self, request: GoalRequest) -> None:
        """Receive a goal; it replaces a waiting one, and preempts one that is being planned.

        Goals may arrive faster than they can be served: the goal after a preempted one is not
        preempted in turn, so that at least every second one that is begun is finished.
        """
        model = self.model
        if model is None or self.hold:
            self.refuse(request.name, self.hold or "the robot model is not known yet")
            return
        try:  # an invalid goal preempts none
            if isinstance(request.goal, JointGoal):
                check_goal(model.robot, model.facts.limits, request.goal)
        except GoalError as error:
            self.refuse(request.name, str(error))
            return
        self._drop_waiting()
        self._waiting = request
        if self._active is not None and (self._may_cancel or self._active.is_detour):
            self._planner.cancel(self._active.key)
        self._go_on()

    @property
    def is_idle(self) -> bool:
        """Whether no goal is being served."""
        return self._active is None and self._waiting is None and self._retry is None

    def answer(self, message: object) -> None:
        """Receive the answer of a worker."""
        if isinstance(message, Planned | Rejected):
            self._answered(message)
        elif isinstance(message, Verdict):
            if message.number == self._watched:
                self._verdict = message
        elif isinstance(message, WorkerDied):
            attempt, self._active = self._active, None
            if attempt is not None and not attempt.is_dropped:
                self._failed(attempt, f"the planner has ended ({message.reason})")
            self._go_on()

    def use_watcher(self, watcher: Link | None) -> None:
        """Have another watcher, or none, check the running motion."""
        self.watcher, execution = watcher, self.execution
        if execution is not None:
            self._watch(execution.motion, is_stop=execution.is_stop)

    # Stops.

    def stop(self, reason: str = "") -> str:
        """Publish a trajectory that brings the robot to rest, and cancel all goals.

        Returns
        -------
        :
            Description of the stop, one sentence.

        Raises
        ------
        PlannerError
            If the robot's state is unknown; nothing was published then.
        """
        self.cancel("")
        return self._stop(reason, max(self._threat_time() - self.tracker.clock(), 0.0))

    def release(self, reason: str) -> None:
        """Stop the robot if it may be executing the motion of a goal."""
        execution = self.execution
        if execution is None or execution.is_stop:
            return
        # A slowed or held robot is on its way for longer; one that left its path may come back.
        is_due = self.tracker.clock() < execution.motion.began + execution.motion.duration
        if is_due or not execution.is_reported:
            self._stop_for(reason)

    def tick(self) -> None:
        """Look at the robot; call this at 20 Hz or more."""
        model = self._last_model
        if model is None:
            return
        now, execution = self.tracker.clock(), self.execution
        where = self._where(model)
        following = None if isinstance(where, GoalError) else where.following
        if execution is not None and self.tracker.motion is None:
            self._report(execution.given_up("time was set back"))
            self.execution = None
        elif execution is not None:
            report = execution.update(following, now)
            self._report(report)
            is_astray = report is not None and report.outcome is MotionOutcome.NOT_FOLLOWED
            moves = following is not None and not following.at_rest
            if is_astray and moves and self.watcher is not None:
                self._stop_for("the robot moves among obstacles, and along no known motion")
            elif execution.is_lost(following, now):
                self._stop_for(execution.reason, again=True)
        self._react(where, now)
        if self._retry is not None and self._active is None:
            attempt, self._retry = self._retry, None
            self._begin(attempt)

    def hear(self, sent: Trajectory, text: str, failure: MotionOutcome | None) -> None:
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
        """
        execution = self.execution
        if execution is None or execution.motion.sent is not sent:
            return  # it has been replaced, and was reported as such
        if failure is MotionOutcome.NEVER_STARTED:
            self.tracker.give_up()
        self._report(execution.answer(text, failure))

    # Serving one goal.

    def _go_on(self) -> None:
        """Begin the waiting goal, if the planner is free."""
        if self._active is not None or self._waiting is None:
            return
        request, self._waiting = self._waiting, None
        latency = self.statistics.expected_latency(type(request.goal))
        if isinstance(request.goal, JointGoal):
            latency = min(latency, _MAX_LOOKAHEAD)
        self._begin(_Attempt(request, latency, deadline=self.tracker.clock() + _CONFIRMATION))

    def _begin(self, attempt: _Attempt) -> None:
        """Choose a start, and ask the planner for a motion from there."""
        model, request = self.model, attempt.request
        if model is None or self.hold:
            self._failed(attempt, self.hold or "the robot model is being replaced")
            return
        now = self.tracker.clock()
        try:
            where = self.tracker.where(model.settings)
            start = choose_start(where, model.settings, attempt.lookahead)
            goal = request.goal if request.make_goal is None else request.make_goal(start.state)
        except PlannerError as error:
            # States that ceased long ago do not come back soon.
            is_heard = (self.tracker.measured.age or 0.0) <= _CONFIRMATION
            if isinstance(error, UnconfirmedError) and is_heard and now <= attempt.deadline:
                self._retry = attempt
            else:
                self._failed(attempt, str(error))
            return
        execution = self.execution
        is_free = math.isinf(self._verdict.place) and not attempt.is_detour
        repeats = execution.repeats(goal, where.following) if execution and is_free else ""
        if repeats and execution is not None:
            self._conclude(GoalOutcome.UNDER_WAY, request.name, repeats, execution.planned)
            self._may_cancel = True
            self._go_on()
            return
        self._key += 1
        attempt.key, attempt.start, attempt.began = self._key, start, now
        measured = dict(self.tracker.measured.others)
        attempt.carriers = {n: measured[n] for n in model.facts.carriers if n in measured}
        self._active = attempt
        running = self._running(start)
        self._planner.send(PlanRequest(self._key, goal, start.state, measured, running))

    def _running(self, start: MotionStart) -> RunningMotion | None:
        """The motion that a start is on, for the planner."""
        following, execution = start.following, self.execution
        if following is None or execution is None or execution.motion is not following.motion:
            return None
        if execution.planned is None:
            return None
        planned = replace(execution.planned, trajectory=following.motion.trajectory)
        return RunningMotion(planned, start.place, following.is_over)

    def _answered(self, message: Planned | Rejected) -> None:
        attempt = self._active
        if attempt is None or message.key != attempt.key:
            return
        self._active = None
        if not attempt.is_dropped:
            if isinstance(message, Rejected):
                self._rejected(attempt, message)
            else:
                self._publish_planned(attempt, message)
        self._go_on()

    def _rejected(self, attempt: _Attempt, message: Rejected) -> None:
        """Report a goal without a motion, or that there is no detour."""
        self._may_cancel = attempt.is_detour or not message.is_preempted
        if message.is_preempted and attempt.is_detour:
            return
        if message.is_preempted:
            self._drop(attempt.request)
        elif message.values.get("status") == ALREADY_THERE and not attempt.is_detour:
            name, reason = attempt.request.name, message.reason
            self._conclude(GoalOutcome.UNDER_WAY, name, reason, message)
        else:
            self._failed(attempt, message.reason, message)

    def _publish_planned(self, attempt: _Attempt, planned: Planned) -> None:
        """Join, check and publish a planned motion; plan again if it comes too late."""
        model, start, now = self.model, attempt.start, self.tracker.clock()
        assert model is not None
        assert start is not None
        try:
            where = self.tracker.where(model.settings)
            self._check_carriers(attempt)
            motion = join(planned.trajectory, start, where)
            self._check(motion, planned, start, where, model)
        except PlannerError as error:
            may_repeat = attempt.is_detour or attempt.number < _MAX_ATTEMPTS
            if not isinstance(error, TooLateError) or not may_repeat:
                self._failed(attempt, str(error))
            elif self._waiting is None:
                attempt.number += 1
                attempt.lookahead = 2.0 * max(now - attempt.began, attempt.lookahead)
                self._begin(attempt)
            elif not attempt.is_detour:
                self._drop(attempt.request)
            return
        self._may_cancel, reason = True, self._verdict.reason
        detour = f"it took a detour, because {reason}" if attempt.is_detour else ""
        execution = Execution(attempt.request.name, motion, planned, detour)
        self._publish(execution, is_detour=attempt.is_detour)
        self.statistics.served(type(planned.goal), planned.solve_time, now - attempt.began)
        if attempt.is_detour:
            self._outputs.log(f"{reason}: another motion leads to the goal")
        else:
            name, ignored = attempt.request.name, attempt.request.ignored_joints
            self._conclude(GoalOutcome.SERVED, name, "", planned, ignored)

    def _check_carriers(self, attempt: _Attempt) -> None:
        """Raise a `TooLateError` if a joint that carries the arm has moved since the request."""
        for name, position in attempt.carriers.items():
            now = self.tracker.measured.others.get(name, position)
            if abs(now - position) > _CARRIER_TOLERANCE:
                raise TooLateError(
                    f"joint '{name}', which carries the arm, moved while the motion was planned; "
                    "send the goal again when it is at rest"
                )

    def _check(
        self,
        motion: PublishedMotion,
        planned: Planned,
        start: MotionStart,
        where: Where,
        model: NodeModel,
    ) -> None:
        """Check a motion that is to be published, where it joins the present one, too.

        Raises
        ------
        TooLateError
            If it exceeds a limit there: at another place, they join within the limits.
        TrajectoryError
            If it must not be published.
        """
        check, first = planned.check, start.state
        if start.following is not None and start.following.is_running:
            check = check_limits(motion.sent, model.robot, model.facts.limits)
            if check.violations:
                raise TooLateError(
                    f"where the motion joins the one under way, the {check.violations[0]}; send "
                    "the goal again"
                )
            first = JointState(first.joint_names, motion.sent.positions[0])
            following = where.following
            assert following is not None
            if following.rate == 1.0 and motion.is_timed:
                reference = following.motion.state(following.at(motion.time))
                jump = float(np.abs(first.positions - reference.positions).max())
                if jump > _ROUNDING:
                    raise TrajectoryError(
                        f"the motion would jump by {jump:.3g} rad (or m) from the one under way"
                    )
            if start.time >= self._threat_time():
                raise GoalError(f"{self._verdict.reason} before another motion could begin")
        may_move = model.settings.allow_nonzero_end_velocity
        check_executable(motion.sent, check, first, allow_nonzero_end_velocity=may_move)

    def _publish(self, execution: Execution, *, is_detour: bool = False) -> None:
        """Publish a motion, the only place where that is done; it replaces the one before."""
        old, motion = self.execution, execution.motion
        self._outputs.send(motion, execution.planned)
        self.tracker.publish(motion)
        self.execution = execution
        if old is not None and not execution.is_stop and not is_detour:
            self._report(old.replaced())
        self._watch(motion, is_stop=execution.is_stop)

    # Obstacles.

    def _watch(self, motion: PublishedMotion, *, is_stop: bool = False) -> None:
        """Have a motion checked against the obstacles; a stop is not replaced, whatever it hits."""
        self._watched, self._watching = self._watched + 1, motion
        self._verdict, self._is_given_up = Verdict(self._watched), False
        if self.watcher is not None and not is_stop:
            place = max(motion.time - motion.began, 0.0)
            self.watcher.send(Watch(self._watched, motion.trajectory, place))

    def _threat_time(self) -> float:
        """When the running motion would hit an obstacle [s]."""
        motion = self._watching
        return math.inf if motion is None else motion.began + self._verdict.place

    def _react(self, where: Where | GoalError, now: float) -> None:
        """Replace the running motion, or stop the robot, before it hits an obstacle."""
        execution = self.execution
        following = None if isinstance(where, GoalError) else where.following
        if execution is None or execution.is_stop or self.watcher is None:
            return
        runs = following is not None and following.is_running
        # The one before, if the controller has not taken that.
        motion = following.motion if following is not None and runs else execution.motion
        if motion is not self._watching:
            self._watch(motion)
        if following is not None and following.motion is motion and following.is_over:
            return
        if following is not None and runs:
            self.watcher.send(Place(self._watched, following.place))
        verdict = self._verdict
        if not math.isfinite(verdict.place):
            return
        if following is not None and runs:
            left = (verdict.place - following.place) / max(following.rate, 0.01)
            if verdict.last < following.place:
                return  # it has passed
        elif following is not None and following.at_rest:
            left = 0.0  # when a held robot moves on is unknown
        else:
            left = self._threat_time() - now
        if left <= _RESERVE or self._is_given_up:
            reason = f"{verdict.reason}, and no other motion was found in time"
            self._stop_for(reason, time_left=max(left, 0.0))
        elif motion is not execution.motion:
            return  # nothing leads around an obstacle on that one
        elif self.is_idle and (goal := execution.rest_of_goal()):
            lookahead = max(self.statistics.expected_latency(type(goal)), _LOOKAHEAD)
            request = GoalRequest(goal, execution.name)
            self._begin(_Attempt(request, min(lookahead, left), is_detour=True))

    # Endings.

    def _where(self, model: NodeModel) -> Where | GoalError:
        try:
            return self.tracker.where(model.settings)
        except GoalError as error:
            return error

    def _stop(self, reason: str, time_left: float = math.inf, *, leaves_path: bool = False) -> str:
        model = self._last_model
        if model is None:
            raise GoalError("the robot model is not known yet, and no motion was published")
        where = self._where(model)
        arguments = (self.tracker, model.robot, model.facts.limits, model.settings, time_left)
        said, motion = find_stop(where, *arguments, leaves_path=leaves_path)
        self._publish(Execution.of_stop(self.execution, motion, reason))
        return said

    def _stop_for(self, reason: str, *, again: bool = False, time_left: float = math.inf) -> None:
        """Stop the robot without being asked to; whatever prevents that is logged."""
        self.cancel(reason)
        try:
            leaves_path = again and self.execution is not None and self.execution.is_repeated
            said = self._stop(reason, time_left, leaves_path=leaves_path)
        except PlannerError as error:
            said = f"the robot was not stopped: {error}"
        if not again:
            self._outputs.log(f"{reason}: {said}")

    def cancel(self, reason: str) -> None:
        """Cancel all goals; with a reason they are refused, else overtaken."""
        self._drop_waiting(reason)
        active = self._active
        if active is not None and not active.is_dropped:
            active.is_dropped = True
            self._planner.cancel(active.key)
            if not active.is_detour:
                self._drop(active.request, reason)
        self._may_cancel = True

    def _failed(self, attempt: _Attempt, reason: str, why: Rejected | None = None) -> None:
        """No motion serves a goal, or leads around an obstacle."""
        self._may_cancel = True
        if not attempt.is_detour:
            self.refuse(attempt.request.name, reason, why)
            return
        self._is_given_up = True
        self._outputs.log(f"{self._verdict.reason}, and no other motion was found: {reason}")

    def refuse(self, name: Any, reason: str, why: Rejected | None = None) -> None:
        """Count and report a goal that is not served."""
        self._conclude(GoalOutcome.REFUSED, name, reason, why)

    def _drop_waiting(self, reason: str = "") -> None:
        """Drop the goals that wait."""
        waiting = [self._waiting, self._retry.request if self._retry else None]
        self._waiting = self._retry = None
        for request in filter(None, waiting):
            self._drop(request, reason)

    def _drop(self, request: GoalRequest, reason: str = "") -> None:
        """Report a goal that is not planned for: with a reason it is refused, else overtaken."""
        if reason:
            self.refuse(request.name, f"{reason}; send the goal again")
            return
        text = "preempted: a newer goal or a stop came before its motion was planned"
        self._conclude(GoalOutcome.OVERTAKEN, request.name, text)

    def _conclude(
        self,
        outcome: GoalOutcome,
        name: Any,
        reason: str = "",
        planned: Planned | Rejected | None = None,
        ignored_joints: Sequence[str] = (),
    ) -> None:
        """Count and report what became of a goal."""
        self.statistics.counts[outcome] += 1
        self._outputs.report_goal(outcome, name, reason, planned, ignored_joints)

    def _report(self, report: ExecutionReport | None) -> None:
        if report is not None:
            self._outputs.report_motion(report)
