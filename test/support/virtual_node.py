# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The core of the node and a simulated robot, stepped together in virtual time.

The planning time is simulated, too, so results do not depend on the load of the machine.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import count
from typing import Any

import numpy as np
from support.problems import Scene, scene_of
from support.referee import Verdict, judge

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.execution.link import (
    Place,
    Planned,
    PlanRequest,
    Rejected,
    Watch,
)
from mp_pca_planner.execution.motions import PublishedMotion
from mp_pca_planner.execution.outcomes import Execution, ExecutionReport, GoalOutcome
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.planning import GoalPlanner, Model, assemble_model, in_world
from mp_pca_planner.execution.server import GoalRequest, MotionServer, NodeModel
from mp_pca_planner.execution.states import MeasuredStates
from mp_pca_planner.execution.tracking import StatedCommand, Tracker
from mp_pca_planner.execution.watching import Watcher
from mp_pca_planner.motion.goal import Goal, JointState
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.robot.examples import example_file
from mp_pca_planner.robot.world import World
from mp_pca_planner.simulation.robot import SimulatedRobot

STATE_PERIOD, WATCH_PERIOD = 2, 50  # in ticks of a millisecond
JERK_OF_ACCELERATION = 20.0
# Limits of MoveIt's joint_limits.yaml for the panda; UR's driver has none, 3 rad/s² is usual.
MAX_ACCELERATION = {"panda": (3.75, 1.875, 2.5, 3.125, 3.75, 5.0, 5.0), "ur5": (3.0,) * 6}


@cache
def scene_and_model(name: str, **others: Any) -> tuple[Scene, Model]:
    """A robot with acceleration and jerk limits, and the planner of its node."""
    scene = scene_of(name, *example_file(name), n_motions=30)
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


@dataclass(frozen=True)
class PlanReport:
    """Report of a goal: what became of it, and the reason."""

    name: Any
    status: GoalOutcome
    message: str
    time: float


class VirtualPlanner:
    """A planner whose answers take a simulated time; it is a link of the server, too."""

    def __init__(self, node: VirtualNode, model: Model) -> None:
        self._node, self._cancelled = node, 0
        self.core = GoalPlanner(lambda key: key <= self._cancelled)
        self.core.model = model

    def send(self, message: object) -> None:
        """Plan at once, and answer after the time that planning takes, or when it is cancelled."""
        assert isinstance(message, PlanRequest)
        node, due = self._node, self._node.draw_planning_time()
        found: list[Planned | Rejected] = []

        def answer() -> None:
            if not found:
                is_cancelled = message.key <= self._cancelled
                gone = Rejected(message.key, "", is_preempted=True)
                found.append(gone if is_cancelled else self.core.plan(message))
                node.server.answer(found[0])

        node.at(due, answer)
        self._answer = answer

    def cancel(self, key: int) -> None:
        """Cancel requests up to a key; the answer comes in the next tick."""
        self._cancelled = max(self._cancelled, key)
        self._node.at(0.0, self._answer)


