# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""States of the robot, and the thread that watches it with them and stops it.

It does so whatever the other threads do.
"""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress
from functools import partial
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from ..execution.serving.motion_monitor import MotionMonitor
from ..execution.threads import SAFETY_WAIT, BusyError, TimedLock
from ..execution.tracking.estimation import ControllerStates
from ..execution.tracking.measured import MeasuredStates
from ..input_limits import INPUT_LIMITS
from .controller import (
    HAS_CONTROL_MSGS,
    ControllerAction,
    JointTrajectoryControllerState,
    to_command,
)
from .goal_messages import GoalTopics, read_stamp
from .messages import read_states, to_seconds, to_state
from .nodes import STATES, GuardedNode, PolledSubscription, ThreadGroup
from .planning_setup import PlanningSetup

_READING_TIME = 0.005  # the longest for all joint states that wait [s]
_MOST_STOPS = 100  # requests that are answered with one stop
_NEWEST_STATE = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class RobotStates:
    """Receives the joint states of the robot and its command; any thread may poll them.

    Parameters
    ----------
    node : GuardedNode
        The node.

    Attributes
    ----------
    measured : MeasuredStates
        The states; they are polled before the newest one is used.
    """

    def __init__(self, node: GuardedNode) -> None:
        self._node = node
        self._subscription = PolledSubscription(node, JointState, "joint_states", STATES)
        # The topic of the controller, its subscription, and what keeps its commands.
        self._controller: tuple[str, PolledSubscription, ControllerStates] | None = None
        self._polling, self._polled = TimedLock(), time.monotonic()
        self.measured = MeasuredStates(time.monotonic, node.seconds, self.poll)

    def use_controller(self, topic: str, commands: ControllerStates) -> None:
        """Receive the command of the controller from a topic, where control_msgs is installed."""
        with self._polling:
            old = self._controller
            if not HAS_CONTROL_MSGS or (old is not None and old[0] == topic):
                return
            subscription = PolledSubscription(
                self._node, JointTrajectoryControllerState, topic, _NEWEST_STATE
            )
            self._controller = topic, subscription, commands
            if old is not None:
                old[1].destroy()

    def poll(self) -> None:
        """Poll the waiting states; their age counts from when the middleware got them."""
        # Another thread that polls takes them, too.
        with suppress(BusyError), self._polling.within(SAFETY_WAIT):
            self._poll_controller()
            last, self._polled = self._polled, time.monotonic()
            deadline, waiting = time.monotonic() + _READING_TIME, self._subscription.poll()
            for k, (content, facts) in enumerate(waiting, start=1):
                if k < len(waiting) and time.monotonic() > deadline:
                    continue  # too many, or too large: the newest one counts
                message = read_states(content)
                read = partial(to_state, message)
                age = (time.time_ns() - facts["received_timestamp"]) * 1e-9
                # At most the time since the last poll, because the wall clock may have been set.
                age = min(max(age, 0.0), time.monotonic() - last)
                stamp, number = message.header.stamp, facts.get("publication_sequence_number")
                self.measured.receive(message.name, read, to_seconds(stamp), age, number or 0)

    def _poll_controller(self) -> None:
        if self._controller is None:
            return
        _, subscription, commands = self._controller
        for content, facts in subscription.poll():
            if len(content) <= INPUT_LIMITS.state_bytes:
                age = min(max((time.time_ns() - facts["received_timestamp"]) * 1e-9, 0.0), 1.0)
                stamp = to_seconds(read_stamp(content))
                commands.receive(partial(to_command, content), stamp, age)


class SafetyThread:
    """Watches the robot at 20 Hz and answers ``~/stop``.

    What it calls reads no files, builds no models, plans nothing and waits at most 5 ms for a lock.
    It runs in real time where the system permits it.

    Parameters
    ----------
    node : GuardedNode
        The node.
    states : RobotStates
        The states of the robot.
    setup : PlanningSetup
        Has the model of the motion of a goal.
    monitor : MotionMonitor
        Checks how the robot follows its motion.
    goals : GoalTopics
        Stops the robot on request, and reacts to obstacles in another thread.
    action : ControllerAction
        Cancels a goal whose stop is not answered.
    """

    period = 0.01
    """Longest time to wait for a request [s]."""

    watch_period = 0.05
    """Time between two checks [s]."""

    def __init__(
        self,
        node: GuardedNode,
        states: RobotStates,
        setup: PlanningSetup,
        monitor: MotionMonitor,
        goals: GoalTopics,
        action: ControllerAction,
    ) -> None:
        self._states, self._setup, self._monitor, self._goals = states, setup, monitor, goals
        self._action = action
        # An executor would give the lock of the interpreter away several times a cycle.
        self._stops: Any = node.create_service(
            Trigger, "~/stop", goals.stop, callback_group=ThreadGroup()
        )
        self._wait_set = _rclpy.WaitSet(0, 0, 0, 0, 1, 0, node.context.handle)
        self._answer = node.guarded(self._answer_stop)
        self._check = node.guarded(self._watch_in_turn)
        self._watched = self._cycled = time.monotonic()
        self._longest_gap = 0.0
        self._is_ending = False
        self._thread = threading.Thread(target=self._run, name="safety", daemon=True)
        self._thread.start()

    def longest_gap(self) -> float:
        """The longest time between two cycles since the last call, also of the present one [s]."""
        longest, self._longest_gap = self._longest_gap, 0.0
        return max(longest, time.monotonic() - self._cycled)

    def close(self) -> None:
        """End the thread, before the node is destroyed."""
        self._is_ending = True
        self._thread.join()

    def _run(self) -> None:
        # The others keep their priority: with a lower one, they would keep the lock of the
        # interpreter for longer while other processes are busy.
        with suppress(OSError):  # the user may not (ulimit -r)
            lowest = os.sched_param(os.sched_get_priority_min(os.SCHED_RR))
            os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, lowest)
        while not self._is_ending:
            self._wait()
            now = time.monotonic()
            self._longest_gap = max(self._longest_gap, now - self._cycled)
            self._cycled = now
            self._answer()
            self._check()

    def _wait(self) -> None:
        """Wait for a request, a millisecond at least, because this thread goes before others."""
        time.sleep(1e-3)
        try:
            self._wait_set.clear_entities()
            self._wait_set.add_service(self._stops.handle)
            self._wait_set.wait(round(1e9 * self.period))
        except RuntimeError:  # rclpy's; the robot is watched all the same
            time.sleep(self.period)

    def _answer_stop(self) -> None:
        """Answer all requests with one stop: those that wait, and those that come meanwhile."""
        waiting = self._take_requests()
        if not waiting:
            return
        response = self._stops.callback(Trigger.Request(), Trigger.Response())
        self._respond(waiting, response)
        if later := self._take_requests():
            if not (response.success and self._goals.stays_stopped()):
                response = self._stops.callback(Trigger.Request(), Trigger.Response())
            self._respond(later, response)

    def _take_requests(self) -> list[Any]:
        """The headers of the requests that wait."""
        handle, headers = self._stops.handle, list[Any]()
        with handle:
            for _ in range(_MOST_STOPS):
                _, header = handle.service_take_request(Trigger.Request)
                if header is None:
                    break
                headers.append(header)
        return headers

    def _respond(self, headers: list[Any], response: Trigger.Response) -> None:
        for header in headers:
            self._stops.send_response(response, header)

    def _watch_in_turn(self) -> None:
        if self._cycled - self._watched < self.watch_period:
            return
        self._states.poll()
        self._answer()  # many states take a while
        self._action.watch()
        monitor, context = self._monitor, self._setup.last_context
        if context is not None:
            try:
                monitor.watch(context)
            except BusyError:  # another thread publishes a motion just now
                return
        if monitor.surroundings.threat is not None:
            self._goals.react()
        self._watched = self._cycled
