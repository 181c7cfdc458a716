# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The core of the node and a simulated robot, stepped together in virtual time.

The planning time is simulated, too, so results do not depend on the load of the machine.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from types import SimpleNamespace
from typing import Any

import numpy as np
from support.problems import Scene, scene_of

from mp_pca_planner.cli.example_robots import robot_file
from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.serving.assembly import Model, assemble_model
from mp_pca_planner.execution.serving.execution import (
    Execution,
    ExecutionReport,
    GoalOutcome,
)
from mp_pca_planner.execution.serving.motion_monitor import MotionMonitor
from mp_pca_planner.execution.serving.motion_server import (
    GoalRequest,
    GoalStatistics,
    MotionServer,
)
from mp_pca_planner.execution.tracking.estimation import StatedCommand
from mp_pca_planner.execution.tracking.following import MotionFollower
from mp_pca_planner.execution.tracking.measured import MeasuredStates
from mp_pca_planner.execution.tracking.published_motion import PublishedMotion
from mp_pca_planner.motion.goal import Goal, JointState
from mp_pca_planner.planning.plan import ALREADY_THERE
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.simulation.robot import SimulatedRobot

STATE_PERIOD, WATCH_PERIOD = 2, 50  # in ticks of a millisecond
JERK_OF_ACCELERATION = 20.0
# Limits of MoveIt's joint_limits.yaml for the panda; UR's driver has none, 3 rad/s² is usual.
MAX_ACCELERATION = {"panda": (3.75, 1.875, 2.5, 3.125, 3.75, 5.0, 5.0), "ur5": (3.0,) * 6}


def scene_and_model(name: str, **others: Any) -> tuple[Scene, Model]:
    """A robot with acceleration and jerk limits, and the planner of its node."""
    scene = scene_of(*robot_file(name), n_motions=30)
    joints = scene.robot.joint_names
    limits = {
        joint: {"max_acceleration": most, "max_jerk": JERK_OF_ACCELERATION * most}
        for joint, most in zip(joints, MAX_ACCELERATION[name], strict=True)
    }
    primitive = build_primitive(scene.demonstrations, name, PrimitiveOptions("arm", 8))
    urdf = scene.urdf.read_text(encoding="utf-8")
    options = {"max_solve_time": 60.0, **others}
    still = {name: 0.0 for name in scene.robot.movable_joints if name not in joints}
    settings = Settings(limits=limits, **options)
    return scene, assemble_model(urdf, [primitive], settings, still)


def receive(
    measured: MeasuredStates,
    stamp: float,
    q: Any,
    v: Any,
    names: Sequence[str] = (),
    joints: slice = slice(None),
) -> None:
    """Measure a state of some of the joints of a robot; by default of those that are needed."""
    names = names or measured.joint_names
    values = {name: (x, y) for name, x, y in zip(names, q, v, strict=True)}

    def read(wanted: Any) -> JointState:
        return JointState(wanted, *zip(*(values[name] for name in wanted), strict=True))

    measured.receive(names[joints], read, stamp)


@dataclass(frozen=True)
class PlanReport:
    """Report of a goal: what became of it, and the reason."""

    name: Any
    status: GoalOutcome
    message: str
    time: float