class VirtualWatcher:
    """A watcher that answers at once, or after a delay [s]."""

    def __init__(self, node: VirtualNode, model: Model) -> None:
        self._node, self.core, self.delay = node, Watcher(), 0.0
        self.core.model = model

    def send(self, message: object) -> None:
        """Watch a motion, or note where the robot is."""
        assert isinstance(message, Watch | Place)
        self.core.receive(message)
        self.look()

    def cancel(self, key: int) -> None:
        """There is nothing to cancel."""

    def look(self) -> None:
        """Check the motion again, if the world or the motion is another."""
        if (verdict := self.core.look()) is not None:
            self._node.at(self.delay, lambda: self._node.server.answer(verdict))


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
    states_scaling : bool
        Whether that holds the factor of its speed; else 0, as of ros2_controllers before 4.39.
    """

    has_velocities, is_split, has_controller_state, states_scaling = True, False, False, True

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
        # With the execution that each report is of.
        self.reported: list[tuple[float, ExecutionReport, Execution]] = []
        self.stops: list[float] = []
        self.restarts: list[float] = []
        self.sent: list[tuple[float, Any, float | None, bool]] = []
        self.logged: list[str] = []
        self._random = np.random.default_rng([seed, 7])
        self._planning_time = planning_time
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self._ticks = 0
        # States that wait, and until when the node stands still, or its states do [s].
        self._waiting: list[tuple[Any, ...]] = []
        self._stated: StatedCommand | None = None
        self._stalled = self._held_back = -np.inf
        self._model, self._world = model, World()
        self.restart()

    @property
    def now(self) -> float:
        """The virtual time [s]."""
        return self.robot.time

    def draw_planning_time(self) -> float:
        """A planning time [s]."""
        return float(self._random.uniform(*self._planning_time))

    def restart(self) -> None:
        """Restart the node; it forgets what was published."""
        self.restarts.append(self.now)
        self._events.clear()
        self._stated = None
        measured = MeasuredStates(lambda: self.now, lambda: self.now)
        self.tracker = Tracker(measured, lambda: self.now)
        self.planner = VirtualPlanner(self, self._model)
        self.watcher = VirtualWatcher(self, self._model)
        self.server = MotionServer(self.tracker, self.planner, self)
        known = NodeModel(self._model.robot, self._model.facts, self._model.settings)
        self.server.use(known, self._model.robot.joint_names)
        self.use_world(self._world)

    def use_world(self, world: World) -> None:
        """Have other obstacles."""
        self._world = self.planner.core.world = self.watcher.core.world = world
        if len(world):
            if self.server.watcher is None:
                in_world(self._model, world)
                self.server.use_watcher(self.watcher)
            self.watcher.look()

    def at(self, delay: float, action: Callable[[], None]) -> None:
        """Call a function after a delay [s]."""
        heapq.heappush(self._events, (self.now + delay, next(self._order), action))

    def goal(self, goal: Goal, name: Any) -> None:
        """Receive a goal, which replaces a waiting one."""
        self.poll()
        self.server.goal(GoalRequest(goal, name))

    def stop(self) -> str:
        """Call the service ~/stop."""
        self.stops.append(self.now)
        self.poll()
        try:
            return self.server.stop()
        except PlannerError as error:
            return f"nothing was published: {error}"

    def verdict(
        self,
        cuts: Iterable[int] = (),
        joins: Iterable[int] = (),
        finest: float = 2e-7,
        first: int = 0,
    ) -> Verdict:
        """What the referee says of all commands, or of those from one on."""
        record, limits = self.robot.record, self._model.limits
        names = ("lower", "upper", "velocity", "acceleration", "jerk")
        return judge(
            record.q[first:],
            record.clock[first:],
            {name: getattr(limits, name) for name in names},
            time=record.times[first:],
            cuts=[x - first for x in (*record.cuts, *cuts)],
            joins=[x - first for x in joins],
            finest=finest,
        )

    def run(self, duration: float) -> None:
        """Advance the time [s]."""
        end = self.now + duration
        while self.now < end:
            self._tick()

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
            for stamp, *state in self._waiting:
                self.tracker.measured.receive(*state, stamp=stamp)
            self._waiting.clear()
            self._state_command()
        if self._ticks % WATCH_PERIOD == 0:
            self.poll()
            self.server.tick()
        while self._events and self._events[0][0] <= self.now:
            self.poll()
            heapq.heappop(self._events)[2]()

    def _state_command(self) -> None:
        """Note what the controller states of itself in this tick."""
        controller = self.robot.controller
        is_stated = self.has_controller_state and controller.is_active
        if not is_stated or self._ticks % STATE_PERIOD:
            return
        scaling = controller.speed_scaling if self.states_scaling else 0.0
        state = JointState(self.robot.joint_names, *controller.stated()[0])
        self._stated = StatedCommand(state, scaling, self.now)

    def poll(self) -> None:
        """Receive what the controller has stated last, as the node does before it looks."""
        if self._stated is not None:
            self.tracker.receive(self._stated)
            self._stated = None

    def _measure(self) -> None:
        """Send the joint states of this tick."""
        names = self._model.robot.joint_names
        turn, half = self._ticks % STATE_PERIOD, len(names) // 2
        if self.robot.faults.silent or (turn and not self.is_split):
            return
        q, v = self.robot.measured_state()
        joints = (slice(half), slice(half, None))[turn] if self.is_split else slice(None)
        v = v if self.has_velocities else np.full_like(v, np.nan)
        self._waiting.append((self.now, names[joints], q[joints], v[joints].tolist()))

    # What the server does.

    def send(self, motion: PublishedMotion, _: Planned | None) -> None:
        """Send a motion to the robot."""
        message = motion.sent, motion.stamp
        self.sent.append((self.now, *message, not motion.is_path_known))
        self.robot.send(*message, last_point_only=not motion.is_path_known)

    def report_motion(self, report: ExecutionReport) -> None:
        """Keep the report of a motion."""
        self.execution_reports.append((self.now, report))
        if self.server.execution is not None:
            self.reported.append((self.now, report, self.server.execution))

    def report_goal(
        self,
        outcome: GoalOutcome,
        name: Any,
        reason: str = "",
        planned: Planned | Rejected | None = None,
        ignored_joints: Sequence[str] = (),
    ) -> None:
        """Keep the report of a goal."""
        self.plan_reports.append(PlanReport(name, outcome, reason, self.now))

    def log(self, text: str) -> None:
        """Keep what was logged."""
        self.logged.append(text)
