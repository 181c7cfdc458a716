# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals, stops and replacements, judged by what a controller commands after them.

Time is the tests' own; planning takes as long as they say.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("trajectory_msgs", reason="ROS 2 messages are not installed")

from arm import JOINTS, arm_primitive
from controller import Controller, RefusedMessageError
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from mp_pca_planner.exceptions import GoalError, PlannerError
from mp_pca_planner.goal import JointGoal, JointState, SequenceGoal
from mp_pca_planner.resources import config_file
from mp_pca_planner.ros.assembly import Model, assemble_model
from mp_pca_planner.ros.goal_statistics import GoalStatistics
from mp_pca_planner.ros.motion_server import MotionServer, UnexecutablePlanError
from mp_pca_planner.ros.newest_goal import CancelledError
from mp_pca_planner.ros.parameters import Settings
from mp_pca_planner.ros.start_state import StartStates, TooLateError
from mp_pca_planner.ros.trajectory_bytes import serialize_trajectory
from mp_pca_planner.trajectory import Trajectory
from mp_pca_planner.validation import check_limits

URDF = config_file("human_arm.urdf").read_text(encoding="utf-8")
MOTION = arm_primitive().boundary_states[0]
START, GOAL = MOTION[0], MOTION[3]
MAX_VELOCITY, MAX_ACCELERATION = 3.0, 40.0
LIMITS = {
    name: {"max_velocity": MAX_VELOCITY, "max_acceleration": MAX_ACCELERATION} for name in JOINTS
}
SETTINGS = Settings(start_from="commanded", limits=LIMITS)
MODEL = assemble_model(URDF, [arm_primitive()], SETTINGS)


class MinimumJerk:
    """A planner that is fast: one quintic to the goal, as long as the way needs."""

    def __init__(self, model: Model) -> None:
        self._model = model

    def plan(self, goal: JointGoal, start: JointState) -> Any:
        way = np.abs(goal.state.positions - start.positions).max()
        duration = max(0.3, 1.0 * way, np.abs(start.velocities).max() / 4.0)
        q = [start.positions, goal.state.positions]
        v, a = ([x, np.zeros(4)] for x in (start.velocities, start.accelerations))
        trajectory = Trajectory(JOINTS, [0.0, duration], q, v, a)
        check = check_limits(trajectory, self._model.robot, self._model.limits)
        return SimpleNamespace(
            trajectory=trajectory,
            limit_check=check,
            is_executable=not check.violations,
            message="",
            solve_time=0.0,
        )


@dataclass
class World:
    """A robot that does what its controller commands, and the server that commands it."""

    model: Model = MODEL
    now: float = 10.0
    planning_time: float = 0.01
    rate: float = 1.0  # of the robot's time to that in which planning is measured

    def __post_init__(self) -> None:
        self.controller = Controller(JOINTS, START, self.now)
        self.states = StartStates(self, lambda: self.now, lambda: self.now, self._measure)
        self.states.expect(JOINTS)
        self.server = MotionServer(
            self.states, GoalStatistics(), self._send, lambda: self.now / self.rate
        )
        self.sent: list[JointTrajectory] = []

    def serve(self, positions: Any, planner: Any = None) -> None:
        """Plan while time passes."""
        inner = planner or self.model.planner

        def plan(goal: JointGoal, start: JointState) -> Any:
            self.now += self.planning_time
            return inner.plan(goal, start)

        model = replace(self.model, planner=SimpleNamespace(plan=plan))
        goal = JointGoal(JointState(JOINTS, positions))
        self.server.serve(JointGoal, lambda _: goal, model, lambda: False)

    def serve_sequence(self, *targets: Any, times: tuple[float | None, ...] = ()) -> int:
        """Plan a sequence while time passes; returns how often it was planned."""
        model, n_plans = replace(self.model), 0
        inner = model.sequence_planner

        def plan(*request: Any) -> Any:
            nonlocal n_plans
            n_plans += 1
            self.now += self.planning_time
            return inner.plan(*request)

        vars(model)["sequence_planner"] = SimpleNamespace(plan=plan)
        goal = SequenceGoal(tuple(JointState(JOINTS, q) for q in targets), times)
        self.server.serve(SequenceGoal, lambda _: goal, model, lambda: False)
        return n_plans

    def names_all(self, message: bytes, joint_names: Any) -> bool:
        return True

    def read(self, message: bytes, joint_names: Any) -> JointState:
        return JointState(JOINTS, *self.controller.state[:2])

    def _measure(self) -> None:
        self.controller.run_until(self.now)
        self.states.receive(b"")

    def _send(self, trajectory: Trajectory, last_point_only: bool) -> None:
        raw = serialize_trajectory(trajectory, with_efforts=False, last_point_only=last_point_only)
        self.sent.append(deserialize_message(raw, JointTrajectory))
        self.controller.receive(self.sent[-1], self.now)