class VirtualNode:
    """The core of the node, connected to a simulated robot.

    Parameters
    ----------
    model : Model
        The planner and its settings.
    start : array, shape (n_joints,)
        Positions of the robot [rad or m].
    seed : int
        Seed of the robot and of the planning times.
    planning_time : tuple of float
        Shortest and longest planning time [s].

    Attributes
    ----------
    has_velocities : bool
        Whether joint states report velocities; broadcasters publish NaN where there are none.
    is_split : bool
        Whether joint states come in two messages, one after the other.
    has_controller_state : bool
        Whether the node receives the state of the controller.
    """

    has_velocities, is_split, has_controller_state = True, False, False

    def __init__(
        self,
        model: Model,
        start: Any,
        *,
        seed: int = 0,
        planning_time: tuple[float, float] = (0.005, 0.05),
    ) -> None:
        self.robot = SimulatedRobot(model.robot, start, seed=seed)
        self.plan_reports: list[PlanReport] = []
        self.execution_reports: list[tuple[float, ExecutionReport]] = []
        self.reported: list[tuple[float, ExecutionReport, Execution]] = []
        self.stops: list[float] = []
        self.restarts: list[float] = []
        self.sent: list[tuple[float, Any, float | None, bool]] = []
        self._random = np.random.default_rng([seed, 7])
        self._planning_time = planning_time
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self._ticks = 0
        # States that wait, and until when the node stands still, or its states do [s].
        self._waiting: list[tuple[Any, ...]] = []
        self._stalled = self._held_back = -np.inf
        self._pending: tuple[Any, Goal] | None = None
        self._may_cancel = True
        self._model = replace(model, planner=self._slow(model.planner, "plan"))
        self.restart()

    @property
    def now(self) -> float:
        """The virtual time [s]."""
        return self.robot.time

    def restart(self) -> None:
        """Restart the node; it forgets what was published."""
        self.restarts.append(self.now)
        self._pending, self._may_cancel = None, True
        self.follower = MotionFollower(MeasuredStates(lambda: self.now, lambda: self.now))
        self.follower.expect(self._model.robot.joint_names)
        self.monitor = MotionMonitor(self.follower, self._send, lambda: self.now, self._report)
        self.server = MotionServer(self.monitor, GoalStatistics(), self.advance)

    def at(self, delay: float, action: Callable[[], None]) -> None:
        """Call a function after a delay [s]."""
        heapq.heappush(self._events, (self.now + delay, next(self._order), action))

    def goal(self, goal: Goal, name: Any) -> None:
        """Receive a goal, which replaces a waiting one."""
        if self._pending is not None:
            self._answer(self._pending[0], GoalOutcome.OVERTAKEN, "")
        self._pending = name, goal

    def stop(self) -> str:
        """Call the service ~/stop."""
        if self._pending is not None:
            self._answer(self._pending[0], GoalOutcome.OVERTAKEN, "")
            self._pending = None
        self._is_cancelled = True
        self.stops.append(self.now)
        try:
            return self.monitor.stop(self._model)
        except PlannerError as error:
            return f"nothing was published: {error}"

    def run(self, duration: float) -> None:
        """Advance the time [s] and serve goals."""
        end = self.now + duration
        while self.now < end:
            if self._pending is None:
                self._tick()
            else:
                self._serve()

    def advance(self, duration: float) -> None:
        """Advance the time while the node plans [s]."""
        for _ in range(max(round(duration * 1e3), 1)):
            self._tick()

    def _serve(self) -> None:
        assert self._pending is not None
        (name, goal), self._pending = self._pending, None
        self._is_cancelled = False

        def is_cancelled() -> bool:
            newer = self._pending is not None and self._may_cancel
            self._is_cancelled = self._is_cancelled or newer
            return self._is_cancelled

        try:
            served = self.server.serve(GoalRequest(goal, self._model, name), is_cancelled)
        except CancelledError:
            self._may_cancel = False
            self._answer(name, GoalOutcome.OVERTAKEN, "")
        except PlannerError as error:
            self._may_cancel = True
            is_there = getattr(getattr(error, "plan", None), "status", "") == ALREADY_THERE
            outcome = GoalOutcome.UNDER_WAY if is_there else GoalOutcome.REFUSED
            self._answer(name, outcome, str(error))
            self.advance(0.001)
        else:
            self._may_cancel = True
            outcome = GoalOutcome.UNDER_WAY if served.under_way else GoalOutcome.SERVED
            self._answer(name, outcome, served.under_way)
            self.advance(0.001)

    def _slow(self, planner: Any, name: str) -> Any:
        """A planner with a simulated planning time, in which it may be cancelled."""

        def plan(*request: Any) -> Any:
            cancellation = self._model.cancellation
            for _ in range(round(self._random.uniform(*self._planning_time) * 1e3)):
                if cancellation():
                    break
                self._tick()
            return getattr(planner, name)(*request)

        others = ("target", "check", "is_too_far", "primitives", "collision")
        kept = {other: getattr(planner, other) for other in others if hasattr(planner, other)}
        return SimpleNamespace(**{name: plan}, **kept)

    def stall(self, duration: float, *, of_states: bool = False) -> None:
        """Let the node, or its joint states on their way, stand still from now on [s].

        What comes meanwhile is received at the end, at once.
        """
        if of_states:
            self._held_back = self.now + duration
        else:
            self._stalled = self.now + duration

    def _tick(self) -> None:
        """Advance by a millisecond, and on to the end of a stall of the node."""
        self._step()
        while self.now < self._stalled:
            self._step()

    def _step(self) -> None:
        self.robot.step()
        self._ticks += 1
        self._measure()
        if self.now < self._stalled:
            return
        if self.now >= self._held_back:
            for state in self._waiting:
                receive(self.follower.measured, *state)
            self._waiting.clear()
            self._state_command()
        if self._ticks % WATCH_PERIOD == 0:
            with suppress(PlannerError):
                self.monitor.surroundings.look_ahead(self._model)
            self.monitor.watch(self._model)
        while self._events and self._events[0][0] <= self.now:
            heapq.heappop(self._events)[2]()

    def _state_command(self) -> None:
        """Receive what the controller states of itself in this tick."""
        controller = self.robot.controller
        is_stated = self.has_controller_state and controller.is_active
        if not is_stated or self._ticks % STATE_PERIOD:
            return
        names, scaling = self.robot.joint_names, controller.speed_scaling
        state, since_ns = controller.stated()
        reference = state.copy()

        def read(wanted: Sequence[str]) -> StatedCommand:
            columns = reference[:, [names.index(name) for name in wanted]]
            command = JointState(tuple(wanted), *columns)
            return StatedCommand(command, 1e-9 * since_ns, scaling)

        self.follower.controller.receive(read, 1e-9 * self.robot.time_ns)

    def _measure(self) -> None:
        """Send the joint states of this tick."""
        turn, half = self._ticks % STATE_PERIOD, len(self._model.robot.joint_names) // 2
        if self.robot.faults.silent or (turn and not self.is_split):
            return
        q, v = self.robot.measured_state()
        joints = (slice(half), slice(half, None))[turn] if self.is_split else slice(None)
        # The reader of messages makes zeros of velocities that are NaN.
        v = v if self.has_velocities else np.zeros_like(v)
        self._waiting.append((self.now, q, v, self.robot.joint_names, joints))

    def _send(self, motion: PublishedMotion) -> None:
        message = motion.sent, motion.stamp
        self.sent.append((self.now, *message, motion.last_point_only))
        self.robot.send(*message, last_point_only=motion.last_point_only)

    def _report(self, report: ExecutionReport) -> None:
        self.execution_reports.append((self.now, report))
        execution = self.follower.execution
        if execution is not None:
            self.reported.append((self.now, report, execution))

    def _answer(self, name: Any, status: GoalOutcome, message: str) -> None:
        self.plan_reports.append(PlanReport(name, status, message, self.now))