@pytest.fixture
def world() -> World:
    return World()


def assert_smooth(controller: Controller) -> None:
    """No command is further from the one before than the limits let a joint go in a cycle.

    A controller starts a message in its next cycle, and the sender can't see how far off that is:
    where one message replaces another, and only there, it may skip what is left of a cycle.
    """
    rounding = 1.0 + 1e-4
    q, v, a = controller.commands().transpose(1, 0, 2)
    assert np.abs(v).max() <= MAX_VELOCITY * rounding
    assert np.abs(a).max() <= MAX_ACCELERATION * rounding
    cycles = np.ones(len(q) - 1)
    cycles[np.array(controller.replaced, dtype=int) - 1] = 2.0
    time = cycles[:, None] * controller.period * rounding
    assert np.all(np.abs(np.diff(q, axis=0)) <= MAX_VELOCITY * time)
    assert np.all(np.abs(np.diff(v, axis=0)) <= MAX_ACCELERATION * time)


def follow_random_sequences(n: int, planner: Any = None) -> tuple[int, int]:
    """Goals and stops at random times; returns how many goals were served, and sent in motion."""
    random = np.random.default_rng(3)
    low, high = np.minimum(START, GOAL), np.maximum(START, GOAL)
    n_served = n_moving = 0
    for _ in range(n):
        world = World(now=float(random.uniform(0.0, 1e5)))
        for _ in range(int(random.integers(2, 5))):
            world.planning_time = float(random.uniform(0.0, 0.1))
            try:
                if random.random() < 0.15:
                    world.server.stop(world.model)
                else:
                    n_moving += world.states.running is not None
                    world.serve(random.uniform(low, high), planner)
                    n_served += 1
            except (UnexecutablePlanError, TooLateError):
                continue  # published nothing
            world.now += float(
                random.choice([0.0, random.uniform(0.0, 0.7), 3.0], p=[0.1, 0.7, 0.2])
            )
        if world.sent:
            end = world.sent[-1].points[-1].time_from_start
            world.controller.run_until(world.now + end.sec + end.nanosec * 1e-9 + 0.01)
        assert_smooth(world.controller)
        assert not np.any(world.controller.state[1])
    return n_served, n_moving


def test_thousand_random_sequences_of_goals_and_stops_are_followed_without_a_jump() -> None:
    n_served, n_moving = follow_random_sequences(1000, MinimumJerk(MODEL))
    assert n_served > 2000
    assert n_moving > 900


def test_random_sequences_are_followed_without_a_jump_as_they_are_really_planned(
    request: pytest.FixtureRequest,
) -> None:
    n = request.config.getoption("--planned-sequences")
    n_served, n_moving = follow_random_sequences(n)
    assert n_served > 2 * n
    assert n_moving > 0.9 * n


def test_planned_motions_replace_each_other_without_a_jump(world: World) -> None:
    for positions in (GOAL, START, 0.5 * (START + GOAL), GOAL):
        world.serve(positions)
        world.now += 0.4
    world.controller.run_until(world.now + 5.0)
    assert len(world.sent) == 4
    assert_smooth(world.controller)
    np.testing.assert_allclose(world.controller.state[0], GOAL, atol=1e-12)


def test_slow_planning_is_made_up_for_by_another_attempt(world: World) -> None:
    world.serve(GOAL)
    world.now += 0.3
    world.planning_time = 0.15  # more than expected after one goal in 0.01 s
    world.serve(START)
    assert len(world.sent) == 2
    world.controller.run_until(world.now + 5.0)
    assert_smooth(world.controller)


def test_robot_may_be_simulated_faster_than_it_is_planned_for() -> None:
    world = World(rate=20.0, planning_time=0.2)
    for positions in (GOAL, START, GOAL):
        world.serve(positions)
        world.now += 0.4
    world.controller.run_until(world.now + 5.0)
    assert len(world.sent) == 3
    assert_smooth(world.controller)


def test_stop_is_one_point_at_rest_that_is_reached_without_a_jump(world: World) -> None:
    world.serve(GOAL)
    world.now += 0.4
    assert "rest" in world.server.stop(world.model)
    (point,) = world.sent[-1].points
    assert list(point.velocities) == list(point.accelerations) == [0.0] * 4
    here, velocity, _ = world.controller.state
    assert np.abs(velocity).max() > 0.1
    world.controller.run_until(world.now + 5.0)
    assert_smooth(world.controller)
    assert not np.any(world.controller.state[1])
    way = np.abs(world.controller.state[0] - here).max()
    assert 0.0 < way < 0.2


def test_stop_of_a_robot_at_rest_stays_where_it_is(world: World) -> None:
    world.server.stop(world.model)
    assert list(world.sent[-1].points[0].positions) == START.tolist()


def test_stop_that_no_limit_allows_holds_the_position_and_says_so(world: World) -> None:
    world.serve(GOAL)
    world.now += 0.4
    tight = world.model.robot.limits({name: {"max_acceleration": 1e-6} for name in JOINTS})
    assert "no stop within the limits" in world.server.stop(replace(world.model, limits=tight))
    assert len(world.sent[-1].points) == 1


def test_stop_needs_to_know_where_the_robot_is(world: World) -> None:
    world.states.expect(("other",))
    world.states.receive(b"")
    world.states.expect(JOINTS)
    world.server._states._fetch = lambda: None
    with pytest.raises(GoalError, match="joint_states"):
        world.server.stop(world.model)
    assert not world.sent


def test_cancelled_goal_publishes_nothing(world: World) -> None:
    goal = JointGoal(JointState(JOINTS, GOAL))
    with pytest.raises(CancelledError):
        world.server.serve(JointGoal, lambda _: goal, world.model, lambda: True)
    assert not world.sent


def test_goal_that_is_cancelled_during_the_solve_ends_it(world: World) -> None:
    asked = iter([False] * 5)
    goal = JointGoal(JointState(JOINTS, GOAL))
    with pytest.raises(CancelledError):
        world.server.serve(JointGoal, lambda _: goal, world.model, lambda: next(asked, True))
    assert next(asked, None) is None


def test_refused_goal_leaves_the_running_motion_alone(world: World) -> None:
    world.serve(GOAL)
    world.now += 0.2
    with pytest.raises(PlannerError, match="outside its limits"):
        world.serve(GOAL + 100.0)
    world.controller.run_until(world.now + 5.0)
    np.testing.assert_allclose(world.controller.state[0], GOAL, atol=1e-12)


def test_sequence_passes_its_vias_without_a_stop_or_a_jump(world: World) -> None:
    via = START + 0.6 * (GOAL - START)
    began = world.now
    world.serve_sequence(via, GOAL, START, times=(None, 2.0, None))
    world.controller.run_until(world.now + 10.0)
    assert_smooth(world.controller)
    q, v, _ = world.controller.commands().transpose(1, 0, 2)
    passed = int(np.abs(q - via).max(axis=1).argmin())
    # As near as commands are to each other.
    assert np.abs(q[passed] - via).max() < MAX_VELOCITY * world.controller.period
    assert np.abs(v[passed]).max() > 0.1
    at_goal = round((world.now + 2.0 - began) / world.controller.period)
    near = slice(at_goal - 3, at_goal + 3)
    assert np.abs(q[near] - GOAL).max(axis=1).min() < MAX_VELOCITY * world.controller.period
    np.testing.assert_allclose(q[-1], START, atol=1e-12)


def test_sequence_takes_a_moving_robot_over_though_single_goals_were_faster(world: World) -> None:
    world.serve(GOAL)
    world.now += 0.3
    world.planning_time = 0.5
    assert world.serve_sequence(START + 0.5 * (GOAL - START), START) > 1
    world.now += 0.3
    # What sequences take is known by now.
    assert world.serve_sequence(GOAL, START) == 1
    world.controller.run_until(world.now + 10.0)
    assert_smooth(world.controller)
    np.testing.assert_allclose(world.controller.state[0], START, atol=1e-12)


def test_sequence_that_is_cancelled_during_the_solve_publishes_nothing(world: World) -> None:
    asked = iter([False] * 5)
    goal = SequenceGoal((JointState(JOINTS, GOAL), JointState(JOINTS, START)))
    with pytest.raises(CancelledError):
        world.server.serve(SequenceGoal, lambda _: goal, world.model, lambda: next(asked, True))
    assert next(asked, None) is None
    assert not world.sent


def test_sequence_that_breaks_limits_is_not_published(world: World) -> None:
    with pytest.raises(UnexecutablePlanError, match="no motion within the limits was found"):
        world.serve_sequence(GOAL, START, times=(0.05, 0.1))
    assert not world.sent


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda m: m.points.clear(), "empty"),
        (lambda m: m.joint_names.append("more"), "joints"),
        (lambda m: m.points[-1].velocities.__setitem__(0, 1e-17), "velocity"),
        (lambda m: m.points[1].positions.__setitem__(0, float("nan")), "finite"),
        (lambda m: m.points.reverse(), "increase"),
    ],
)
def test_controller_of_these_tests_refuses_what_the_real_one_does(
    world: World, spoil: Any, reason: str
) -> None:
    world.serve(GOAL)
    spoil(world.sent[-1])
    with pytest.raises(RefusedMessageError, match=reason):
        world.controller.receive(world.sent[-1], world.now)


def test_controller_of_these_tests_sees_a_jump(world: World) -> None:
    world.serve(GOAL)
    late = world.sent[-1]
    world.now += 0.3
    world.controller.receive(late, world.now)
    with pytest.raises(AssertionError):
        assert_smooth(world.controller)
